//! Sends frames and maps on the full-rate stream.

use std::sync::Arc;

use dbus::stream::{Body, Record};
use eit::Pressure;
use logbook::LogbookError;
use survey::{Frame, Map, Reading};

use crate::recording::frame_sink::FrameSink;
use crate::recording::published::{Published, json};
use crate::recording::session_status::SessionStatus;

/// The readers of the full-rate stream.
pub(super) struct StreamSink(pub Arc<SessionStatus>);

impl FrameSink for StreamSink {
    fn frames(&mut self, frames: &[Arc<Published>]) -> Result<(), LogbookError> {
        if self.0.readers.is_empty() {
            return Ok(());
        }
        for published in frames {
            self.publish(&published.frame, frame_body(&published.frame));
            self.late_map(published)?;
        }
        Ok(())
    }

    fn late_map(&mut self, published: &Arc<Published>) -> Result<(), LogbookError> {
        if self.0.readers.is_empty() {
            return Ok(());
        }
        if let Some(pressure) = &published.pressure {
            self.publish(&published.frame, pressure_body(pressure));
        }
        if let Some(map) = &published.map {
            if let Some(quality) = &map.quality {
                let json = json(quality);
                self.publish(&published.frame, Body::Quality { json });
            }
            if let Some(tracked) = &published.tracked {
                let json = json(tracked);
                self.publish(&published.frame, Body::Tracked { json });
            }
            if let Some(quantities) = &published.quantities {
                let json = json(quantities);
                self.publish(&published.frame, Body::Quantities { json });
            }
            self.publish(&published.frame, map_body(map));
        }
        Ok(())
    }
}

impl StreamSink {
    /// Sends a result that is computed separately from frames and maps, for the frame with this sequence.
    pub(super) fn beside_frames(&self, sequence: u64, wall_ns: i64, body: Body) {
        self.0.readers.publish(&Record {
            sequence,
            wall_ns,
            gap: 0,
            simulated: self.0.facts.simulated,
            body,
        });
    }

    fn publish(&self, frame: &Frame, body: Body) {
        self.0.readers.publish(&Record {
            sequence: frame.sequence,
            wall_ns: survey::nanoseconds(frame.wall),
            gap: 0,
            simulated: frame.simulated,
            body,
        });
    }
}

fn frame_body(frame: &Frame) -> Body {
    Body::Frame {
        volts: volts(&frame.readings),
        flags: frame
            .readings
            .iter()
            .map(|reading| reading.flag())
            .collect(),
    }
}

fn map_body(map: &Map) -> Body {
    Body::Map {
        values: map.values.clone(),
        mesh_hash: map.mesh_hash.clone(),
        method: map.method.clone(),
    }
}

fn pressure_body(pressure: &Pressure) -> Body {
    Body::Pressure {
        kpa: pressure.kpa.clone(),
        newtons: pressure.newtons,
    }
}

/// Voltages as numbers for the bus; NaN for a reading without voltage, whose flag gives the reason.
pub(crate) fn volts(readings: &[Reading]) -> Vec<f64> {
    readings
        .iter()
        .map(|reading| reading.volts().map_or(f64::NAN, |volts| volts.0))
        .collect()
}
