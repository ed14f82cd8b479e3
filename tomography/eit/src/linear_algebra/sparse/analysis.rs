//! Symbolic factorisation: fronts, their borders, and the positions of entries and update matrices (remainders).

use crate::linear_algebra::sparse::SparseError;

/// Doubles in a vector register of the widest processors; stored columns of fronts are padded to a multiple.
pub(super) const LANES: usize = 8;
/// Columns that the kernels eliminate together; pivots of fronts are padded to a multiple.
pub(super) const GROUP: usize = 4;
/// Larger parts are split into several fronts, one above the other, so that each stays in the cache.
const MOST_PIVOTS: usize = 96;

/// Unknowns that are eliminated together.
///
/// Its columns are stored with `leading` rows each: the pivots (padded to [`LANES`]), then the border (padded too).
#[derive(Clone)]
pub(super) struct Front {
    /// First unknown; the pivots are consecutive.
    pub(super) first: usize,
    pub(super) pivots: usize,
    /// Unknowns eliminated later that this front touches, ascending.
    pub(super) border: Vec<usize>,
    /// Length of a stored column.
    pub(super) leading: usize,
    /// Offset of its columns in the factor.
    pub(super) at: usize,
    pub(super) parent: Option<usize>,
    /// Child fronts, and for each of their border unknowns the row in this front.
    pub(super) children: Vec<(usize, Vec<u32>)>,
    /// Offset of its remainder during a factorisation that reuses memory.
    pub(super) passing: usize,
    /// Offset of its remainder if all are kept.
    pub(super) kept: usize,
}

pub(super) fn up(count: usize, to: usize) -> usize {
    count.div_ceil(to) * to
}

impl Front {
    /// Columns stored, padded.
    pub(super) fn columns(&self) -> usize {
        up(self.pivots, GROUP)
    }
    /// Row of the first border unknown.
    pub(super) fn edge(&self) -> usize {
        up(self.pivots, LANES)
    }
    /// Length of a column of the remainder.
    pub(super) fn remainder_leading(&self) -> usize {
        up(self.border.len(), LANES)
    }
    /// Size of the remainder.
    pub(super) fn remainder(&self) -> usize {
        self.remainder_leading() * up(self.border.len(), GROUP)
    }
}

/// The non-zero pattern of a symmetric matrix (lower triangle by columns), and the structure of its factor.
#[derive(Clone)]
pub(crate) struct Analysis {
    pub(super) size: usize,
    pub(super) fronts: Vec<Front>,
    /// Front of each unknown.
    front_of: Vec<usize>,
    starts: Vec<usize>,
    rows: Vec<usize>,
    /// Position of each entry in the factor.
    pub(super) places: Vec<usize>,
    /// Lengths of the factor and of the memory for remainders, reused and kept.
    pub(super) factor_length: usize,
    pub(super) passing_length: usize,
    pub(super) kept_length: usize,
}

impl Analysis {
    /// From pairs of unknowns, in any order, with or without repetitions (the diagonal is always included), and the
    /// lengths of the parts of unknowns that are eliminated together, which sum to the size.
    pub(crate) fn new(
        parts: &[usize],
        pairs: impl IntoIterator<Item = [usize; 2]>,
    ) -> Result<Self, SparseError> {
        let size = parts.iter().sum();
        let mut columns: Vec<Vec<usize>> = (0..size).map(|unknown| vec![unknown]).collect();
        for [a, b] in pairs {
            columns[a.min(b)].push(a.max(b));
        }
        let mut starts = vec![0];
        let mut rows = Vec::new();
        for column in &mut columns {
            column.sort_unstable();
            column.dedup();
            rows.extend_from_slice(column);
            starts.push(rows.len());
        }
        let pieces = parts.iter().flat_map(|&part| {
            let count = part.div_ceil(MOST_PIVOTS).max(1);
            (0..count).map(move |k| part * (k + 1) / count - part * k / count)
        });
        let mut analysis = Self {
            size,
            fronts: Vec::new(),
            front_of: vec![0; size],
            starts,
            rows,
            places: Vec::new(),
            factor_length: 0,
            passing_length: 0,
            kept_length: 0,
        };
        analysis.shape(pieces.filter(|pivots| *pivots > 0));
        analysis.place_entries();
        analysis.place_remainders()?;
        Ok(analysis)
    }

