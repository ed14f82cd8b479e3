//! Inserts the rows of a part. Every statement may be repeated: existing rows are not changed.

use chrono::{DateTime, Utc};
use logbook::QuantityLine;
use serde_json::Value;
use tokio_postgres::Transaction;

use super::error::{CatalogueError, Endpoint};
use crate::part::Part;

/// Maximum number of rows in one statement.
const ROWS: usize = 1000;

/// Replaces zero bytes, which PostgreSQL cannot store in texts.
fn storable(text: &str) -> String {
    text.replace('\0', "\u{fffd}")
}

fn storable_json(value: Value) -> Value {
    match value {
        Value::String(text) => Value::String(storable(&text)),
        Value::Array(values) => values.into_iter().map(storable_json).collect(),
        Value::Object(entries) => entries
            .into_iter()
            .map(|(name, value)| (storable(&name), storable_json(value)))
            .collect(),
        other => other,
    }
}

fn whole(number: impl TryInto<i64>) -> i64 {
    number.try_into().unwrap_or(i64::MAX)
}

fn counted(number: usize) -> i32 {
    i32::try_from(number).unwrap_or(i32::MAX)
}

pub(super) async fn part(
    transaction: &Transaction<'_>,
    server: &Endpoint,
    part: &Part,
) -> Result<(), CatalogueError> {
    let (name, header) = (&part.name, &part.header);
    let session = "INSERT INTO tactus.session
        (site, daq, session, kind, simulated, electrodes, readings, build, config_sha256, model_sha256, note, about, instruments)
        VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13) ON CONFLICT DO NOTHING";
    let json = |value: Result<Value, _>| storable_json(value.unwrap_or(Value::Null));
    let about = json(serde_json::to_value(&header.about));
    let instruments = json(serde_json::to_value(&header.instruments));
    server
        .within(transaction.execute(
            session,
            &[
                &name.site,
                &name.daq,
                &name.session,
                &header.kind.as_str(),
                &header.simulated,
                &counted(header.protocol.electrodes()),
                &counted(header.protocol.len()),
                &storable(&header.build),
                &storable(&header.config_hash),
                &header.model_hash.as_deref().map(storable),
                &storable(&header.note),
                &about,
                &instruments,
            ],
        ))
        .await?;
    if let Some(state) = &part.tracking {
        let tracking = "INSERT INTO tactus.tracking (site, daq, session, state) VALUES ($1, $2, $3, $4) ON CONFLICT DO NOTHING";
        let state = storable(state);
        server
            .within(transaction.execute(tracking, &[&name.site, &name.daq, &name.session, &state]))
            .await?;
    }
    let insert = "INSERT INTO tactus.part
        (site, daq, part, session, sha256, bytes, stored_as, continues, first_sequence, frames, started, last, closed, closed_reason)
        VALUES ($1, $2, $3, $4, decode($5::text, 'hex'), $6, $7, $8, $9, $10, $11, $12, $13, $14) ON CONFLICT DO NOTHING";
    server
        .within(transaction.execute(
            insert,
            &[
                &name.site,
                &name.daq,
                &name.part,
                &name.session,
                &name.sha256,
                &whole(part.bytes),
                &name.to_string(),
                &header.continues,
                &whole(header.first_sequence),
                &whole(part.frames),
                &header.started,
                &part.last,
                &part.closing.at,
                &storable(&part.closing.reason),
            ],
        ))
        .await?;
    let of =
        "SELECT encode(sha256, 'hex') FROM tactus.part WHERE site = $1 AND daq = $2 AND part = $3";
    let row = server
        .within(transaction.query_one(of, &[&name.site, &name.daq, &name.part]))
        .await?;
    let archived: String = row.get(0);
    match archived == name.sha256 {
        true => Ok(()),
        false => Err(CatalogueError::Conflict {
            part: name.part.clone(),
            site: name.site.clone(),
            daq: name.daq.clone(),
            archived,
            found: name.sha256.clone(),
        }),
    }
}

/// The alarm and its change, from the kind of an alarm's event and its text `NAME: text`.
fn alarm_of<'a>(kind: &'a str, text: &'a str) -> Option<(&'a str, &'a str)> {
    let change = match kind {
        "trouble" => "active",
        "trouble-over" => "over",
        _ => kind.strip_prefix("alarm-")?,
    };
    let (alarm, _) = text.split_once(": ")?;
    Some((alarm, change))
}

