//! The voltmeter's settings: only changed ones are sent; all are read back in every frame.

use std::collections::BTreeMap;
use std::time::Duration;

use rig::{RigError, Sample, Stream};
use scpi::{Answer, ChannelList, Common};
use survey::{Relay, Volts};

use super::{Prepared, Unit, compact};
use crate::command::{
    Command, Field, HeaderForm, Measure, Quantity, Range, Route, Sense, Setting, TriggerSource,
};

/// Error number "undefined header".
const UNDEFINED_HEADER: i32 = -113;

impl<S: Stream> Unit<S> {
    /// Sends all settings, or after a preparation with the same settings only those that the last frame changed.
    pub(in crate::driver) async fn bring_to(
        &mut self,
        requested: &Prepared,
        before: Option<Prepared>,
    ) -> Result<(), RigError> {
        let same = before.is_some_and(|before| before.is_set_as(requested));
        if !same || std::mem::take(&mut self.doubted) {
            self.doubted = false;
            return self.set_up(requested).await;
        }
        if self.listed != requested.ascending() {
            self.set(vec![Route::SetScan(requested.list()).into()])
                .await?;
            self.listed = requested.ascending();
        }
        // delays are sent again in the message that reads them back, so that the messages of one frame can be replayed
        // without those of earlier frames
        let all = requested.meter.channel_delay;
        let differing = self.delays.iter().filter(|(_, delay)| **delay != all);
        let again = delays(differing.map(|(relay, delay)| (*relay, *delay)));
        self.held.extend(again);
        Ok(())
    }

    pub(super) async fn set_up(&mut self, requested: &Prepared) -> Result<(), RigError> {
        if !self.reset {
            self.set(vec![Common::Reset.into(), Common::ClearStatus.into()])
                .await?;
            self.reset = true;
        }
        let list = || Some(requested.list());
        let set = |setting: Setting| Command::from(Sense::Set(setting, list()));
        for setting in [
            Command::from(Sense::Configure {
                range: Range::Fixed(requested.meter.range.0),
                resolution: None,
                channels: list(),
            }),
            set(Setting::Nplc(requested.meter.nplc)),
        ] {
            self.set(vec![setting]).await?;
        }
        let autozero = Setting::Autozero(requested.meter.autozero);
        self.set_by_accepted_header(autozero, requested).await?;
        self.set_by_accepted_header(Setting::InputAuto(true), requested)
            .await?;
        let mut settings = vec![
            Command::from(Measure::SetSource(TriggerSource::Immediate)),
            Measure::SetCount(Some(requested.meter.averages)).into(),
        ];
        if !requested.scan.is_empty() {
            settings.push(set(Setting::Delay(
                requested.meter.channel_delay.as_secs_f64(),
            )));
        }
        let fields = [Field::Unit, Field::Time, Field::Channel, Field::Alarm];
        settings.extend(fields.map(|field| Measure::SetField(field, false).into()));
        for setting in settings {
            self.set(vec![setting]).await?;
        }
        let range = requested.meter.range.0;
        self.listed = requested.ascending();
        self.delays.clear();
        self.ranges = match requested.scan.is_empty() {
            true => BTreeMap::from([(None, range)]),
            false => requested
                .scan
                .iter()
                .map(|one| (Some(*one), range))
                .collect(),
        };
        Ok(())
    }

    /// Sends a setting with the documented header and, if that is undefined, with the 34970A's; stores and logs the
    /// accepted form. The error queue is read by a separate message, because a command error ends its message.
    async fn set_by_accepted_header(
        &mut self,
        setting: Setting,
        requested: &Prepared,
    ) -> Result<(), RigError> {
        let quantity = setting.quantity();
        let forms = match self.headers.get(&quantity) {
            Some(form) => vec![*form],
            None => vec![HeaderForm::Documented, HeaderForm::Of34970A],
        };
        let mut first_refusal = None;
        for form in forms {
            let list = Some(requested.list());
            let command = match form {
                HeaderForm::Documented => Sense::Set(setting, list),
                HeaderForm::Of34970A => Sense::SetOlder(setting, list),
            };
            let sent = command.to_string();
            self.conversation.link_mut().send(&sent).await?;
            let error = self.conversation.send(&[] as &[Command]).await?.error;
            if error.code == 0 {
                if self.headers.insert(quantity, form).is_none() {
                    let instrument = self.conversation.instrument();
                    let header = quantity.header(form);
                    tracing::info!(instrument, header, ?form, "header accepted");
                }
                return Ok(());
            }
            let undefined = error.code == UNDEFINED_HEADER;
            let refusal = self.conversation.refused(sent, error);
            if !undefined {
                return Err(refusal);
            }
            first_refusal.get_or_insert(refusal);
        }
        first_refusal.map_or(Ok(()), Err)
    }

