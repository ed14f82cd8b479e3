//! Writing rows.

use std::path::Path;

use rusqlite::{Connection, OptionalExtension, Params, params};
use survey::{Baseline, Quality, QualityFlag, Reading, Settings, Volts};

use super::references::Packed;
use super::{nanoseconds, span};
use crate::codec::{EncodeError, Reference, encode};
use crate::row::{
    FrameExtras, FrameRow, HEADER_COLUMNS, HeaderChecksum, Stretch, baseline_checksum,
    event_checksum, mapper_checksum, reference_checksum, settings_checksum,
};
use crate::{LogbookError, MapRecord, SessionHeader};

pub(super) fn json<T>(value: serde_json::Result<T>) -> rusqlite::Result<T> {
    value.map_err(|cause| rusqlite::Error::ToSqlConversionFailure(cause.into()))
}

pub(super) fn write_header(
    transaction: &Connection,
    header: &SessionHeader,
    started: i64,
) -> rusqlite::Result<HeaderChecksum> {
    let header_checksum = json(HeaderChecksum::of(header))?;
    transaction.execute(
        &format!(
            "INSERT INTO session (only, {HEADER_COLUMNS})
             VALUES (1, ?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17, ?18, ?19)"
        ),
        params![
            header.id,
            header.kind.as_str(),
            started,
            header.simulated,
            header.build,
            header.seed.map(|seed| seed.to_string()),
            header.config_toml,
            header.config_hash,
            header.model_hash,
            header.geometry_hash,
            json(serde_json::to_string(&header.protocol))?,
            json(serde_json::to_string(&header.instruments))?,
            json(serde_json::to_string(&header.modules))?,
            header.note,
            json(serde_json::to_string(&header.about))?,
            header.asked,
            header.continues,
            header.first_sequence as i64,
            header_checksum.bytes(),
        ],
    )?;
    Ok(header_checksum)
}

/// Writes a baseline and returns its settings' row.
pub(super) fn write_baseline(
    transaction: &Connection,
    header_checksum: HeaderChecksum,
    baseline: &Baseline,
) -> Result<i64, Unwritten> {
    let readings = encode(&[&baseline.readings], &Reference::NONE)?;
    let deviation: Vec<Reading> = baseline
        .deviation
        .iter()
        .map(|deviation| deviation.map_or(Reading::NotMeasured, |v| Reading::Ok(Volts(v))))
        .collect();
    let deviation = encode(&[&deviation], &Reference::NONE)?;
    let wall = nanoseconds(baseline.wall, "the baseline's wall time")?;
    let settle = span(baseline.settings.settle, "the settling time")?;
    let settings = settings_id(transaction, header_checksum, &baseline.settings, settle)?;
    let checksum = baseline_checksum(
        header_checksum,
        baseline,
        settings,
        wall,
        &readings,
        &deviation,
    );
    transaction.execute(
        "INSERT INTO baseline (only, id, wall_ns, frames, settings, simulated, readings, deviation, checksum)
         VALUES (1, ?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8)",
        params![
            baseline.id,
            wall,
            baseline.frames as i64,
            settings,
            baseline.simulated,
            readings,
            deviation,
            checksum
        ],
    )?;
    Ok(settings)
}

/// The number of the next row of a table.
fn next_id(connection: &Connection, table: &'static str) -> rusqlite::Result<i64> {
    connection
        .prepare_cached(&format!("SELECT coalesce(max(id), 0) + 1 FROM {table}"))?
        .query_row([], |row| row.get(0))
}

/// The id that a query finds; `None` if there is no such row yet.
fn known_id(
    connection: &Connection,
    query: &str,
    values: impl Params,
) -> rusqlite::Result<Option<i64>> {
    connection
        .query_row(query, values, |row| row.get(0))
        .optional()
}

pub(super) fn write_event(
    transaction: &Connection,
    header_checksum: HeaderChecksum,
    at: i64,
    kind: &str,
    text: &str,
) -> rusqlite::Result<()> {
    let id = next_id(transaction, "event")?;
    let checksum = event_checksum(header_checksum, id, at, kind, text);
    transaction
        .prepare_cached(
            "INSERT INTO event (id, at_ns, kind, text, checksum) VALUES (?1, ?2, ?3, ?4, ?5)",
        )?
        .execute(params![id, at, kind, text, checksum])?;
    Ok(())
}

pub(super) fn settings_id(
    connection: &Connection,
    header_checksum: HeaderChecksum,
    settings: &Settings,
    settle: i64,
) -> rusqlite::Result<i64> {
    let precautions = json(serde_json::to_string(&settings.precautions))?;
    let known = "SELECT id FROM settings WHERE protocol_hash = ?1 AND current_a = ?2 AND range_v = ?3 AND nplc = ?4
        AND settle_ns = ?5 AND wiring = ?6 AND precautions = ?7";
    let values = params![
        settings.protocol_hash,
        settings.current.0,
        settings.range.0,
        settings.nplc,
        settle,
        settings.wiring,
        precautions,
    ];
    if let Some(id) = known_id(connection, known, values)? {
        return Ok(id);
    }
    let id = next_id(connection, "settings")?;
    connection.execute(
        "INSERT INTO settings (id, protocol_hash, current_a, range_v, nplc, settle_ns, wiring, precautions, checksum)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9)",
        params![
            id,
            settings.protocol_hash,
            settings.current.0,
            settings.range.0,
            settings.nplc,
            settle,
            settings.wiring,
            precautions,
            settings_checksum(header_checksum, id, settings),
        ],
    )?;
    Ok(id)
}

