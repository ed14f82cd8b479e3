//! The channels of each module, their functions and times: fact sheet section 3, as plain tables.
//!
//! A channel is numbered within its slot (`36`, `911`); a [`Relay`] with its slot (`1036`, `1911`).

mod contact;
mod model;
#[cfg(test)]
mod tests;

use std::fmt;
use std::str::FromStr;

use survey::Relay;

pub use contact::Contact;
use contact::{dual_matrix, large_matrix, multiplexer};
pub use model::Model;

/// The terminal block of a module. It determines which channels of a matrix exist, and how many wires each switches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Terminal {
    /// No terminal block: on a 34934A no channel may then close.
    None,
    /// The block with the module's own channel numbers.
    Plain,
    /// A 34933A as four 4 x 8 one-wire matrices.
    OneWire,
    /// A matrix of this number of rows and columns.
    Matrix {
        /// Rows.
        rows: u32,
        /// Columns.
        columns: u32,
    },
}

/// A module with its terminal block.
///
/// Its text is `34924A`, `34934A,4x128`, `34934A,none`, `34933A,1-wire`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Module {
    model: Model,
    terminal: Terminal,
}

/// Why a module is invalid.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ModuleError {
    /// No such module.
    #[error("no module '{0}' is known; known are 34921A to 34925A and 34931A to 34934A")]
    Unknown(String),
    /// The module does not take this terminal block.
    #[error("a {model} takes no terminal '{terminal}'; it takes {takes}")]
    Terminal {
        /// The module.
        model: Model,
        /// The requested terminal block.
        terminal: String,
        /// The terminal blocks that the module takes.
        takes: &'static str,
    },
}

impl Module {
    /// A module with its default terminal block: plain, or 4x32 on a 34934A.
    pub fn new(model: Model) -> Self {
        let terminal = match model {
            Model::M34934A => Terminal::Matrix {
                rows: 4,
                columns: 32,
            },
            _ => Terminal::Plain,
        };
        Self { model, terminal }
    }

    /// A module with a terminal block.
    ///
    /// # Errors
    /// A block that does not fit the module.
    pub fn with_terminal(model: Model, terminal: Terminal) -> Result<Self, ModuleError> {
        let fits = match (model, terminal) {
            (_, Terminal::None) => true,
            (Model::M34934A, Terminal::Plain) => false,
            (_, Terminal::Plain) => true,
            (model, Terminal::OneWire) => model == Model::M34933A,
            (model, Terminal::Matrix { rows, columns }) => {
                layouts(model).contains(&(rows, columns))
            }
        };
        if fits {
            Ok(Self { model, terminal })
        } else {
            Err(ModuleError::Terminal {
                model,
                terminal: terminal.to_string(),
                takes: accepted_terminals(model),
            })
        }
    }

    /// The model.
    pub fn model(&self) -> Model {
        self.model
    }

    /// The terminal block.
    pub fn terminal(&self) -> Terminal {
        self.terminal
    }

    /// The name in the reply to `SYST:CTYP?`: for a 34934A with its layout, also without a terminal block (then 4x32,
    /// because a public client reads the layout from this reply when `SYST:MOD:TERM:TYPE?` returns NONE).
    pub fn card_type(&self) -> String {
        match (self.model, self.terminal) {
            (Model::M34934A, Terminal::Matrix { rows, columns }) => {
                format!("34934A-{rows}x{columns}")
            }
            (Model::M34934A, _) => "34934A-4x32".to_owned(),
            (model, _) => model.name().to_owned(),
        }
    }

    /// The name in the reply to `SYST:MOD:TERM:TYPE?`: `NONE`, the layout of a matrix such as `R8_R64`, or the order
    /// number of any other block (for which the sources give no name).
    pub fn terminal_type(&self) -> String {
        match self.terminal {
            Terminal::None => "NONE".to_owned(),
            Terminal::Matrix { rows, columns } => format!("R{rows}_R{columns}"),
            Terminal::Plain | Terminal::OneWire => {
                format!("{}T", self.model.name().trim_end_matches('A'))
            }
        }
    }

    /// The low-side channel of a high-side channel on a 34934A with a two-wire layout (4x32, 4x64, 8x32). `None` for
    /// every other channel and module.
    pub fn pair(&self, channel: u32) -> Option<u32> {
        let Terminal::Matrix { rows, columns } = self.terminal else {
            return None;
        };
        let Some(Contact::Cross { matrix, .. }) = self.contact(channel) else {
            return None;
        };
        let highs = match (self.model, rows, columns) {
            (Model::M34934A, 4, 32) => 2,
            (Model::M34934A, 4, 64) | (Model::M34934A, 8, 32) => 1,
            _ => 0,
        };
        (matrix <= highs).then_some(channel + highs * columns)
    }

    /// Parses the model field of a `SYST:CTYP?` reply.
    ///
    /// # Errors
    /// An unknown model or layout.
    pub fn from_card_type(text: &str) -> Result<Self, ModuleError> {
        match text.split_once('-') {
            None if text == Model::M34934A.name() => {
                Self::with_terminal(Model::M34934A, Terminal::None)
            }
            None => text.parse(),
            Some((model, layout)) => format!("{model},{layout}").parse(),
        }
    }

    /// The switch behind a channel number; `None` if there is no such channel.
    pub fn contact(&self, channel: u32) -> Option<Contact> {
        if let Some(size) = self.model.bank_size() {
            return multiplexer(self.model, size, channel);
        }
        match (self.model, self.terminal) {
            (Model::M34931A, _) => dual_matrix(channel, 8),
            (Model::M34932A, _) => dual_matrix(channel, 16),
            (Model::M34933A, Terminal::OneWire) => {
                let (matrix, row, column) = (channel / 100, channel / 10 % 10, channel % 10);
                let exists = (1..=4).contains(&matrix)
                    && (1..=4).contains(&row)
                    && (1..=8).contains(&column);
                exists.then_some(Contact::Cross {
                    matrix,
                    row,
                    column,
                })
            }
            (Model::M34933A, _) => dual_matrix(channel, 8),
            (Model::M34934A, Terminal::Matrix { rows, columns }) => {
                large_matrix(rows, columns, channel)
            }
            _ => None,
        }
    }

