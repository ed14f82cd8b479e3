//! Stored quantities over all sessions, for the charts of the live page.

use std::collections::BTreeSet;
use std::path::PathBuf;

use imaging::quantities::{QuantityRow, STORED_S, joined, keep_newest_unit, stored};
use logbook::SessionSummary;
use web::History;

/// Reads the rows of a region in `[from_s, to_s)`, s of the Unix epoch, and joins them to at most `spans` rows. Rows in
/// another unit than the newest ones are left out and counted, because a curve has one unit.
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
    let other_unit = keep_newest_unit(&mut rows);
    let span_s = span_s((from_s, to_s), spans);
    Ok(History {
        rows: joined(&rows, span_s),
        span_s,
        regions: regions.into_iter().collect(),
        damaged,
        other_unit,
    })
}

/// Length of the spans, s, so that at most `spans` cover these rows of [`STORED_S`]. The rows need not be in the order
/// of time, because the clock may have been set back between them.
pub(super) fn span_of(rows: &[QuantityRow], spans: u32) -> u32 {
    let begins = rows.iter().map(|row| row.begin_s);
    let ends = begins.clone().min().zip(begins.max());
    span_s(ends.unwrap_or_default(), spans)
}

fn span_s((from_s, to_s): (i64, i64), spans: u32) -> u32 {
    let minutes = (to_s - from_s).unsigned_abs() / u64::from(STORED_S) + 1;
    let joins = u32::try_from(minutes.div_ceil(u64::from(spans.max(1)))).unwrap_or(u32::MAX);
    STORED_S.saturating_mul(joins)
}

#[cfg(test)]
mod tests {
    use chrono::DateTime;
    use imaging::quantities::{LoadUnit, Quantity, store};
    use logbook::SessionKind;

    use super::*;

    /// The begin of a minute.
    const BEGIN_S: i64 = 1_700_000_040;
    const DAY_S: i64 = 86_400;
    const YEAR_S: i64 = 365 * DAY_S;

    /// A session with a row of load for each minute from `begin_s` on, for the sheet and for `region`.
    fn session(
        folder: &std::path::Path,
        (id, region): (&str, &str),
        (begin_s, of): (i64, LoadUnit),
        loads: &[f64],
    ) -> SessionSummary {
        let minute = i64::from(STORED_S);
        for (index, load) in loads.iter().enumerate() {
            let row = |region: &str, load: f64| QuantityRow {
                begin_s: begin_s + minute * index as i64,
                region: region.to_owned(),
                quantity: Quantity::Load,
                of,
                min: load - 1.0,
                mean: load,
                max: load + 2.0,
                frames: 60,
                known: 60,
            };
            let rows = [row("sheet", *load), row(region, 0.5 * load)];
            store(folder, id, &rows).unwrap();
        }
        let at = |s: i64| DateTime::from_timestamp(s, 0).unwrap();
        SessionSummary {
            id: id.to_owned(),
            path: folder.join(format!("{id}.tactus")),
            kind: SessionKind::Measurement,
            started: at(begin_s),
            last: Some(at(begin_s + minute * loads.len() as i64 - 1)),
            frames: 60 * loads.len() as u64,
            first_sequence: 1,
            continues: None,
            closed: None,
            simulated: true,
            electrodes: 26,
            readings: 598,
            note: String::new(),
        }
    }

    /// Begin (s after [`BEGIN_S`]), smallest, mean and largest load, and frames of each row.
    fn rows(history: &History) -> Vec<(i64, f64, f64, f64, u64)> {
        let each = history.rows.iter();
        each.map(|row| {
            (
                row.begin_s - BEGIN_S,
                row.min,
                row.mean,
                row.max,
                row.frames,
            )
        })
        .collect()
    }

    #[test]
    fn a_history_spans_sessions_in_minutes_and_in_a_year() {
        let folder = tempfile::tempdir().unwrap();
        let with =
            |name, begin_s, of, loads: &[f64]| session(folder.path(), name, (begin_s, of), loads);
        let newtons = LoadUnit::Pressure;
        let first = with(("m1", "hip"), BEGIN_S, newtons, &[10.0, 20.0]);
        let second = with(("m2", "heel"), BEGIN_S + 300, newtons, &[30.0]);
        let last = with(("m3", "heel"), BEGIN_S + YEAR_S / 2, newtons, &[50.0, 70.0]);
        let other = with(
            ("m0", "hip"),
            BEGIN_S - 600,
            LoadUnit::RelativeLoss,
            &[900.0],
        );
        // the newest first, and m2 in two parts
        let all = [last, second.clone(), second, first, other];

        // one row a minute, with a gap between the two sessions; no duplicate row, although m2 has two parts; and no
        // row in another unit
        let hour = (BEGIN_S - 1200, BEGIN_S + 2400);
        let found = history(&all, hour, "sheet", 720).unwrap();
        assert_eq!((found.span_s, found.damaged, found.other_unit), (60, 0, 1));
        let minutes = [
            (0, 9.0, 10.0, 12.0, 60),
            (60, 19.0, 20.0, 22.0, 60),
            (300, 29.0, 30.0, 32.0, 60),
        ];
        assert_eq!(rows(&found), minutes);
        assert_eq!(found.regions, ["heel", "hip", "sheet"]);
        let heel = history(&all, hour, "heel", 720).unwrap();
        assert_eq!(rows(&heel), [(300, 14.0, 15.0, 17.0, 60)]);

        // the end of the interval is exclusive
        let short = history(&all, (BEGIN_S, BEGIN_S + 60), "sheet", 720).unwrap();
        assert_eq!(rows(&short), minutes[..1]);

        // a year in at most 720 spans: two of them have frames, and together they contain all minutes
        let year = (BEGIN_S - DAY_S, BEGIN_S + YEAR_S);
        let found = history(&all, year, "sheet", 720).unwrap();
        assert!((year.1 - year.0) <= 720 * i64::from(found.span_s));
        let found = rows(&found);
        let (frames, least, most) = (
            found.iter().map(|row| row.4).sum::<u64>(),
            found.iter().map(|row| row.1).fold(f64::INFINITY, f64::min),
            found.iter().map(|row| row.3).fold(0.0, f64::max),
        );
        assert_eq!((frames, least, most), (300, 9.0, 72.0), "{found:?}");
        assert_eq!((found[0].2, found[1].2), (20.0, 60.0), "{found:?}");
        assert_eq!(found.len(), 2);
        assert!(rows(&history(&all, year, "toe", 720).unwrap()).is_empty());
    }

    #[test]
    fn spans_hold_all_rows_where_the_clock_was_set_back() {
        let folder = tempfile::tempdir().unwrap();
        let loads = [1.0];
        for minute in [0, 1439, 1] {
            let begin = (BEGIN_S + 60 * minute, LoadUnit::Pressure);
            session(folder.path(), ("m1", "hip"), begin, &loads);
        }
        let (rows, _) = stored(folder.path(), "m1").unwrap().unwrap();
        assert_eq!(rows.last().unwrap().begin_s, BEGIN_S + 60);
        assert_eq!(span_of(&rows, 720), 120);
        assert_eq!(span_of(&rows, 1440), 60);
        assert_eq!(span_of(&[], 720), 60);
    }
}
