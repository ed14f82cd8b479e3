//! Sends the quantities of frames to the task that judges them; never waits.

use std::sync::Arc;

use logbook::LogbookError;
use tokio::sync::mpsc;

use crate::recording::frame_sink::FrameSink;
use crate::recording::published::Published;

/// A frame with its quantities.
#[derive(Debug)]
pub(crate) struct JudgedFrame {
    /// Id of its session.
    pub session: String,
    pub published: Arc<Published>,
}

/// Sends the frames of one session.
pub(crate) struct AlarmSink {
    pub session: String,
    pub frames: mpsc::Sender<JudgedFrame>,
}

impl FrameSink for AlarmSink {
    fn frames(&mut self, frames: &[Arc<Published>]) -> Result<(), LogbookError> {
        for published in frames {
            self.late_map(published)?;
        }
        Ok(())
    }

    fn late_map(&mut self, published: &Arc<Published>) -> Result<(), LogbookError> {
        if published.quantities.is_some() {
            // a full queue means that frames arrive faster than they are judged: this one is left out
            let _ = self.frames.try_send(JudgedFrame {
                session: self.session.clone(),
                published: Arc::clone(published),
            });
        }
        Ok(())
    }
}
