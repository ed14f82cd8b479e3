//! Result of a hard case: the error of the naive implementation, the error of ours, the bound, and whether the bound is
//! satisfied.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use crate::failure::Failure;

/// A text that is a constant of the code or was read from a shard.
type Text = Cow<'static, str>;

/// Result of the naive implementation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) enum Naive {
    /// Its error, in the measure of the check.
    Error(#[serde(with = "shards::any_f64")] f64),
    /// Its error was computed and is not finite: the error, and a description.
    Fails(#[serde(with = "shards::any_f64")] f64, Text),
    /// There is no naive implementation of this figure, for this reason. Nothing is compared.
    Absent(Text),
}

/// Side of the bound on which a figure must be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum Side {
    AtMost,
    AtLeast,
}

/// One line of the table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Check {
    /// What is measured.
    pub(crate) what: Text,
    pub(crate) naive: Naive,
    #[serde(with = "shards::any_f64")]
    pub(crate) ours: f64,
    pub(crate) side: Side,
    #[serde(with = "shards::any_f64")]
    pub(crate) bound: f64,
}

impl Check {
    /// An error that may be at most `bound`.
    pub(crate) fn at_most(what: &'static str, naive: Naive, ours: f64, bound: f64) -> Self {
        Self {
            what: what.into(),
            naive,
            ours,
            side: Side::AtMost,
            bound,
        }
    }

    /// A figure that must be at least `bound`.
    pub(crate) fn at_least(what: &'static str, naive: Naive, ours: f64, bound: f64) -> Self {
        Self {
            side: Side::AtLeast,
            ..Self::at_most(what, naive, ours, bound)
        }
    }

    fn within(&self, figure: f64) -> bool {
        match self.side {
            Side::AtMost => figure <= self.bound,
            Side::AtLeast => figure >= self.bound,
        }
    }

    /// Whether our figure satisfies the bound; NaN does not.
    pub(crate) fn holds(&self) -> bool {
        self.within(self.ours)
    }

    /// Whether the naive implementation violates the bound, fails, or does not exist.
    pub(crate) fn naive_is_as_expected(&self) -> bool {
        match &self.naive {
            Naive::Error(figure) => !self.within(*figure),
            Naive::Fails(figure, _) => !figure.is_finite(),
            Naive::Absent(_) => true,
        }
    }
}

/// Result of a case.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Outcome {
    pub(crate) checks: Vec<Check>,
    /// Explanation of the naive implementation or of an unusual bound; may be empty.
    pub(crate) note: String,
}

impl Outcome {
    pub(crate) fn of(checks: impl Into<Vec<Check>>) -> Self {
        Self {
            checks: checks.into(),
            note: String::new(),
        }
    }

    pub(crate) fn noted(mut self, note: impl Into<String>) -> Self {
        self.note = note.into();
        self
    }
}

/// A hard case with its number in the fact sheet.
#[derive(Debug)]
pub(crate) struct Case {
    pub(crate) number: u8,
    pub(crate) name: &'static str,
    pub(crate) run: fn() -> Result<Outcome, Failure>,
}

/// Largest difference of two lists over the largest value of the second; infinite if one is NaN.
pub(crate) fn apart(found: &[f64], exact: &[f64]) -> f64 {
    let largest = exact.iter().fold(0.0_f64, |top, v| top.max(v.abs()));
    found
        .iter()
        .zip(exact)
        .map(|(a, b)| (a - b).abs() / largest)
        .fold(0.0, worst)
}

/// The larger number; infinite if one is NaN.
pub(crate) fn worst(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() {
        f64::INFINITY
    } else {
        a.max(b)
    }
}

/// An error, or the description `instead` if it is not finite.
pub(crate) fn naive(error: f64, instead: &'static str) -> Naive {
    if error.is_finite() {
        Naive::Error(error)
    } else {
        Naive::Fails(error, instead.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bound_breaks_on_its_side_and_by_what_is_no_number() {
        let at_most = |ours| Check::at_most("x", Naive::Error(2.0), ours, 1.0).holds();
        assert!(at_most(1.0) && !at_most(1.1) && !at_most(f64::NAN));
        let at_least = |ours| Check::at_least("x", Naive::Error(0.0), ours, 1.0).holds();
        assert!(at_least(1.0) && !at_least(0.9) && !at_least(f64::NAN));
    }

    #[test]
    fn naive_form_must_behave_as_stated() {
        let message = |naive| Check::at_most("x", naive, 0.5, 1.0).naive_is_as_expected();
        assert!(message(Naive::Error(2.0)) && !message(Naive::Error(0.5)));
        assert!(message(naive(f64::NAN, "fails")) && !message(Naive::Fails(2.0, "fails".into())));
        assert!(message(Naive::Absent("no form".into())));
    }

    #[test]
    fn what_is_no_number_is_infinitely_far() {
        assert_eq!(apart(&[1.0, f64::NAN], &[1.0, 2.0]), f64::INFINITY);
        assert_eq!(apart(&[1.0, 1.0], &[1.0, 2.0]), 0.5);
    }
}
