//! The internal voltmeter: settings of every channel, scan list, trigger, memory, and the form of a reading (section 5).

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use scpi::{Numeric, ParseError, format_nr3_signed};
use survey::{Relay, Volts};

use super::relays::Relays;
use super::trouble::Trouble;
use super::{MeterRequest, Wires, join};
use crate::command::{Channels, Command, Field, INTEGRATION, RANGES, Range, TriggerSource};

/// Readings that the memory holds (section 5).
const MEMORY: usize = 500_000;
/// Readings a second that the voltmeter alone can take (section 5).
const READINGS_PER_SECOND: f64 = 3000.0;
/// A reading may exceed its range by a fifth (section 5).
const OVER_RANGE: f64 = 1.2;

/// How one channel, or the bare voltmeter, is measured.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Setup {
    range: Range,
    nplc: f64,
    /// `None`: automatic.
    delay: Option<f64>,
    autozero: bool,
    input_auto: bool,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            range: Range::Auto,
            nplc: 1.0,
            delay: None,
            autozero: true,
            input_auto: false,
        }
    }
}

impl Setup {
    /// Delay before a scanned reading, s: 1 ms up to 1 cycle, 2 ms above, unless it is set.
    fn delay(self) -> f64 {
        self.delay
            .unwrap_or(if self.nplc <= 1.0 { 1e-3 } else { 2e-3 })
    }
}

#[derive(Debug, Clone, Copy)]
struct Stored {
    /// Infinite for an overload.
    volts: f64,
    /// Since the start of the measurement.
    time: Duration,
    at: Duration,
    channel: Option<Relay>,
}

/// Some rounds through a scan list; an empty list is the bare voltmeter.
pub(super) struct Sweep<'a> {
    pub(super) list: &'a [Relay],
    pub(super) sweeps: u32,
    pub(super) start: Duration,
}

#[derive(Debug)]
pub(super) struct Meter {
    line_hz: f64,
    bare: Setup,
    channels: BTreeMap<Relay, Setup>,
    scan: Vec<Relay>,
    source: TriggerSource,
    timer: f64,
    count: u32,
    fields: BTreeSet<Field>,
    memory: Vec<Stored>,
    /// A measurement started by INIT or `*TRG` ends then.
    until: Duration,
    /// Triggers that are still to come.
    triggers: u32,
}

impl Meter {
    /// As after `*RST`.
    pub(super) fn new(line_hz: f64) -> Self {
        Self {
            line_hz,
            bare: Setup::default(),
            channels: BTreeMap::new(),
            scan: Vec::new(),
            source: TriggerSource::Immediate,
            timer: 10.0,
            count: 1,
            fields: BTreeSet::new(),
            memory: Vec::new(),
            until: Duration::ZERO,
            triggers: 0,
        }
    }

    pub(super) fn scan_list(&self) -> &[Relay] {
        &self.scan
    }

    pub(super) fn count(&self) -> u32 {
        self.count
    }

    pub(super) fn is_measuring(&self, now: Duration) -> bool {
        now < self.until
    }

    pub(super) fn is_waiting(&self) -> bool {
        self.triggers > 0
    }

    pub(super) fn is_busy(&self, now: Duration) -> bool {
        self.is_measuring(now) || self.is_waiting()
    }

    pub(super) fn time_left(&self, now: Duration) -> Duration {
        self.until.saturating_sub(now)
    }

    pub(super) fn measuring_until(&mut self, until: Duration) {
        self.until = until;
    }

    /// Whether a measurement begins by waiting.
    pub(super) fn awaits_trigger(&self) -> bool {
        matches!(self.source, TriggerSource::Bus | TriggerSource::External)
    }

    pub(super) fn wait_for_triggers(&mut self) {
        self.triggers = self.count;
    }

    /// Takes a trigger from the bus, if one is waited for.
    pub(super) fn take_trigger(&mut self) -> bool {
        let waits = self.triggers > 0 && self.source == TriggerSource::Bus;
        self.triggers -= u32::from(waits);
        waits
    }

    pub(super) fn abort(&mut self, now: Duration) {
        self.triggers = 0;
        if self.is_measuring(now) {
            self.memory.retain(|reading| reading.at <= now);
            self.until = now;
        }
    }

