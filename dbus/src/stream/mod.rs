//! Records of the full-rate stream of `Session1.OpenStream`: encodes and decodes them, without I/O.
//!
//! All numbers little-endian, without padding. Every record is
//!
//! | bytes | type | what |
//! |---|---|---|
//! | 0 to 3 | u32 | length of the rest of the record |
//! | 4, 5 | u16 | version, 1 |
//! | 6, 7 | u16 | kind: 1 frame, 2 map, 3 end, 4 pressure, 5 quality, 6 tracked, 7 quantities, 8 injection, 9 deviation |
//! | 8 to 15 | u64 | sequence of the frame, from 1 in its session |
//! | 16 to 23 | i64 | wall time of the frame, ns since 1970 UTC |
//! | 24 to 31 | u64 | gap: records that this reader lost just before this one, because it read too slowly |
//! | 32 to 35 | u32 | bit 0: simulated; other bits 0 |
//! | 36 to 39 | u32 | n |
//!
//! followed by the body:
//!
//! | kind | body |
//! |---|---|
//! | frame | n voltages (f64, V; NaN where the flag is not 0), n flags (u8: 0 ok, 1 overload, 3 not measured) |
//! | map | n relative changes of conductance (f64, one a triangle of the region), then mesh hash and method, each after a u16 length |
//! | pressure | n pressures (f64, kPa, one a triangle of the region), then the total load (f64, N) |
//! | quality | n bytes of JSON (UTF-8): `verdict` and `reasons`, as in `watch --json` |
//! | tracked, quantities | n bytes of JSON (UTF-8), as in `watch --json` |
//! | injection | n values as in a map, then JSON to the end of the record, as in `watch --fast --json` |
//! | deviation | n standard deviations of the change of ln conductance (f64; NaN: not determined), then the mesh hash to the end |
//! | end | the reason, n bytes (UTF-8); the descriptor is then closed |
//!
//! Pressure, quality, tracked and quantities come just before the map of the same frame. An injection belongs to the
//! frame of its sequence, which is still being measured. A reader skips unknown kinds by their length, and rejects
//! other versions. `dbus/stream_reader.py` is a reader in less than forty lines.
//!
//! ```
//! use dbus::stream::{Body, Decoder, Record};
//! let sent = Record { sequence: 7, wall_ns: 0, gap: 2, simulated: true,
//!     body: Body::Frame { volts: vec![0.25], flags: vec![0] } };
//! let mut decoder = Decoder::new();
//! let bytes = sent.encode();
//! decoder.push(&bytes[..5]);
//! assert_eq!(decoder.next_record()?, None);
//! decoder.push(&bytes[5..]);
//! assert_eq!(decoder.next_record()?, Some(sent));
//! # Ok::<(), dbus::stream::StreamError>(())
//! ```

#[cfg(test)]
mod tests;

/// Version of the layout.
pub const VERSION: u16 = 1;
/// Maximum length of a record; a larger length means that the reader is not synchronised.
pub const LONGEST: usize = 64 * 1024 * 1024;
/// Offset of the gap in an encoded record.
const GAP_AT: usize = 24;
const HEADER: usize = 40;

/// One record.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// Sequence of the frame, from 1 in its session.
    pub sequence: u64,
    /// Wall time of the frame, ns since 1970 UTC.
    pub wall_ns: i64,
    /// Records lost just before this one.
    pub gap: u64,
    /// Whether the voltages are simulated.
    pub simulated: bool,
    /// The content.
    pub body: Body,
}