    /// Every channel number, ABus relays included, ascending.
    pub fn channels(&self) -> impl Iterator<Item = u32> + use<> {
        let module = *self;
        (1..1000).filter(move |channel| module.contact(*channel).is_some())
    }

    /// Whether a channel can be in a scan list.
    pub fn scannable(&self, channel: u32) -> bool {
        self.model.scan_rate().is_some()
            && matches!(
                self.contact(channel),
                Some(Contact::Channel { .. } | Contact::Current { .. })
            )
    }

    /// The relay that connects a bank to an analogue bus.
    pub fn bus_relay(&self, bank: u32, bus: u32) -> Option<u32> {
        let channel = 900 + bank * 10 + bus;
        matches!(self.contact(channel), Some(Contact::AnalogBus { .. })).then_some(channel)
    }

    /// Checks that these channels may be closed at the same time: the number of coils (section 3), and on a FET module
    /// one channel a bank.
    ///
    /// # Errors
    /// The exceeded limit, in words.
    pub fn check_closed(&self, channels: impl IntoIterator<Item = u32>) -> Result<(), String> {
        let (most_slot, most_bank) = self.model.most_coils();
        let (mut slot, mut banks, mut closed) = (0, [0_u32; 2], [0_u32; 2]);
        for channel in channels {
            let Some(contact) = self.contact(channel) else {
                continue;
            };
            let one_wire = self.terminal == Terminal::OneWire || self.model == Model::M34934A;
            let coils = match contact {
                Contact::AnalogBus { .. } => 1,
                _ if one_wire => 1,
                _ => 2,
            };
            slot += coils;
            if let Some(bank) = contact.bank() {
                let bank = (bank - 1) as usize;
                banks[bank] += coils;
                closed[bank] += u32::from(!matches!(contact, Contact::AnalogBus { .. }));
            }
        }
        if slot > most_slot {
            return Err(format!("{slot} coils at work, {most_slot} in a slot"));
        }
        if self.model.bank_size().is_some() && banks.iter().any(|coils| *coils > most_bank) {
            return Err(format!("more than {most_bank} coils at work in a bank"));
        }
        if self.model == Model::M34925A && closed.iter().any(|channels| *channels > 1) {
            return Err("more than one channel of a bank closed".to_owned());
        }
        Ok(())
    }
}

impl fmt::Display for Terminal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None => f.write_str("none"),
            Self::Plain => f.write_str("plain"),
            Self::OneWire => f.write_str("1-wire"),
            Self::Matrix { rows, columns } => write!(f, "{rows}x{columns}"),
        }
    }
}

impl fmt::Display for Module {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.terminal == Terminal::Plain {
            write!(f, "{}", self.model)
        } else {
            write!(f, "{},{}", self.model, self.terminal)
        }
    }
}

impl FromStr for Module {
    type Err = ModuleError;

    fn from_str(text: &str) -> Result<Self, ModuleError> {
        let (name, terminal) = match text.split_once(',') {
            None => (text.trim(), None),
            Some((name, terminal)) => (name.trim(), Some(terminal.trim())),
        };
        let model = Model::ALL
            .into_iter()
            .find(|model| model.name().eq_ignore_ascii_case(name))
            .ok_or_else(|| ModuleError::Unknown(name.to_owned()))?;
        let Some(terminal) = terminal else {
            return Ok(Self::new(model));
        };
        let parsed = match terminal.to_ascii_lowercase().as_str() {
            "none" => Some(Terminal::None),
            "plain" => Some(Terminal::Plain),
            "1-wire" => Some(Terminal::OneWire),
            layout => layout.split_once('x').and_then(|(rows, columns)| {
                Some(Terminal::Matrix {
                    rows: rows.parse().ok()?,
                    columns: columns.parse().ok()?,
                })
            }),
        };
        parsed
            .ok_or_else(|| ModuleError::Terminal {
                model,
                terminal: terminal.to_owned(),
                takes: accepted_terminals(model),
            })
            .and_then(|terminal| Self::with_terminal(model, terminal))
    }
}

/// The slot of a relay (1 to 8) and its channel; `None` outside the mainframe.
pub fn split(relay: Relay) -> Option<(u32, u32)> {
    let (slot, channel) = (relay.0 / 1000, relay.0 % 1000);
    ((1..=8).contains(&slot) && channel > 0).then_some((slot, channel))
}

/// The relay of a channel in a slot.
pub fn join(slot: u32, channel: u32) -> Relay {
    Relay(slot * 1000 + channel)
}

fn layouts(model: Model) -> &'static [(u32, u32)] {
    match model {
        Model::M34931A | Model::M34933A => &[(8, 8), (4, 16)],
        Model::M34932A => &[(8, 16), (4, 32)],
        Model::M34934A => &[(4, 32), (4, 64), (4, 128), (8, 32), (8, 64), (16, 32)],
        _ => &[],
    }
}

fn accepted_terminals(model: Model) -> &'static str {
    match model {
        Model::M34931A => "plain, none, 8x8, 4x16",
        Model::M34932A => "plain, none, 8x16, 4x32",
        Model::M34933A => "plain, none, 1-wire, 8x8, 4x16",
        Model::M34934A => "none, 4x32, 4x64, 4x128, 8x32, 8x64, 16x32",
        _ => "plain, none",
    }
}
