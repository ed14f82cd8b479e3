//! The load after every injection, computed on a separate thread: neither frames nor maps wait for it. It is computed
//! only while a client reads it, from the newest injection, and for at most half of the time.

use std::sync::{Arc, Mutex};
use std::time::Instant;

use dbus::stream::Body;
use eit::Reconstructor;
use imaging::Tracking;
use imaging::tracking::{Injection, InjectionWindow, TimedReading, seconds};
use rig::InjectionReadings;
use survey::{error_chain as chain, nanoseconds};
use tokio::sync::mpsc;

use crate::locked::locked;
use crate::panics::containment;
use crate::recording::session_status::SessionStatus;
use crate::recording::stream_sink::StreamSink;

/// Maximum number of injections that wait for a fit in progress: more than arrive during a fit.
const WAITING: usize = 64;

/// The tracked baseline after the newest frame; `None` until a frame is complete, and while no client reads.
#[derive(Clone, Default)]
pub(super) struct SharedTracking(Arc<Mutex<Option<Arc<Tracking>>>>);

impl SharedTracking {
    pub(super) fn set(&self, tracking: Option<&Tracking>) {
        *locked(&self.0) = tracking.map(|tracking| Arc::new(tracking.clone()));
    }
}

/// Computes the load after each injection of a session, for the readers of the stream.
pub(super) struct Injections {
    pub(super) tracking: SharedTracking,
    /// The method of the session; its mesh is that of the maps.
    pub(super) method: Arc<dyn Reconstructor>,
    pub(super) status: Arc<SessionStatus>,
}

impl Injections {
    /// Starts the thread, which ends with its sender.
    pub(super) fn start(self) -> std::io::Result<mpsc::Sender<InjectionReadings>> {
        let (to, came) = mpsc::channel(WAITING);
        std::thread::Builder::new()
            .name("injections".to_owned())
            .spawn(move || self.run(came))?;
        Ok(to)
    }

    fn run(self, mut came: mpsc::Receiver<InjectionReadings>) {
        let mut window = InjectionWindow::default();
        let sink = StreamSink(Arc::clone(&self.status));
        let mut rests_until = Instant::now();
        let mut frame = None;
        while let Some(injection) = came.blocking_recv() {
            let of = (injection.frame, injection.frame_began);
            let repeated = |(number, began)| number == of.0 && began != of.1;
            // compliance may have begun in the previous injection; a frame that is measured again has failed
            if injection.compliance || frame.is_some_and(repeated) {
                window.clear();
            }
            frame = Some(of);
            if injection.compliance {
                continue;
            }
            push(&mut window, &injection);
            let wanted = self.status.readers.want_injections() && came.is_empty();
            let began = Instant::now();
            if !wanted || began < rests_until {
                continue;
            }
            // after a panic only this load is missing
            let fitted = containment::run(|| self.publish(&sink, &window, &injection));
            drop(fitted);
            rests_until = Instant::now() + began.elapsed();
        }
    }

    fn publish(&self, sink: &StreamSink, window: &InjectionWindow, last: &InjectionReadings) {
        let Some(tracking) = locked(&self.tracking.0).clone() else {
            return;
        };
        match tracking.after_injection(window, last.drive, seconds(last.wall)) {
            Ok((after, disc)) => {
                let mesh = self.method.mesh();
                let empty = || vec![0.0; mesh.region().len()];
                let body = Body::Injection {
                    values: disc.map_or_else(empty, |disc| disc.map(mesh)),
                    json: serde_json::json!(after).to_string(),
                };
                sink.beside_frames(last.frame, nanoseconds(last.wall), body);
            }
            Err(error) => tracing::debug!("no load after an injection: {}", chain(&error)),
        }
    }
}

fn push(window: &mut InjectionWindow, injection: &InjectionReadings) {
    let readings = injection
        .readings
        .iter()
        .map(|(number, reading)| TimedReading {
            reading: *number,
            volts: reading.volts().map_or(f64::NAN, |volts| volts.0),
        });
    let at_s = injection.monotonic.as_secs_f64();
    let readings = readings.collect();
    window.push(
        Injection { at_s, readings },
        injection.duration.as_secs_f64(),
    );
}
