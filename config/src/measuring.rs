//! How a frame is measured: the keys of `[survey]`, and what they mean for the plan of a frame.

use serde::{Deserialize, Serialize};
use survey::Bounds::{self, Above, OneOf, Within};
use survey::{Amps, Injection, Timing, Volts, duration};

use crate::bounds::ELECTRODES;
use crate::section::section;

const WAIT_MS: Bounds = Within(0.0, 60e3);

section! {
    /// `[survey]`: how a frame is measured.
    SurveySection, "survey" {
        /// Number of electrodes; by default that of the sheet.
        electrodes: Option<usize>, in ELECTRODES;
        /// Injected current, uA.
        // the preparation compares them with the limits of source and relays
        current_ua: f64 = 1000.0, in Above(0.0, 1e6);
        /// Voltage limit of the source, V.
        compliance_v: f64 = 10.0, in Above(0.0, 1e3);
        /// Settling time after a change of current, ms.
        settle_ms: f64 = 2.0, in WAIT_MS;
        /// Range of the voltmeter, V.
        range_v: f64 = 1.0, in OneOf(&[0.1, 1.0, 10.0, 100.0, 300.0]);
        /// Integration time, power-line cycles.
        nplc: f64 = 1.0, in OneOf(&[0.02, 0.2, 1.0, 2.0, 10.0, 20.0, 100.0, 200.0]);
        /// Whether every reading is followed by a zero reading.
        autozero: bool;
        /// Mains frequency, Hz.
        line_hz: f64 = 50.0, in OneOf(&[50.0, 60.0]);
        /// Number of readings that are averaged to one.
        averages: u32 = 1, in Within(1.0, 1000.0);
        /// Wait before each scanned channel, ms.
        channel_delay_ms: f64 = 0.0, in WAIT_MS;
        /// Whether every injection is read with both polarities.
        reversal: bool;
        /// Number of electrodes between those of a pair.
        skip: usize = 0, in Within(0.0, 254.0);
        /// Whether only one of two reciprocal readings is taken.
        half: bool;
        /// Where the voltmeter's ranges come from.
        ranges: RangesName;
        /// Margin of planned ranges, a factor.
        range_margin: f64 = 1.5, in Within(1.0, 100.0);
        /// With a matrix: whether all readings of an injection are requested in one message.
        chained: bool;
        /// A zero-current frame before the first and after this many frames; never if not given.
        zero_every: Option<u64>, in Within(1.0, 1e9);
    }
}

impl SurveySection {
    /// How the current is injected.
    pub fn injection(&self) -> Injection {
        Injection {
            current: Amps(self.current_ua * 1e-6),
            compliance: Volts(self.compliance_v),
            settle: duration(self.settle_ms * 1e-3),
            reversal: self.reversal,
        }
    }

    /// The timing of readings with these settings; `instruments`: that of the instruments for `nplc` and `line_hz`.
    pub fn timing(&self, instruments: Timing) -> Timing {
        Timing {
            autozero: self.autozero,
            averages: self.averages,
            channel_delay: duration(self.channel_delay_ms * 1e-3),
            ..instruments
        }
    }
}

/// Where the voltmeter's ranges come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RangesName {
    /// One for every reading.
    #[default]
    Fixed,
    /// Individual ranges: from the baseline, or from the model of the sheet before there is one.
    Planned,
}
