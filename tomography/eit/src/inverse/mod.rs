//! Inverse problems: from a difference of voltages to a map of the relative change of conductance. `forward` computes
//! voltages from conductances.

pub(crate) mod box_constrained;
pub(crate) mod cut;
pub(crate) mod data_space;
pub(crate) mod error;
pub(crate) mod evidence;
pub(crate) mod frame_rule;
pub(crate) mod graph;
pub(crate) mod interior_point;
pub mod learned;
pub(crate) mod low_rank;
pub(crate) mod model_check;
pub(crate) mod nonlinear;
pub(crate) mod one_step;
pub(crate) mod options;
pub(crate) mod prior;
pub(crate) mod reciprocity;
pub(crate) mod reconstructor;
pub(crate) mod shapes;
pub(crate) mod tv;
pub(crate) mod wrappers;
