//! Checks from the file alone that no row is missing.

use rusqlite::types::Value;

use super::SessionReader;
use super::opening::JournalMode;
use crate::LogbookError;
use crate::row::{End, RowCounts};

/// Maximum number of SQLite's structural errors reported.
const MOST_REPORTED: u32 = 3;
/// Late maps read at a time.
const PAGE: i64 = 1000;

/// Tables with rows numbered from 1 without a gap, and the name of the number's column.
const NUMBERED: [(&str, &str); 6] = [
    ("event", "id"),
    ("reference", "id"),
    ("stretch", "id"),
    ("settings", "id"),
    ("mapper", "id"),
    ("late_map", "number"),
];

impl SessionReader {
    /// Defects other than those of frames, events and baseline: a machine-readable kind and a sentence each.
    pub(crate) fn faults(&self) -> Vec<(&'static str, String)> {
        let mut faults = Vec::new();
        self.structure(&mut faults);
        let counts = match self.counts(&mut faults) {
            Ok(counts) => counts,
            Err(damage) => {
                faults.push(("damaged", damage.to_string()));
                return faults;
            }
        };
        self.rows_of_small_tables(&mut faults);
        match &self.end {
            End::Closed(_, tally) => compare(tally, &counts, &mut faults),
            End::Damaged(_) => {
                let text = "the entry of its end does not agree with its checksum";
                faults.push(("closing", text.to_owned()));
            }
            // Only closing changes a file to this mode.
            End::Open if self.mode == JournalMode::Rollback => {
                let text = "it was closed, and the entry of its end is missing";
                faults.push(("closing", text.to_owned()));
            }
            End::Open => {}
        }
        faults
    }

    /// SQLite's integrity check: pages, order of rows, types.
    fn structure(&self, faults: &mut Vec<(&'static str, String)>) {
        let mut found = Vec::new();
        let sql = format!("PRAGMA integrity_check({MOST_REPORTED})");
        let asked = self.ask().prepare(&sql).and_then(|mut statement| {
            let mut rows = statement.query([])?;
            while let Some(row) = rows.next()? {
                found.push(row.get::<_, String>(0)?);
            }
            Ok(())
        });
        if let Err(refusal) = asked {
            found.push(refusal.to_string());
        }
        found.retain(|text| text != "ok");
        let reported = found.iter().map(|text| {
            // the first line only names the database
            let lines = text.lines().filter(|line| !line.starts_with("***"));
            ("damaged", lines.collect::<Vec<_>>().join("; "))
        });
        faults.extend(reported);
    }

    /// Number of rows of each table; missing numbers are a defect.
    fn counts(&self, faults: &mut Vec<(&'static str, String)>) -> Result<RowCounts, LogbookError> {
        let mut tally = RowCounts {
            last: self.last_sequence()?,
            frames: self.rows()?,
            baselines: self.count("baseline", "only")?.0,
            ..RowCounts::default()
        };
        for (table, number) in NUMBERED {
            let (rows, last) = self.count(table, number)?;
            if i64::try_from(rows) != Ok(last) {
                let text =
                    format!("table {table} has {rows} rows, and the last one is number {last}");
                faults.push(("missing", text));
            }
            *match table {
                "event" => &mut tally.events,
                "reference" => &mut tally.references,
                "stretch" => &mut tally.stretches,
                "settings" => &mut tally.settings,
                "mapper" => &mut tally.mappers,
                _ => &mut tally.late_maps,
            } = rows;
        }
        Ok(tally)
    }

    fn count(&self, table: &str, number: &str) -> Result<(u64, i64), LogbookError> {
        let sql = format!("SELECT count(*), coalesce(max({number}), 0) FROM {table}");
        self.ask()
            .query_row(&sql, [], |row| Ok((row.get::<_, i64>(0)?, row.get(1)?)))
            .map(|(rows, last)| (rows.unsigned_abs(), last))
            .map_err(|source| LogbookError::reading(&self.path, "count the rows of", source))
    }

    /// Verifies the checksums of all rows of the small tables, used or not.
    fn rows_of_small_tables(&self, faults: &mut Vec<(&'static str, String)>) {
        let mut check = |table: &str, check: &dyn Fn(i64) -> Result<(), LogbookError>| {
            let damage = match self.count(table, "id").map(|(_, last)| last) {
                Ok(last) => (1..=last.min(self.most_rows())).find_map(|number| check(number).err()),
                Err(refusal) => Some(refusal),
            };
            // gaps were reported by the counts already
            faults.extend(damage.map(|damage| ("damaged", damage.to_string())));
        };
        check("settings", &|number| self.settings(number).map(drop));
        check("mapper", &|number| {
            self.map_record(number, &Value::Text(String::new()))
                .map(drop)
        });
        check("stretch", &|number| self.stretch(0, number).map(drop));
        check("reference", &|number| self.reference(0, number).map(drop));
        if let Err(damage) = self.late_maps() {
            faults.push(("damaged", damage.to_string()));
        }
    }

    /// Verifies that each late map is intact and belongs to an existing frame.
    fn late_maps(&self) -> Result<(), LogbookError> {
        let mut behind = i64::MIN;
        loop {
            let page = || -> rusqlite::Result<Vec<i64>> {
                self.ask()
                    .prepare_cached(
                        "SELECT sequence FROM late_map WHERE sequence > ?1 ORDER BY sequence LIMIT ?2",
                    )?
                    .query_map([behind, PAGE], |row| row.get(0))?
                    .collect()
            };
            let page = page().map_err(|source| {
                LogbookError::reading(&self.path, "read the late maps of", source)
            })?;
            for sequence in &page {
                self.late_map(*sequence)?;
                let frame = u64::try_from(*sequence).ok();
                if frame
                    .map(|frame| self.row(frame))
                    .transpose()?
                    .flatten()
                    .is_none()
                {
                    let place = format!("the late map of frame {sequence}");
                    return Err(self.damaged(place, "that frame is not there"));
                }
            }
            match page.last() {
                Some(last) if *last > behind => behind = *last,
                Some(_) => return Err(self.damaged("late maps".into(), "they are out of order")),
                None => return Ok(()),
            }
        }
    }
}

fn compare(closed_with: &RowCounts, counts: &RowCounts, faults: &mut Vec<(&'static str, String)>) {
    let kinds = [
        ("frames", closed_with.frames, counts.frames),
        ("baselines", closed_with.baselines, counts.baselines),
        ("events", closed_with.events, counts.events),
        ("references", closed_with.references, counts.references),
        ("stretches", closed_with.stretches, counts.stretches),
        ("settings", closed_with.settings, counts.settings),
        ("map methods", closed_with.mappers, counts.mappers),
        ("late maps", closed_with.late_maps, counts.late_maps),
    ];
    for (kind, then, now) in kinds {
        if then != now {
            let text = format!("{kind}: it was closed with {then}, and {now} are there");
            faults.push(("missing", text));
        }
    }
    if closed_with.last != counts.last {
        let (then, now) = (closed_with.last, counts.last);
        let text = format!("its last frame was {then} when it was closed, and is {now} now");
        faults.push(("missing", text));
    }
}
