//! Simulated acquisition of frames without instruments or waiting: the context of each reading.
//!
//! Times follow the fact sheet's formula (section 2.2): T = drives x settle + readings x (switching + NPLC / f_line).

use std::time::Duration;

use survey::{Amps, Dipole, Ohms, Protocol, ProtocolError, Relay, Volts};

/// The conditions of a reading that effects may depend on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReadingContext {
    /// End of the reading.
    pub at: Duration,
    /// Duration of the integration up to the end of the reading.
    pub integration: Duration,
    /// The voltmeter's range.
    pub range: Volts,
    /// Integration in power-line cycles.
    pub nplc: f64,
    /// The voltmeter's resolution at this integration as a share of its range; effects use it as noise.
    pub resolution: f64,
    /// The channel to the voltmeter; `None` for the voltmeter's direct input.
    pub relay: Option<Relay>,
    /// The current that flows: that set at the source, or less in compliance.
    pub flowing: Amps,
    /// The source's range.
    pub source_range: Amps,
    /// Time from the last change of current or relays to the reading's end.
    pub since_change: Duration,
    /// Resistance between the voltmeter's terminals, looking into the sheet; computed only if [`crate::Needs`] requests
    /// it.
    pub source_resistance: Ohms,
    /// Load resistance of the source; computed only if [`crate::Needs`] requests it.
    pub load_resistance: Ohms,
}

impl ReadingContext {
    /// Time from the last change to the beginning of the integration.
    pub(crate) fn settled(&self) -> Duration {
        self.since_change.saturating_sub(self.integration)
    }

    /// Mean of exp(-t / tau) over the integration, t since the last change; tau in s.
    pub(crate) fn mean_left_after(&self, tau: f64) -> f64 {
        let begin = self.settled().as_secs_f64() / tau;
        let length = self.integration.as_secs_f64() / tau;
        let mean = if length > 0.0 {
            -(-length).exp_m1() / length
        } else {
            1.0
        };
        (-begin).exp() * mean
    }
}

/// Settings of the acquisition of frames.
#[derive(Debug, Clone, PartialEq)]
pub struct Scan {
    /// The measurements.
    pub protocol: Protocol,
    /// Current of every injection.
    pub current: Amps,
    /// The source's range.
    pub source_range: Amps,
    /// The voltmeter's range.
    pub range: Volts,
    /// Integration in power-line cycles.
    pub nplc: f64,
    /// The voltmeter's resolution at this integration as a share of its range.
    pub resolution: f64,
    /// Mains frequency, Hz.
    pub line_hz: f64,
    /// Delay after a change of the current.
    pub settle: Duration,
    /// Switching time of a channel.
    pub switching: Duration,
    /// Period of the frames, if longer than a frame.
    pub every: Duration,
    /// Number of frames.
    pub frames: usize,
}

impl Scan {
    /// The defaults of a session: the adjacent pattern, 1 mA, 1 NPLC at 50 Hz on the 1 V range of a 6.5-digit
    /// voltmeter, reed relays, frames without a pause.
    ///
    /// # Errors
    /// The pattern does not exist for this number of electrodes.
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

    /// Integration time of a reading.
    pub fn integration(&self) -> Duration {
        survey::duration(self.nplc / self.line_hz)
    }

    /// Duration of a frame.
    pub fn frame_time(&self) -> Duration {
        let readings = u32::try_from(self.protocol.len()).unwrap_or(u32::MAX);
        let drives = u32::try_from(self.protocol.drives().len()).unwrap_or(u32::MAX);
        self.settle * drives + (self.switching + self.integration()) * readings
    }

    /// Start of a frame; 0 for the first.
    pub fn begin(&self, frame: usize) -> Duration {
        let step = self.every.max(self.frame_time());
        step * u32::try_from(frame).unwrap_or(u32::MAX)
    }

    /// The context of each reading of a frame that starts at `begin`, without resistances.
    pub(crate) fn contexts(&self, begin: Duration) -> impl Iterator<Item = ReadingContext> {
        let integration = self.integration();
        let mut at = begin;
        let mut changed = begin;
        let mut driven: Option<Dipole> = None;
        self.protocol.measurements().iter().map(move |requested| {
            if driven != Some(requested.drive) {
                driven = Some(requested.drive);
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
                relay: Some(channel(requested.sense)),
                flowing: self.current,
                source_range: self.source_range,
                since_change: at - changed,
                source_resistance: Ohms(0.0),
                load_resistance: Ohms(0.0),
            }
        })
    }
}

/// Transfer impedance from one pair to another, ohm, from the matrix Z of [`crate::Phantom::transfer_impedance`].
pub fn across(z: &nalgebra::DMatrix<f64>, sense: Dipole, drive: Dipole) -> f64 {
    let seen = |electrode: usize| z[(sense.plus.0, electrode)] - z[(sense.minus.0, electrode)];
    seen(drive.plus.0) - seen(drive.minus.0)
}

/// The channel of a pair on a module in slot 1 with one pair per channel.
pub(crate) fn channel(sense: Dipole) -> Relay {
    Relay(1001 + u32::try_from(sense.plus.0.min(sense.minus.0)).unwrap_or(u32::MAX - 1001))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn duration_of_a_frame_follows_the_formula() {
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
