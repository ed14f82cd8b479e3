//! A session of plain frames.

use std::path::Path;

use logbook::{SessionHeader, SessionWriter};
use survey::{Protocol, Reading, Volts};

use super::taken::{at, taken};

/// An open session with this many frames, one a second; every reading is the frame's number, V.
pub fn written(dir: &Path, id: &str, electrodes: usize, frames: u64) -> SessionWriter {
    let protocol = Protocol::sheffield(electrodes).unwrap();
    let header = SessionHeader::new(id, at(0), protocol.clone());
    let mut writer = SessionWriter::create(dir, &header).unwrap();
    for number in 1..=frames {
        let readings = vec![Reading::Ok(Volts(number as f64)); protocol.len()];
        let frame = taken(&protocol, number, number as i64, readings);
        writer.append(&frame, None).unwrap();
    }
    writer
}
