//! Lists of values: list sweeps and arbitrary waves.

use scpi::ParseError;

use crate::List;

/// Most values of a list.
const LONGEST: usize = 65_535;

/// The lists as set.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Lists {
    levels: Vec<f64>,
    delays: Vec<f64>,
    limits: Vec<f64>,
    wave: Vec<f64>,
}

impl Lists {
    /// The lists after `*RST`: one value each (assumed), and no wave.
    pub(super) fn reset() -> Self {
        let one = |list: List| vec![list.kind().reset_value()];
        Self {
            levels: one(List::Levels),
            delays: one(List::Delays),
            limits: one(List::Limits),
            wave: Vec::new(),
        }
    }

    pub(super) fn get(&self, list: List) -> &[f64] {
        match list {
            List::Levels => &self.levels,
            List::Delays => &self.delays,
            List::Limits => &self.limits,
            List::Wave => &self.wave,
        }
    }

    fn get_mut(&mut self, list: List) -> &mut Vec<f64> {
        match list {
            List::Levels => &mut self.levels,
            List::Delays => &mut self.delays,
            List::Limits => &mut self.limits,
            List::Wave => &mut self.wave,
        }
    }

    /// # Errors
    /// -223 for more values than fit; the list stays as it was.
    pub(super) fn set(&mut self, list: List, values: Vec<f64>) -> Result<(), ParseError> {
        if values.len() > LONGEST {
            return Err(ParseError::TooMuchData);
        }
        *self.get_mut(list) = values;
        Ok(())
    }

    /// # Errors
    /// -223 for more values than fit; the list stays as it was.
    pub(super) fn append(&mut self, list: List, values: Vec<f64>) -> Result<(), ParseError> {
        let held = self.get_mut(list);
        if held.len() + values.len() > LONGEST {
            return Err(ParseError::TooMuchData);
        }
        held.extend(values);
        Ok(())
    }

    /// The values in the form of a query's reply.
    pub(super) fn read(&self, list: List) -> String {
        let values = self.get(list).iter();
        let values: Vec<String> = values.map(|v| list.kind().read_back(*v)).collect();
        values.join(",")
    }
}
