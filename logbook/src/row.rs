//! Rows of the file as they are written, checked and read.

use chrono::DateTime;
use rusqlite::Row;
use rusqlite::types::Value;
use sha2::{Digest, Sha256};

use crate::{Closing, SessionHeader, SessionKind};

/// A row of `frame` as it is checked: everything that a picture or an export is made from.
pub(crate) struct FrameRow {
    pub(crate) sequence: i64,
    pub(crate) wall: i64,
    pub(crate) monotonic: i64,
    pub(crate) duration: i64,
    pub(crate) simulated: bool,
    pub(crate) compliance: Option<String>,
    pub(crate) map_hash: Option<Value>,
    pub(crate) reference: Option<i64>,
    pub(crate) blob: Vec<u8>,
}

impl FrameRow {
    /// First 8 bytes of SHA-256; absent values hash as -1, texts and blobs with their length in front.
    pub(crate) fn checksum(&self, settings: i64, mapper: Option<i64>) -> Vec<u8> {
        let mut hasher = Sha256::new();
        for number in [
            self.sequence,
            self.wall,
            self.monotonic,
            self.duration,
            settings,
            i64::from(self.simulated),
            mapper.unwrap_or(-1),
            self.reference.unwrap_or(-1),
        ] {
            hasher.update(number.to_le_bytes());
        }
        let hash = match &self.map_hash {
            Some(Value::Blob(bytes)) => bytes.as_slice(),
            Some(Value::Text(text)) => text.as_bytes(),
            _ => &[],
        };
        for bytes in [
            self.compliance.as_deref().unwrap_or("").as_bytes(),
            hash,
            &self.blob,
        ] {
            hasher.update((bytes.len() as u64).to_le_bytes());
            hasher.update(bytes);
        }
        hasher.finalize()[..8].to_vec()
    }
}

pub(crate) fn baseline_checksum(
    id: &str,
    wall: i64,
    frames: i64,
    settings: i64,
    simulated: bool,
    readings: &[u8],
    deviation: &[u8],
) -> Vec<u8> {
    let mut hasher = Sha256::new();
    for number in [wall, frames, settings, i64::from(simulated)] {
        hasher.update(number.to_le_bytes());
    }
    for bytes in [id.as_bytes(), readings, deviation] {
        hasher.update((bytes.len() as u64).to_le_bytes());
        hasher.update(bytes);
    }
    hasher.finalize()[..8].to_vec()
}

pub(crate) fn reference_checksum(id: i64, against_baseline: bool, readings: &[u8]) -> Vec<u8> {
    let mut hasher = Sha256::new();
    hasher.update(id.to_le_bytes());
    hasher.update([u8::from(against_baseline)]);
    hasher.update(readings);
    hasher.finalize()[..8].to_vec()
}

pub(crate) struct StoredFrame {
    pub(crate) row: FrameRow,
    pub(crate) settings: i64,
    pub(crate) mapper: Option<i64>,
    pub(crate) reciprocity: Option<f64>,
    pub(crate) loop_sum: Option<f64>,
    pub(crate) implausible: i64,
    pub(crate) flags: String,
    pub(crate) checksum: Vec<u8>,
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
                wall: row.get("wall_ns")?,
                monotonic: row.get("monotonic_ns")?,
                duration: row.get("duration_ns")?,
                simulated: row.get("simulated")?,
                compliance: row.get("compliance")?,
                map_hash: row.get("map_hash")?,
                reference: row.get("reference")?,
                blob: row.get("readings")?,
            },
            settings: row.get("settings")?,
            mapper: row.get("mapper")?,
            reciprocity: row.get("reciprocity")?,
            loop_sum: row.get("loop_sum")?,
            implausible: row.get("implausible")?,
            flags: row.get("flags")?,
            checksum: row.get("checksum")?,
        })
    }
}

/// As 32 bytes where the hash is lower-case hex of that length, else as the text that it is.
pub(crate) fn pack_hash(hash: &str) -> Value {
    let nibbles: Option<Vec<u8>> = hash
        .bytes()
        .map(|digit| match digit {
            b'0'..=b'9' => Some(digit - b'0'),
            b'a'..=b'f' => Some(digit - b'a' + 10),
            _ => None,
        })
        .collect();
    match nibbles {
        Some(nibbles) if nibbles.len() == 64 => {
            let (pairs, _) = nibbles.as_chunks::<2>();
            Value::Blob(pairs.iter().map(|[high, low]| high << 4 | low).collect())
        }
        _ => Value::Text(hash.to_owned()),
    }
}

pub(crate) fn unpack_hash(stored: &Value) -> Option<String> {
    match stored {
        Value::Text(text) => Some(text.clone()),
        Value::Blob(bytes) => Some(bytes.iter().map(|byte| format!("{byte:02x}")).collect()),
        _ => None,
    }
}

pub(crate) enum HeaderFault {
    Store(rusqlite::Error),
    Content(String),
}

impl From<rusqlite::Error> for HeaderFault {
    fn from(source: rusqlite::Error) -> Self {
        Self::Store(source)
    }
}

pub(crate) fn header_row(row: &Row<'_>) -> Result<(SessionHeader, Option<Closing>), HeaderFault> {
    let content = |what: &str, cause: &dyn std::fmt::Display| {
        HeaderFault::Content(format!("{what}: {cause}"))
    };
    let text = |name: &str| row.get::<_, String>(name);
    let kind = text("kind")?;
    let seed: Option<String> = row.get("seed")?;
    let closed_ns: Option<i64> = row.get("closed_ns")?;
    let reason: Option<String> = row.get("closed_reason")?;
    let header = SessionHeader {
        id: text("id")?,
        kind: SessionKind::parse(&kind).ok_or_else(|| content("kind", &kind))?,
        started: DateTime::from_timestamp_nanos(row.get("started_ns")?),
        instruments: serde_json::from_str(&text("instruments")?)
            .map_err(|cause| content("instruments", &cause))?,
        modules: serde_json::from_str(&text("modules")?)
            .map_err(|cause| content("modules", &cause))?,
        config_toml: text("config_toml")?,
        config_hash: text("config_hash")?,
        model_hash: row.get("model_hash")?,
        geometry_hash: row.get("geometry_hash")?,
        protocol: serde_json::from_str(&text("protocol")?)
            .map_err(|cause| content("protocol", &cause))?,
        build: text("build")?,
        seed: seed
            .map(|seed| seed.parse().map_err(|cause| content("seed", &cause)))
            .transpose()?,
        simulated: row.get("simulated")?,
        note: text("note")?,
        about: serde_json::from_str(&text("about")?).map_err(|cause| content("about", &cause))?,
        asked: text("asked")?,
        continues: row.get("continues")?,
        first_sequence: u64::try_from(row.get::<_, i64>("first_sequence")?)
            .map_err(|cause| content("first sequence", &cause))?,
    };
    let closed = closed_ns.map(|at| Closing {
        at: DateTime::from_timestamp_nanos(at),
        reason: reason.unwrap_or_default(),
    });
    Ok((header, closed))
}
