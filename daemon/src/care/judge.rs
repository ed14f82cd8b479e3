//! What the readings of a self-test mean.
//!
//! The measure of everything is the uniform sheet of the configured geometry, its resistance fitted to the readings:
//! each injecting relay is a row, each measuring relay a column of the matrix of readings, and an electrode's contact
//! shows where it is shared by the driving and the sensing pair.

use survey::{Relay, Wiring};

use super::pauw::sheet_resistance;
use super::probe::{Lone, Raw, Retry};
use super::report::{Line, Report, Verdict};
use super::uniform::Uniform;
use crate::model::Geometry;

/// A row or column that differs from the uniform sheet by more is at fault; loads and uneven sheets stay below.
const GAIN_OFF: f64 = 0.4;
/// A measuring pair that reads less of what it should is joined to nothing.
const DEAD: f64 = 0.1;
/// Part of the readings that a uniform sheet leaves unexplained, from which nothing is compared with it.
const STRANGE: f64 = 0.7;
/// Exchanging drive and sense changes the readings of a sound rig by less, rms.
const RECIPROCITY: f64 = 0.01;
/// A contact is poor when it has so many times the median, and [`CONTACT_MORE`] on top.
const CONTACT_TIMES: f64 = 5.0;
const CONTACT_MORE: f64 = 100.0;
/// Noise is called high from so many times the configured value.
const NOISE_TIMES: f64 = 10.0;
/// Likeness of patterns from which a relay is named.
const ALIKE: f64 = 0.8;

/// Judges what was read. `noise_v` is what the configuration expects of one reading; `at` is the wall time.
///
/// # Errors
/// A geometry whose forward solution fails.
pub(crate) fn judge(
    raw: &Raw,
    wiring: &Wiring,
    current: f64,
    geometry: &Geometry,
    noise_v: f64,
    at: String,
) -> Result<Report, eit::ForwardError> {
    let nominal = Uniform::new(geometry, 1.0)?;
    let first = Judge::new(raw, wiring, current, nominal);
    let sheet = match first.factor() {
        Some(factor) => Uniform::new(geometry, factor)?,
        None => Uniform::new(geometry, 1.0)?,
    };
    let fitted = first.factor().is_some();
    let judge = Judge::new(raw, wiring, current, sheet);
    Ok(judge.report(fitted, noise_v, at))
}

struct Judge<'a> {
    raw: &'a Raw,
    wiring: &'a Wiring,
    sheet: Uniform,
    n: usize,
    /// Ohm, by driven and sensed pair; `None` where nothing was read.
    matrix: Vec<Vec<Option<f64>>>,
    current: f64,
}

impl<'a> Judge<'a> {
    fn new(raw: &'a Raw, wiring: &'a Wiring, current: f64, sheet: Uniform) -> Self {
        let ohms = |volts: &Option<f64>| volts.map(|volts| volts / current);
        let matrix = raw.rows.iter().map(|row| match row.compliance {
            true => vec![None; row.volts.len()],
            false => row.volts.iter().map(ohms).collect(),
        });
        Self {
            matrix: matrix.collect(),
            n: wiring.electrodes,
            raw,
            wiring,
            sheet,
            current,
        }
    }

    /// Whether two pairs share an electrode, or are one.
    fn touch(&self, one: usize, other: usize) -> bool {
        let apart = (one + self.n - other) % self.n;
        apart <= 1 || apart == self.n - 1
    }

