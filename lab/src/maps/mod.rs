//! Commands on frames and maps: reconstruction, calibration to pressure, figures of merit of images. The methods are
//! prepared by `studies::evaluation`.

mod calibrate;
mod merit;
mod presses;
mod reconstruct;

pub(crate) use calibrate::calibrate;
pub(crate) use merit::merit;
pub(crate) use presses::{Press, Presses};
pub(crate) use reconstruct::reconstruct;
