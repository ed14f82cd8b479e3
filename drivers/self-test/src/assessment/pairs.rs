//! Pairs one by one: whether an injecting pair carries current, whether a measuring pair reaches the voltmeter.

use survey::{Relay, Wiring};

use crate::assessment::{Assessment, DISCONNECTED, GAIN_TOLERANCE};
use crate::probe::Retry;
use crate::report::{CheckOutcome, ReportLine};

impl Assessment<'_> {
    pub(super) fn fails_row(&self, pair: usize) -> bool {
        self.raw.rows[pair % self.n].compliance
    }

    pub(super) fn injecting(
        &self,
        sound: bool,
        unexplained: bool,
        findings: &mut Vec<String>,
        lines: &mut Vec<ReportLine>,
    ) {
        let open = self.open_electrodes();
        // The readings of a disconnected measuring pair are not the fault of the injecting pair.
        let dead: Vec<bool> = (0..self.wiring.measure.len())
            .map(|pair| {
                self.sensed_gain(pair)
                    .is_some_and(|(gain, _)| gain.abs() < DISCONNECTED)
            })
            .collect();
        for (pair, (ends, relays)) in self.wiring.inject.iter().enumerate() {
            let touches_open = open.contains(&ends.plus.0) || open.contains(&ends.minus.0);
            let gain = Self::gain(
                self.readings()
                    .filter(|(drive, sense, ..)| *drive == pair && !dead[*sense])
                    .map(|(.., read, model)| (read, model)),
            );
            let (verdict, text) = if unexplained || (touches_open && self.fails_row(pair)) {
                let why = if touches_open && !unexplained {
                    "its electrode is open"
                } else {
                    ""
                };
                (CheckOutcome::NotJudged, why.to_owned())
            } else if self.fails_row(pair) {
                let text = stays_open(self.wiring, &at_fault(&self.raw.retries, pair, relays));
                findings.push(text.clone());
                (CheckOutcome::Failed, text)
            } else if sound && gain.is_some_and(|(gain, _)| (gain - 1.0).abs() > GAIN_TOLERANCE) {
                let text = format!(
                    "injecting pair {}: its readings do not match the sheet; is it wired to electrodes {} and {}?",
                    pair + 1,
                    ends.plus,
                    ends.minus
                );
                findings.push(text.clone());
                (CheckOutcome::Failed, text)
            } else {
                (CheckOutcome::Ok, String::new())
            };
            lines.push(ReportLine {
                subject: named(relays),
                check: "carries current",
                verdict,
                measured: self.matrix[pair][pair],
                expected: sound.then(|| self.sheet.pair(pair, pair)),
                unit: "ohm",
                text,
            });
        }
    }

    /// The readings of a measuring pair as a fraction of those of the model, and the part that this fraction does not
    /// explain.
    pub(super) fn sensed_gain(&self, pair: usize) -> Option<(f64, f64)> {
        Self::gain(
            self.readings()
                .filter(|(_, sense, ..)| *sense == pair)
                .map(|(.., read, model)| (read, model)),
        )
    }

    pub(super) fn measuring(
        &self,
        sound: bool,
        findings: &mut Vec<String>,
        lines: &mut Vec<ReportLine>,
    ) {
        for (pair, (ends, relays)) in self.wiring.measure.iter().enumerate() {
            let gain = self.sensed_gain(pair);
            let (verdict, text) = match gain {
                Some((gain, _)) if sound && gain.abs() < DISCONNECTED => {
                    let at_fault = at_fault(&self.raw.meter_retries, pair, relays);
                    let text = stays_open(self.wiring, &at_fault);
                    findings.push(text.clone());
                    (CheckOutcome::Failed, text)
                }
                Some((gain, rest))
                    if sound && ((gain - 1.0).abs() > GAIN_TOLERANCE || rest > GAIN_TOLERANCE) =>
                {
                    let text = format!(
                        "measuring pair {}: its readings do not match the sheet; is it wired to electrodes {} and {}?",
                        pair + 1,
                        ends.plus,
                        ends.minus
                    );
                    findings.push(text.clone());
                    (CheckOutcome::Failed, text)
                }
                Some(_) if sound => (CheckOutcome::Ok, String::new()),
                _ => (CheckOutcome::NotJudged, String::new()),
            };
            lines.push(ReportLine {
                subject: named(relays),
                check: "reaches the voltmeter",
                verdict,
                measured: gain.map(|(gain, _)| gain).filter(|_| sound),
                expected: sound.then_some(1.0),
                unit: "",
                text,
            });
        }
    }
}

/// The relays of a pair that also failed together with a relay of another pair; all relays of the pair if no retry
/// failed.
fn at_fault(retries: &[Retry], pair: usize, relays: &[Relay]) -> Vec<Relay> {
    let led_nowhere = retries
        .iter()
        .filter(|retry| retry.pair == pair && !retry.flows);
    let named: Vec<Relay> = led_nowhere.map(|retry| retry.relay).collect();
    if named.is_empty() {
        relays.to_vec()
    } else {
        named
    }
}

fn stays_open(wiring: &Wiring, relays: &[Relay]) -> String {
    let each: Vec<String> = relays
        .iter()
        .map(|relay| format!("relay {relay} stays open: it {}", wiring.purpose(*relay)))
        .collect();
    each.join(", or ")
}

pub(super) fn named(relays: &[Relay]) -> String {
    let numbers: Vec<String> = relays.iter().map(Relay::to_string).collect();
    let word = if relays.len() == 1 { "relay" } else { "relays" };
    format!("{word} {}", numbers.join(" and "))
}
