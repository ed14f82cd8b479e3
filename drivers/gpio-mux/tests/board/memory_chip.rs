//! A chip in memory that records every edge.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use gpio_mux::{GpioChip, GpioFault, LINES, Levels, Line};

/// A change of a line's level.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct LineEdge {
    /// Time of the edge by the chip's clock.
    pub(crate) at: Duration,
    /// The line.
    pub(crate) line: Line,
    /// The new level.
    pub(crate) level: bool,
}

/// Number of edges kept; older ones are dropped.
const EDGES: usize = 65_536;

#[derive(Debug)]
struct Pins {
    levels: Levels,
    /// Lines that are stuck, and their levels.
    stuck: u32,
    stuck_at: u32,
    edges: VecDeque<LineEdge>,
    clock: Duration,
    set_time: Duration,
    gone: Option<String>,
}

/// A chip in memory. Clones are handles of the same chip. Every call that sets lines advances its clock by `set_time`.
#[derive(Debug, Clone)]
pub(crate) struct MemoryChip(Arc<Mutex<Pins>>);

impl MemoryChip {
    /// All lines low at time zero.
    pub(crate) fn new(set_time: Duration) -> Self {
        Self(Arc::new(Mutex::new(Pins {
            levels: Levels::default(),
            stuck: 0,
            stuck_at: 0,
            edges: VecDeque::new(),
            clock: Duration::ZERO,
            set_time,
            gone: None,
        })))
    }

    fn pins(&self) -> MutexGuard<'_, Pins> {
        // A thread that panicked while it held the lock left complete levels behind.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The last edges, oldest first.
    pub(crate) fn edges(&self) -> Vec<LineEdge> {
        self.pins().edges.iter().copied().collect()
    }

    /// The levels at the multiplexers.
    pub(crate) fn levels(&self) -> Levels {
        self.pins().levels
    }

    /// Makes a line stick at a level.
    pub(crate) fn stick(&self, line: Line, level: bool) {
        let mut pins = self.pins();
        pins.stuck |= line.mask();
        let bits = if level { line.mask() } else { 0 };
        pins.stuck_at = pins.stuck_at & !line.mask() | bits;
        pins.change(line.mask(), bits);
    }

    /// Ends a fault of [`MemoryChip::stick`]. The line keeps its level until it is set again.
    pub(crate) fn unstick(&self, line: Line) {
        self.pins().stuck &= !line.mask();
    }

    /// Unplugs the chip (with a reason) or plugs it in again. While it is unplugged, the pull resistors hold every line
    /// low.
    pub(crate) fn unplug(&self, reason: Option<&str>) {
        let mut pins = self.pins();
        pins.gone = reason.map(str::to_owned);
        if pins.gone.is_some() {
            let all = (1 << LINES) - 1;
            pins.change(all, 0);
        }
    }

    fn fault(&self, attempt: &'static str) -> Result<(), GpioFault> {
        match &self.pins().gone {
            None => Ok(()),
            Some(reason) => Err(GpioFault {
                chip: self.name().to_owned(),
                attempt,
                reason: reason.clone(),
            }),
        }
    }
}

impl Pins {
    /// Stuck lines do not change.
    fn change(&mut self, mask: u32, bits: u32) {
        let wanted = self.levels.with(mask, bits).with(self.stuck, self.stuck_at);
        for line in Line::all() {
            let level = wanted.is_set(line);
            if level != self.levels.is_set(line) {
                if self.edges.len() == EDGES {
                    self.edges.pop_front();
                }
                let at = self.clock;
                self.edges.push_back(LineEdge { at, line, level });
            }
        }
        self.levels = wanted;
    }
}

impl GpioChip for MemoryChip {
    fn name(&self) -> &str {
        "the chip in memory"
    }

    fn set(&mut self, mask: u32, bits: u32) -> Result<(), GpioFault> {
        self.fault("set")?;
        // as the kernel does
        if mask == 0 {
            return Err(GpioFault {
                chip: self.name().to_owned(),
                attempt: "set",
                reason: "no lines".to_owned(),
            });
        }
        let mut pins = self.pins();
        let set_time = pins.set_time;
        pins.clock += set_time;
        pins.change(mask, bits);
        Ok(())
    }

    fn read(&mut self) -> Result<Levels, GpioFault> {
        self.fault("read")?;
        Ok(self.levels())
    }
}