    pub(super) fn has_readings(&self) -> bool {
        !self.memory.is_empty()
    }

    pub(super) fn clear_memory(&mut self) {
        self.memory.clear();
    }

    /// Whether a READ? can end and its readings be held.
    pub(super) fn check_read(&self, channels: usize) -> Result<(), Trouble> {
        if self.awaits_trigger() {
            return Err(Trouble::DEADLOCK);
        }
        self.check_memory(channels)
    }

    /// Whether the readings of a measurement can be held.
    pub(super) fn check_memory(&self, channels: usize) -> Result<(), Trouble> {
        if channels.max(1) * self.count as usize > MEMORY {
            return Err(Trouble::MEMORY);
        }
        Ok(())
    }

    /// A scan list: only channels that can be scanned, ascending, each once.
    pub(super) fn sorted(&self, relays: &Relays, list: Vec<Relay>) -> Result<Vec<Relay>, Trouble> {
        let distinct: BTreeSet<Relay> = list.into_iter().collect();
        for relay in &distinct {
            let (module, _) = relays.contact(*relay)?;
            if !module.scannable(relay.0 % 1000) {
                return Err(Trouble::CHANNEL_UNABLE);
            }
        }
        Ok(distinct.into_iter().collect())
    }

    pub(super) fn set_scan(&mut self, relays: &Relays, list: Vec<Relay>) -> Result<(), Trouble> {
        self.scan = self.sorted(relays, list)?;
        self.memory.clear();
        Ok(())
    }

    /// Carries out a setting or answers a query of the voltmeter. Also says how many channels it was for.
    pub(super) fn obey(
        &mut self,
        relays: &Relays,
        command: Command,
    ) -> Result<(Option<String>, usize), Trouble> {
        let asked = |text: String| Ok((Some(text), 0));
        let yes_no = |yes: bool| u8::from(yes).to_string();
        let nr3 = |value: f64| format_nr3_signed(value, 8);
        match command {
            Command::ConfigureVolts {
                range,
                resolution,
                channels,
            } => self.configure(relays, range, resolution, &channels),
            Command::SetChannelDelay(delay, channels) => {
                self.set(relays, &channels, |setup| setup.delay = Some(delay))
            }
            Command::SetChannelDelayAuto(auto, channels) => self.set(relays, &channels, |setup| {
                setup.delay = (!auto).then(|| setup.delay());
            }),
            Command::SetNplc(nplc, channels) => {
                self.set(relays, &channels, |setup| setup.nplc = nplc)
            }
            Command::SetRange(range, channels) => {
                self.set(relays, &channels, |setup| setup.range = range)
            }
            Command::SetRangeAuto(auto, channels) => self.set(relays, &channels, |setup| {
                if auto {
                    setup.range = Range::Auto;
                } else if setup.range == Range::Auto {
                    // The range that it had is not known before it has measured; the widest loses nothing.
                    setup.range = Range::Fixed(RANGES[RANGES.len() - 1]);
                }
            }),
            Command::SetAutozero(on, channels) => {
                self.set(relays, &channels, |setup| setup.autozero = on)
            }
            Command::SetInputAuto(on, channels) => {
                self.set(relays, &channels, |setup| setup.input_auto = on)
            }
            Command::ChannelDelay(channels) => {
                self.ask(relays, &channels, |setup| nr3(setup.delay()))
            }
            Command::ChannelDelayAuto(channels) => {
                self.ask(relays, &channels, |setup| yes_no(setup.delay.is_none()))
            }
            Command::Nplc(channels) => self.ask(relays, &channels, |setup| nr3(setup.nplc)),
            Command::Range(channels) => self.ask(relays, &channels, |setup| match setup.range {
                Range::Fixed(range) => nr3(range),
                Range::Auto => nr3(RANGES[RANGES.len() - 1]),
            }),
            Command::RangeAuto(channels) => self.ask(relays, &channels, |setup| {
                yes_no(setup.range == Range::Auto)
            }),
            Command::Autozero(channels) => {
                self.ask(relays, &channels, |setup| yes_no(setup.autozero))
            }
            Command::InputAuto(channels) => {
                self.ask(relays, &channels, |setup| yes_no(setup.input_auto))
            }
            Command::Configuration(channels) => self.ask(relays, &channels, configuration),
            Command::SetTriggerSource(source) => {
                self.source = source;
                Ok((None, 0))
            }
            Command::TriggerSource => asked(self.source.word()),
            Command::SetTriggerTimer(time) => {
                self.timer = time;
                Ok((None, 0))
            }
            Command::TriggerTimer => asked(nr3(self.timer)),
            Command::SetTriggerCount(count) => {
                self.count = count;
                Ok((None, 0))
            }
            Command::TriggerCount => asked(format!("{:+}", self.count)),
            Command::SetField(field, on) => {
                if on {
                    self.fields.insert(field);
                } else {
                    self.fields.remove(&field);
                }
                Ok((None, 0))
            }
            Command::Field(field) => asked(yes_no(self.fields.contains(&field))),
            // The simulator hands only the commands above on.
            _ => Err(Trouble::UNABLE),
        }
    }

