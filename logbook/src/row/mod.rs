//! Rows of the file: writing, checking and reading.

mod checksums;
mod header;

use rusqlite::Row;
use rusqlite::types::Value;
use serde::{Deserialize, Serialize};
use survey::Electrode;

use crate::MapRecord;

pub(crate) use checksums::{
    HeaderChecksum, baseline_checksum, closing_checksum, event_checksum, late_map_checksum,
    mapper_checksum, reference_checksum, settings_checksum,
};
pub(crate) use header::{End, HEADER_COLUMNS, HeaderFault, RowCounts, header_row};

/// A row of `frame`.
pub(crate) struct FrameRow {
    pub(crate) sequence: i64,
    pub(crate) stretch: i64,
    pub(crate) tick: i64,
    pub(crate) skew: i64,
    pub(crate) duration: i64,
    pub(crate) reference: Option<i64>,
    pub(crate) flags: i64,
    pub(crate) loop_sum: Option<f64>,
    pub(crate) remarks: Option<String>,
    pub(crate) map_hash: Option<Value>,
    /// Distance in rows back to the row whose blob holds its readings; 0 for its own.
    pub(crate) place: i64,
    pub(crate) blob: Option<Vec<u8>>,
}

impl FrameRow {
    pub(crate) fn checksum(&self, header_checksum: HeaderChecksum) -> i64 {
        header_checksum
            .row("frame")
            .number(self.sequence)
            .number(self.stretch)
            .number(self.tick)
            .number(self.skew)
            .number(self.duration)
            .number(self.reference)
            .number(self.flags)
            .real(self.loop_sum)
            .text(self.remarks.as_deref())
            .value(self.map_hash.as_ref())
            .number(self.place)
            .bytes(self.blob.as_deref())
            .finish4()
    }
}

/// Optional data of a frame, rarely present.
#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct FrameExtras {
    #[serde(skip_serializing_if = "is_none")]
    pub(crate) implausible: usize,
    /// Driving electrodes in compliance.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(crate) compliance: Vec<Electrode>,
}

fn is_none(count: &usize) -> bool {
    *count == 0
}

/// A row of `stretch`: frames taken with the same settings, and a common clock rate. Microseconds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Stretch {
    pub(crate) id: i64,
    pub(crate) settings: i64,
    pub(crate) mapper: Option<i64>,
    pub(crate) simulated: bool,
    pub(crate) sequence: i64,
    pub(crate) monotonic: i64,
    pub(crate) wall: i64,
    pub(crate) period: i64,
}

impl Stretch {
    /// Deviation of a frame's clocks from this stretch: its tick, and its wall clock's skew.
    pub(crate) fn apart(&self, sequence: i64, monotonic: i64, wall: i64) -> (i64, i64) {
        let ticked = self.ticked(sequence);
        let since = monotonic - self.monotonic;
        (since - ticked, wall - self.wall - since)
    }

    /// Monotonic and wall time of a frame.
    pub(crate) fn times(&self, row: &FrameRow) -> (i64, i64) {
        let since = self.ticked(row.sequence).wrapping_add(row.tick);
        (
            self.monotonic.wrapping_add(since),
            self.wall.wrapping_add(since).wrapping_add(row.skew),
        )
    }

    fn ticked(&self, sequence: i64) -> i64 {
        sequence
            .wrapping_sub(self.sequence)
            .wrapping_mul(self.period)
    }

    pub(crate) fn checksum(&self, header_checksum: HeaderChecksum) -> [u8; 8] {
        header_checksum
            .row("stretch")
            .number(self.id)
            .number(self.settings)
            .number(self.mapper)
            .number(i64::from(self.simulated))
            .number(self.sequence)
            .number(self.monotonic)
            .number(self.wall)
            .number(self.period)
            .finish()
    }
}

pub(crate) struct StoredFrame {
    pub(crate) row: FrameRow,
    pub(crate) checksum: i64,
}

impl std::fmt::Debug for StoredFrame {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "frame {}", self.row.sequence)
    }
}

impl StoredFrame {
    pub(crate) fn read(row: &Row<'_>) -> rusqlite::Result<Self> {
        Ok(Self {
            row: FrameRow {
                sequence: row.get("sequence")?,
                stretch: row.get("stretch")?,
                tick: row.get("tick_us")?,
                skew: row.get("skew_us")?,
                duration: row.get("duration_us")?,
                reference: row.get("reference")?,
                flags: row.get("flags")?,
                loop_sum: row.get("loop_sum")?,
                remarks: row.get("remarks")?,
                map_hash: row.get("map_hash")?,
                place: row.get("place")?,
                blob: row.get("readings")?,
            },
            checksum: row.get("checksum")?,
        })
    }
}

/// Bytes of a map's hash kept if there is no sum.
const HASH_BYTES: usize = 8;

/// Packs a map record: a number with the first 4 bytes of its hash above its sum in single precision; 8 bytes of a
/// hash without a sum; or, if the hash is not a SHA-256, its text.
pub(crate) fn pack_trace(map: &MapRecord) -> Value {
    let nibbles: Option<Vec<u8>> = map
        .hash
        .bytes()
        .map(|digit| match digit {
            b'0'..=b'9' => Some(digit - b'0'),
            b'a'..=b'f' => Some(digit - b'a' + 10),
            _ => None,
        })
        .collect();
    let bytes: Option<Vec<u8>> = nibbles.map(|nibbles| {
        let (pairs, _) = nibbles.as_chunks::<2>();
        pairs.iter().map(|[high, low]| high << 4 | low).collect()
    });
    match (bytes.as_deref(), map.sum) {
        (Some([a, b, c, d, rest @ ..]), Some(sum))
            if [0, HASH_BYTES - 4, 28].contains(&rest.len()) =>
        {
            let [e, f, g, h] = sum.to_le_bytes();
            Value::Integer(i64::from_be_bytes([*a, *b, *c, *d, e, f, g, h]))
        }
        (Some(bytes), None) if [HASH_BYTES, 32].contains(&bytes.len()) => {
            Value::Blob(bytes[..HASH_BYTES].to_vec())
        }
        _ => Value::Text(map.hash.clone()),
    }
}

pub(crate) fn unpack_trace(stored: &Value) -> Option<(String, Option<f32>)> {
    match stored {
        Value::Text(text) => Some((text.clone(), None)),
        Value::Blob(bytes) => Some((survey::hex(bytes), None)),
        Value::Integer(number) => {
            let [a, b, c, d, e, f, g, h] = number.to_be_bytes();
            let sum = f32::from_le_bytes([e, f, g, h]);
            Some((survey::hex(&[a, b, c, d]), Some(sum)))
        }
        _ => None,
    }
}
