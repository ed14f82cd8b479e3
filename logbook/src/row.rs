//! Rows of the file: writing, checking and reading.

use chrono::DateTime;
use rusqlite::Row;
use rusqlite::types::Value;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use survey::{Baseline, Electrode, Settings};

use crate::{Closing, MapRecord, SessionHeader, SessionKind};

/// Hash of a row's numbers and texts; values are delimited, and absent values differ from all others.
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
    fn row(self, table: &str) -> Digest8 {
        Digest8(Sha256::new()).text(table).bytes(self.0.as_slice())
    }
}

impl Digest8 {
    /// SQLite returns a negative zero as a positive one.
    fn real(self, number: impl Into<Option<f64>>) -> Self {
        self.number(number.into().map(|number| (number + 0.0).to_bits() as i64))
    }

    /// Hashes a value with its type: text, blob or number.
    fn value(self, value: Option<&Value>) -> Self {
        match value {
            None | Some(Value::Null) => self.number(0),
            Some(Value::Integer(number)) => self.number(1).number(*number),
            Some(Value::Real(number)) => self.number(2).real(*number),
            Some(Value::Text(text)) => self.number(3).text(text.as_str()),
            Some(Value::Blob(bytes)) => self.number(4).bytes(bytes.as_slice()),
        }
    }

    /// Four bytes, for the rows of large tables.
    fn finish4(self) -> i64 {
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

/// What a session held when it was closed. Rows of most tables are numbered without a gap, so the last number is the
/// count.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RowCounts {
    /// Sequence of the last frame; without frames, one less than the first sequence.
    pub(crate) last: u64,
    pub(crate) frames: u64,
    pub(crate) baselines: u64,
    pub(crate) events: u64,
    pub(crate) references: u64,
    pub(crate) stretches: u64,
    pub(crate) settings: u64,
    pub(crate) mappers: u64,
    pub(crate) late_maps: u64,
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

/// Packs a map record: a number with the first 4 bytes of its hash above its sum in single precision; 8 bytes of a hash
/// without a sum; or, if the hash is no SHA-256, its text.
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

pub(crate) enum HeaderFault {
    Store(rusqlite::Error),
    Content(String),
}

impl From<rusqlite::Error> for HeaderFault {
    fn from(source: rusqlite::Error) -> Self {
        Self::Store(source)
    }
}

/// The closing entry in the header's row.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum End {
    /// None: the session runs, or its writer was killed.
    Open,
    Closed(Closing, RowCounts),
    /// Present but fails its checksum: the session was closed, how is unknown.
    Damaged(Closing),
}

/// The columns of a header without those of its closing.
pub(crate) const HEADER_COLUMNS: &str = "id, kind, started_ns, simulated, build, seed, config_toml, config_hash, model_hash, \
     geometry_hash, protocol, instruments, modules, note, about, asked, continues, first_sequence, checksum";

pub(crate) fn header_row(
    row: &Row<'_>,
) -> Result<(SessionHeader, HeaderChecksum, End), HeaderFault> {
    let content = |what: &str, cause: &dyn std::fmt::Display| {
        HeaderFault::Content(format!("{what}: {cause}"))
    };
    let text = |name: &str| row.get::<_, String>(name);
    let kind = text("kind")?;
    let seed: Option<String> = row.get("seed")?;
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
    let header_checksum =
        HeaderChecksum::of(&header).map_err(|cause| content("checksum", &cause))?;
    if row.get::<_, Vec<u8>>("checksum")? != header_checksum.bytes() {
        return Err(HeaderFault::Content("its checksum does not agree".into()));
    }
    let end = end(row, header_checksum);
    Ok((header, header_checksum, end))
}

fn end(row: &Row<'_>, header_checksum: HeaderChecksum) -> End {
    let read = || -> rusqlite::Result<_> {
        let at: Option<i64> = row.get("closed_ns")?;
        let texts: [Option<String>; 2] = [row.get("closed_reason")?, row.get("closed_tally")?];
        let checksum: Option<Vec<u8>> = row.get("closed_checksum")?;
        Ok((at, texts, checksum))
    };
    let whole = match read() {
        Ok((None, [None, None], None)) => return End::Open,
        Ok((Some(at), [Some(reason), Some(tally)], Some(checksum))) => {
            let agrees = checksum == closing_checksum(header_checksum, at, &reason, &tally);
            let tally = serde_json::from_str(&tally).ok().filter(|_| agrees);
            tally.map(|tally| {
                let at = DateTime::from_timestamp_nanos(at);
                End::Closed(Closing { at, reason }, tally)
            })
        }
        _ => None,
    };
    whole.unwrap_or_else(|| {
        let at = row.get("closed_ns").unwrap_or_default();
        End::Damaged(Closing {
            at: DateTime::from_timestamp_nanos(at),
            reason: "closed; the entry with the reason is damaged".into(),
        })
    })
}