    /// Reads back every setting that a reading depends on, in one message.
    pub(in crate::driver) async fn verify(&mut self, requested: &Prepared) -> Result<(), RigError> {
        let headers = self.headers.clone();
        let ask = |quantity| {
            let list = Some(requested.list());
            Command::from(match headers.get(&quantity) {
                Some(HeaderForm::Of34970A) => Sense::AskOlder(quantity, None, list),
                _ => Sense::Ask(quantity, None, list),
            })
        };
        let channels = requested.scan.len().max(1);
        let number = |value: f64| vec![value; channels];
        let mut settings = vec![
            ("range", ask(Quantity::Range), self.ranges_of(requested)),
            (
                "integration",
                ask(Quantity::Nplc),
                number(requested.meter.nplc),
            ),
            (
                "autozero",
                ask(Quantity::Autozero),
                number(f64::from(u8::from(requested.meter.autozero))),
            ),
            ("input impedance", ask(Quantity::InputAuto), number(1.0)),
            (
                "trigger count",
                Measure::Count(None).into(),
                vec![f64::from(requested.meter.averages)],
            ),
            (
                "scan size",
                Route::ScanSize.into(),
                vec![requested.scan.len() as f64],
            ),
        ];
        if !requested.scan.is_empty() {
            settings.push((
                "channel delay",
                ask(Quantity::Delay),
                self.delays_of(requested),
            ));
        }
        let mut queries: Vec<Command> =
            settings.iter().map(|(_, query, _)| query.clone()).collect();
        queries.push(Route::Scan.into());
        let replies = self.ask_all(queries).await?;
        let answers = &replies.answers;
        for ((setting, _, set), answer) in settings.into_iter().zip(answers) {
            let read = self.numbers(&replies.message, answer, set.len())?;
            let differs = |(read, set): (&Answer, &f64)| {
                !read
                    .value()
                    .is_some_and(|read| (read - set).abs() <= 1e-6 * set.abs())
            };
            if let Some(place) = read.iter().zip(&set).position(differs) {
                return Err(self.conversation.mismatch(setting, set[place], answer));
            }
        }
        // the scan list is the last reply
        let answer = answers.last().map_or("", String::as_str);
        let meant = ChannelList::of(requested.ascending().iter().map(|relay| relay.0));
        let read = scpi::parse_block(answer.as_bytes())
            .ok()
            .and_then(|block| std::str::from_utf8(block).ok())
            .and_then(|text| text.parse::<ChannelList>().ok())
            .ok_or_else(|| {
                let expected = "a channel list in a block";
                self.conversation
                    .garbled(&replies.message, answer, expected)
            })?;
        if read != meant && read != requested.list() {
            return Err(self.conversation.mismatch("scan list", meant, read));
        }
        Ok(())
    }

    /// The ranges as last set, in the order in which the instrument reports them.
    pub(super) fn ranges_of(&self, requested: &Prepared) -> Vec<f64> {
        let set = |place| self.ranges.get(&place).copied();
        let otherwise = requested.meter.range.0;
        match requested.scan.is_empty() {
            true => vec![set(None).unwrap_or(otherwise)],
            false => requested
                .ascending()
                .into_iter()
                .map(|relay| set(Some(relay)).unwrap_or(otherwise))
                .collect(),
        }
    }

    /// The delays as last set, ascending channels, s.
    pub(super) fn delays_of(&self, requested: &Prepared) -> Vec<f64> {
        let of = |relay| {
            *self
                .delays
                .get(&relay)
                .unwrap_or(&requested.meter.channel_delay)
        };
        let relays = requested.ascending().into_iter();
        relays.map(|relay| of(relay).as_secs_f64()).collect()
    }

    /// The commands for channels whose delay changes. A delay is the common delay plus the channel's own wait, rounded
    /// up to whole milliseconds (section 5).
    pub(super) fn change_delays(&mut self, samples: &[Sample], all: Duration) -> Vec<Command> {
        let mut changed = Vec::new();
        for sample in samples {
            let requested = whole_milliseconds(all + sample.wait);
            if self.delays.insert(sample.relay, requested).unwrap_or(all) != requested {
                changed.push((sample.relay, requested));
            }
        }
        delays(changed)
    }

    /// The commands for channels whose range changes.
    pub(super) fn change_ranges(&mut self, requested: &[(Option<Relay>, Volts)]) -> Vec<Command> {
        let mut groups: Vec<(f64, Vec<Relay>)> = Vec::new();
        for (place, Volts(range)) in requested.iter().copied() {
            if self.ranges.insert(place, range) == Some(range) {
                continue;
            }
            let relays = place.into_iter();
            match groups.iter_mut().find(|(known, _)| *known == range) {
                Some((_, group)) => group.extend(relays),
                None => groups.push((range, relays.collect())),
            }
        }
        groups
            .into_iter()
            .map(|(range, mut relays)| {
                relays.sort_unstable();
                let range = Setting::Range(Range::Fixed(range));
                Sense::Set(range, Some(compact(&relays))).into()
            })
            .collect()
    }
}

/// Rounds up to whole milliseconds, so that a wait is never shorter than requested.
fn whole_milliseconds(wait: Duration) -> Duration {
    Duration::from_millis(wait.as_nanos().div_ceil(1_000_000) as u64)
}

/// The commands that set delays, one for each different delay.
fn delays(requested: impl IntoIterator<Item = (Relay, Duration)>) -> Vec<Command> {
    let mut groups: BTreeMap<Duration, Vec<Relay>> = BTreeMap::new();
    for (relay, delay) in requested {
        groups.entry(delay).or_default().push(relay);
    }
    groups
        .into_iter()
        .map(|(delay, mut relays)| {
            relays.sort_unstable();
            let delay = Setting::Delay(delay.as_secs_f64());
            Sense::Set(delay, Some(compact(&relays))).into()
        })
        .collect()
}
