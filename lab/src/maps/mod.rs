//! Commands on frames and maps: reconstruction, calibration to pressure, figures of merit of images. Left to others: methods
//! and how they are chosen (`studies::evaluation`).

mod calibrate;
mod merit;
mod reconstruct;

pub(crate) use calibrate::calibrate;
pub(crate) use merit::merit;
pub(crate) use reconstruct::reconstruct;
