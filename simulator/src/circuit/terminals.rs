//! Connections of each relay: the terminal blocks of a rig wired for pairs.
//!
//! Pair k is electrodes k and k+1, H on k, L on k+1, the last with the first (fact sheet 34980A, section 8).
//!
//! | module | wired as |
//! |---|---|
//! | 34925A | channel k, numbered across both banks: pair k; both commons: the voltmeter by their ABus1 relays |
//! | other multiplexer (34921A to 34924A) | channel k of bank 1 and channel k of bank 2: pair k; common of bank 2: the source |
//! | dual matrix (34931A to 34933A) | columns: pairs, numbered from matrix 1 to matrix 2; rows 1 and 5 jumpered: the voltmeter by the ABus1 relay of row 5; rows 2 and 6 jumpered: the source |
//! | 34934A | rows I+, I-, V+, V-; column k: electrode k; the voltmeter by the rear ABus connector |
//! | multiplexer board | poles I+, I-, V+, V-, any electrode on each; the voltmeter by the rear ABus connector |
//!
//! A channel after the last pair is not connected. A 34933A as one-wire matrices is left unwired.

use std::collections::BTreeMap;

use keysight_34980a::{Contact, Model, Module, Terminal};
use survey::{Electrode, Relay};

use crate::circuit::{METER_HI, METER_LO, Point, Resistor};

/// One pole of a closed armature relay, and of a reed without its in-rush resistor, ohm.
const CONTACT: f64 = 0.1;
/// In-rush resistor of each pole of a 34923A, 34924A or 34933A, ohm.
const IN_RUSH: f64 = 100.0;
/// One pole of a 34925A, ohm: data sheet "under 700" for both.
const FET: f64 = 350.0;
/// A channel of a 74HC4067 on 5 V, ohm.
const CHIP: f64 = 70.0;

/// The resistors of each mainframe relay when closed.
#[derive(Debug, Default)]
pub(crate) struct Fixture {
    relays: BTreeMap<Relay, Vec<Resistor>>,
    /// For a channel of a multiplexer, the relay that a scan closes with it: its bank's to bus 1.
    scanned_by: BTreeMap<Relay, Relay>,
    slots: [Option<Module>; 8],
    electrodes: usize,
}

impl Fixture {
    /// Wires the modules in their slots, numbered from 1, to a ring of electrodes.
    pub(crate) fn new(slots: &[Option<Module>; 8], electrodes: usize) -> Self {
        let mut fixture = Self {
            electrodes,
            slots: *slots,
            ..Self::default()
        };
        for (slot, module) in (1..).zip(slots) {
            let Some(module) = module else { continue };
            for channel in module.channels() {
                let relay = keysight_34980a::join(slot, channel);
                let resistors = closed(module, slot, channel, electrodes);
                if !resistors.is_empty() {
                    fixture.relays.insert(relay, resistors);
                }
                if let Some(Contact::Channel { bank }) = module.contact(channel)
                    && let Some(bus) = module.bus_relay(bank, 1)
                {
                    let bus = keysight_34980a::join(slot, bus);
                    fixture.scanned_by.insert(relay, bus);
                }
            }
        }
        fixture
    }

    /// The resistors of a closed relay; none if it is not connected.
    pub(crate) fn resistors(&self, relay: Relay) -> &[Resistor] {
        self.relays.get(&relay).map_or(&[], Vec::as_slice)
    }

    /// The resistors of a closed relay of the mainframe or the board.
    pub(crate) fn joined(&self, relay: Relay) -> impl Iterator<Item = Resistor> {
        let chip = board(relay).filter(|chip| self.has(chip.from));
        self.resistors(relay).iter().copied().chain(chip)
    }

    /// The module in a slot, 1 to 8.
    pub(crate) fn module(&self, slot: u32) -> Option<Module> {
        let index = (slot as usize).checked_sub(1)?;
        self.slots.get(index).copied().flatten()
    }

    /// Whether the module in its slot has this relay, connected or not.
    pub(crate) fn has_relay(&self, relay: Relay) -> bool {
        let place = keysight_34980a::split(relay);
        place.is_some_and(|(slot, channel)| {
            let module = self.module(slot);
            module.is_some_and(|module| module.contact(channel).is_some())
        })
    }

