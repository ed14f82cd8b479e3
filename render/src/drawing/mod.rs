//! What every picture is drawn with: canvas, pen, colours, scales, text that fits.
//! What is drawn is decided by the callers.

pub(crate) mod canvas;
pub(crate) mod colour;
pub(crate) mod pen;
pub(crate) mod scale;
pub(crate) mod text_fitting;
