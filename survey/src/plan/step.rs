//! One step of a frame, and its text form.

use std::fmt;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::{Dipole, Relay, Volts};

/// One channel of a scan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Channel {
    /// The relay that the voltmeter closes.
    pub relay: Relay,
    /// The pair that the relay connects.
    pub sense: Dipole,
    /// Index of its reading in the frame; `None` if the protocol does not contain it: it is then stored in
    /// [`crate::Frame::extra`], and its overload is ignored.
    pub reading: Option<usize>,
    /// The voltmeter's range; `None` for the one range of the session.
    pub range: Option<Volts>,
}

/// One pair joined to the voltmeter and read.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Routed {
    /// The pair.
    pub sense: Dipole,
    /// Relays of the previous pair, to open.
    pub open: Vec<Relay>,
    /// Relays of this pair, to close.
    pub close: Vec<Relay>,
    /// Index of the reading in the frame.
    pub reading: usize,
    /// The voltmeter's range; `None` for the one range of the session.
    pub range: Option<Volts>,
}

/// One step of a frame. A frame is stopped only between steps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "step")]
pub enum Step {
    /// Source to 0 A and off, read back; every injecting and measuring relay open. The first and the last step.
    AllOff,
    /// Close relays that stay closed for the whole frame.
    Bus {
        /// To close.
        close: Vec<Relay>,
    },
    /// Source to 0 A, open the previous pair, close the next, source on at the plan's current.
    Break {
        /// Where the current goes.
        drive: Dipole,
        /// Relays of the previous pair, to open.
        open: Vec<Relay>,
        /// Relays of this pair, to close.
        close: Vec<Relay>,
    },
    /// Close the next pair, then open the previous one, with the source on.
    Overlap {
        /// Where the current goes.
        drive: Dipole,
        /// Relays of this pair, to close.
        close: Vec<Relay>,
        /// Relays of the previous pair, to open.
        open: Vec<Relay>,
    },
    /// Reverse the current through the same pair; subsequent readings count with the opposite sign.
    Reverse {
        /// Where the current goes.
        drive: Dipole,
    },
    /// Wait for sheet and source.
    Settle {
        /// How long.
        wait: Duration,
    },
    /// The voltmeter scans these channels in one message.
    Scan {
        /// In the wiring's order.
        channels: Vec<Channel>,
    },
    /// Join another pair to the voltmeter: open, then close.
    Route {
        /// The pair.
        sense: Dipole,
        /// Relays of the previous pair, to open.
        open: Vec<Relay>,
        /// Relays of this pair, to close.
        close: Vec<Relay>,
    },
    /// Read the routed pair.
    Read {
        /// Index of the reading in the frame.
        reading: usize,
        /// The voltmeter's range; `None` for the one range of the session.
        range: Option<Volts>,
    },
    /// Route and read one pair after the other, all in one message.
    Chain {
        /// In the order of the readings.
        routes: Vec<Routed>,
    },
    /// Query the source's compliance state; if it was in compliance, this injection's readings count as not measured.
    /// Sent while the voltmeter reads, when the relays have settled.
    Compliance {
        /// The injection concerned.
        drive: Dipole,
    },
}

impl Step {
    /// Whether the voltmeter reads in this step.
    pub fn reads(&self) -> bool {
        matches!(
            self,
            Self::Scan { .. } | Self::Read { .. } | Self::Chain { .. }
        )
    }

    /// The index and range of each reading of this step that the protocol has.
    pub(super) fn readings(&self) -> Vec<(usize, Option<Volts>)> {
        match self {
            Self::Scan { channels } => channels
                .iter()
                .filter_map(|channel| Some((channel.reading?, channel.range)))
                .collect(),
            Self::Chain { routes } => routes
                .iter()
                .map(|route| (route.reading, route.range))
                .collect(),
            Self::Read { reading, range } => vec![(*reading, *range)],
            _ => Vec::new(),
        }
    }
}

fn list(relays: &[Relay]) -> String {
    if relays.is_empty() {
        return "none".to_owned();
    }
    relays
        .iter()
        .map(Relay::to_string)
        .collect::<Vec<_>>()
        .join(",")
}

/// Formats as `; ranges 1 V: 3-4,4-5; 100 mV: 5-6`; empty if no range is set.
fn ranges(pairs: impl Iterator<Item = (Dipole, Option<Volts>)>) -> String {
    let mut groups: Vec<(Volts, Vec<String>)> = Vec::new();
    for (pair, range) in pairs {
        let Some(range) = range else { continue };
        match groups.iter_mut().find(|(known, _)| *known == range) {
            Some((_, group)) => group.push(pair.to_string()),
            None => groups.push((range, vec![pair.to_string()])),
        }
    }
    groups.sort_by(|a, b| b.0.0.total_cmp(&a.0.0));
    groups
        .iter()
        .map(|(range, pairs)| format!("; on {range}: {}", pairs.join(",")))
        .collect()
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::AllOff => write!(f, "all off: source 0 A and off, read back; relays open"),
            Self::Bus { close } => write!(f, "bus: close {}", list(close)),
            Self::Break { drive, open, close } => write!(
                f,
                "break to {drive}: 0 A, open {}, close {}, source on",
                list(open),
                list(close)
            ),
            Self::Overlap { drive, close, open } => write!(
                f,
                "overlap to {drive}: close {}, open {}, source on",
                list(close),
                list(open)
            ),
            Self::Reverse { drive } => write!(f, "reverse the current at {drive}"),
            Self::Settle { wait } => write!(f, "settle {wait:?}"),
            Self::Scan { channels } => write!(
                f,
                "scan {} pairs, {} of them in the protocol{}",
                channels.len(),
                channels
                    .iter()
                    .filter(|channel| channel.reading.is_some())
                    .count(),
                ranges(
                    channels
                        .iter()
                        .map(|channel| (channel.sense, channel.range))
                )
            ),
            Self::Route { sense, open, close } => write!(
                f,
                "route {sense}: open {}, close {}",
                list(open),
                list(close)
            ),
            Self::Read { reading, range } => {
                write!(f, "read m{reading}")?;
                match range {
                    Some(range) => write!(f, " on {range}"),
                    None => Ok(()),
                }
            }
            Self::Chain { routes } => {
                write!(f, "route and read {} pairs in one message", routes.len())?;
                f.write_str(&ranges(
                    routes.iter().map(|route| (route.sense, route.range)),
                ))
            }
            Self::Compliance { drive } => write!(f, "query the source's compliance at {drive}"),
        }
    }
}
