//! Evaluates methods on test sets: frames from a finer, different mesh, drawn from other random streams than any
//! training. A method receives the case and the frames of a folder; only this module reads the truth.
//! The callers choose the methods and print the results.

mod figures;
mod maps;
mod method;
mod raster;
mod statistics;
pub mod test_set;

pub use eit::metrics::median;
pub use figures::{Figures, OfFrame, figures, of_frames};
pub use maps::{Frame, Judged, has_load, maps, maps_not_refused};
pub use method::MethodOptions;
pub(crate) use statistics::quantile;
pub use statistics::{average, mean_and_deviation};
