//! Stored quantities over all sessions, for the charts of the live page.

use std::collections::BTreeSet;
use std::path::PathBuf;

use imaging::quantities::{LoadUnit, QuantityRow, STORED_S, joined, stored};
use logbook::SessionSummary;
use web::History;

/// Reads the rows of a region in `[from_s, to_s)`, s of the Unix epoch, in at most so many spans. Rows in another unit than the
/// newest ones are left out: they cannot stand on the same curve.
///
/// # Errors
/// A sentence: a file cannot be read.
pub(super) fn history(
    sessions: &[SessionSummary],
    (from_s, to_s): (i64, i64),
    region: &str,
    spans: u32,
) -> Result<History, String> {
    let wanted = sessions.iter().filter(|part| {
        let last = part.last.unwrap_or(part.started).timestamp();
        last >= from_s && part.started.timestamp() < to_s
    });
    let mut files: BTreeSet<(PathBuf, String)> = BTreeSet::new();
    for part in wanted {
        let folder = part.path.parent().map(PathBuf::from).unwrap_or_default();
        files.insert((folder, part.session().to_owned()));
    }
    let (mut rows, mut regions, mut damaged) = (Vec::new(), BTreeSet::new(), 0);
    for (folder, session) in files {
        let found = stored(&folder, &session).map_err(|why| why.to_string())?;
        let Some((found, bad)) = found else { continue };
        damaged += bad;
        let inside = found
            .into_iter()
            .filter(|row| (from_s..to_s).contains(&row.begin_s));
        for row in inside {
            if !regions.contains(&row.region) {
                regions.insert(row.region.clone());
            }
            if row.region == region {
                rows.push(row);
            }
        }
    }
    rows.sort_by_key(|row| row.begin_s);
    let unit: Option<LoadUnit> = rows.last().map(|row: &QuantityRow| row.of);
    rows.retain(|row| Some(row.of) == unit);
    let minutes = (to_s - from_s).unsigned_abs() / u64::from(STORED_S) + 1;
    let joins = u32::try_from(minutes.div_ceil(u64::from(spans.max(1)))).unwrap_or(u32::MAX);
    let span_s = STORED_S.saturating_mul(joins);
    Ok(History {
        rows: joined(&rows, span_s),
        span_s,
        regions: regions.into_iter().collect(),
        damaged,
    })
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use chrono::DateTime;
    use imaging::quantities::{Quantity, store};
    use logbook::SessionKind;

    use super::*;

    const HOUR_S: i64 = 3600;

    fn summary(folder: &Path, id: &str, from_s: i64, last_s: i64) -> SessionSummary {
        let time = |s: i64| DateTime::from_timestamp(s, 0).unwrap();
        SessionSummary {
            id: id.to_owned(),
            path: folder.join(id).with_extension("tactus"),
            kind: SessionKind::Measurement,
            started: time(from_s),
            last: Some(time(last_s)),
            frames: 1,
            first_sequence: 1,
            continues: None,
            closed: None,
            simulated: true,
            electrodes: 26,
            readings: 598,
            note: String::new(),
        }
    }

    fn keep(folder: &Path, id: &str, begin_s: i64, of: LoadUnit, values: &[(&str, f64)]) {
        let rows: Vec<QuantityRow> = values
            .iter()
            .map(|(region, value)| QuantityRow {
                begin_s,
                region: (*region).to_owned(),
                quantity: Quantity::Load,
                of,
                min: *value,
                mean: *value,
                max: *value,
                frames: 2,
                known: 2,
            })
            .collect();
        store(folder, id, &rows).unwrap();
    }

    #[test]
    fn rows_of_several_sessions_and_parts_are_one_curve() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        let (first, second) = ("m20261124t200000_000", "m20261124t230000_000");
        // listed newest first; the first session has two parts, whose rows lie in one file
        let sessions = [
            summary(at, second, 3 * HOUR_S, 4 * HOUR_S),
            summary(at, &format!("{first}.2"), HOUR_S, 2 * HOUR_S),
            summary(at, first, 0, HOUR_S),
        ];
        keep(at, first, 60, LoadUnit::RelativeLoss, &[("sheet", 1.0)]);
        keep(
            at,
            first,
            HOUR_S,
            LoadUnit::RelativeLoss,
            &[("sheet", 2.0), ("hip", 9.0)],
        );
        keep(
            at,
            second,
            3 * HOUR_S,
            LoadUnit::RelativeLoss,
            &[("sheet", 3.0)],
        );
        let of = |span: (i64, i64), region: &str, spans: u32| {
            let found = history(&sessions, span, region, spans).unwrap();
            let means: Vec<f64> = found.rows.iter().map(|row| row.mean).collect();
            (means, found.regions, found.span_s)
        };
        let (means, regions, span_s) = of((0, 4 * HOUR_S), "sheet", 1000);
        assert_eq!(means, [1.0, 2.0, 3.0]);
        assert_eq!(regions, ["hip", "sheet"]);
        assert_eq!(span_s, STORED_S);
        assert_eq!(of((0, 4 * HOUR_S), "hip", 1000).0, [9.0]);
        // the end is not part of the time
        assert_eq!(of((HOUR_S, 3 * HOUR_S), "sheet", 1000).0, [2.0]);
        // five hours in three spans of two hours
        let (means, _, span_s) = of((0, 5 * HOUR_S), "sheet", 3);
        assert_eq!((means, i64::from(span_s)), (vec![1.5, 3.0], 6060));
    }

    #[test]
    fn rows_in_another_unit_than_the_newest_are_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        let sessions = [
            summary(at, "m20261124t230000_000", HOUR_S, 2 * HOUR_S),
            summary(at, "m20261124t200000_000", 0, HOUR_S),
        ];
        let (old, new) = (LoadUnit::RelativeLoss, LoadUnit::Pressure);
        keep(at, "m20261124t200000_000", 60, old, &[("sheet", 1.0)]);
        keep(at, "m20261124t230000_000", HOUR_S, new, &[("sheet", 2.0)]);
        let of = |to_s: i64| {
            let found = history(&sessions, (0, to_s), "sheet", 100).unwrap();
            found
                .rows
                .iter()
                .map(|row| (row.of, row.mean))
                .collect::<Vec<_>>()
        };
        assert_eq!(of(2 * HOUR_S), [(new, 2.0)]);
        assert_eq!(of(HOUR_S), [(old, 1.0)]);
    }
}
