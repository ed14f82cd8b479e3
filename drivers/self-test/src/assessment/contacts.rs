//! The contact of every electrode.

use crate::assessment::{Assessment, CONTACT_FACTOR, CONTACT_OFFSET_OHM};
use crate::median::median;
use crate::report::{CheckOutcome, ReportLine};

impl Assessment<'_> {
    /// An electrode is open if both pairs that drive it carry no current.
    pub(super) fn open_electrodes(&self) -> Vec<usize> {
        let fails = |electrode: &usize| {
            self.fails_row(*electrode) && self.fails_row(electrode + self.n - 1)
        };
        (0..self.n).filter(fails).collect()
    }

    pub(super) fn contacts(
        &self,
        sound: bool,
        unexplained: bool,
        findings: &mut Vec<String>,
        lines: &mut Vec<ReportLine>,
    ) {
        let n = self.n;
        let open = self.open_electrodes();
        let contact = |electrode: usize| {
            let last = (electrode + n - 1) % n;
            // the previous pair driven and this pair sensed, and the reverse: they share this electrode
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
        let median = median(each.iter().flatten().copied()).unwrap_or(0.0);
        for (electrode, ohms) in each.into_iter().enumerate() {
            let number = electrode + 1;
            let (verdict, text) = if !unexplained && open.contains(&electrode) {
                let text = format!(
                    "electrode {number}: open; check its wire and its contact with the sheet"
                );
                findings.push(text.clone());
                (CheckOutcome::Failed, text)
            } else {
                match ohms {
                    Some(ohms) if ohms > CONTACT_FACTOR * median.max(0.0) + CONTACT_OFFSET_OHM => {
                        let text = format!(
                            "electrode {number}: poor contact, {ohms:.0} ohm where the others have {median:.0}"
                        );
                        findings.push(text.clone());
                        (CheckOutcome::Failed, text)
                    }
                    Some(_) => (CheckOutcome::Ok, String::new()),
                    None => (CheckOutcome::NotJudged, String::new()),
                }
            };
            lines.push(ReportLine {
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
}