pub(super) fn mapper_id(
    connection: &Connection,
    header_checksum: HeaderChecksum,
    map: &MapRecord,
) -> rusqlite::Result<i64> {
    let known =
        "SELECT id FROM mapper WHERE method = ?1 AND model_hash IS ?2 AND build = ?3 AND cpu = ?4";
    let values = params![map.method, map.model_hash, map.build, map.cpu];
    if let Some(id) = known_id(connection, known, values)? {
        return Ok(id);
    }
    let id = next_id(connection, "mapper")?;
    connection.execute(
        "INSERT INTO mapper (id, method, model_hash, build, cpu, checksum) VALUES (?1, ?2, ?3, ?4, ?5, ?6)",
        params![
            id,
            map.method,
            map.model_hash,
            map.build,
            map.cpu,
            mapper_checksum(header_checksum, id, map),
        ],
    )?;
    Ok(id)
}

/// Why a transaction failed: because of the file, or because of the data.
pub(super) enum Unwritten {
    Store(rusqlite::Error),
    Refused(LogbookError),
}

impl Unwritten {
    /// Converts to an error of the file at `path`.
    pub(super) fn into_error(self, path: &Path, attempt: &'static str) -> LogbookError {
        match self {
            Self::Refused(refusal) => refusal,
            Self::Store(source) => LogbookError::writing(path, attempt, source),
        }
    }
}

impl From<rusqlite::Error> for Unwritten {
    fn from(source: rusqlite::Error) -> Self {
        Self::Store(source)
    }
}

impl From<LogbookError> for Unwritten {
    fn from(refusal: LogbookError) -> Self {
        Self::Refused(refusal)
    }
}

impl From<EncodeError> for Unwritten {
    fn from(refusal: EncodeError) -> Self {
        Self::Refused(refusal.into())
    }
}

pub(super) fn known_settings(
    transaction: &Connection,
    header_checksum: HeaderChecksum,
    known: &mut Option<(i64, Settings)>,
    settings: &Settings,
) -> Result<i64, Unwritten> {
    if let Some((id, same)) = known
        && same == settings
    {
        return Ok(*id);
    }
    let settle = span(settings.settle, "the settling time")?;
    let id = settings_id(transaction, header_checksum, settings, settle)?;
    *known = Some((id, settings.clone()));
    Ok(id)
}

pub(super) fn known_mapper(
    transaction: &Connection,
    header_checksum: HeaderChecksum,
    known: &mut Option<(i64, MapRecord)>,
    map: &MapRecord,
) -> rusqlite::Result<i64> {
    let makers = |map: &MapRecord| {
        (
            map.method.clone(),
            map.model_hash.clone(),
            map.build.clone(),
            map.cpu.clone(),
        )
    };
    if let Some((id, same)) = known
        && makers(same) == makers(map)
    {
        return Ok(*id);
    }
    let id = mapper_id(transaction, header_checksum, map)?;
    *known = Some((id, map.clone()));
    Ok(id)
}

pub(super) fn write_reference(
    transaction: &Connection,
    header_checksum: HeaderChecksum,
    packed: &Packed,
) -> rusqlite::Result<()> {
    let Some(new) = &packed.written else {
        return Ok(());
    };
    transaction
        .prepare_cached(
            "INSERT INTO reference (id, against_baseline, readings, checksum) VALUES (?1, ?2, ?3, ?4)",
        )?
        .execute(params![
            new.id,
            new.against_baseline,
            new.blob,
            reference_checksum(header_checksum, new.id, new.against_baseline, &new.blob),
        ])?;
    Ok(())
}

pub(super) fn write_stretch(
    transaction: &Connection,
    header_checksum: HeaderChecksum,
    stretch: &Stretch,
) -> rusqlite::Result<()> {
    transaction
        .prepare_cached(
            "INSERT INTO stretch (id, settings, mapper, simulated, sequence, monotonic_us, wall_us, period_us, checksum)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9)",
        )?
        .execute(params![
            stretch.id,
            stretch.settings,
            stretch.mapper,
            stretch.simulated,
            stretch.sequence,
            stretch.monotonic,
            stretch.wall,
            stretch.period,
            stretch.checksum(header_checksum),
        ])?;
    Ok(())
}

pub(super) fn write_frame(
    transaction: &Connection,
    header_checksum: HeaderChecksum,
    row: &FrameRow,
) -> rusqlite::Result<()> {
    transaction
        .prepare_cached(
            "INSERT INTO frame (sequence, stretch, tick_us, skew_us, duration_us, reference, flags, loop_sum, remarks,
                map_hash, place, readings, checksum)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13)",
        )?
        .execute(params![
            row.sequence,
            row.stretch,
            row.tick,
            row.skew,
            row.duration,
            row.reference,
            row.flags,
            row.loop_sum,
            row.remarks,
            row.map_hash,
            row.place,
            row.blob,
            row.checksum(header_checksum),
        ])?;
    Ok(())
}

/// The quality flags as bits.
pub(super) fn bits(quality: &Quality) -> i64 {
    QualityFlag::ALL
        .iter()
        .enumerate()
        .filter(|(_, flag)| quality.flags.contains(flag))
        .map(|(place, _)| 1 << place)
        .sum()
}

/// Optional data as JSON; `None` if there is none.
pub(super) fn remarks(quality: &Quality) -> rusqlite::Result<Option<String>> {
    let remarks = FrameExtras {
        implausible: quality.implausible,
        compliance: quality.compliance.clone(),
    };
    match remarks == FrameExtras::default() {
        true => Ok(None),
        false => json(serde_json::to_string(&remarks)).map(Some),
    }
}
