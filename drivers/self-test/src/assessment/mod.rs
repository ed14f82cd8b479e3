//! Assessment of the readings of a self-test.
//!
//! The reference is the uniform sheet of the configured geometry, with its resistance fitted to the readings. In the
//! matrix of readings each injecting pair is a row and each measuring pair a column. The contact of an electrode is
//! determined from the readings whose driving and sensing pair share the electrode.

mod closed;
mod contacts;
mod noise;
mod pairs;
mod readings;

use survey::Wiring;

use crate::probe::Measured;
use crate::report::{CheckOutcome, Report, ReportLine};
use crate::uniform_sheet::{ExpectedSheet, Uniform};

/// Relative difference from the uniform sheet above which a row or column is at fault; loads and uneven sheets cause
/// less.
const GAIN_TOLERANCE: f64 = 0.4;
/// A measuring pair whose readings are below this fraction of the expected ones is disconnected.
const DISCONNECTED: f64 = 0.1;
/// If more than this part of the readings is unexplained, nothing is compared with the uniform sheet.
const UNEXPLAINED: f64 = 0.7;
/// Exchanging drive and sense changes the readings of a sound rig by less than this, rms.
const RECIPROCITY: f64 = 0.01;
/// A contact is poor above this many times the median resistance plus [`CONTACT_OFFSET_OHM`].
const CONTACT_FACTOR: f64 = 5.0;
const CONTACT_OFFSET_OHM: f64 = 100.0;
/// Noise is too high above this many times the configured value.
const NOISE_FACTOR: f64 = 10.0;
/// A channel is noisy above this many times both the noise of the others and the configured noise. The standard
/// deviation of eight readings of a sound channel is less than three times its noise.
const NOISY_CHANNEL_FACTOR: f64 = 5.0;
/// Smallest correlation with the expected pattern at which a relay is named.
const MIN_CORRELATION: f64 = 0.8;

/// Assesses the readings: compares them with the expected sheet and names the electrode or relay at fault. `noise_v` is
/// the configured noise of one reading, V; `at` is the wall time.
///
/// # Errors
/// A sheet whose forward solution fails.
pub fn assess(
    raw: &Measured,
    wiring: &Wiring,
    current: f64,
    expected: &ExpectedSheet,
    noise_v: f64,
    at: String,
) -> Result<Report, eit::ForwardError> {
    let nominal = Uniform::new(expected, 1.0)?;
    let first = Assessment::new(raw, wiring, current, nominal);
    let sheet = match first.factor() {
        Some(factor) => Uniform::new(expected, factor)?,
        None => Uniform::new(expected, 1.0)?,
    };
    let fitted = first.factor().is_some();
    let assessment = Assessment::new(raw, wiring, current, sheet);
    Ok(assessment.report(fitted, noise_v, at))
}

struct Assessment<'a> {
    raw: &'a Measured,
    wiring: &'a Wiring,
    sheet: Uniform,
    n: usize,
    /// Transfer resistance, ohm, by driven and sensed pair; `None` without a reading.
    matrix: Vec<Vec<Option<f64>>>,
    current: f64,
}

impl<'a> Assessment<'a> {
    fn new(raw: &'a Measured, wiring: &'a Wiring, current: f64, sheet: Uniform) -> Self {
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

    fn report(&self, fitted: bool, noise_v: f64, at: String) -> Report {
        let mut findings = Vec::new();
        let mut lines = Vec::new();
        let closed = self.stay_closed(&mut findings);
        let nothing_flows = self.raw.rows.iter().all(|row| row.compliance);
        if nothing_flows && !closed {
            findings.push(
                "no pair carries current: is the source connected to the switch, and its interlock closed?".to_owned(),
            );
        }
        let strange = self.misfit().is_none_or(|misfit| misfit > UNEXPLAINED);
        if strange && !closed && !nothing_flows {
            findings.push(
                "the readings do not resemble those of a uniform sheet: is the voltmeter connected to the switch, the \
                 geometry right, the sheet free of loads?"
                    .to_owned(),
            );
        }
        let sound = fitted && !closed && !nothing_flows && !strange;
        self.injecting(sound, nothing_flows || closed, &mut findings, &mut lines);
        self.measuring(sound, &mut findings, &mut lines);
        self.contacts(sound, nothing_flows || closed, &mut findings, &mut lines);
        self.channels(noise_v, &mut findings, &mut lines);
        let mut number = |subject: &str,
                          check: &'static str,
                          measured: Option<f64>,
                          expected: Option<f64>,
                          unit: &'static str,
                          fails: bool,
                          text: String| {
            let verdict = match (measured, fails) {
                (None, _) => CheckOutcome::NotJudged,
                (Some(_), true) => CheckOutcome::Failed,
                (Some(_), false) => CheckOutcome::Ok,
            };
            // consequences of a relay or electrode at fault are not reported again
            if verdict == CheckOutcome::Failed && findings.is_empty() {
                findings.push(format!("{subject}: {text}"));
            }
            lines.push(ReportLine {
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
        let pauw = self.van_der_pauw().filter(|_| sound);
        number(
            "sheet",
            "van der Pauw",
            pauw.map(|(_, corrected)| corrected),
            sheet_ohm,
            "ohm",
            false,
            match pauw {
                Some((raw, _)) => format!("{raw:.1} ohm before the correction for this geometry"),
                None => "a faulty electrode or relay prevents it".to_owned(),
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
        let noise = self.noise(noise_v);
        number(
            "voltmeter",
            "noise",
            noise,
            Some(noise_v),
            "V",
            noise.is_some_and(|noise| noise > NOISE_FACTOR * noise_v),
            match noise {
                Some(noise) => format!("{:.2} uV in one reading", 1e6 * noise),
                None => String::new(),
            },
        );
        let zero: Vec<f64> = self.raw.zero.iter().flatten().flatten().copied().collect();
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
}
