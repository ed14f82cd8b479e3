//! Counts of frames by the quality of their readings.

use std::collections::BTreeMap;

use imaging::recorded::SessionParts;
use survey::Quality;

/// Number of frames with each fault.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Health {
    /// Number of readable frames.
    pub(super) frames: u64,
    /// Number of frames without a missing reading, compliance of the source or a failed check.
    pub(super) sound: u64,
    /// Number of frames by fault.
    pub(super) faults: BTreeMap<&'static str, u64>,
}

impl Health {
    pub(super) fn of(session: &SessionParts) -> Self {
        let mut health = Self::default();
        for record in session.frames().filter_map(Result::ok) {
            health.take(&record.quality);
        }
        health
    }

    fn take(&mut self, quality: &Quality) {
        self.frames += 1;
        let counts = [
            ("readings over range", quality.overloads),
            ("readings that were not taken", quality.not_measured),
            ("source in compliance", quality.compliance.len()),
        ];
        let counted = counts
            .into_iter()
            .filter(|(_, count)| *count > 0)
            .map(|(fault, _)| fault);
        let checked = quality.flags.iter().map(|flag| flag.word());
        let mut faults: Vec<&'static str> = counted.chain(checked).collect();
        faults.sort_unstable();
        faults.dedup();
        self.sound += u64::from(faults.is_empty());
        for fault in faults {
            *self.faults.entry(fault).or_default() += 1;
        }
    }
}
