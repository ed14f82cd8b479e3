//! The request of `tactus quantities`: regions, quantities, units, and columns.

use chrono::{DateTime, Utc};
use imaging::quantities::{
    FrameQuantities, KPA_PER_MMHG, LoadUnit, Quantity, QuantityRow, RegionQuantities, STORED_S,
    rounded,
};

use crate::args::Quantities;
use crate::output::time::local;

/// Width of a column of the text output.
const WIDTH: usize = 18;

/// What a column shows of a span.
#[derive(Debug, Clone, Copy)]
enum Of {
    Mean,
    Largest,
}

/// Default quantities of the text output.
const SHOWN: [Quantity; 7] = [
    Quantity::Load,
    Quantity::Contact,
    Quantity::Ppi,
    Quantity::CentreX,
    Quantity::CentreY,
    Quantity::Unrelieved,
    Quantity::Known,
];

impl Quantities {
    pub(crate) fn span_s(&self) -> u32 {
        self.every.map_or(STORED_S, |every| {
            u32::try_from(every.as_secs()).unwrap_or(u32::MAX)
        })
    }

    /// Whether the request cannot be answered from the stored rows.
    pub(crate) fn recomputes(&self) -> bool {
        let source = &self.from;
        self.recompute
            || self.each_frame
            || source.baseline.is_some()
            || source.negate
            // a session has frames of its own: opening it with another file is refused
            || source.frames.is_some()
            || source.from.is_some()
            || source.to.is_some()
            || self.asked.differ()
    }

    pub(crate) fn has(&self, region: &str) -> bool {
        self.region.as_deref().is_none_or(|wanted| wanted == region)
    }

    pub(crate) fn wants(&self, quantity: Quantity) -> bool {
        self.quantities.is_empty() || self.quantities.contains(&quantity)
    }

    /// Whether the text output shows the quantity.
    fn shows(&self, quantity: Quantity) -> bool {
        match self.quantities.is_empty() {
            true => SHOWN.contains(&quantity),
            false => self.quantities.contains(&quantity),
        }
    }

    pub(crate) fn unit(&self, quantity: Quantity, of: LoadUnit) -> String {
        let unit = quantity.unit(of);
        match self.mmhg {
            true => unit.replace("kPa", "mmHg"),
            false => unit.to_owned(),
        }
    }

    pub(crate) fn convert(&self, quantity: Quantity, of: LoadUnit, value: f64) -> f64 {
        match self.mmhg && quantity.unit(of).contains("kPa") {
            true => value / KPA_PER_MMHG,
            false => value,
        }
    }

    pub(crate) fn shown(
        &self,
        quantity: Quantity,
        of: LoadUnit,
        values: &imaging::quantities::Values,
    ) -> String {
        values
            .get(quantity)
            .map_or("not known".to_owned(), |value| {
                let value = self.convert(quantity, of, value);
                format!("{} {}", rounded(value), self.unit(quantity, of))
            })
    }

    /// Columns of the text output: the quantity, and whether its smallest, mean or largest value.
    fn columns(&self) -> Vec<(Quantity, Of)> {
        let of = |quantity: Quantity| match quantity {
            Quantity::Peak | Quantity::Ppi | Quantity::Dose | Quantity::Unrelieved => Of::Largest,
            _ => Of::Mean,
        };
        let shown = Quantity::ALL
            .into_iter()
            .filter(|quantity| self.shows(*quantity));
        shown.map(|quantity| (quantity, of(quantity))).collect()
    }

    pub(crate) fn table_heading(&self, of: LoadUnit) -> String {
        let mut text = format!("{:<26}  {:<10}", "begin", "region");
        for (quantity, _) in self.columns() {
            let title = match (quantity, self.unit(quantity, of).as_str()) {
                (Quantity::Known, _) => "known share".to_owned(),
                (counted, "1") => counted.name().to_owned(),
                (other, unit) => format!("{}, {unit}", other.name()),
            };
            text.push_str(&format!("  {title:>WIDTH$}"));
        }
        text.push('\n');
        text
    }

    /// The line of a span and region with its begin, if known: mean values, and the largest value of quantities that
    /// are judged by it.
    pub(crate) fn table_row(&self, begin: Option<DateTime<Utc>>, rows: &[&QuantityRow]) -> String {
        let Some(first) = rows.first() else {
            return String::new();
        };
        let begin = begin.map_or_else(|| "not known".to_owned(), local);
        let mut text = format!("{begin:<26}  {:<10}", first.region);
        for (quantity, of) in self.columns() {
            let row = rows.iter().find(|row| row.quantity == quantity);
            let value = row.map_or("-".to_owned(), |row| {
                let value = match of {
                    Of::Mean => row.mean,
                    Of::Largest => row.max,
                };
                rounded(self.convert(quantity, row.of, value))
            });
            text.push_str(&format!("  {value:>WIDTH$}"));
        }
        text
    }

    pub(crate) fn frame_sentence(
        &self,
        sequence: u64,
        region: &RegionQuantities,
        frame: &FrameQuantities,
    ) -> String {
        let parts: Vec<String> = Quantity::ALL
            .into_iter()
            .filter(|quantity| self.shows(*quantity))
            .filter_map(|quantity| {
                let value = self.convert(quantity, frame.unit, region.values.get(quantity)?);
                let sd = region.deviations.get(quantity).map_or(String::new(), |sd| {
                    format!(" +- {}", rounded(self.convert(quantity, frame.unit, sd)))
                });
                let name = quantity.name();
                Some(match (quantity, self.unit(quantity, frame.unit).as_str()) {
                    (Quantity::Known, _) if value == 1.0 => format!("{name} yes"),
                    (Quantity::Known, _) => format!("{name} no"),
                    (_, "1") => format!("{name} {value}{sd}"),
                    (_, unit) => format!("{name} {}{sd} {unit}", rounded(value)),
                })
            })
            .collect();
        let values = match parts.is_empty() {
            true => "no quantities".to_owned(),
            false => parts.join(", "),
        };
        let reason = match &frame.reason {
            Some(reason) => format!("; not known: {reason}"),
            None => String::new(),
        };
        format!("frame {sequence}  {}: {values}{reason}", region.name)
    }
}
