//! The destinations of measured frames.

use std::sync::Arc;

use logbook::LogbookError;

use crate::recording::published::Published;

/// A destination of frames. The recorder hands each frame to the logbook first, which makes it durable, and then to the
/// others.
pub(crate) trait FrameSink: Send {
    /// Takes frames in the order in which they were measured.
    ///
    /// # Errors
    /// The disk refuses them; only the logbook refuses frames.
    fn frames(&mut self, frames: &[Arc<Published>]) -> Result<(), LogbookError>;

    /// Receives a frame again, with its late map.
    ///
    /// # Errors
    /// As [`FrameSink::frames`].
    fn late_map(&mut self, frame: &Arc<Published>) -> Result<(), LogbookError>;
}
