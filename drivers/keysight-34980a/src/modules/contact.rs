//! The switch behind a channel number on each kind of module.

use super::Model;

/// One switch of a module, identified by a channel number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Contact {
    /// A channel of a multiplexer: connects its two wires to the bank's common.
    Channel {
        /// 1 or 2.
        bank: u32,
    },
    /// A current channel of a 34921A.
    Current {
        /// 1 or 2.
        bank: u32,
    },
    /// Connects a bank's common (a multiplexer) or a row (a matrix) to an analogue bus.
    AnalogBus {
        /// 1 or 2; on a matrix always 2.
        bank: u32,
        /// 1 to 4. The voltmeter is on bus 1.
        bus: u32,
    },
    /// A cross point.
    Cross {
        /// Number of the matrix on the module, from 1.
        matrix: u32,
        /// Row, as the module numbers it (5 to 8 on the second matrix of a dual one).
        row: u32,
        /// Column, from 1.
        column: u32,
    },
}

impl Contact {
    /// The bank of a multiplexer's channel or of an ABus relay.
    pub fn bank(self) -> Option<u32> {
        match self {
            Self::Channel { bank } | Self::Current { bank } | Self::AnalogBus { bank, .. } => {
                Some(bank)
            }
            Self::Cross { .. } => None,
        }
    }
}

pub(super) fn multiplexer(model: Model, size: u32, channel: u32) -> Option<Contact> {
    match channel {
        911..=914 => Some(Contact::AnalogBus {
            bank: 1,
            bus: channel - 910,
        }),
        921..=924 => Some(Contact::AnalogBus {
            bank: 2,
            bus: channel - 920,
        }),
        // The sources do not state to which bank a current channel belongs; the bank with the nearer numbers is
        // assumed.
        41..=44 if model == Model::M34921A => Some(Contact::Current {
            bank: if channel <= 42 { 1 } else { 2 },
        }),
        _ if channel >= 1 && channel <= size => Some(Contact::Channel { bank: 1 }),
        _ if channel > size && channel <= 2 * size => Some(Contact::Channel { bank: 2 }),
        _ => None,
    }
}

/// The contact of a dual matrix. Rows 1 to 4 are matrix 1, rows 5 to 8 matrix 2; only matrix 2 connects to the ABus.
pub(super) fn dual_matrix(channel: u32, columns: u32) -> Option<Contact> {
    if (921..=924).contains(&channel) {
        return Some(Contact::AnalogBus {
            bank: 2,
            bus: channel - 920,
        });
    }
    let (row, column) = (channel / 100, channel % 100);
    ((1..=8).contains(&row) && (1..=columns).contains(&column)).then_some(Contact::Cross {
        matrix: if row <= 4 { 1 } else { 2 },
        row,
        column,
    })
}

/// The contact of a 34934A channel. The channels of each row begin at a number of its own; those of further matrices
/// follow in the same row.
pub(super) fn large_matrix(rows: u32, columns: u32, channel: u32) -> Option<Contact> {
    let matrices = match (rows, columns) {
        (4, 32) => 4,
        (4, 64) | (8, 32) => 2,
        _ => 1,
    };
    let first = |row: u32| match rows {
        4 => 100 * (2 * row - 1),
        8 => 100 * row,
        _ => 50 * (row + 1),
    };
    (1..=rows).find_map(|row| {
        let offset = channel.checked_sub(first(row) + 1)?;
        (offset < columns * matrices).then_some(Contact::Cross {
            matrix: offset / columns + 1,
            row,
            column: offset % columns + 1,
        })
    })
}
