//! The frames of a session: pauses, recovery of a lost rig, failed frames.

use std::sync::Arc;

use rig::Clock;
use survey::error_chain as chain;
use tokio::sync::mpsc;
use tracing::Instrument;

use crate::acquisition::task::{Acquisition, AcquisitionEnd, FrameSource, Pause};
use crate::events::kind::EventKind;
use crate::instruments::transcripts::{self, FailedFrame};
use crate::recording::recorder_message::RecorderMessage;
use crate::recording::session_status::SessionStatus;
use crate::session::controller::Controller;
use crate::session::controller::recovery::{MOST_FAILED, may_pass};
use crate::session::controller::rig_events::ActiveSession;
use crate::session::state::Trigger;

impl Controller {
    /// Changes the state of the daemon when acquisition pauses and continues.
    pub(super) async fn follow_pauses(self: Arc<Self>, mut pauses: mpsc::Receiver<Pause>) {
        while let Some(Pause { pauses, applied }) = pauses.recv().await {
            let _ = self.change_state(match pauses {
                true => Trigger::Suspend,
                false => Trigger::Resume,
            });
            let _ = applied.send(());
        }
    }

    /// Takes frames, and recovers the rig when it is lost.
    pub(super) async fn run_and_recover(
        self: &Arc<Self>,
        acquisition: &mut Acquisition,
        orders: &mpsc::Sender<RecorderMessage>,
    ) -> AcquisitionEnd {
        let status = Arc::clone(&acquisition.status);
        let session = ActiveSession {
            status: &status,
            record: orders,
        };
        let mut source = self.source.lock().await;
        let (mut failed, mut acquired) = (0, status.acquired());
        loop {
            let ended = acquisition.run(&mut source).await;
            let AcquisitionEnd::Rig(error) = &ended else {
                return ended;
            };
            if status.acquired() > acquired {
                (failed, acquired) = (0, status.acquired());
            }
            failed += 1;
            self.frame_failed(session, error).await;
            if status.stop_request().is_requested() || !may_pass(error) || failed >= MOST_FAILED {
                if let FrameSource::Rig { rig, .. } = &mut *source {
                    // its links may be unsynchronised: the rig is reassembled
                    *rig = None;
                }
                return self.fault_or_stop(&status, ended);
            }
            if !self.recover(session, &mut source, error).await {
                return match status.has_failed() || self.source_state() == "unknown" {
                    true => self.fault_or_stop(&status, ended),
                    false => AcquisitionEnd::Done(status.stop_reason()),
                };
            }
        }
    }

    /// A session that ends because the daemon is stopped is not faulted: the failed frame and the state of the source
    /// are events of the session, and the daemon's exit code reports whether the source is off.
    fn fault_or_stop(&self, status: &SessionStatus, ended: AcquisitionEnd) -> AcquisitionEnd {
        if !self.inner().stopping || !status.stop_request().is_requested() {
            return ended;
        }
        self.inner().rig_fault = Some(ended.text());
        AcquisitionEnd::Done(status.stop_reason())
    }

    /// Handles a failed frame: records the cause as an event, and stores its transcript.
    async fn frame_failed(&self, session: ActiveSession<'_>, error: &rig::AcquireError) {
        let number = session.status.acquired() + 1;
        let text = format!(
            "frame {number} failed: {}",
            crate::acquisition::failed_frame::describe(error)
        );
        let at = self.runtime().clock.wall();
        session.status.count_failure(at, &text);
        let failures = session.status.failures();
        let instrument = error.cause().and_then(rig::RigError::instrument);
        let journal = tracing::error_span!("frame", frame = number, instrument);
        self.report(Some(session), EventKind::FrameFailed, &text)
            .instrument(journal)
            .await;
        self.report_safety(Some(session), error.cleanup()).await;
        let (transcript, id) = (self.transcript.clone(), session.status.facts.id.clone());
        let folder = self.runtime().setup.record_directory.clone();
        let written = tokio::task::spawn_blocking(move || {
            transcripts::write_failed(&transcript, &folder, &id, failures)
        })
        .await;
        let text = match written {
            Ok(Ok(FailedFrame::Written(path))) => {
                format!("the transcript of frame {number} is in {}", path.display())
            }
            Ok(Ok(FailedFrame::WrittenLast(path))) => format!(
                "the transcript of frame {number} is in {}; {} are kept for this session, those of later frames are not",
                path.display(),
                transcripts::MOST_OF_A_SESSION
            ),
            Ok(Ok(FailedFrame::OverLimit)) => return,
            Ok(Err(error)) => return tracing::warn!("{}", chain(&error)),
            Err(_) => return tracing::warn!("the transcript could not be written"),
        };
        self.report(Some(session), EventKind::Transcript, &text)
            .await;
    }
}
