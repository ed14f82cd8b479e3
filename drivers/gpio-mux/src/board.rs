//! A board whose lines are on this machine's own gpiochip, as a [`Switch`].

use std::time::Duration;

use rig::{LinkError, Move, RigError, Switch};
use survey::{Electrode, Relay};

use crate::chip::{GpioChip, GpioFault};
use crate::command::{Pole, State};
use crate::lines::{Chip, Levels, Line, steps};
use crate::moves::state_after;

/// A multiplexer board on the lines of a chip.
///
/// Every change is made in three steps: enables off, addresses, enables on. Each step is read back before the next. A
/// line that does not follow ends the change; every enable that can be switched off is then switched off.
#[derive(Debug)]
pub struct GpioBoard<C> {
    chip: C,
    instrument: String,
    electrodes: usize,
    settling: Duration,
}

impl<C: GpioChip> GpioBoard<C> {
    /// Takes the lines and switches every enable off.
    ///
    /// # Errors
    /// [`LinkError::Lost`] for a chip that is gone, [`RigError::StillClosed`] for an enable that stays on,
    /// [`RigError::Unable`] for more electrodes than the 32 of two chips a pole.
    pub fn new(chip: C, electrodes: usize, settling: Duration) -> Result<Self, RigError> {
        let instrument = format!("GPIO board on {}", chip.name());
        let mut board = Self {
            chip,
            instrument,
            electrodes,
            settling,
        };
        if electrodes > 32 {
            return Err(board.unable(format!(
                "connect {electrodes} electrodes: it has 32, two 16-way chips for each pole"
            )));
        }
        board.all_off()?;
        Ok(board)
    }

    /// Reads back the electrodes on the poles.
    ///
    /// # Errors
    /// [`LinkError::Lost`] for a chip that is gone.
    pub fn state(&mut self) -> Result<State, RigError> {
        Ok(self.levels()?.state())
    }

    /// Switches every enable off and verifies that they are off.
    ///
    /// # Errors
    /// [`LinkError::Lost`] for a chip that is gone, [`RigError::StillClosed`] for an enable that stays on.
    pub fn all_off(&mut self) -> Result<(), RigError> {
        let enables = Pole::ALL.map(Levels::enables).into_iter().sum();
        let outcome = self.chip.set(enables, 0);
        outcome.map_err(|fault| self.broken(fault))?;
        self.refuse_joined(|_| true)
    }

    /// Fails with [`RigError::StillClosed`] if any relay that `meant` selects is closed.
    fn refuse_joined(&mut self, meant: impl Fn(Relay) -> bool) -> Result<(), RigError> {
        let joined = self.levels()?.joined();
        let relays: Vec<Relay> = joined.into_iter().filter(|relay| meant(*relay)).collect();
        if relays.is_empty() {
            return Ok(());
        }
        Err(RigError::StillClosed {
            instrument: self.instrument.clone(),
            relays,
        })
    }

    fn levels(&mut self) -> Result<Levels, RigError> {
        let outcome = self.chip.read();
        outcome.map_err(|fault| self.broken(fault))
    }

    /// The error for a chip that cannot be used: the same as for the broken link of a serial board, because its lines
    /// must be requested again when the chip is back.
    fn broken(&self, fault: GpioFault) -> RigError {
        RigError::Link(LinkError::Lost {
            instrument: self.instrument.clone(),
            message: String::new(),
            cause: Some(std::io::Error::other(fault)),
        })
    }

    fn unable(&self, what: String) -> RigError {
        RigError::Unable {
            instrument: self.instrument.clone(),
            what,
        }
    }

    fn pole_and_electrode(&self, relay: Relay) -> Result<(Pole, Electrode), RigError> {
        let place = Pole::of(relay).filter(|(_, electrode)| {
            electrode.0 < self.electrodes && Chip::of(*electrode).is_some()
        });
        place.ok_or_else(|| {
            self.unable(format!(
                "move relay {relay}: its relays are pole x 100 + electrode, poles 1 to 4, electrodes 1 to {}",
                self.electrodes
            ))
        })
    }

    fn apply(&mut self, from: State, to: State) -> Result<(), RigError> {
        for step in steps(from, to) {
            let outcome = self.chip.set(step.mask, step.bits);
            outcome.map_err(|fault| self.broken(fault))?;
            let read = self.levels()?;
            let wrong = (read.0 ^ step.bits) & step.mask;
            if let Some(line) = Line::all().find(|line| line.mask() & wrong != 0) {
                // The first line that did not follow is reported; enables that stay on are found when the caller makes
                // the rig safe.
                self.all_off().ok();
                return Err(RigError::Mismatch {
                    instrument: self.instrument.clone(),
                    setting: format!("line {line}"),
                    set: u8::from(step.bits & line.mask() != 0).to_string(),
                    read: u8::from(read.is_set(line)).to_string(),
                });
            }
        }
        Ok(())
    }
}

impl<C: GpioChip> Switch for GpioBoard<C> {
    async fn move_relays(&mut self, moves: &[Move]) -> Result<(), RigError> {
        let from = self.state()?;
        // checked before any line is set
        let place = |relay| self.pole_and_electrode(relay);
        let to = state_after(from, moves, place, |what| self.unable(what))?;
        self.apply(from, to)?;
        if from != to && !self.settling.is_zero() {
            tokio::time::sleep(self.settling).await;
        }
        Ok(())
    }

    /// Does nothing: a move has settled when it returns.
    async fn settle(&mut self) -> Result<(), RigError> {
        Ok(())
    }

    async fn closed(&mut self, relays: &[Relay]) -> Result<Vec<bool>, RigError> {
        for relay in relays {
            self.pole_and_electrode(*relay)?;
        }
        let joined = self.levels()?.joined();
        Ok(relays.iter().map(|relay| joined.contains(relay)).collect())
    }

    async fn open_verified(&mut self, relays: &[Relay]) -> Result<(), RigError> {
        let mut mask = 0;
        let joined = self.levels()?.joined();
        for relay in relays {
            let (pole, electrode) = self.pole_and_electrode(*relay)?;
            if joined.contains(relay)
                && let Some(chip) = Chip::of(electrode)
            {
                mask |= Line::Enable(pole, chip).mask();
            }
        }
        // a gpiochip rejects a request without lines
        if mask != 0 {
            let outcome = self.chip.set(mask, 0);
            outcome.map_err(|fault| self.broken(fault))?;
        }
        self.refuse_joined(|relay| relays.contains(&relay))
    }
}