    /// Builds the fronts and their borders, from the leaves of the tree up.
    fn shape(&mut self, pieces: impl Iterator<Item = usize>) {
        let mut waiting: Vec<Vec<usize>> = Vec::new();
        let mut first = 0;
        let pieces: Vec<usize> = pieces.collect();
        for (index, &pivots) in pieces.iter().enumerate() {
            self.front_of[first..first + pivots].fill(index);
            first += pivots;
        }
        waiting.resize_with(pieces.len(), Vec::new);
        let mut first = 0;
        for (index, pivots) in pieces.into_iter().enumerate() {
            let end = first + pivots;
            let below = std::mem::take(&mut waiting[index]);
            let own = self.rows[self.starts[first]..self.starts[end]].iter();
            let handed = below
                .iter()
                .flat_map(|&child: &usize| self.fronts[child].border.iter());
            let mut border: Vec<usize> = own.chain(handed).copied().filter(|&u| u >= end).collect();
            border.sort_unstable();
            border.dedup();
            let edge = up(pivots, LANES);
            let children = below
                .into_iter()
                .map(|child| {
                    let row = |&unknown: &usize| {
                        let row = if unknown < end {
                            unknown - first
                        } else {
                            edge + border.partition_point(|&other| other < unknown)
                        };
                        u32::try_from(row).expect("a front has fewer than 2^32 rows")
                    };
                    (child, self.fronts[child].border.iter().map(row).collect())
                })
                .collect();
            let parent = border.first().map(|&unknown| self.front_of[unknown]);
            if let Some(parent) = parent {
                waiting[parent].push(index);
            }
            let leading = edge + up(border.len(), LANES);
            let front = Front {
                first,
                pivots,
                leading,
                at: self.factor_length,
                parent,
                children,
                passing: 0,
                kept: self.kept_length,
                border,
            };
            self.factor_length += leading * front.columns();
            self.kept_length += front.remainder();
            self.fronts.push(front);
            first = end;
        }
    }

    fn place_entries(&mut self) {
        self.places = Vec::with_capacity(self.rows.len());
        for column in 0..self.size {
            let front = &self.fronts[self.front_of[column]];
            let end = front.first + front.pivots;
            for &row in &self.rows[self.starts[column]..self.starts[column + 1]] {
                let row = if row < end {
                    row - front.first
                } else {
                    front.edge() + front.border.partition_point(|&other| other < row)
                };
                self.places
                    .push(front.at + (column - front.first) * front.leading + row);
            }
        }
    }

    /// A remainder is needed until its parent front is done: gives each the lowest memory that is free for that time.
    fn place_remainders(&mut self) -> Result<(), SparseError> {
        let mut living: Vec<(usize, usize, usize)> = Vec::new();
        for index in 0..self.fronts.len() {
            let length = self.fronts[index].remainder();
            let mut at = 0;
            for &(start, end, _) in &living {
                if start >= at + length {
                    break;
                }
                at = at.max(end);
            }
            if length > 0 {
                let place = living.partition_point(|(start, _, _)| *start < at);
                living.insert(place, (at, at + length, index));
            }
            self.fronts[index].passing = at;
            self.passing_length = self.passing_length.max(at + length);
            let gone = &self.fronts[index].children;
            living.retain(|(_, _, front)| gone.iter().all(|(child, _)| child != front));
        }
        // row indices and the size of a factor must not overflow
        if self.factor_length.checked_mul(8).is_none() {
            return Err(SparseError::Memory);
        }
        Ok(())
    }

    /// Number of stored entries.
    pub(crate) fn entries(&self) -> usize {
        self.rows.len()
    }

    /// Marks all ancestors of every marked front.
    pub(super) fn close(&self, marked: &mut [bool]) {
        for index in 0..self.fronts.len() {
            if marked[index]
                && let Some(parent) = self.fronts[index].parent
            {
                marked[parent] = true;
            }
        }
    }

    /// The stored entries of a front's pivots, as a range.
    pub(super) fn entries_of(&self, front: &Front) -> std::ops::Range<usize> {
        self.starts[front.first]..self.starts[front.first + front.pivots]
    }

    /// Index of an entry among the stored ones.
    pub(crate) fn entry(&self, a: usize, b: usize) -> Option<usize> {
        let (row, column) = (a.max(b), a.min(b));
        let start = self.starts[column];
        self.rows[start..self.starts[column + 1]]
            .binary_search(&row)
            .ok()
            .map(|at| start + at)
    }
}