    /// Whether the board has a chip that connects this pole to an electrode.
    pub(crate) fn has_chip(&self, relay: Relay) -> bool {
        board(relay).is_some_and(|chip| self.has(chip.from))
    }

    fn has(&self, point: Point) -> bool {
        matches!(point, Point::Electrode(index) if index < self.electrodes)
    }

    /// The ABus1 relay of the bank of a channel that is being scanned.
    pub(crate) fn scanned_by(&self, channel: Relay) -> Option<Relay> {
        self.scanned_by.get(&channel).copied()
    }
}

/// A chip of the multiplexer board: pole x 100 + electrode; poles 1 to 4 are I+, I-, V+, V-.
fn board(relay: Relay) -> Option<Resistor> {
    let to = match relay.0 / 100 {
        1 => Point::Source(true),
        2 => Point::Source(false),
        3 => METER_HI,
        4 => METER_LO,
        _ => return None,
    };
    let electrode = Electrode::from_number((relay.0 % 100) as usize)?;
    Some(Resistor {
        from: Point::Electrode(electrode.0),
        to,
        ohms: CHIP,
    })
}

fn closed(module: &Module, slot: u32, channel: u32, electrodes: usize) -> Vec<Resistor> {
    let Some(contact) = module.contact(channel) else {
        return Vec::new();
    };
    let model = module.model();
    let ohms = match model {
        Model::M34923A | Model::M34924A | Model::M34933A => CONTACT + IN_RUSH,
        Model::M34925A => FET,
        Model::M34921A | Model::M34922A | Model::M34931A | Model::M34932A | Model::M34934A => {
            CONTACT
        }
    };
    match contact {
        Contact::Channel { bank } => {
            let first_of_second = module
                .channels()
                .find(|channel| module.contact(*channel) == Some(Contact::Channel { bank: 2 }))
                .unwrap_or(1);
            let pair = if bank == 1 || model == Model::M34925A {
                channel - 1
            } else {
                channel - first_of_second
            };
            pair_to(pair, electrodes, ohms, |hi| common(model, slot, bank, hi))
        }
        Contact::AnalogBus { bank, bus } if is_multiplexer(model) => {
            two_wires(|hi| common(model, slot, bank, hi), |hi| Point::Bus(bus, hi))
        }
        // On a dual matrix 921 connects row 5 to ABus1, 922 row 6 to ABus2, and so on.
        Contact::AnalogBus { bus, .. } => {
            two_wires(|hi| row(slot, 4 + bus, hi), |hi| Point::Bus(bus, hi))
        }
        Contact::Cross { row, column, .. } if model == Model::M34934A => {
            let ends = [
                Point::Source(true),
                Point::Source(false),
                METER_HI,
                METER_LO,
            ];
            let electrode = column as usize - 1;
            match ends.get(row as usize - 1) {
                Some(to) if electrode < electrodes => vec![Resistor {
                    from: Point::Electrode(electrode),
                    to: *to,
                    ohms,
                }],
                _ => Vec::new(),
            }
        }
        Contact::Cross { .. } if module.terminal() == Terminal::OneWire => Vec::new(),
        Contact::Cross {
            matrix,
            row: at,
            column,
        } => {
            let columns = if model == Model::M34932A { 16 } else { 8 };
            let pair = (matrix - 1) * columns + column - 1;
            pair_to(pair, electrodes, ohms, |hi| row(slot, at, hi))
        }
        Contact::Current { .. } => Vec::new(),
    }
}

fn is_multiplexer(model: Model) -> bool {
    model.scan_rate().is_some()
}

/// Bank 2's common is wired to the source, unless the module only measures.
fn common(model: Model, slot: u32, bank: u32, hi: bool) -> Point {
    match bank {
        2 if model != Model::M34925A => Point::Source(hi),
        _ => Point::Common(slot, bank, hi),
    }
}