    fn configure(
        &mut self,
        relays: &Relays,
        range: Range,
        resolution: Option<Numeric>,
        channels: &Channels,
    ) -> Result<(Option<String>, usize), Trouble> {
        let nplc = integration_for(range, resolution)?;
        if let Some(list) = channels {
            let list = relays.expand(list)?;
            self.set_scan(relays, list)?;
        }
        self.fields.clear();
        self.set(relays, &None, |setup| {
            *setup = Setup {
                range,
                nplc,
                ..Setup::default()
            };
        })
    }

    /// The channels that a setting is for; `None` stands for the bare voltmeter.
    fn targets(&self, relays: &Relays, channels: &Channels) -> Result<Vec<Option<Relay>>, Trouble> {
        let list = match channels {
            Some(list) => {
                // Queries answer in the list's own order, once all of it can be scanned.
                let list = relays.expand(list)?;
                self.sorted(relays, list.clone())?;
                list
            }
            None => self.scan.clone(),
        };
        if list.is_empty() {
            Ok(vec![None])
        } else {
            Ok(list.into_iter().map(Some).collect())
        }
    }

    fn set(
        &mut self,
        relays: &Relays,
        channels: &Channels,
        change: impl Fn(&mut Setup),
    ) -> Result<(Option<String>, usize), Trouble> {
        let targets = self.targets(relays, channels)?;
        for target in &targets {
            match target {
                Some(relay) => change(self.channels.entry(*relay).or_default()),
                None => change(&mut self.bare),
            }
        }
        self.memory.clear();
        Ok((None, targets.len()))
    }

    fn ask(
        &self,
        relays: &Relays,
        channels: &Channels,
        answer: impl Fn(Setup) -> String,
    ) -> Result<(Option<String>, usize), Trouble> {
        let targets = self.targets(relays, channels)?;
        let answers = targets.into_iter().map(|target| answer(self.setup(target)));
        Ok((Some(join(answers)), 0))
    }

    fn setup(&self, channel: Option<Relay>) -> Setup {
        match channel {
            Some(relay) => self.channels.get(&relay).copied().unwrap_or_default(),
            None => self.bare,
        }
    }

    /// Measures into memory; says how long it took and whether a reading was over its range.
    pub(super) fn sweep(
        &mut self,
        relays: &mut Relays,
        sweep: &Sweep<'_>,
        wires: &mut dyn Wires,
    ) -> (Duration, bool) {
        let mut now = sweep.start;
        let mut overload = false;
        if !sweep.list.is_empty() {
            relays.clear_for_scan(sweep.list);
            wires.relays(relays.closed(), now);
        }
        for round in 0..sweep.sweeps {
            if self.source == TriggerSource::Timer {
                let due = Duration::from_secs_f64(self.timer * f64::from(round));
                now = now.max(sweep.start + due);
            }
            if sweep.list.is_empty() {
                overload |= self.take(None, sweep.start, &mut now, relays, wires);
            }
            for channel in sweep.list {
                let joined = relays.join_to_bus(*channel);
                wires.relays(relays.closed(), now);
                overload |= self.take(Some(*channel), sweep.start, &mut now, relays, wires);
                relays.unjoin(joined);
            }
        }
        if !sweep.list.is_empty() {
            wires.relays(relays.closed(), now);
        }
        (now - sweep.start, overload)
    }

