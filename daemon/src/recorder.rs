//! The way of a frame after acquisition, on a thread of its own: quality, difference to the baseline, reconstruction,
//! then the sinks in order: logbook (durable), then everybody who listens.

use std::sync::Arc;

use bus::stream::{Body, Record};
use chrono::{DateTime, Utc};
use eit::Pressure;
use logbook::{LogbookError, MapRecord, SessionWriter};
use rig::{Clock, SystemClock};
use survey::{Baseline, Checks, Frame, Map};
use tokio::sync::mpsc;

use crate::live::{Live, Published};
use crate::model::{Model, chain};

/// Frames that may wait for the disk before acquisition does.
pub(crate) const QUEUE: usize = 16;

/// What the recorder is told.
#[derive(Debug)]
pub(crate) enum Order {
    Frame(Box<Frame>),
    Event {
        at: DateTime<Utc>,
        kind: &'static str,
        text: String,
    },
    Close {
        at: DateTime<Utc>,
        reason: String,
    },
}

/// Writes one session.
pub(crate) struct Recorder {
    pub live: Arc<Live>,
    pub writer: SessionWriter,
    pub clock: SystemClock,
    pub checks: Checks,
    pub task: Task,
    pub build: String,
}

/// What is made of the frames.
pub(crate) enum Task {
    /// The mean of so many.
    Baseline { frames: Vec<Frame>, wanted: u64 },
    /// A map of each.
    Maps {
        baseline: Box<Baseline>,
        model: Model,
        centroids: Vec<[f64; 2]>,
        areas: Vec<f64>,
    },
}

impl Recorder {
    /// Works until the session is closed. Returns the baseline, where one was recorded to its end. Blocks: not for an
    /// async task.
    ///
    /// # Errors
    /// The disk refused; everything acknowledged before is on it. The session has then been told to stop.
    pub(crate) fn run(
        mut self,
        mut orders: mpsc::Receiver<Order>,
    ) -> Result<Option<Baseline>, LogbookError> {
        while let Some(order) = orders.blocking_recv() {
            let outcome = match order {
                Order::Frame(frame) => self.frame(*frame),
                Order::Event { at, kind, text } => self.writer.event(at, kind, &text),
                Order::Close { at, reason } => return self.close(at, &reason),
            };
            if let Err(error) = outcome {
                self.live.stop(&chain(&error));
                // what is still on its way has nowhere to go
                orders.close();
                while let Some(order) = orders.blocking_recv() {
                    if let Order::Frame(_) = order {
                        self.live.count_dropped(1);
                    }
                }
                self.live.count_dropped(1);
                return Err(error);
            }
        }
        let at = self.clock.wall();
        self.close(at, "the daemon let go of the session")
    }

    fn frame(&mut self, mut frame: Frame) -> Result<(), LogbookError> {
        let quality = self.checks.of(&frame);
        let begun = self.clock.monotonic();
        let (map, found, record) = self.reconstruct(&frame);
        let reconstruction = self.clock.monotonic().saturating_sub(begun);
        let pressure = map.as_ref().and_then(|map| self.pressure(map));
        frame.sequence = self.writer.append(&frame, record.as_ref())?;
        let taken = frame.monotonic + frame.duration;
        let durable = self.clock.monotonic().saturating_sub(taken);
        tracing::debug!(
            session = self.live.facts.id,
            frame = frame.sequence,
            us = durable.as_micros() as u64,
            "durable"
        );
        if !self.live.readers.is_empty() {
            for body in bodies(&frame, map.as_ref(), pressure.as_ref()) {
                self.live.readers.publish(&Record {
                    sequence: frame.sequence,
                    wall_ns: nanoseconds(frame.wall),
                    gap: 0,
                    simulated: frame.simulated,
                    body,
                });
            }
        }
        if let Task::Baseline { frames, .. } = &mut self.task {
            frames.push(frame.clone());
        }
        self.live.publish(Published {
            frame,
            quality,
            map,
            found,
            pressure,
            reconstruction,
            durable,
        });
        Ok(())
    }

