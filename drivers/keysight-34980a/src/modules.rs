//! Which channels exist on which module, what they can do, and how fast: fact sheet section 3, pure tables.
//!
//! A channel is counted within its slot (`36`, `911`); a [`Relay`] with its slot (`1036`, `1911`).

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use survey::{Amps, Limits, Relay, Volts};

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
    /// Reed matrix whose layout its terminal block decides.
    M34934A,
}

impl Model {
    /// Every module known.
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

    /// As `SYST:CTYP?` names it, without a layout.
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

    /// Time to close a relay. A FET's is not worth counting.
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

    /// Whether its relays keep their state without power. (Its ABus relays never do.)
    pub fn latching(self) -> bool {
        matches!(
            self,
            Self::M34921A | Self::M34922A | Self::M34931A | Self::M34932A
        )
    }

    /// What a plan may ask of its relays, with a 6221 as the source: the current through a closed one, the voltage
    /// over an open one. A 34933A is taken with its in-rush resistors.
    pub fn limits(self) -> Limits {
        let (relay_current, relay_voltage) = match self {
            Self::M34921A | Self::M34922A | Self::M34931A | Self::M34932A => (1.0, 300.0),
            Self::M34923A | Self::M34924A | Self::M34933A => (0.05, 150.0),
            Self::M34925A => (0.02, 80.0),
            Self::M34934A => (0.5, 100.0),
        };
        Limits {
            relay_current: Amps(relay_current),
            relay_voltage: Volts(relay_voltage),
            ..Limits::REED
        }
    }

    /// Most coils (closures, where a coil is no limit) that may be at work in the slot, and in each bank.
    fn most_coils(self) -> (u32, u32) {
        match self {
            Self::M34923A | Self::M34924A => (40, 20),
            Self::M34933A => (40, 40),
            Self::M34934A => (64, 64),
            _ => (u32::MAX, u32::MAX),
        }
    }

    /// Channels of bank 1; bank 2 has as many.
    fn bank_size(self) -> Option<u32> {
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

/// What is screwed to a module. It decides which channels of a matrix exist, and how many wires each switches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Terminal {
    /// Nothing: on a 34934A no channel may then close.
    None,
    /// The block that leaves the module as its own numbering has it.
    Plain,
    /// A 34933A as four 4 x 8 one-wire matrices.
    OneWire,
    /// A matrix joined to so many rows and columns.
    Matrix {
        /// Rows.
        rows: u32,
        /// Columns.
        columns: u32,
    },
}

/// One switch of a module: what a channel number means.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Contact {
    /// A channel of a multiplexer: joins its two wires to the bank's common.
    Channel {
        /// 1 or 2.
        bank: u32,
    },
    /// A current channel of a 34921A.
    Current {
        /// 1 or 2.
        bank: u32,
    },
    /// A bank's common (a multiplexer) or a row (a matrix) to an analogue bus.
    AnalogBus {
        /// 1 or 2; on a matrix always 2.
        bank: u32,
        /// 1 to 4. The voltmeter is on 1.
        bus: u32,
    },
    /// A cross point.
    Cross {
        /// Which of the module's matrices, from 1.
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

/// A module with its terminal block.
///
/// Written `34924A`, `34934A,4x128`, `34934A,none`, `34933A,1-wire`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Module {
    model: Model,
    terminal: Terminal,
}

/// Why a module cannot be.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ModuleError {
    /// No such module.
    #[error("no module '{0}' is known; known are 34921A to 34925A and 34931A to 34934A")]
    Unknown(String),
    /// The module does not take such a terminal.
    #[error("a {model} takes no terminal '{terminal}'; it takes {takes}")]
    Terminal {
        /// The module.
        model: Model,
        /// What was asked for.
        terminal: String,
        /// What it takes.
        takes: &'static str,
    },
}

impl Module {
    /// A module with the terminal block that a bare name means: plain, or 4x32 on a 34934A.
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
                takes: takes(model),
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

    /// As `SYST:CTYP?` names it: a 34934A appends its layout.
    pub fn card_type(&self) -> String {
        match (self.model, self.terminal) {
            (Model::M34934A, Terminal::Matrix { rows, columns }) => {
                format!("34934A-{rows}x{columns}")
            }
            (model, _) => model.name().to_owned(),
        }
    }

    /// Reads the model field of a `SYST:CTYP?` reply.
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

    /// What a channel number means here; `None` where there is no such channel.
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

    /// The relay that joins a bank to an analogue bus.
    pub fn bus_relay(&self, bank: u32, bus: u32) -> Option<u32> {
        let channel = 900 + bank * 10 + bus;
        matches!(self.contact(channel), Some(Contact::AnalogBus { .. })).then_some(channel)
    }

    /// Whether these channels may be closed at once: coils (section 3), and one channel a bank on a FET module.
    ///
    /// # Errors
    /// What is too many, in words.
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
                takes: takes(model),
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

fn takes(model: Model) -> &'static str {
    match model {
        Model::M34931A => "plain, none, 8x8, 4x16",
        Model::M34932A => "plain, none, 8x16, 4x32",
        Model::M34933A => "plain, none, 1-wire, 8x8, 4x16",
        Model::M34934A => "none, 4x32, 4x64, 4x128, 8x32, 8x64, 16x32",
        _ => "plain, none",
    }
}

