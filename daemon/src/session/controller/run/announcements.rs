//! Announces a session to clients: its frames, its changes and its end. An ended session stays on the bus for a while.

use std::sync::Arc;
use std::time::Duration;

use dbus::FrameSummary;

use crate::events::event::{BusEvent, FrameDone};
use crate::recording::session_status::SessionStatus;
use crate::session::controller::{Controller, Inner};

/// Ended sessions kept on the bus, so that their clients can query the result.
const ENDED_SESSIONS: usize = 16;
/// Minimum time between two summaries: at most five a second.
const SUMMARY_INTERVAL: Duration = Duration::from_millis(200);

impl Controller {
    /// Keeps a session that has ended on the bus for a while.
    pub(in crate::session::controller) fn remember(
        &self,
        inner: &mut Inner,
        status: &Arc<SessionStatus>,
    ) {
        inner.recent.push_back(Arc::clone(status));
        while inner.recent.len() > ENDED_SESSIONS {
            if let Some(old) = inner.recent.pop_front() {
                self.events
                    .publish(&BusEvent::SessionRemoved(old.facts.id.clone()));
            }
        }
    }

    /// Announces frames, at most five times a second, and every other change of a session.
    pub(in crate::session::controller) async fn announce_frames(
        self: Arc<Self>,
        status: Arc<SessionStatus>,
    ) {
        let mut durable = status.follow_durable();
        let mut progress = status.follow();
        let mut reported = 0;
        loop {
            let over = tokio::select! {
                changed = durable.changed() => changed.is_err(),
                changed = progress.changed() => {
                    let over = progress.borrow_and_update().ended.is_some();
                    if !over {
                        self.events.publish(&BusEvent::SessionChanged(status.facts.id.clone()));
                    }
                    over || changed.is_err()
                }
            };
            if let Some(latest) = status.latest_frame()
                && latest.frame.sequence > reported
            {
                reported = latest.frame.sequence;
                let done = FrameDone {
                    session: status.facts.id.clone(),
                    sequence: reported,
                    wall_ns: survey::nanoseconds(latest.frame.wall),
                    summary: FrameSummary {
                        frames_acquired: Some(status.acquired()),
                        frames_dropped: Some(status.dropped()),
                        simulated: Some(latest.frame.simulated),
                        quality: latest.quality_details(),
                        map: latest.map_details(),
                    },
                };
                self.events.publish(&BusEvent::FrameDone(Arc::new(done)));
                if !over {
                    tokio::time::sleep(SUMMARY_INTERVAL).await;
                }
            }
            if over {
                self.events
                    .publish(&BusEvent::SessionChanged(status.facts.id.clone()));
                return;
            }
        }
    }
}
