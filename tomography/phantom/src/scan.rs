//! Frames straight from a phantom, in time that nobody waits for: what an ideal voltmeter is given, reading by reading.
//!
//! No instrument and no text is between sheet and frame here, so compliance, ranges and digits are the bench's to show.
//! Times follow the fact sheet's formula (section 2.2): T = drives x settle + readings x (switching + NPLC / f_line).

use std::time::Duration;

use survey::{Amps, Dipole, Ohms, Protocol, ProtocolError, Relay, Volts};

use crate::effects::ReadingContext;
use crate::sheet::{Phantom, PhantomError};

/// How frames are taken.
#[derive(Debug, Clone, PartialEq)]
pub struct Scan {
    /// What is asked.
    pub protocol: Protocol,
    /// Of every injection.
    pub current: Amps,
    /// The source's range.
    pub source_range: Amps,
    /// The voltmeter's range.
    pub range: Volts,
    /// Integration in power-line cycles.
    pub nplc: f64,
    /// The voltmeter's resolution at this integration as a part of its range.
    pub resolution: f64,
    /// Of the mains.
    pub line_hz: f64,
    /// Waited after the current has moved.
    pub settle: Duration,
    /// What a channel takes to change.
    pub switching: Duration,
    /// From the start of a frame to the start of the next, where that is longer than a frame.
    pub every: Duration,
    /// How many frames.
    pub frames: usize,
}

impl Scan {
    /// What a session asks that says nothing else: the adjacent pattern, 1 mA, 1 NPLC at 50 Hz on the 1 V range of a
    /// 6.5-digit voltmeter, reed relays; one frame after the other.
    ///
    /// # Errors
    /// A ring for which there is no pattern.
    pub fn usual(electrodes: usize) -> Result<Self, ProtocolError> {
        Ok(Self {
            protocol: Protocol::sheffield(electrodes)?,
            current: Amps(1e-3),
            source_range: Amps(2e-3),
            range: Volts(1.0),
            nplc: 1.0,
            resolution: 3e-6,
            line_hz: 50.0,
            settle: Duration::from_millis(2),
            switching: Duration::from_millis(2),
            every: Duration::ZERO,
            frames: 1,
        })
    }

    /// How long the voltmeter integrates.
    pub fn integration(&self) -> Duration {
        survey::duration(self.nplc / self.line_hz)
    }

    /// How long a frame takes.
    pub fn frame_time(&self) -> Duration {
        let readings = u32::try_from(self.protocol.len()).unwrap_or(u32::MAX);
        let drives = u32::try_from(self.protocol.drives().len()).unwrap_or(u32::MAX);
        self.settle * drives + (self.switching + self.integration()) * readings
    }

    /// When a frame begins, the first being 0.
    pub fn begin(&self, frame: usize) -> Duration {
        let step = self.every.max(self.frame_time());
        step * u32::try_from(frame).unwrap_or(u32::MAX)
    }

    /// How each reading of a frame is taken that begins at a moment; resistances are not filled in.
    pub(crate) fn contexts(&self, begin: Duration) -> impl Iterator<Item = ReadingContext> {
        let integration = self.integration();
        let mut at = begin;
        let mut changed = begin;
        let mut driven: Option<Dipole> = None;
        self.protocol.measurements().iter().map(move |asked| {
            if driven != Some(asked.drive) {
                driven = Some(asked.drive);
                changed = at;
                at += self.settle;
            }
            at += self.switching + integration;
            ReadingContext {
                at,
                integration,
                range: self.range,
                nplc: self.nplc,
                resolution: self.resolution,
                relay: Some(channel(asked.sense)),
                flowing: self.current,
                source_range: self.source_range,
                since_change: at - changed,
                source_resistance: Ohms(0.0),
                load_resistance: Ohms(0.0),
            }
        })
    }

    /// The readings of a frame that begins at a moment no earlier than the last.
    ///
    /// # Errors
    /// A sheet that cannot be solved.
    pub fn frame(
        &self,
        phantom: &mut Phantom,
        begin: Duration,
    ) -> Result<Vec<Volts>, PhantomError> {
        let needs = phantom.needs();
        let asked = self.protocol.measurements().iter();
        asked
            .zip(self.contexts(begin))
            .map(|(asked, context)| {
                let z = phantom.transfer_impedance(context.at)?;
                let exact = self.current.0 * across(z, asked.sense, asked.drive);
                let seen = |needed: bool, pair: Dipole| {
                    Ohms(if needed { across(z, pair, pair) } else { 0.0 })
                };
                let context = ReadingContext {
                    source_resistance: seen(needs.source_resistance, asked.sense),
                    load_resistance: seen(needs.load_resistance, asked.drive),
                    ..context
                };
                Ok(phantom.reading(Volts(exact), context))
            })
            .collect()
    }
}

/// Transfer impedance from one pair to another, ohm, out of the matrix Z of [`Phantom::transfer_impedance`].
pub fn across(z: &nalgebra::DMatrix<f64>, sense: Dipole, drive: Dipole) -> f64 {
    let seen = |electrode: usize| z[(sense.plus.0, electrode)] - z[(sense.minus.0, electrode)];
    seen(drive.plus.0) - seen(drive.minus.0)
}

/// The channel of a pair on a module in slot 1 that has a pair a channel.
pub(crate) fn channel(sense: Dipole) -> Relay {
    Relay(1001 + u32::try_from(sense.plus.0.min(sense.minus.0)).unwrap_or(u32::MAX - 1001))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_takes_what_the_formula_says() {
        let scan = Scan::usual(26).unwrap();
        let last = scan.contexts(Duration::ZERO).last().unwrap();
        assert_eq!(last.at, scan.frame_time());
        assert_eq!(
            last.at,
            Duration::from_millis(26 * 2) + Duration::from_millis(22) * 598
        );
        assert_eq!(scan.begin(2), 2 * scan.frame_time());
    }
}
