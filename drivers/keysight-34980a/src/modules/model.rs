//! The module models, with the data of the tables of section 3.

use std::fmt;
use std::time::Duration;

use survey::{Amps, RelayLimits, Timing, Volts};

use crate::meter::reading_timing;

/// A switch module that fits a slot of the mainframe.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Model {
    /// 40 two-wire armature relays and 4 current channels.
    M34921A,
    /// 70 two-wire armature relays.
    M34922A,
    /// 40 two-wire reed relays.
    M34923A,
    /// 70 two-wire reed relays.
    M34924A,
    /// 40 two-wire FET switches.
    M34925A,
    /// Dual 4 x 8 armature matrix.
    M34931A,
    /// Dual 4 x 16 armature matrix.
    M34932A,
    /// Dual 4 x 8 reed matrix.
    M34933A,
    /// Reed matrix whose terminal block determines its layout.
    M34934A,
}

impl Model {
    /// All models.
    pub const ALL: [Self; 9] = [
        Self::M34921A,
        Self::M34922A,
        Self::M34923A,
        Self::M34924A,
        Self::M34925A,
        Self::M34931A,
        Self::M34932A,
        Self::M34933A,
        Self::M34934A,
    ];

    /// The name in the reply to `SYST:CTYP?`, without a layout.
    pub fn name(self) -> &'static str {
        match self {
            Self::M34921A => "34921A",
            Self::M34922A => "34922A",
            Self::M34923A => "34923A",
            Self::M34924A => "34924A",
            Self::M34925A => "34925A",
            Self::M34931A => "34931A",
            Self::M34932A => "34932A",
            Self::M34933A => "34933A",
            Self::M34934A => "34934A",
        }
    }

    /// Time to close a relay; zero for a FET, whose time is negligible.
    pub fn close_time(self) -> Duration {
        match self {
            Self::M34921A | Self::M34922A | Self::M34931A | Self::M34932A => {
                Duration::from_millis(4)
            }
            Self::M34923A | Self::M34924A | Self::M34933A => Duration::from_micros(500),
            Self::M34934A => Duration::from_micros(350),
            Self::M34925A => Duration::ZERO,
        }
    }

    /// Time to open a relay.
    pub fn open_time(self) -> Duration {
        match self {
            Self::M34934A => Duration::from_micros(100),
            other => other.close_time(),
        }
    }

    /// Channels a second in a scan; `None` for a module that cannot be scanned.
    pub fn scan_rate(self) -> Option<u32> {
        match self {
            Self::M34921A | Self::M34922A => Some(100),
            Self::M34923A | Self::M34924A => Some(500),
            Self::M34925A => Some(1000),
            Self::M34931A | Self::M34932A | Self::M34933A | Self::M34934A => None,
        }
    }

    /// Whether the relays keep their state without power; ABus relays never do.
    pub fn latching(self) -> bool {
        matches!(
            self,
            Self::M34921A | Self::M34922A | Self::M34931A | Self::M34932A
        )
    }

    /// The times of the module's relays and of readings. For a module that cannot be scanned, 100 channels a second are
    /// assumed.
    pub fn timing(self, nplc: f64, line_hz: f64) -> Timing {
        Timing {
            relay_close: self.close_time(),
            relay_open: self.open_time(),
            scan_period: Duration::from_secs(1) / self.scan_rate().unwrap_or(100),
            ..reading_timing(nplc, line_hz)
        }
    }

    /// Limits of the module's relays, for checking a plan. A 34933A is assumed to have its in-rush resistors.
    pub fn relay_limits(self) -> RelayLimits {
        let (current, voltage) = match self {
            Self::M34921A | Self::M34922A | Self::M34931A | Self::M34932A => (1.0, 300.0),
            Self::M34923A | Self::M34924A | Self::M34933A => (0.05, 150.0),
            Self::M34925A => (0.02, 80.0),
            Self::M34934A => (0.5, 100.0),
        };
        RelayLimits {
            current: Amps(current),
            voltage: Volts(voltage),
        }
    }

    /// Maximum number of coils energised at the same time in the slot and in each bank (of closed channels, where coils
    /// are not the limit).
    pub(super) fn most_coils(self) -> (u32, u32) {
        match self {
            Self::M34923A | Self::M34924A => (40, 20),
            Self::M34933A => (40, 40),
            Self::M34934A => (64, 64),
            _ => (u32::MAX, u32::MAX),
        }
    }

    /// Channels of bank 1; bank 2 has as many.
    pub(super) fn bank_size(self) -> Option<u32> {
        match self {
            Self::M34921A | Self::M34923A | Self::M34925A => Some(20),
            Self::M34922A | Self::M34924A => Some(35),
            _ => None,
        }
    }
}

impl fmt::Display for Model {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
