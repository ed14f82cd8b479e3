//! The standard deviation of maps, computed on a separate thread: neither frames nor maps wait for it. It is computed
//! only while a client reads it, for at most one frame per second.

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

/// Minimum time between two frames with a standard deviation, s: a higher rate gives no more information, and costs as
/// much as the maps.
const EVERY_S: f64 = 1.0;

/// A copy of the tracked baseline just after a frame.
struct FollowedFrame {
    tracking: Tracking,
    sequence: u64,
    wall_ns: i64,
}

/// Passes frames to the thread.
pub(super) struct Deviations {
    to: SyncSender<FollowedFrame>,
    /// Whether the thread is still computing: the tracked baseline is copied only if the thread is idle.
    busy: Arc<AtomicBool>,
    status: Arc<SessionStatus>,
    last_s: Option<f64>,
}

impl Deviations {
    /// Starts the thread, which ends when this value is dropped. `method`: the method of the session; its mesh is that
    /// of the maps.
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

    /// Passes the last frame to the thread if its standard deviation is wanted and the thread is idle. Never waits.
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
        // cannot be full: the thread is idle
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
        // after a panic only this standard deviation is missing
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
