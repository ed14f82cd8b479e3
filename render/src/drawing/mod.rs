//! Drawing tools for all pictures: canvas, pen, colours, scales, text fitting.
//! The callers decide what to draw.

pub(crate) mod canvas;
pub(crate) mod colour;
pub(crate) mod pen;
pub(crate) mod scale;
pub(crate) mod text_fitting;