    fn reconstruct(&self, frame: &Frame) -> (Option<Map>, Option<[f64; 2]>, Option<MapRecord>) {
        let Task::Maps {
            baseline,
            model,
            centroids,
            areas,
        } = &self.task
        else {
            return (None, None, None);
        };
        match model
            .reconstructor
            .reconstruct(&baseline.readings, &frame.readings)
        {
            Ok(map) => {
                self.live.set_last_error("");
                let record = MapRecord {
                    hash: map.hash(),
                    method: map.method.clone(),
                    model_hash: model.hash.clone(),
                    build: self.build.clone(),
                    cpu: cpu_features(),
                };
                let found = map.found(centroids, areas);
                (Some(map), found, Some(record))
            }
            Err(error) => {
                self.live.set_last_error(&chain(&error));
                (None, None, None)
            }
        }
    }

    /// Of a method that is calibrated; a map that the calibration refuses stays a map, and the session says why.
    fn pressure(&self, map: &Map) -> Option<Pressure> {
        let Task::Maps { model, .. } = &self.task else {
            return None;
        };
        let calibration = model.calibration.as_ref()?;
        match calibration.pressure(model.reconstructor.mesh(), map) {
            Ok(pressure) => Some(pressure),
            Err(error) => {
                self.live.set_last_error(&chain(&error));
                None
            }
        }
    }

    fn close(mut self, at: DateTime<Utc>, reason: &str) -> Result<Option<Baseline>, LogbookError> {
        let mut baseline = None;
        if let Task::Baseline { frames, wanted } = &self.task
            && frames.len() as u64 >= *wanted
        {
            match Baseline::from_frames(self.live.facts.id.clone(), frames) {
                Ok(made) => {
                    self.writer.baseline(&made)?;
                    baseline = Some(made);
                }
                Err(error) => self.writer.event(at, "baseline", &chain(&error))?,
            }
        }
        self.writer.close(at, reason)?;
        Ok(baseline)
    }
}

fn bodies(frame: &Frame, map: Option<&Map>, pressure: Option<&Pressure>) -> Vec<Body> {
    let frame = Body::Frame {
        volts: volts(&frame.readings),
        flags: frame
            .readings
            .iter()
            .map(|reading| reading.flag())
            .collect(),
    };
    let map = map.map(|map| Body::Map {
        values: map.values.clone(),
        mesh_hash: map.mesh_hash.clone(),
        method: map.method.clone(),
    });
    let pressure = pressure.map(|pressure| Body::Pressure {
        kpa: pressure.kpa.clone(),
        newtons: pressure.newtons,
    });
    std::iter::once(frame).chain(pressure).chain(map).collect()
}

/// Voltages as numbers for the bus; NaN, which its flag explains, where there is none.
pub(crate) fn volts(readings: &[survey::Reading]) -> Vec<f64> {
    readings
        .iter()
        .map(|reading| reading.volts().map_or(f64::NAN, |volts| volts.0))
        .collect()
}

/// Nanoseconds since 1970 UTC; the ends of the scale outside of 1677 to 2262.
pub(crate) fn nanoseconds(wall: DateTime<Utc>) -> i64 {
    wall.timestamp_nanos_opt()
        .unwrap_or(if wall < DateTime::UNIX_EPOCH {
            i64::MIN
        } else {
            i64::MAX
        })
}

/// What decides the last bits of a map beside the build.
fn cpu_features() -> String {
    #[cfg(target_arch = "x86_64")]
    {
        let features = [
            ("avx512f", std::arch::is_x86_feature_detected!("avx512f")),
            ("avx2", std::arch::is_x86_feature_detected!("avx2")),
            ("fma", std::arch::is_x86_feature_detected!("fma")),
        ];
        let names: Vec<&str> = features
            .into_iter()
            .filter_map(|(name, there)| there.then_some(name))
            .collect();
        format!("x86_64 {}", names.join(" "))
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        std::env::consts::ARCH.to_owned()
    }
}
