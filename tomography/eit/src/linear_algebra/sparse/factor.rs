//! Numerical factorisation.

use crate::linear_algebra::sparse::SparseError;
use crate::linear_algebra::sparse::aligned::Aligned;
use crate::linear_algebra::sparse::analysis::{Analysis, Front};
use crate::linear_algebra::sparse::elimination::{eliminate, product};
use crate::linear_algebra::sparse::kernel::{MulAdd, Task, widest};

/// L with L Lᵀ = A, front by front, and its working memory.
#[derive(Clone)]
pub(crate) struct Factor {
    /// Columns of the fronts.
    pub(super) columns: Aligned,
    /// Remainders of fronts whose parent is not done.
    remainders: Aligned,
    /// Whether every remainder is kept.
    keeps: bool,
    /// Fronts computed for this factor; the others are those of the factor it is based on.
    pub(super) own: Vec<bool>,
}

impl Factor {
    /// Memory for a factor that reuses the memory of remainders.
    pub(crate) fn passing(analysis: &Analysis) -> Result<Self, SparseError> {
        Self::allocated(analysis, false)
    }

    /// Memory for a factor that keeps its remainders, so that others can be based on it.
    pub(crate) fn keeping(analysis: &Analysis) -> Result<Self, SparseError> {
        Self::allocated(analysis, true)
    }

    fn allocated(analysis: &Analysis, keeps: bool) -> Result<Self, SparseError> {
        let remainders = if keeps {
            analysis.kept_length
        } else {
            analysis.passing_length
        };
        Ok(Self {
            columns: Aligned::new(analysis.factor_length)?,
            remainders: Aligned::new(remainders)?,
            keeps,
            own: vec![true; analysis.fronts.len()],
        })
    }

    /// Factors the matrix with these entries.
    pub(crate) fn make(&mut self, analysis: &Analysis, values: &[f64]) -> Result<(), SparseError> {
        self.own.fill(true);
        widest(Make {
            analysis,
            values,
            factor: self,
            base: None,
        })
    }

    /// Factors a matrix that differs from an already factored one with these entries: only fronts that differ are
    /// recomputed.
    pub(crate) fn make_from(
        &mut self,
        analysis: &Analysis,
        values: &[f64],
        base: &Self,
        base_values: &[f64],
    ) -> Result<(), SparseError> {
        debug_assert!(base.keeps, "a base keeps its remainders");
        for (own, front) in self.own.iter_mut().zip(&analysis.fronts) {
            let entries = analysis.entries_of(front);
            *own = values[entries.clone()] != base_values[entries];
        }
        analysis.close(&mut self.own);
        widest(Make {
            analysis,
            values,
            factor: self,
            base: Some(base),
        })
    }
}

struct Make<'a> {
    analysis: &'a Analysis,
    values: &'a [f64],
    factor: &'a mut Factor,
    base: Option<&'a Factor>,
}

impl Task for Make<'_> {
    type Output = Result<(), SparseError>;

    #[inline(always)]
    fn run<M: MulAdd>(self) -> Self::Output {
        let Self {
            analysis,
            values,
            factor,
            base,
        } = self;
        let Factor {
            columns,
            remainders,
            keeps,
            own,
        } = factor;
        let (columns, allocated) = (columns.values_mut(), remainders.values_mut());
        let place = |front: &Front| if *keeps { front.kept } else { front.passing };
        for (index, front) in analysis.fronts.iter().enumerate() {
            if !own[index] {
                continue;
            }
            let panel = &mut columns[front.at..front.at + front.leading * front.columns()];
            panel.fill(0.0);
            for k in analysis.entries_of(front) {
                panel[analysis.places[k] - front.at] = values[k];
            }
            for pad in front.pivots..front.columns() {
                panel[pad * front.leading + pad] = 1.0;
            }
            for (child, rows) in &front.children {
                let from = &analysis.fronts[*child];
                let remainder = match base {
                    Some(base) if !own[*child] => &base.remainders.values()[from.kept..],
                    _ => &allocated[place(from)..],
                };
                add_to_panel(front, panel, from, remainder, rows);
            }
            eliminate::<M>(panel, front.leading, front.columns())?;
            if front.border.is_empty() {
                continue;
            }
            let at = place(front);
            product::<M>(panel, front, &mut allocated[at..at + front.remainder()]);
            for (child, rows) in &front.children {
                let from = &analysis.fronts[*child];
                match base {
                    Some(base) if !own[*child] => add_to_remainder(
                        front,
                        &mut allocated[at..at + front.remainder()],
                        from,
                        &base.remainders.values()[from.kept..],
                        rows,
                    ),
                    _ => {
                        // the two ranges do not overlap: both remainders are in use
                        let below = place(from);
                        let length = from.remainder();
                        let (into, remainder) = if below < at {
                            let (low, high) = allocated.split_at_mut(at);
                            (&mut high[..front.remainder()], &low[below..below + length])
                        } else {
                            let (low, high) = allocated.split_at_mut(below);
                            (&mut low[at..at + front.remainder()], &high[..length])
                        };
                        add_to_remainder(front, into, from, remainder, rows);
                    }
                }
            }
        }
        Ok(())
    }
}

/// Adds the part of a child's remainder that belongs to this front's pivots.
#[inline(always)]
fn add_to_panel(front: &Front, panel: &mut [f64], from: &Front, remainder: &[f64], rows: &[u32]) {
    let step = from.remainder_leading();
    for (k, &column) in rows.iter().enumerate() {
        let column = column as usize;
        if column >= front.pivots {
            break;
        }
        let into = &mut panel[column * front.leading..][..front.leading];
        let values = &remainder[k * step..][..rows.len()];
        for (value, &row) in values[k..].iter().zip(&rows[k..]) {
            into[row as usize] += value;
        }
    }
}

/// Adds the other part of a child's remainder to this front's remainder.
#[inline(always)]
fn add_to_remainder(
    front: &Front,
    into: &mut [f64],
    from: &Front,
    remainder: &[f64],
    rows: &[u32],
) {
    let step = from.remainder_leading();
    let (edge, leading) = (front.edge(), front.remainder_leading());
    let start = rows.partition_point(|&row| (row as usize) < front.pivots);
    for k in start..rows.len() {
        let column = rows[k] as usize - edge;
        // border rows count from the top of the panel: this view begins `edge` rows earlier
        let into = &mut into[column * leading..][..leading];
        let values = &remainder[k * step..][..rows.len()];
        for (value, &row) in values[k..].iter().zip(&rows[k..]) {
            into[row as usize - edge] += value;
        }
    }
}