pub(super) async fn events(
    transaction: &Transaction<'_>,
    server: &Endpoint,
    part: &Part,
) -> Result<(), CatalogueError> {
    let name = &part.name;
    let insert = "INSERT INTO tactus.event (site, daq, part, number, at, kind, text)
        SELECT $1, $2, $3, e.number, e.at, e.kind, e.text
        FROM unnest($4::int4[], $5::timestamptz[], $6::text[], $7::text[]) AS e (number, at, kind, text)
        ON CONFLICT DO NOTHING";
    let insert_alarms = "INSERT INTO tactus.alarm (site, daq, part, number, at, alarm, change, text)
        SELECT $1, $2, $3, e.number, e.at, e.alarm, e.change, e.text
        FROM unnest($4::int4[], $5::timestamptz[], $6::text[], $7::text[], $8::text[]) AS e (number, at, alarm, change, text)
        ON CONFLICT DO NOTHING";
    let numbered: Vec<(i32, DateTime<Utc>, String, String)> = (1..)
        .zip(&part.events)
        .map(|(number, event)| {
            (
                counted(number),
                event.at,
                storable(&event.kind),
                storable(&event.text),
            )
        })
        .collect();
    for chunk in numbered.chunks(ROWS) {
        let numbers: Vec<i32> = chunk.iter().map(|event| event.0).collect();
        let times: Vec<DateTime<Utc>> = chunk.iter().map(|event| event.1).collect();
        let kinds: Vec<&str> = chunk.iter().map(|event| event.2.as_str()).collect();
        let texts: Vec<&str> = chunk.iter().map(|event| event.3.as_str()).collect();
        server
            .within(transaction.execute(
                insert,
                &[
                    &name.site, &name.daq, &name.part, &numbers, &times, &kinds, &texts,
                ],
            ))
            .await?;
        let alarms: Vec<_> = chunk
            .iter()
            .filter_map(|event| Some((event, alarm_of(&event.2, &event.3)?)))
            .collect();
        if alarms.is_empty() {
            continue;
        }
        let numbers: Vec<i32> = alarms.iter().map(|(event, _)| event.0).collect();
        let times: Vec<DateTime<Utc>> = alarms.iter().map(|(event, _)| event.1).collect();
        let names: Vec<&str> = alarms.iter().map(|(_, (alarm, _))| *alarm).collect();
        let changes: Vec<&str> = alarms.iter().map(|(_, (_, change))| *change).collect();
        let texts: Vec<&str> = alarms.iter().map(|(event, _)| event.3.as_str()).collect();
        server
            .within(transaction.execute(
                insert_alarms,
                &[
                    &name.site, &name.daq, &name.part, &numbers, &times, &names, &changes, &texts,
                ],
            ))
            .await?;
    }
    Ok(())
}

pub(super) async fn quantities(
    transaction: &Transaction<'_>,
    server: &Endpoint,
    (site, daq, session): (&str, &str, &str),
    lines: &[QuantityLine],
) -> Result<(), CatalogueError> {
    let insert = "INSERT INTO tactus.quantity (site, daq, session, line, begin, span)
        SELECT $1, $2, $3, q.line, to_timestamp(q.begin_s), q.span
        FROM unnest($4::int4[], $5::float8[], $6::json[]) AS q (line, begin_s, span)
        ON CONFLICT DO NOTHING";
    for chunk in lines.chunks(ROWS) {
        let (mut numbers, mut begins, mut spans) = (Vec::new(), Vec::new(), Vec::new());
        for line in chunk {
            // a line of a later version may be another kind of row: it is skipped
            let Ok(span) = serde_json::from_str::<Value>(&line.json) else {
                continue;
            };
            let Some(begin_s) = span["begin_s"].as_f64() else {
                continue;
            };
            numbers.push(i32::try_from(line.number).unwrap_or(i32::MAX));
            begins.push(begin_s);
            spans.push(storable_json(span));
        }
        server
            .within(
                transaction.execute(insert, &[&site, &daq, &session, &numbers, &begins, &spans]),
            )
            .await?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_of_alarms_have_name_and_change() {
        assert_eq!(
            alarm_of("alarm-active", "heel: ppi is 9 kPa"),
            Some(("heel", "active"))
        );
        assert_eq!(
            alarm_of("trouble-over", "disk: 90 days"),
            Some(("disk", "over"))
        );
        assert_eq!(alarm_of("started", "a: b"), None);
        assert_eq!(alarm_of("alarm-active", "no name"), None);
    }

    #[test]
    fn zero_bytes_are_replaced_everywhere() {
        let value = storable_json(serde_json::json!({"a\0": ["b\0", 1]}));
        assert_eq!(value, serde_json::json!({"a\u{fffd}": ["b\u{fffd}", 1]}));
    }
}
