//! Methods on judging data: frames from a finer, different mesh, drawn from other random streams than any training. A method
//! gets the case and the frames of a folder; the truth is opened here alone.
//!
//! Left to others: which methods are compared, and what is printed.

mod figures;
mod maps;
mod method;
mod raster;
mod statistics;
pub mod test_set;

pub use figures::{Figures, OfFrame, figures, of_frames};
pub use maps::{Frame, Judged, maps, maps_not_refused};
pub use method::MethodOptions;
pub use statistics::{average, mean_and_deviation, median};
