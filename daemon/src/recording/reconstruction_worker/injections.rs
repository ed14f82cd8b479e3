//! The load after every injection, on a thread of its own: neither frames nor their maps wait for it. It is computed while somebody
//! reads it, from the newest injection, for at most half of the time.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use dbus::stream::Body;
use eit::Reconstructor;
use imaging::Tracking;
use imaging::tracking::{Injection, InjectionWindow, TimedReading, seconds};
use rig::InjectionReadings;
use survey::{error_chain as chain, nanoseconds};
use tokio::sync::mpsc;

use crate::panics::containment;
use crate::recording::session_status::SessionStatus;
use crate::recording::stream_sink::StreamSink;

/// Injections that may wait for a fit in progress: more than a fit needs.
const WAITING: usize = 64;

/// The tracked baseline after a frame, and the sequence of that frame.
struct Reference {
    tracking: Tracking,
    sequence: u64,
}

/// The newest one.
#[derive(Clone, Default)]
pub(super) struct SharedTracking(Arc<Mutex<Option<Arc<Reference>>>>);

impl SharedTracking {
    fn place(&self) -> std::sync::MutexGuard<'_, Option<Arc<Reference>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn set(&self, tracking: &Tracking, sequence: u64) {
        *self.place() = Some(Arc::new(Reference {
            tracking: tracking.clone(),
            sequence,
        }));
    }
}

/// The last injections of a session, and who reads what they say.
pub(super) struct Injections {
    pub(super) tracking: SharedTracking,
    /// The method of the session, whose mesh its maps have.
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
        while let Some(injection) = came.blocking_recv() {
            push(&mut window, &injection);
            let wanted = self.status.readers.want_injections() && came.is_empty();
            let began = Instant::now();
            if !wanted || injection.compliance || began < rests_until {
                continue;
            }
            // a panic costs this record
            let fitted = containment::run(|| self.publish(&sink, &window, &injection));
            drop(fitted);
            rests_until = Instant::now() + began.elapsed();
        }
    }

    fn publish(&self, sink: &StreamSink, window: &InjectionWindow, last: &InjectionReadings) {
        let Some(reference) = self.tracking.place().clone() else {
            return;
        };
        match reference.tracking.after_injection(window, last.drive) {
            Ok((after, disc)) => {
                let mesh = self.method.mesh();
                let empty = || vec![0.0; mesh.region().len()];
                let body = Body::Injection {
                    values: disc.map_or_else(empty, |disc| disc.map(mesh)),
                    json: serde_json::json!(after).to_string(),
                };
                sink.injection(reference.sequence + 1, nanoseconds(last.wall), body);
            }
            Err(error) => tracing::debug!("no load after an injection: {}", chain(&error)),
        }
    }
}

fn push(window: &mut InjectionWindow, injection: &InjectionReadings) {
    if injection.compliance {
        // it may have begun in the injection before
        return window.clear();
    }
    let readings = injection.readings.iter().filter_map(|(number, reading)| {
        Some(TimedReading {
            reading: *number,
            volts: reading.volts()?.0,
        })
    });
    let at_s = seconds(injection.wall);
    let readings = readings.collect();
    window.push(
        Injection { at_s, readings },
        injection.duration.as_secs_f64(),
    );
}
