//! Drift of a sheet: single frames and the tracked baseline, with readings of a finer mesh than the model's.

mod deviation;
mod loads;
mod masked;
mod moving;
mod oblong;
mod orders;
mod restored;
mod sheet;
mod single_frame;
mod tracker;
mod walk;
