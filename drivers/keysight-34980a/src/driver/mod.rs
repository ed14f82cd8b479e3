//! The mainframe as [`Switch`] and [`Voltmeter`].
//!
//! Relay moves are deferred and sent in one segment with the next query, so that an injection needs one message:
//! `ROUT:CLOS (@1037);:ROUT:OPEN (@1036);:READ?`. A move that only closes relays is sent at once, because its relays
//! must be closed before the source is switched on.

mod checks;
mod relay_life;
mod unit;

use std::sync::Arc;
use std::time::Duration;

use rig::{
    ChainedReading, Conversation, Link, MeterSettings, Move, RigError, Sample, Stream, Switch,
    Voltmeter,
};
use scpi::Common;
use survey::{Reading, Relay, Volts};
use tokio::sync::Mutex;

use crate::command::{Command, MOST_SWEEPS, Route, System};
use crate::meter::{INTEGRATION, RANGES};
use crate::modules::Module;
use unit::{Prepared, Unit, compact};

const MODEL: &str = "34980A";
/// The two vendor names of the instrument (fact sheet section 1).
const VENDORS: [&str; 2] = ["Agilent Technologies", "Keysight Technologies"];
/// Entries of the error queue (section 7), and a margin.
const MOST_ERRORS: usize = 25;
/// The lower of the two mains frequencies; deadlines must be long enough for both.
const SLOWEST_LINE_HZ: f64 = 50.0;
/// Longest delay before a channel (section 5).
const LONGEST_DELAY: Duration = Duration::from_secs(60);

/// A handle of one mainframe. Clones are handles of the same instrument and wait for each other.
#[derive(Debug)]
pub struct Keysight34980a<S> {
    unit: Arc<Mutex<Unit<S>>>,
    identification: Arc<Identification>,
}

impl<S> Clone for Keysight34980a<S> {
    fn clone(&self) -> Self {
        Self {
            unit: Arc::clone(&self.unit),
            identification: Arc::clone(&self.identification),
        }
    }
}

/// Data that do not change while connected.
#[derive(Debug)]
struct Identification {
    instrument: String,
    identity: String,
    cards: [Option<String>; 8],
    serials: [Option<String>; 8],
    modules: [Option<Module>; 8],
}

impl<S: Stream> Keysight34980a<S> {
    /// Queries the identity and the modules in the slots. Moves and resets nothing, so that relays left closed earlier
    /// can be detected.
    ///
    /// # Errors
    /// Another instrument, an invalid reply, or a broken connection.
    pub async fn connect(link: Link<S>) -> Result<Self, RigError> {
        let mut conversation =
            Conversation::new(link, Command::from(System::NextError), MOST_ERRORS);
        let expected = format!("{MODEL} of {}", VENDORS.join(" or "));
        let is_34980a = |fields: &[&str]| {
            matches!(fields, [vendor, model, ..]
                if *model == MODEL && VENDORS.iter().any(|known| known.eq_ignore_ascii_case(vendor)))
        };
        let identity = conversation.identify(&expected, is_34980a).await?;
        let deadline = conversation.link().deadline();
        let mut cards = [const { None }; 8];
        let mut serials = [const { None }; 8];
        for ((slot, card), serial) in (1..).zip(&mut cards).zip(&mut serials) {
            let query = [System::CardType(slot)];
            let (query, answer) = conversation.ask(&query, deadline).await?;
            let unquoted = answer.trim().trim_matches('"');
            let fields: Vec<&str> = unquoted.split(',').map(str::trim).collect();
            let model = *fields
                .get(1)
                .ok_or_else(|| conversation.garbled(&query, &answer, "vendor,model,..."))?;
            if model != "0" {
                *card = Some(model.to_owned());
                *serial = fields.get(2).map(|serial| (*serial).to_owned());
            }
        }
        let modules = cards.each_ref().map(|card| {
            card.as_deref()
                .and_then(|card| Module::from_card_type(card).ok())
        });
        let identification = Identification {
            instrument: conversation.instrument().to_owned(),
            identity,
            cards,
            serials,
            modules,
        };
        Ok(Self {
            unit: Arc::new(Mutex::new(Unit::new(conversation))),
            identification: Arc::new(identification),
        })
    }

    /// The reply to `*IDN?`.
    pub fn identity(&self) -> &str {
        &self.identification.identity
    }

    /// The modules in slots 1 to 8; `None` for an empty slot or an unknown module.
    pub fn modules(&self) -> [Option<Module>; 8] {
        self.identification.modules
    }

    /// The serial numbers of the modules in slots 1 to 8.
    pub fn serials(&self) -> &[Option<String>; 8] {
        &self.identification.serials
    }