    /// Takes one reading; says whether it was over its range.
    fn take(
        &mut self,
        channel: Option<Relay>,
        start: Duration,
        now: &mut Duration,
        relays: &Relays,
        wires: &mut dyn Wires,
    ) -> bool {
        let setup = self.setup(channel);
        *now += self.period(channel, setup, relays);
        let at = *now;
        let mut measure = |range: f64| {
            let request = MeterRequest {
                channel,
                range: Volts(range),
                nplc: setup.nplc,
            };
            let Volts(volts) = wires.measure(at, request);
            let over = !volts.is_finite() || volts.abs() > range * OVER_RANGE;
            (if over { f64::INFINITY } else { volts }, over)
        };
        let widest = RANGES[RANGES.len() - 1];
        let (volts, over) = match setup.range {
            Range::Fixed(range) => measure(range),
            Range::Auto => {
                let (probe, over) = measure(widest);
                let fits = RANGES
                    .into_iter()
                    .find(|range| probe.abs() <= range * OVER_RANGE);
                match fits {
                    Some(range) if !over && range < widest => measure(range),
                    _ => (probe, over),
                }
            }
        };
        self.memory.push(Stored {
            volts,
            time: at - start,
            at,
            channel,
        });
        over
    }

    /// Time of one reading: for a channel the larger of 1/rate and 1/rate - 0.02 PLC + integration, and its delay
    /// (section 9).
    fn period(&self, channel: Option<Relay>, setup: Setup, relays: &Relays) -> Duration {
        let zero = if setup.autozero { 2.0 } else { 1.0 };
        let integration = zero * setup.nplc / self.line_hz;
        let rate = channel
            .and_then(|relay| relays.contact(relay).ok())
            .and_then(|(module, _)| module.model().scan_rate());
        let seconds = match rate {
            Some(rate) => {
                let shortest = 1.0 / f64::from(rate);
                shortest.max(shortest - 0.02 / self.line_hz + integration) + setup.delay()
            }
            None => integration.max(1.0 / READINGS_PER_SECOND),
        };
        Duration::from_secs_f64(seconds)
    }

    /// Everything in memory, as FETC? and READ? answer it.
    pub(super) fn readings(&self) -> String {
        join(self.memory.iter().map(|reading| {
            let mut text = format_nr3_signed(reading.volts, 8);
            for field in &self.fields {
                match field {
                    Field::Unit => text.push_str(" VDC"),
                    Field::Time => {
                        text.push_str(&format!(",{:013.3}", reading.time.as_secs_f64()));
                    }
                    Field::Channel => {
                        text.push_str(&format!(",{}", reading.channel.map_or(0, |relay| relay.0)));
                    }
                    Field::Alarm => text.push_str(",0"),
                }
            }
            text
        }))
    }
}

/// The shortest integration whose resolution suffices; 1 cycle when none is asked for.
fn integration_for(range: Range, resolution: Option<Numeric>) -> Result<f64, Trouble> {
    let Some(resolution) = resolution else {
        return Ok(1.0);
    };
    let Range::Fixed(range) = range else {
        // A resolution in volts means nothing while the range is not fixed.
        return Err(ParseError::SettingsConflict.into());
    };
    let (finest, coarsest) = (3e-7 * range, 1e-4 * range);
    // MIN is the smallest value, that is the finest; one coarser than any is the coarsest.
    let asked = match resolution {
        Numeric::Value(value) => value.abs(),
        Numeric::Min => finest,
        Numeric::Max => coarsest,
        _ => return Err(ParseError::OutOfRange.into()),
    };
    INTEGRATION
        .into_iter()
        // The last digit of a value given in decimals must not cost a step.
        .find(|(_, fraction)| fraction * range <= asked * (1.0 + 1e-9))
        .map(|(nplc, _)| nplc)
        .ok_or(ParseError::OutOfRange.into())
}

/// As CONF? answers it.
fn configuration(setup: Setup) -> String {
    let fraction = INTEGRATION
        .into_iter()
        .find(|(nplc, _)| setup.nplc <= *nplc)
        .map_or(3e-7, |(_, fraction)| fraction);
    match setup.range {
        Range::Fixed(range) => format!(
            "\"VOLT {},{}\"",
            format_nr3_signed(range, 6),
            format_nr3_signed(range * fraction, 6)
        ),
        Range::Auto => "\"VOLT AUTO\"".to_owned(),
    }
}