/// The content of a record.
#[derive(Debug, Clone, PartialEq)]
pub enum Body {
    /// Voltages and flags, equally many.
    Frame {
        /// V; NaN where the flag is not 0.
        volts: Vec<f64>,
        /// 0 ok, 1 overload, 3 not measured.
        flags: Vec<u8>,
    },
    /// One value for each triangle of the region.
    Map {
        /// Relative change of conductance.
        values: Vec<f64>,
        /// Hash of the mesh.
        mesh_hash: String,
        /// The method of the map.
        method: String,
    },
    /// Pressure of the map of the same sequence, which follows.
    Pressure {
        /// kPa.
        kpa: Vec<f64>,
        /// Total load, N.
        newtons: f64,
    },
    /// Reliability of the map of the same sequence, which follows.
    Quality {
        /// A `survey::MapQuality` as JSON.
        json: String,
    },
    /// Result of the tracked baseline for the frame of the same sequence, whose map follows.
    Tracked {
        /// `tracked` of `tactus watch --json`.
        json: String,
    },
    /// Quantities of the map of the same sequence, which follows.
    Quantities {
        /// `quantities` of `tactus watch --json`.
        json: String,
    },
    /// The load after an injection of the frame of this sequence, which is still being measured.
    Injection {
        /// Relative change of conductance, one value for each triangle of the region.
        values: Vec<f64>,
        /// `after` of `tactus watch --fast --json`.
        json: String,
    },
    /// Precision of each value for the frame of this sequence, relative to the sheet without its load.
    Deviation {
        /// Standard deviation of the change of ln conductance, one value for each triangle of the region; NaN if the
        /// frame does not determine it.
        values: Vec<f64>,
        /// Hash of the mesh.
        mesh_hash: String,
    },
    /// The session has ended.
    End {
        /// The reason.
        reason: String,
    },
}

/// Bytes that are not records.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum StreamError {
    /// Written by another version.
    #[error(
        "the stream is of version {0}, this reader knows version {VERSION}; use the client of the daemon's version"
    )]
    Version(u16),
    /// An invalid length.
    #[error(
        "a record of {0} bytes is not possible: the reader lost the position in the stream; open the stream again"
    )]
    Length(usize),
    /// A count that does not fit the record's length, or text that is not UTF-8.
    #[error("record {sequence} is malformed ({what}); open the stream again")]
    Malformed {
        /// The record's sequence.
        sequence: u64,
        /// The invalid field.
        what: &'static str,
    },
}

impl Record {
    /// Encodes the record, with its length.
    pub fn encode(&self) -> Vec<u8> {
        let bytes_of = |text: &str| text.as_bytes().to_vec();
        // the values, and the bytes after them
        let (kind, values, rest): (u16, &[f64], Vec<u8>) = match &self.body {
            Body::Frame { volts, flags } => {
                let flag = |at: usize| flags.get(at).copied().unwrap_or(3);
                (1, volts, (0..volts.len()).map(flag).collect())
            }
            Body::Map {
                values,
                mesh_hash,
                method,
            } => (2, values, [counted(mesh_hash), counted(method)].concat()),
            Body::End { reason } => (3, &[], bytes_of(reason)),
            Body::Pressure { kpa, newtons } => (4, kpa, newtons.to_le_bytes().to_vec()),
            Body::Quality { json } => (5, &[], bytes_of(json)),
            Body::Tracked { json } => (6, &[], bytes_of(json)),
            Body::Quantities { json } => (7, &[], bytes_of(json)),
            Body::Injection { values, json } => (8, values, bytes_of(json)),
            Body::Deviation { values, mesh_hash } => (9, values, bytes_of(mesh_hash)),
        };
        let count = match is_text(kind) {
            true => rest.len(),
            false => values.len(),
        };
        let mut bytes = vec![0; 4];
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend(kind.to_le_bytes());
        bytes.extend(self.sequence.to_le_bytes());
        bytes.extend(self.wall_ns.to_le_bytes());
        bytes.extend(self.gap.to_le_bytes());
        bytes.extend(u32::from(self.simulated).to_le_bytes());
        bytes.extend((count as u32).to_le_bytes());
        bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        bytes.extend(rest);
        let length = (bytes.len() - 4) as u32;
        bytes[..4].copy_from_slice(&length.to_le_bytes());
        bytes
    }
}

/// Sets the gap in an encoded record, so that one encoding serves several readers.
pub fn set_gap(encoded: &mut [u8], gap: u64) {
    if let Some(place) = encoded.get_mut(GAP_AT..GAP_AT + 8) {
        place.copy_from_slice(&gap.to_le_bytes());
    }
}

/// Assembles records from bytes, however they were split.
#[derive(Debug, Default)]
pub struct Decoder {
    bytes: Vec<u8>,
    read: usize,
}