    /// The module types as reported for slots 1 to 8, also of unknown modules; `None` for an empty slot.
    pub fn cards(&self) -> &[Option<String>; 8] {
        &self.identification.cards
    }

    /// Converts relay moves to commands, after checking that each relay exists.
    fn commands(&self, moves: &[Move]) -> Result<Vec<Command>, RigError> {
        let mut commands = Vec::new();
        for one in moves {
            let (Move::Close(relays) | Move::Open(relays)) = one;
            self.check_exist(relays)?;
            if relays.is_empty() {
                continue;
            }
            let list = compact(relays);
            commands.push(match one {
                Move::Close(_) => Route::Close(list).into(),
                Move::Open(_) => Route::Open(list).into(),
            });
        }
        Ok(commands)
    }

    /// The prepared scan list, on the prepared range.
    async fn prepared_samples(&self) -> Vec<Sample> {
        let unit = self.unit.lock().await;
        let sample = |prepared: &Prepared| {
            let range = prepared.meter.range;
            let relays = prepared.scan.iter().copied();
            let wait = Duration::ZERO;
            relays.map(|relay| Sample { relay, range, wait }).collect()
        };
        unit.prepared.as_ref().map(sample).unwrap_or_default()
    }

    async fn prepared_range(&self) -> Volts {
        let unit = self.unit.lock().await;
        let prepared = unit.prepared.as_ref();
        // without a preparation every reading is rejected, so that any range can be returned
        prepared.map_or(Volts(RANGES[0]), |prepared| prepared.meter.range)
    }

    /// Timeout of the readings of one message, beyond the usual reply time: that of the plan, otherwise 1.5 times the
    /// time by section 9.
    fn deadline(&self, meter: MeterSettings, scan: &[Relay], link: Duration) -> Duration {
        let zero = if meter.autozero { 2.0 } else { 1.0 };
        let integration = zero * meter.nplc / SLOWEST_LINE_HZ;
        let delay = meter.channel_delay.as_secs_f64();
        let channel = |relay: &Relay| {
            let rate = self
                .module_of(*relay)
                .ok()
                .and_then(|(module, _)| module.model().scan_rate());
            1.0 / f64::from(rate.unwrap_or(100)) + integration + delay
        };
        let seconds: f64 = if scan.is_empty() {
            integration
        } else {
            scan.iter().map(channel).sum()
        };
        let usual = survey::duration(1.5 * f64::from(meter.averages) * seconds);
        link + meter.deadline.unwrap_or(usual)
    }
}

impl<S: Stream> Switch for Keysight34980a<S> {
    /// Defers the moves to the next query, unless they only close relays: these are sent at once.
    async fn move_relays(&mut self, moves: &[Move]) -> Result<(), RigError> {
        let commands = self.commands(moves)?;
        let opens = |command: &Command| matches!(command, Command::Route(Route::Open(_)));
        let opens = commands.iter().any(opens);
        if commands.is_empty() {
            return Ok(());
        }
        let mut unit = self.unit.lock().await;
        unit.held.extend(commands);
        unit.unchecked = true;
        drop(unit);
        if opens { Ok(()) } else { self.settle().await }
    }

    async fn settle(&mut self) -> Result<(), RigError> {
        let mut unit = self.unit.lock().await;
        if unit.held.is_empty() {
            return Ok(());
        }
        let deadline = unit.conversation.link().deadline();
        let query = Command::Common(Common::WhenComplete);
        let (message, answer) = unit.ask(vec![query], deadline).await?;
        match scpi::parse_boolean(&answer) {
            Ok(true) => Ok(()),
            Ok(false) | Err(_) => Err(unit.conversation.garbled(&message, &answer, "1")),
        }
    }

    async fn closed(&mut self, relays: &[Relay]) -> Result<Vec<bool>, RigError> {
        self.check_exist(relays)?;
        self.unit.lock().await.read_closed(relays).await
    }

    /// Opens the relays, reads them back, and then checks whether an earlier move was rejected. A link that is
    /// unsynchronised after a lost or late reply is resynchronised first, because relays that stay closed are worse
    /// than a longer message exchange.
    async fn open_verified(&mut self, relays: &[Relay]) -> Result<(), RigError> {
        self.check_exist(relays)?;
        let mut unit = self.unit.lock().await;
        if !unit.conversation.link().is_synchronised() {
            unit.prepared = None;
            unit.conversation.link_mut().resynchronise().await?;
        }
        // deferred closures are dropped: while the rig is made safe no relay is closed
        unit.held
            .retain(|command| !matches!(command, Command::Route(Route::Close(_))));
        unit.open(relays).await
    }

