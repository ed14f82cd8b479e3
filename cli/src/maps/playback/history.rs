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
