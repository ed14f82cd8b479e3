//! A frame with given readings; all its other fields have arbitrary fixed values.

use std::time::Duration;

use chrono::{DateTime, Utc};
use survey::{Amps, Frame, Protocol, Reading, Settings, Volts};

/// Wall time of a second.
pub fn at(second: i64) -> DateTime<Utc> {
    DateTime::from_timestamp(1_700_000_000 + second, 0).unwrap()
}

/// A frame of this protocol, taken at this second.
pub fn taken(protocol: &Protocol, number: u64, second: i64, readings: Vec<Reading>) -> Frame {
    Frame {
        extra: Vec::new(),
        sequence: number,
        readings,
        monotonic: Duration::from_secs(second as u64),
        wall: at(second),
        duration: Duration::from_millis(900),
        settings: Settings {
            precautions: survey::Precautions::default(),
            protocol_hash: protocol.hash(),
            current: Amps(1e-3),
            range: Volts(1.0),
            nplc: 1.0,
            settle: Duration::ZERO,
            wiring: "w".into(),
        },
        compliance: Vec::new(),
        simulated: true,
    }
}