impl Decoder {
    /// An empty decoder.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds received bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        self.bytes.drain(..self.read);
        self.read = 0;
        self.bytes.extend_from_slice(bytes);
    }

    /// The next complete record; `None` until more bytes arrive. Records of unknown kind are skipped.
    ///
    /// # Errors
    /// Another version, or bytes that are not records; the stream is then unusable.
    pub fn next_record(&mut self) -> Result<Option<Record>, StreamError> {
        loop {
            let rest = &self.bytes[self.read..];
            let Some(length) = number::<4>(rest, 0).map(u32::from_le_bytes) else {
                return Ok(None);
            };
            let length = length as usize;
            if !(HEADER - 4..=LONGEST).contains(&length) {
                return Err(StreamError::Length(length));
            }
            let Some(record) = rest.get(..length + 4) else {
                return Ok(None);
            };
            let decoded = decode(record)?;
            self.read += length + 4;
            if decoded.is_some() {
                return Ok(decoded);
            }
        }
    }
}

fn decode(record: &[u8]) -> Result<Option<Record>, StreamError> {
    let short = StreamError::Length(record.len());
    let read = || {
        Some((
            u16::from_le_bytes(number(record, 4)?),
            u16::from_le_bytes(number(record, 6)?),
            u64::from_le_bytes(number(record, 8)?),
            i64::from_le_bytes(number(record, 16)?),
            u64::from_le_bytes(number(record, GAP_AT)?),
            u32::from_le_bytes(number(record, 32)?),
            u32::from_le_bytes(number(record, 36)?) as usize,
        ))
    };
    let (version, kind, sequence, wall_ns, gap, marks, count) = read().ok_or(short)?;
    if version != VERSION {
        return Err(StreamError::Version(version));
    }
    if !(1..=9).contains(&kind) {
        return Ok(None);
    }
    let malformed = |what| StreamError::Malformed { sequence, what };
    let misfit = || malformed("the count does not fit the length");
    let whole = |bytes: &[u8], what| {
        String::from_utf8(bytes.to_vec()).map_err(|_| StreamError::Malformed { sequence, what })
    };
    let numbers = if is_text(kind) { 0 } else { count * 8 };
    let (values, rest) = record[HEADER..]
        .split_at_checked(numbers)
        .ok_or_else(misfit)?;
    let expected = match kind {
        // of any length
        2 | 8 | 9 => rest.len(),
        4 => 8,
        _ => count,
    };
    if rest.len() != expected {
        return Err(misfit());
    }
    let values = floats(values);
    let body = match kind {
        1 => Body::Frame {
            volts: values,
            flags: rest.to_vec(),
        },
        2 => {
            let (mesh_hash, rest) = text(rest).ok_or_else(|| malformed("the mesh hash"))?;
            let (method, rest) = text(rest).ok_or_else(|| malformed("the method"))?;
            if !rest.is_empty() {
                return Err(malformed("bytes after the method"));
            }
            Body::Map {
                values,
                mesh_hash,
                method,
            }
        }
        3 => Body::End {
            reason: whole(rest, "the reason")?,
        },
        4 => Body::Pressure {
            kpa: values,
            newtons: number(rest, 0).map_or(f64::NAN, f64::from_le_bytes),
        },
        _ => {
            let text = whole(rest, "the text")?;
            match kind {
                5 => Body::Quality { json: text },
                6 => Body::Tracked { json: text },
                7 => Body::Quantities { json: text },
                8 => Body::Injection { values, json: text },
                _ => Body::Deviation {
                    values,
                    mesh_hash: text,
                },
            }
        }
    };
    Ok(Some(Record {
        sequence,
        wall_ns,
        gap,
        simulated: marks & 1 != 0,
        body,
    }))
}

fn number<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..at + N)?.try_into().ok()
}

fn floats(bytes: &[u8]) -> Vec<f64> {
    bytes
        .chunks_exact(8)
        .filter_map(|value| number(value, 0).map(f64::from_le_bytes))
        .collect()
}

/// Whether the body of a record of this kind is one text, whose bytes its count counts.
fn is_text(kind: u16) -> bool {
    matches!(kind, 3 | 5..=7)
}

/// A text after its length, cut at the largest length.
fn counted(text: &str) -> Vec<u8> {
    let text = &text.as_bytes()[..text.len().min(usize::from(u16::MAX))];
    [&(text.len() as u16).to_le_bytes(), text].concat()
}

fn text(bytes: &[u8]) -> Option<(String, &[u8])> {
    let length = usize::from(u16::from_le_bytes(number(bytes, 0)?));
    let text = bytes.get(2..2 + length)?;
    Some((String::from_utf8(text.to_vec()).ok()?, &bytes[2 + length..]))
}
