//! The result of a self-test.

use serde::Serialize;

/// The result of one check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum CheckOutcome {
    /// As it should be.
    Ok,
    /// At fault.
    Failed,
    /// Not assessed, because another fault must be repaired first.
    NotJudged,
}

impl CheckOutcome {
    /// The word for this verdict on D-Bus.
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
    /// The property that was checked.
    pub check: &'static str,
    /// The result.
    pub verdict: CheckOutcome,
    /// The measured value; `None` if there is none.
    pub measured: Option<f64>,
    /// The value expected of a rig without faults.
    pub expected: Option<f64>,
    /// Unit of both values.
    pub unit: &'static str,
    /// Description for people.
    pub text: String,
}

/// The whole result.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Time of the self-test, RFC 3339, UTC.
    pub at: String,
    /// Whether the instruments are simulated.
    pub simulated: bool,
    /// Name of the wiring.
    pub wiring: String,
    /// Current injected, A.
    pub current_a: f64,
    /// Whether there are no findings.
    pub passed: bool,
    /// Faults to repair, most severe first: `relay 1042 stays closed: ...`, `electrode 17: open ...`.
    pub findings: Vec<String>,
    /// Every check.
    pub lines: Vec<ReportLine>,
    /// Sheet resistance from the fit of a uniform sheet, ohm.
    pub sheet_ohm: Option<f64>,
    /// Part of the readings that the uniform sheet does not explain, rms.
    pub misfit: Option<f64>,
    /// Sheet resistance by van der Pauw with superposition, corrected for electrodes that are not on the edge, ohm.
    pub pauw_ohm: Option<f64>,
    /// Sheet resistance by van der Pauw without the correction, ohm.
    pub pauw_raw_ohm: Option<f64>,
    /// Difference between exchanged drive and sense, rms of the readings.
    pub reciprocity: Option<f64>,
    /// Standard deviation of one reading, V.
    pub noise_v: Option<f64>,
    /// Mean reading at 0 A, V.
    pub offset_v: Option<f64>,
}