/// Rows 2 and 6 are wired to the source, and row 1 is row 5.
fn row(slot: u32, row: u32, hi: bool) -> Point {
    match row {
        2 | 6 => Point::Source(hi),
        1 | 5 => Point::Common(slot, 5, hi),
        _ => Point::Common(slot, row, hi),
    }
}

fn pair_to(pair: u32, electrodes: usize, ohms: f64, to: impl Fn(bool) -> Point) -> Vec<Resistor> {
    let plus = pair as usize;
    if plus >= electrodes {
        return Vec::new();
    }
    let wire = |electrode, hi| Resistor {
        from: Point::Electrode(electrode),
        to: to(hi),
        ohms,
    };
    vec![wire(plus, true), wire((plus + 1) % electrodes, false)]
}

fn two_wires(from: impl Fn(bool) -> Point, to: impl Fn(bool) -> Point) -> Vec<Resistor> {
    [true, false]
        .map(|hi| Resistor {
            from: from(hi),
            to: to(hi),
            ohms: CONTACT,
        })
        .to_vec()
}

#[cfg(test)]
mod tests {
    use crate::circuit::terminals::*;

    fn fixture(module: &str) -> Fixture {
        let mut slots = [None; 8];
        slots[0] = Some(module.parse().unwrap());
        Fixture::new(&slots, 26)
    }

    fn ends(fixture: &Fixture, relay: u32) -> Vec<(Point, Point)> {
        let resistors = fixture.resistors(Relay(relay));
        resistors.iter().map(|each| (each.from, each.to)).collect()
    }

    #[test]
    fn pairs_are_wired_by_map_m() {
        let fixture = fixture("34924A");
        let measuring = ends(&fixture, 1026);
        assert_eq!(
            measuring,
            [
                (Point::Electrode(25), Point::Common(1, 1, true)),
                (Point::Electrode(0), Point::Common(1, 1, false))
            ]
        );
        assert_eq!(
            ends(&fixture, 1036),
            [
                (Point::Electrode(0), Point::Source(true)),
                (Point::Electrode(1), Point::Source(false))
            ]
        );
        assert_eq!(ends(&fixture, 1027), []);
        assert_eq!(fixture.scanned_by(Relay(1026)), Some(Relay(1911)));
        assert_eq!(ends(&fixture, 1911)[0].1, METER_HI);
        assert_eq!(fixture.resistors(Relay(1036))[0].ohms, 100.1);
    }

    #[test]
    fn a_fet_module_measures_on_both_banks() {
        let fixture = fixture("34925A");
        assert_eq!(
            ends(&fixture, 1026),
            [
                (Point::Electrode(25), Point::Common(1, 2, true)),
                (Point::Electrode(0), Point::Common(1, 2, false))
            ]
        );
        let bus = fixture.scanned_by(Relay(1026)).unwrap();
        assert_eq!(
            ends(&fixture, bus.0)[0],
            (Point::Common(1, 2, true), METER_HI)
        );
    }

    #[test]
    fn the_matrix_is_jumpered_by_map_x() {
        let fixture = fixture("34932A");
        assert_eq!(
            ends(&fixture, 1116)[0],
            (Point::Electrode(15), Point::Common(1, 5, true))
        );
        assert_eq!(
            ends(&fixture, 1501)[0],
            (Point::Electrode(16), Point::Common(1, 5, true))
        );
        assert_eq!(
            ends(&fixture, 1610)[1],
            (Point::Electrode(0), Point::Source(false))
        );
        assert_eq!(
            ends(&fixture, 1921)[0],
            (Point::Common(1, 5, true), METER_HI)
        );
        assert_eq!(
            ends(&fixture, 1922)[0],
            (Point::Source(true), Point::Bus(2, true))
        );
    }

    #[test]
    fn a_large_matrix_has_an_electrode_a_column() {
        let fixture = fixture("34934A,4x128");
        assert_eq!(
            ends(&fixture, 1126),
            [(Point::Electrode(25), Point::Source(true))]
        );
        assert_eq!(ends(&fixture, 1701), [(Point::Electrode(0), METER_LO)]);
        assert_eq!(ends(&fixture, 1127), []);
    }
}
