//! Checksums of rows.

use rusqlite::types::Value;
use sha2::{Digest, Sha256};
use survey::{Baseline, Settings};

use crate::{MapRecord, SessionHeader};

/// Hash of a row's numbers and texts. Values are delimited, and absent values differ from all others.
pub(crate) struct Digest8(Sha256);

/// Checksum of a session's header. It is part of every other row's checksum, so a row of another session is detected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct HeaderChecksum([u8; 8]);

impl HeaderChecksum {
    /// From a header; the same header always gives the same JSON.
    pub(crate) fn of(header: &SessionHeader) -> serde_json::Result<Self> {
        let text = serde_json::to_string(header)?;
        let digest = Digest8(Sha256::new()).text("session").text(text.as_str());
        Ok(Self(digest.finish()))
    }

    /// As stored in the header's row.
    pub(crate) fn bytes(self) -> [u8; 8] {
        self.0
    }

    /// Starts the checksum of a row of a table.
    pub(super) fn row(self, table: &str) -> Digest8 {
        Digest8(Sha256::new()).text(table).bytes(self.0.as_slice())
    }
}

impl Digest8 {
    /// SQLite returns a negative zero as a positive one, so both are hashed as positive.
    pub(super) fn real(self, number: impl Into<Option<f64>>) -> Self {
        self.number(number.into().map(|number| (number + 0.0).to_bits() as i64))
    }

    /// Hashes a value with its type: text, blob or number.
    pub(super) fn value(self, value: Option<&Value>) -> Self {
        match value {
            None | Some(Value::Null) => self.number(0),
            Some(Value::Integer(number)) => self.number(1).number(*number),
            Some(Value::Real(number)) => self.number(2).real(*number),
            Some(Value::Text(text)) => self.number(3).text(text.as_str()),
            Some(Value::Blob(bytes)) => self.number(4).bytes(bytes.as_slice()),
        }
    }

    /// Four bytes, for the rows of large tables.
    pub(super) fn finish4(self) -> i64 {
        let [a, b, c, d, ..] = self.finish();
        i64::from(i32::from_le_bytes([a, b, c, d]))
    }

    pub(crate) fn number(mut self, number: impl Into<Option<i64>>) -> Self {
        match number.into() {
            Some(number) => {
                self.0.update([1]);
                self.0.update(number.to_le_bytes());
            }
            None => self.0.update([0]),
        }
        self
    }

    pub(crate) fn bytes<'a>(mut self, bytes: impl Into<Option<&'a [u8]>>) -> Self {
        match bytes.into() {
            Some(bytes) => {
                self = self.number(bytes.len() as i64);
                self.0.update(bytes);
                self
            }
            None => self.number(None),
        }
    }

    pub(crate) fn text<'a>(self, text: impl Into<Option<&'a str>>) -> Self {
        self.bytes(text.into().map(str::as_bytes))
    }

    pub(crate) fn finish(self) -> [u8; 8] {
        let hash = self.0.finalize();
        std::array::from_fn(|byte| hash[byte])
    }
}

/// Checksum of settings as read from the file, including the frame's current.
pub(crate) fn settings_checksum(
    header_checksum: HeaderChecksum,
    id: i64,
    settings: &Settings,
) -> [u8; 8] {
    let precautions = serde_json::to_string(&settings.precautions).unwrap_or_default();
    header_checksum
        .row("settings")
        .number(id)
        .text(settings.protocol_hash.as_str())
        .real(settings.current.0)
        .real(settings.range.0)
        .real(settings.nplc)
        .number(settings.settle.as_nanos() as i64)
        .text(settings.wiring.as_str())
        .text(precautions.as_str())
        .finish()
}

/// Checksum of a map's origin: all of its record except hash and sum.
pub(crate) fn mapper_checksum(
    header_checksum: HeaderChecksum,
    id: i64,
    map: &MapRecord,
) -> [u8; 8] {
    header_checksum
        .row("mapper")
        .number(id)
        .text(map.method.as_str())
        .text(map.model_hash.as_deref())
        .text(map.build.as_str())
        .text(map.cpu.as_str())
        .finish()
}

pub(crate) fn late_map_checksum(
    header_checksum: HeaderChecksum,
    sequence: i64,
    number: i64,
    mapper: i64,
    trace: &Value,
) -> i64 {
    header_checksum
        .row("late_map")
        .number(sequence)
        .number(number)
        .number(mapper)
        .value(Some(trace))
        .finish4()
}

pub(crate) fn event_checksum(
    header_checksum: HeaderChecksum,
    id: i64,
    at: i64,
    kind: &str,
    text: &str,
) -> [u8; 8] {
    header_checksum
        .row("event")
        .number(id)
        .number(at)
        .text(kind)
        .text(text)
        .finish()
}

pub(crate) fn baseline_checksum(
    header_checksum: HeaderChecksum,
    baseline: &Baseline,
    settings: i64,
    wall: i64,
    readings: &[u8],
    deviation: &[u8],
) -> [u8; 8] {
    header_checksum
        .row("baseline")
        .text(baseline.id.as_str())
        .number(wall)
        .number(baseline.frames as i64)
        .number(settings)
        .number(i64::from(baseline.simulated))
        .bytes(readings)
        .bytes(deviation)
        .finish()
}

pub(crate) fn reference_checksum(
    header_checksum: HeaderChecksum,
    id: i64,
    against_baseline: bool,
    readings: &[u8],
) -> [u8; 8] {
    header_checksum
        .row("reference")
        .number(id)
        .number(i64::from(against_baseline))
        .bytes(readings)
        .finish()
}

pub(crate) fn closing_checksum(
    header_checksum: HeaderChecksum,
    at: i64,
    reason: &str,
    tally: &str,
) -> [u8; 8] {
    header_checksum
        .row("closing")
        .number(at)
        .text(reason)
        .text(tally)
        .finish()
}
