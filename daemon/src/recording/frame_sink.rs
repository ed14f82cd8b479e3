//! The destinations of measured frames.

use std::sync::Arc;

use logbook::LogbookError;

use crate::recording::published::Published;

/// A destination of frames. The recorder passes each frame to the logbook first, which makes it durable, and then to
/// the other sinks.
pub(crate) trait FrameSink: Send {
    /// Takes frames in the order in which they were measured.
    ///
    /// # Errors
    /// The frames cannot be written to the disk. Only the logbook returns errors.
    fn frames(&mut self, frames: &[Arc<Published>]) -> Result<(), LogbookError>;

    /// Receives a frame again, with its late map.
    ///
    /// # Errors
    /// As [`FrameSink::frames`].
    fn late_map(&mut self, frame: &Arc<Published>) -> Result<(), LogbookError>;
}
