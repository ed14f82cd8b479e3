//! The standard deviation of maps, on a thread of its own: neither frames nor their maps wait for it. It is computed while somebody
//! reads it, at most once in a second of frames.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use dbus::stream::Body;
use eit::Reconstructor;
use imaging::Tracking;
use survey::error_chain as chain;

use super::FrameRequest;
use crate::locked::locked;
use crate::panics::containment;
use crate::recording::session_status::SessionStatus;
use crate::recording::stream_sink::StreamSink;

/// Time of frames between two with a standard deviation, s: a larger rate tells nothing more, and costs as much as the maps.
const EVERY_S: f64 = 1.0;

/// The tracked baseline just after it followed a frame.
struct FollowedFrame {
    tracking: Tracking,
    sequence: u64,
    wall_ns: i64,
}

/// Passes frames to the thread.
pub(super) struct Deviations {
    to: SyncSender<FollowedFrame>,
    /// Whether the thread still computes one: a frame is copied only for a thread that takes it.
    busy: Arc<AtomicBool>,
    status: Arc<SessionStatus>,
    last_s: Option<f64>,
}

impl Deviations {
    /// Starts the thread, which ends with this value. `method`: that of the session, whose mesh its maps have.
    pub(super) fn start(
        method: Arc<dyn Reconstructor>,
        status: &Arc<SessionStatus>,
    ) -> std::io::Result<Self> {
        let (to, came) = sync_channel(1);
        let sink = StreamSink(Arc::clone(status));
        let busy = Arc::new(AtomicBool::new(false));
        let computing = Arc::clone(&busy);
        std::thread::Builder::new()
            .name("deviations".to_owned())
            .spawn(move || run(&came, method.as_ref(), &sink, &computing))?;
        Ok(Self {
            to,
            busy,
            status: Arc::clone(status),
            last_s: None,
        })
    }

    /// Takes the frame that the baseline followed last, if its standard deviation is wanted now. Never waits.
    pub(super) fn take(&mut self, tracking: &Tracking, frame: &FrameRequest) {
        let recent = |last: f64| (frame.at_s - last).abs() < EVERY_S;
        let wanted = self.status.readers.want_deviations() && !self.last_s.is_some_and(recent);
        if !wanted || self.busy.swap(true, Ordering::AcqRel) {
            return;
        }
        let followed = FollowedFrame {
            tracking: tracking.clone(),
            sequence: frame.sequence,
            wall_ns: frame.wall_ns,
        };
        // the thread is idle, so that its only place is free
        let _ = self.to.try_send(followed);
        self.last_s = Some(frame.at_s);
    }
}

fn run(
    came: &Receiver<FollowedFrame>,
    method: &dyn Reconstructor,
    sink: &StreamSink,
    busy: &AtomicBool,
) {
    let mesh = method.mesh();
    while let Ok(followed) = came.recv() {
        // a panic costs this record
        let found = containment::run(|| followed.tracking.map_deviation(mesh));
        busy.store(false, Ordering::Release);
        let Ok(found) = found else {
            continue;
        };
        match found {
            Ok(values) => {
                let latest = &sink.0.deviation;
                let mut latest = locked(latest);
                *latest = Some((followed.sequence, values.clone()));
                drop(latest);
                let mesh_hash = mesh.hash().to_owned();
                let body = Body::Deviation { values, mesh_hash };
                sink.beside_frames(followed.sequence, followed.wall_ns, body);
            }
            Err(error) => tracing::debug!("a map has no standard deviation: {}", chain(&error)),
        }
    }
}
