//! What a self-test found.

use serde::Serialize;

/// The result of one check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// As it should be.
    Ok,
    /// At fault.
    Failed,
    /// Something else is wrong that must be mended first.
    NotJudged,
}

impl Verdict {
    /// The word on the bus.
    pub fn word(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Failed => "failed",
            Self::NotJudged => "not-judged",
        }
    }
}

/// One row of the table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReportLine {
    /// `relay 1042`, `electrode 17`, `sheet`, `voltmeter`.
    pub subject: String,
    /// What was looked at.
    pub check: &'static str,
    /// Its result.
    pub verdict: Verdict,
    /// What was measured; `None` where nothing was.
    pub measured: Option<f64>,
    /// What a sound rig would give.
    pub expected: Option<f64>,
    /// Of both numbers.
    pub unit: &'static str,
    /// For a person.
    pub text: String,
}

/// The whole of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// RFC 3339, UTC.
    pub at: String,
    /// Whether the instruments are simulated.
    pub simulated: bool,
    /// Name of the wiring.
    pub wiring: String,
    /// Current injected, A.
    pub current_a: f64,
    /// Nothing was found.
    pub passed: bool,
    /// What to mend, most grave first: `relay 1042 stays closed: ...`, `electrode 17: open ...`.
    pub findings: Vec<String>,
    /// Every check.
    pub lines: Vec<ReportLine>,
    /// By the fit of a uniform sheet, ohm.
    pub sheet_ohm: Option<f64>,
    /// Part of the readings that a uniform sheet does not explain, rms.
    pub misfit: Option<f64>,
    /// Van der Pauw by superposition, corrected for electrodes that are not on the edge, ohm.
    pub pauw_ohm: Option<f64>,
    /// The same as the formula gives it.
    pub pauw_raw_ohm: Option<f64>,
    /// Difference of exchanged drive and sense, rms of the readings.
    pub reciprocity: Option<f64>,
    /// Standard deviation of one reading, V.
    pub noise_v: Option<f64>,
    /// Mean reading at 0 A, V.
    pub offset_v: Option<f64>,
}