    async fn closed_before_opening(
        &mut self,
        requested: &[Relay],
        relays: &[Relay],
    ) -> Result<Vec<bool>, RigError> {
        self.check_exist(requested)?;
        self.check_exist(relays)?;
        let mut unit = self.unit.lock().await;
        unit.closed_before_opening(requested, relays).await
    }
}

impl<S: Stream> Voltmeter for Keysight34980a<S> {
    /// Sends all settings if they differ from those of the last preparation or if a measurement has failed since, and
    /// reads all of them back in any case. The first call resets the instrument, which opens every relay.
    async fn prepare(&mut self, meter: MeterSettings, scan: &[Relay]) -> Result<(), RigError> {
        self.check_range(meter.range)?;
        if !INTEGRATION.iter().any(|(nplc, _)| *nplc == meter.nplc) {
            return Err(self.unable(format!(
                "integrate over {} power-line cycles; set 0.02, 0.2, 1, 2, 10, 20, 100 or 200",
                meter.nplc
            )));
        }
        if !(1..=MOST_SWEEPS).contains(&meter.averages) {
            return Err(self.unable(format!(
                "average {} readings; set 1 to {MOST_SWEEPS}",
                meter.averages
            )));
        }
        if meter.channel_delay > LONGEST_DELAY
            || !meter.channel_delay.subsec_micros().is_multiple_of(1000)
        {
            return Err(self.unable(format!(
                "wait {:?} before each channel; set 0 to 60 s, in whole milliseconds",
                meter.channel_delay
            )));
        }
        self.check_scan(scan)?;
        let mut unit = self.unit.lock().await;
        let requested = Prepared {
            deadline: self.deadline(meter, scan, unit.conversation.link().deadline()),
            meter: MeterSettings {
                deadline: None,
                ..meter
            },
            scan: scan.to_vec(),
        };
        let before = unit.prepared.take();
        unit.bring_to(&requested, before).await?;
        unit.verify(&requested).await?;
        unit.prepared = Some(requested);
        Ok(())
    }

    async fn scan(&mut self) -> Result<Vec<Reading>, RigError> {
        let samples = self.prepared_samples().await;
        self.scan_on(&samples).await
    }

    async fn scan_on(&mut self, channels: &[Sample]) -> Result<Vec<Reading>, RigError> {
        for channel in channels {
            self.check_range(channel.range)?;
        }
        let mut unit = self.unit.lock().await;
        let delay = unit
            .prepared
            .as_ref()
            .map(|prepared| prepared.meter.channel_delay);
        let longest = channels.iter().map(|channel| channel.wait).max();
        if let Some(wait) = delay.zip(longest).map(|(delay, longest)| delay + longest)
            && wait > LONGEST_DELAY
        {
            return Err(self.unable(format!(
                "wait {wait:?} before a channel; the longest delay is {LONGEST_DELAY:?}, settling included"
            )));
        }
        let prepared = unit.prepared.as_ref().map(|prepared| &prepared.scan);
        let stranger = prepared.and_then(|scan| {
            let unknown = |channel: &&Sample| !scan.contains(&channel.relay);
            channels.iter().find(unknown)
        });
        if prepared.is_some() && (channels.is_empty() || stranger.is_some()) {
            return Err(self.unable(match stranger {
                Some(channel) => format!("scan relay {}: it was not prepared", channel.relay),
                None => "scan: it was prepared for single readings".to_owned(),
            }));
        }
        unit.scan(channels).await
    }

    async fn read(&mut self) -> Result<Reading, RigError> {
        let range = self.prepared_range().await;
        self.read_on(range).await
    }

    async fn read_on(&mut self, range: Volts) -> Result<Reading, RigError> {
        // `chain` returns exactly one reading for each pair
        let moves = Vec::new();
        let readings = self.chain(&[ChainedReading { moves, range }]).await?;
        Ok(readings.first().copied().unwrap_or(Reading::NotMeasured))
    }

    async fn chain(&mut self, chained: &[ChainedReading]) -> Result<Vec<Reading>, RigError> {
        let mut moves = Vec::with_capacity(chained.len());
        for one in chained {
            self.check_range(one.range)?;
            moves.push((self.commands(&one.moves)?, one.range));
        }
        let mut unit = self.unit.lock().await;
        if unit
            .prepared
            .as_ref()
            .is_some_and(|prepared| !prepared.scan.is_empty())
        {
            return Err(self.unable("read once: it was prepared to scan".to_owned()));
        }
        unit.chain(moves).await
    }
}
