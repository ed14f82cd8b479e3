//! Stored weights of a layer: f32, f16, or int8 with a scale per row.

use half::f16;
use serde::{Deserialize, Serialize};

/// Precision of a network's stored weights; sums are always in f32.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Precision {
    /// Four bytes per weight, as trained.
    #[default]
    F32,
    /// Two bytes per weight.
    F16,
    /// One byte per weight and one scale per row.
    Int8,
}

impl Precision {
    /// `f32`, `f16`, `int8`.
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F16 => "f16",
            Self::Int8 => "int8",
        }
    }
}

/// Weights of one layer, row-major.
#[derive(Debug, Clone, PartialEq)]
pub enum Weights {
    /// As trained.
    F32(Vec<f32>),
    /// Rounded to the nearest f16.
    F16(Vec<f16>),
    /// `values` times the scale of their row.
    Int8 {
        /// From -127 to 127.
        values: Vec<i8>,
        /// One per row.
        scales: Vec<f32>,
    },
}

/// Some rows of a layer's weights.
#[derive(Debug, Clone, Copy)]
pub(super) enum Rows<'a> {
    F32(&'a [f32]),
    F16(&'a [f16]),
    Int8(&'a [i8], &'a [f32]),
}

impl Weights {
    /// Number of weights.
    pub fn len(&self) -> usize {
        match self {
            Self::F32(values) => values.len(),
            Self::F16(values) => values.len(),
            Self::Int8 { values, .. } => values.len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Size in bytes.
    pub fn bytes(&self) -> usize {
        match self {
            Self::F32(values) => 4 * values.len(),
            Self::F16(values) => 2 * values.len(),
            Self::Int8 { values, scales } => values.len() + 4 * scales.len(),
        }
    }

    /// Their precision.
    pub fn precision(&self) -> Precision {
        match self {
            Self::F32(_) => Precision::F32,
            Self::F16(_) => Precision::F16,
            Self::Int8 { .. } => Precision::Int8,
        }
    }

    pub(super) fn is_finite(&self) -> bool {
        match self {
            Self::F32(values) => values.iter().all(|value| value.is_finite()),
            Self::F16(values) => values.iter().all(|value| value.is_finite()),
            Self::Int8 { scales, .. } => scales.iter().all(|scale| scale.is_finite()),
        }
    }

    /// `count` rows of `width` entries, starting at row `first`.
    pub(super) fn rows(&self, first: usize, count: usize, width: usize) -> Rows<'_> {
        let range = first * width..(first + count) * width;
        match self {
            Self::F32(values) => Rows::F32(&values[range]),
            Self::F16(values) => Rows::F16(&values[range]),
            Self::Int8 { values, scales } => {
                Rows::Int8(&values[range], &scales[first..first + count])
            }
        }
    }

    /// The same weights in f32.
    fn wide(&self, width: usize) -> Vec<f32> {
        match self {
            Self::F32(values) => values.clone(),
            Self::F16(values) => values.iter().map(|value| value.to_f32()).collect(),
            Self::Int8 { values, scales } => values
                .chunks(width)
                .zip(scales)
                .flat_map(|(row, scale)| row.iter().map(move |value| f32::from(*value) * scale))
                .collect(),
        }
    }

    /// Rounded to the nearest; `width` entries per row.
    pub(super) fn rounded(&self, precision: Precision, width: usize) -> Self {
        let wide = self.wide(width);
        match precision {
            Precision::F32 => Self::F32(wide),
            Precision::F16 => Self::F16(wide.into_iter().map(f16::from_f32).collect()),
            Precision::Int8 => {
                let mut values = Vec::with_capacity(wide.len());
                let mut scales = Vec::with_capacity(wide.len() / width.max(1));
                for row in wide.chunks(width) {
                    let top = row.iter().fold(0.0_f32, |top, value| top.max(value.abs()));
                    let scale = top / 127.0;
                    let inverse = if scale > 0.0 { scale.recip() } else { 0.0 };
                    values.extend(row.iter().map(|value| (value * inverse).round() as i8));
                    scales.push(scale);
                }
                Self::Int8 { values, scales }
            }
        }
    }
}