fn multiplexer(model: Model, size: u32, channel: u32) -> Option<Contact> {
    match channel {
        911..=914 => Some(Contact::AnalogBus {
            bank: 1,
            bus: channel - 910,
        }),
        921..=924 => Some(Contact::AnalogBus {
            bank: 2,
            bus: channel - 920,
        }),
        // Which bank a current channel belongs to is not in the sources; the nearer numbers are taken.
        41..=44 if model == Model::M34921A => Some(Contact::Current {
            bank: if channel <= 42 { 1 } else { 2 },
        }),
        _ if channel >= 1 && channel <= size => Some(Contact::Channel { bank: 1 }),
        _ if channel > size && channel <= 2 * size => Some(Contact::Channel { bank: 2 }),
        _ => None,
    }
}

/// Rows 1 to 4 are matrix 1, rows 5 to 8 matrix 2; only matrix 2 reaches the ABus.
fn dual_matrix(channel: u32, columns: u32) -> Option<Contact> {
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

/// A 34934A: every row's channels begin at its own number; the further matrices follow in the same row.
fn large_matrix(rows: u32, columns: u32, channel: u32) -> Option<Contact> {
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

#[cfg(test)]
mod tests {
    use super::*;

    fn module(text: &str) -> Module {
        text.parse().unwrap()
    }

    #[test]
    fn every_module_has_the_channels_of_the_table() {
        for (text, channels) in [
            ("34921A", 40 + 4 + 8),
            ("34922A", 70 + 8),
            ("34923A", 40 + 8),
            ("34924A", 70 + 8),
            ("34925A", 40 + 8),
            ("34931A", 64 + 4),
            ("34932A", 128 + 4),
            ("34933A", 64 + 4),
            ("34933A,1-wire", 128),
            ("34934A,4x32", 512),
            ("34934A,4x64", 512),
            ("34934A,4x128", 512),
            ("34934A,8x32", 512),
            ("34934A,8x64", 512),
            ("34934A,16x32", 512),
            ("34934A,none", 0),
        ] {
            assert_eq!(module(text).channels().count(), channels, "{text}");
        }
    }

    #[test]
    fn banks_rows_and_bus_relays_are_where_the_table_says() {
        let reed = module("34924A");
        assert_eq!(reed.contact(35), Some(Contact::Channel { bank: 1 }));
        assert_eq!(reed.contact(36), Some(Contact::Channel { bank: 2 }));
        assert_eq!(reed.contact(71), None);
        assert_eq!(reed.bus_relay(1, 1), Some(911));
        let cross = |matrix, row, column| {
            Some(Contact::Cross {
                matrix,
                row,
                column,
            })
        };
        let matrix = module("34932A,4x32");
        assert_eq!(matrix.contact(116), cross(1, 1, 16));
        assert_eq!(matrix.contact(501), cross(2, 5, 1));
        assert_eq!(matrix.contact(117), None);
        assert_eq!(matrix.contact(911), None);
        assert!(matrix.contact(921).is_some());
        assert!(!matrix.scannable(101));
        // 100(2R-1)+C, plus 32 for M2H: row 3, column 5 of M2H
        assert_eq!(module("34934A,4x32").contact(537), cross(2, 3, 5));
        assert_eq!(module("34934A,4x128").contact(726), cross(1, 4, 26));
        assert_eq!(module("34934A,8x32").contact(833), cross(2, 8, 1));
        assert_eq!(module("34934A,16x32").contact(882), cross(1, 16, 32));
        assert_eq!(module("34934A,16x32").contact(883), None);
    }

    #[test]
    fn coils_are_counted() {
        let reed = module("34924A");
        assert_eq!(reed.check_closed(1..=10), Ok(()));
        assert!(reed.check_closed(1..=11).is_err());
        assert!(reed.check_closed((1..=10).chain([911])).is_err());
        assert_eq!(reed.check_closed((1..=10).chain(36..=45)), Ok(()));
        assert_eq!(module("34922A").check_closed(1..=70), Ok(()));
        assert_eq!(module("34925A").check_closed([1, 21, 911]), Ok(()));
        assert!(module("34925A").check_closed([1, 2]).is_err());
    }

    #[test]
    fn a_terminal_that_does_not_fit_is_refused_by_name() {
        let refusal = "34924A,4x32".parse::<Module>().unwrap_err();
        assert_eq!(
            refusal.to_string(),
            "a 34924A takes no terminal '4x32'; it takes plain, none"
        );
        assert!("34999A".parse::<Module>().is_err());
        assert!("34934A,7x7".parse::<Module>().is_err());
        for model in Model::ALL {
            let module = Module::new(model);
            assert_eq!(module.to_string().parse(), Ok(module));
            assert_eq!(Module::from_card_type(&module.card_type()), Ok(module));
        }
    }
}