    /// Pairs of pairs that share no electrode, with what was read and what the sheet would give, ohm.
    fn readings(&self) -> impl Iterator<Item = (usize, usize, f64, f64)> + '_ {
        (0..self.n).flat_map(move |drive| {
            (0..self.n)
                .filter(move |sense| !self.touch(drive, *sense))
                .filter_map(move |sense| {
                    let read = self.matrix[drive][sense]?;
                    Some((drive, sense, read, self.sheet.pair(drive, sense)))
                })
        })
    }

    /// By how much the sheet's resistance differs from the configured one: the median over all readings, which a few
    /// relays and electrodes at fault do not move.
    fn factor(&self) -> Option<f64> {
        let mut ratios: Vec<f64> = self
            .readings()
            .map(|(.., read, model)| read / model)
            .collect();
        ratios.sort_by(f64::total_cmp);
        let median = *ratios.get(ratios.len() / 2)?;
        (median > 1e-6 && median < 1e6).then_some(median)
    }

    /// The part of the sheet's pattern that is in some readings, and how much else is in them; `None` without any.
    fn gain(readings: impl Iterator<Item = (f64, f64)>) -> Option<(f64, f64)> {
        let readings: Vec<(f64, f64)> = readings.collect();
        let power: f64 = readings.iter().map(|(_, model)| model * model).sum();
        let shared: f64 = readings.iter().map(|(read, model)| read * model).sum();
        if readings.len() < 3 || power == 0.0 {
            return None;
        }
        let gain = shared / power;
        let rest: f64 = readings
            .iter()
            .map(|(read, model)| (read - gain * model).powi(2))
            .sum();
        Some((gain, (rest / power).sqrt()))
    }

    fn fails_row(&self, pair: usize) -> bool {
        self.raw.rows[pair % self.n].compliance
    }

    /// An electrode is open where both pairs that drive it carry no current.
    fn open_electrodes(&self) -> Vec<usize> {
        let fails = |electrode: &usize| {
            self.fails_row(*electrode) && self.fails_row(electrode + self.n - 1)
        };
        (0..self.n).filter(fails).collect()
    }

    fn report(&self, fitted: bool, noise_v: f64, at: String) -> Report {
        let mut findings = Vec::new();
        let mut lines = Vec::new();
        let closed = self.stay_closed(&mut findings);
        let nothing_flows = self.raw.rows.iter().all(|row| row.compliance);
        if nothing_flows && !closed {
            findings.push(
                "no pair carries current: is the source joined to the switch, and its interlock closed?".to_owned(),
            );
        }
        let strange = self.misfit().is_none_or(|misfit| misfit > STRANGE);
        if strange && !closed && !nothing_flows {
            findings.push(
                "the readings are not a uniform sheet's at all: is the voltmeter joined to the switch, the geometry \
                 right, the sheet free of loads?"
                    .to_owned(),
            );
        }
        let sound = fitted && !closed && !nothing_flows && !strange;
        self.injecting(sound, nothing_flows || closed, &mut findings, &mut lines);
        self.measuring(sound, &mut findings, &mut lines);
        self.contacts(sound, nothing_flows || closed, &mut findings, &mut lines);
        let mut number = |subject: &str,
                          check: &'static str,
                          measured: Option<f64>,
                          expected: Option<f64>,
                          unit: &'static str,
                          fails: bool,
                          text: String| {
            let verdict = match (measured, fails) {
                (None, _) => Verdict::NotJudged,
                (Some(_), true) => Verdict::Failed,
                (Some(_), false) => Verdict::Ok,
            };
            // what follows from a relay or electrode at fault is not told again
            if verdict == Verdict::Failed && findings.is_empty() {
                findings.push(format!("{subject}: {text}"));
            }
            lines.push(Line {
                subject: subject.to_owned(),
                check,
                verdict,
                measured,
                expected,
                unit,
                text,
            });
        };
        let sheet_ohm = sound.then_some(self.sheet.sheet_ohm);
        let misfit = self.misfit().filter(|_| sound);
        number(
            "sheet",
            "resistance",
            sheet_ohm,
            None,
            "ohm",
            false,
            match misfit {
                Some(misfit) => format!(
                    "uniform sheet, {:.1} % of the readings unexplained",
                    100.0 * misfit
                ),
                None => String::new(),
            },
        );
        let pauw = self.pauw().filter(|_| sound);
        number(
            "sheet",
            "van der Pauw",
            pauw.map(|(_, corrected)| corrected),
            sheet_ohm,
            "ohm",
            false,
            match pauw {
                Some((raw, _)) => format!("{raw:.1} ohm before the correction for this geometry"),
                None => "an electrode or relay at fault is in the way".to_owned(),
            },
        );
        let reciprocity = self.reciprocity();
        number(
            "sheet",
            "reciprocity",
            reciprocity,
            Some(0.0),
            "",
            sound && reciprocity.is_some_and(|part| part > RECIPROCITY),
            match reciprocity {
                Some(part) => format!("drive and sense exchanged differ by {:.2} %", 100.0 * part),
                None => String::new(),
            },
        );
        let noise = self.noise();
        number(
            "voltmeter",
            "noise",
            noise,
            Some(noise_v),
            "V",
            noise.is_some_and(|noise| noise > NOISE_TIMES * noise_v),
            match noise {
                Some(noise) => format!("{:.2} uV in one reading", 1e6 * noise),
                None => String::new(),
            },
        );
        let zero: Vec<f64> = self.raw.zero.iter().flatten().copied().collect();
        let offset = (!zero.is_empty()).then(|| zero.iter().sum::<f64>() / zero.len() as f64);
        number(
            "voltmeter",
            "offset",
            offset,
            Some(0.0),
            "V",
            false,
            match offset {
                Some(offset) => format!("{:.2} uV at 0 A", 1e6 * offset),
                None => String::new(),
            },
        );
        Report {
            at,
            simulated: false,
            wiring: self.wiring.name.clone(),
            current_a: self.current,
            passed: findings.is_empty(),
            findings,
            lines,
            sheet_ohm,
            misfit,
            pauw_ohm: pauw.map(|(_, corrected)| corrected),
            pauw_raw_ohm: pauw.map(|(raw, _)| raw),
            reciprocity,
            noise_v: noise,
            offset_v: offset,
        }
    }

    /// Relays that stay closed: something came of what should have led nowhere. Returns whether any does.
    fn stay_closed(&self, findings: &mut Vec<String>) -> bool {
        let before = findings.len();
        let mut say = |relay: Option<Relay>, kind: &str| {
            let text = match relay {
                Some(relay) => format!(
                    "relay {relay} stays closed: it {}",
                    self.wiring.purpose(relay)
                ),
                None => format!(
                    "a relay that {kind} stays closed; which is not to be told from the readings"
                ),
            };
            if !findings.contains(&text) {
                findings.push(text);
            }
        };
        for lone in self
            .raw
            .lone_sources
            .iter()
            .filter(|lone| !lone.row.compliance)
        {
            say(
                self.which(lone, &self.wiring.inject, |lone_pair, other, pair| {
                    Some(match lone_pair {
                        None => self.sheet.pair(other, pair),
                        Some(ends) => self.sheet.volts(ends(other), (pair, pair + 1)),
                    })
                }),
                "joins an electrode to the source",
            );
        }
        // what a pair reads at most from its own injection
        let typical = self.sheet.pair(0, 0).abs() * self.current;
        for lone in &self.raw.lone_meters {
            let seen = lone
                .row
                .volts
                .iter()
                .flatten()
                .fold(0.0_f64, |most, volts| most.max(volts.abs()));
            if seen > 1e-2 * typical {
                say(
                    self.which(lone, &self.wiring.measure, |lone_pair, other, pair| {
                        Some(match lone_pair {
                            None => self.sheet.pair(pair, other),
                            Some(ends) => self.sheet.volts((pair, pair + 1), ends(other)),
                        })
                    }),
                    "joins an electrode to the voltmeter",
                );
            }
        }
        findings.len() > before
    }

    /// The relay whose pattern is most like what was read while it should have been open. `model` gives the voltage
    /// for a candidate (a pair, or the electrode opposite the lone one) and a place in the row.
    fn which(
        &self,
        lone: &Lone,
        pairs: &[(survey::Dipole, Vec<Relay>)],
        model: impl Fn(Option<&dyn Fn(usize) -> (usize, usize)>, usize, usize) -> Option<f64>,
    ) -> Option<Relay> {
        let read = &lone.row.volts;
        // on a side of its own: the electrode that it is on, and whether it is the minus side
        let side = lone.closed.first().and_then(|closed| {
            pairs.iter().find_map(|(pair, relays)| {
                let place = relays.iter().position(|relay| relay == closed)?;
                Some((
                    if place == 0 {
                        pair.plus.0
                    } else {
                        pair.minus.0
                    },
                    place,
                ))
            })
        });
        let other_side = |electrode: usize, place: usize| {
            pairs.iter().find_map(|(pair, relays)| {
                let (end, relay) = match place {
                    0 => (pair.minus.0, *relays.get(1)?),
                    _ => (pair.plus.0, *relays.first()?),
                };
                (end == electrode).then_some(relay)
            })
        };
        let typical = self.sheet.pair(0, 0).abs() * self.current;
        if let Some((electrode, place)) = side
            && read
                .iter()
                .flatten()
                .all(|volts| volts.abs() < 1e-3 * typical)
        {
            // current, and no voltage: source or voltmeter is shorted through the lone relay's own electrode
            return other_side(electrode, place);
        }
        let mut best: Option<(f64, Relay)> = None;
        for (candidate, pair) in pairs.iter().enumerate().take(self.n) {
            let relay = match side {
                None => *pair.1.first()?,
                Some((electrode, place)) => {
                    if electrode == candidate {
                        continue;
                    }
                    other_side(candidate, place)?
                }
            };
            let ends = side.map(|(electrode, place)| {
                move |other: usize| match place {
                    0 => (electrode, other),
                    _ => (other, electrode),
                }
            });
            let (mut shared, mut a, mut b) = (0.0, 0.0, 0.0);
            for (place, volts) in read.iter().enumerate() {
                let Some(volts) = volts else { continue };
                let lone = ends
                    .as_ref()
                    .map(|ends| ends as &dyn Fn(usize) -> (usize, usize));
                let expected = model(lone, candidate, place)?;
                shared += volts * expected;
                a += volts * volts;
                b += expected * expected;
            }
            let alike = shared / (a * b).sqrt();
            if alike.is_finite() && best.is_none_or(|(most, _)| alike > most) {
                best = Some((alike, relay));
            }
        }
        best.filter(|(alike, _)| *alike > ALIKE)
            .map(|(_, relay)| relay)
    }

    fn injecting(
        &self,
        sound: bool,
        hopeless: bool,
        findings: &mut Vec<String>,
        lines: &mut Vec<Line>,
    ) {
        let open = self.open_electrodes();
        // What a dead measuring pair reads is its own fault, not that of the pair that injects beside it.
        let dead: Vec<bool> = (0..self.wiring.measure.len())
            .map(|pair| {
                self.sensed_gain(pair)
                    .is_some_and(|(gain, _)| gain.abs() < DEAD)
            })
            .collect();
        for (pair, (ends, relays)) in self.wiring.inject.iter().enumerate() {
            let touches_open = open.contains(&ends.plus.0) || open.contains(&ends.minus.0);
            let gain = Self::gain(
                self.readings()
                    .filter(|(drive, sense, ..)| *drive == pair && !dead[*sense])
                    .map(|(.., read, model)| (read, model)),
            );
            let (verdict, text) = if hopeless || (touches_open && self.fails_row(pair)) {
                let why = if touches_open && !hopeless {
                    "its electrode is open"
                } else {
                    ""
                };
                (Verdict::NotJudged, why.to_owned())
            } else if self.fails_row(pair) {
                let text = stays_open(self.wiring, &at_fault(&self.raw.retries, pair, relays));
                findings.push(text.clone());
                (Verdict::Failed, text)
            } else if sound && gain.is_some_and(|(gain, _)| (gain - 1.0).abs() > GAIN_OFF) {
                let text = format!(
                    "injecting pair {}: its readings are not the sheet's; is it wired to electrodes {} and {}?",
                    pair + 1,
                    ends.plus,
                    ends.minus
                );
                findings.push(text.clone());
                (Verdict::Failed, text)
            } else {
                (Verdict::Ok, String::new())
            };
            lines.push(Line {
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

    /// What a measuring pair reads of what the model says, and how far single readings are from that.
    fn sensed_gain(&self, pair: usize) -> Option<(f64, f64)> {
        Self::gain(
            self.readings()
                .filter(|(_, sense, ..)| *sense == pair)
                .map(|(.., read, model)| (read, model)),
        )
    }

    fn measuring(&self, sound: bool, findings: &mut Vec<String>, lines: &mut Vec<Line>) {
        for (pair, (ends, relays)) in self.wiring.measure.iter().enumerate() {
            let gain = self.sensed_gain(pair);
            let (verdict, text) = match gain {
                Some((gain, _)) if sound && gain.abs() < DEAD => {
                    let at_fault = at_fault(&self.raw.meter_retries, pair, relays);
                    let text = stays_open(self.wiring, &at_fault);
                    findings.push(text.clone());
                    (Verdict::Failed, text)
                }
                Some((gain, rest))
                    if sound && ((gain - 1.0).abs() > GAIN_OFF || rest > GAIN_OFF) =>
                {
                    let text = format!(
                        "measuring pair {}: its readings are not the sheet's; is it wired to electrodes {} and {}?",
                        pair + 1,
                        ends.plus,
                        ends.minus
                    );
                    findings.push(text.clone());
                    (Verdict::Failed, text)
                }
                Some(_) if sound => (Verdict::Ok, String::new()),
                _ => (Verdict::NotJudged, String::new()),
            };
            lines.push(Line {
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

    fn contacts(
        &self,
        sound: bool,
        hopeless: bool,
        findings: &mut Vec<String>,
        lines: &mut Vec<Line>,
    ) {
        let n = self.n;
        let open = self.open_electrodes();
        let contact = |electrode: usize| {
            let last = (electrode + n - 1) % n;
            // leaves by the last pair's minus, seen by this pair's plus, and the other way round
            let each = [(last, electrode), (electrode, last)];
            let seen: Vec<f64> = each
                .into_iter()
                .filter_map(|(drive, sense)| {
                    Some(self.sheet.pair(drive, sense) - self.matrix[drive][sense]?)
                })
                .collect();
            let mean = seen.iter().sum::<f64>() / seen.len() as f64;
            (sound && !seen.is_empty()).then(|| self.sheet.contact_ohm[electrode] + mean)
        };
        let each: Vec<Option<f64>> = (0..n).map(contact).collect();
        let mut sorted: Vec<f64> = each.iter().flatten().copied().collect();
        sorted.sort_by(f64::total_cmp);
        let median = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
        for (electrode, ohms) in each.into_iter().enumerate() {
            let number = electrode + 1;
            let (verdict, text) = if !hopeless && open.contains(&electrode) {
                let text = format!(
                    "electrode {number}: open; look at its wire and its contact with the sheet"
                );
                findings.push(text.clone());
                (Verdict::Failed, text)
            } else {
                match ohms {
                    Some(ohms) if ohms > CONTACT_TIMES * median.max(0.0) + CONTACT_MORE => {
                        let text = format!(
                            "electrode {number}: poor contact, {ohms:.0} ohm where the others have {median:.0}"
                        );
                        findings.push(text.clone());
                        (Verdict::Failed, text)
                    }
                    Some(_) => (Verdict::Ok, String::new()),
                    None => (Verdict::NotJudged, String::new()),
                }
            };
            lines.push(Line {
                subject: format!("electrode {number}"),
                check: "contact",
                verdict,
                measured: ohms,
                expected: sound.then_some(median),
                unit: "ohm",
                text,
            });
        }
    }

    fn misfit(&self) -> Option<f64> {
        let (mut rest, mut power) = (0.0, 0.0);
        for (.., read, model) in self.readings() {
            rest += (read - model) * (read - model);
            power += model * model;
        }
        (power > 0.0).then(|| (rest / power).sqrt())
    }

    fn reciprocity(&self) -> Option<f64> {
        let (mut differing, mut power) = (0.0, 0.0);
        for (drive, sense, read, _) in self.readings() {
            if let Some(exchanged) = self.matrix[sense][drive] {
                differing += (read - exchanged) * (read - exchanged);
                power += read * read;
            }
        }
        (power > 0.0).then(|| (differing / power).sqrt())
    }

    /// By superposition of neighbouring pairs on four electrodes a quarter ring apart: as the formula gives it, and
    /// corrected by what it gives for the model of a sheet whose resistance is known. Every way of placing the four is
    /// tried until one has no missing reading; a missing one is taken from its exchanged twin.
    fn pauw(&self) -> Option<(f64, f64)> {
        let n = self.n;
        let quarter = |place: usize| (place * n + 2) / 4;
        let corners = [0, 1, 2, 3].map(quarter);
        let resistance = |matrix: &dyn Fn(usize, usize) -> Option<f64>,
                          drive: (usize, usize),
                          sense: (usize, usize)| {
            let mut sum = 0.0;
            for from in drive.0..drive.1 {
                for to in sense.0..sense.1 {
                    sum += matrix(from % n, to % n)?;
                }
            }
            Some(sum.abs())
        };
        let formula = |matrix: &dyn Fn(usize, usize) -> Option<f64>, shift: usize| {
            let [a, b, c, d] = corners.map(|corner| corner + shift);
            let first = resistance(matrix, (a, b), (c, d))?;
            let second = resistance(matrix, (b, c), (d, a + n))?;
            sheet_resistance(first, second)
        };
        let read =
            |drive: usize, sense: usize| self.matrix[drive][sense].or(self.matrix[sense][drive]);
        let model = |drive: usize, sense: usize| Some(self.sheet.pair(drive, sense));
        (0..n).find_map(|shift| {
            let raw = formula(&read, shift)?;
            let correction = self.sheet.sheet_ohm / formula(&model, shift)?;
            Some((raw, raw * correction))
        })
    }

    /// Standard deviation of one reading, pooled over the places that were read again and again.
    fn noise(&self) -> Option<f64> {
        let places = self.raw.repeats.first()?.len();
        let (mut squares, mut freedom) = (0.0, 0.0);
        for place in 0..places {
            let read: Vec<f64> = self
                .raw
                .repeats
                .iter()
                .filter_map(|row| row[place])
                .collect();
            if read.len() < 2 {
                continue;
            }
            let mean = read.iter().sum::<f64>() / read.len() as f64;
            squares += read
                .iter()
                .map(|volts| (volts - mean) * (volts - mean))
                .sum::<f64>();
            freedom += read.len() as f64 - 1.0;
        }
        (freedom > 0.0).then(|| (squares / freedom).sqrt())
    }
}

/// Of a pair's relays the one that led nowhere in another pair's company too; all of them where none was tried.
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

fn named(relays: &[Relay]) -> String {
    let numbers: Vec<String> = relays.iter().map(Relay::to_string).collect();
    let word = if relays.len() == 1 { "relay" } else { "relays" };
    format!("{word} {}", numbers.join(" and "))
}
