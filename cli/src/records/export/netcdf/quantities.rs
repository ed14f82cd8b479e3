//! Quantities in a netCDF file: the rows that are stored with the session, a value for each span and region.

use std::path::Path;

use imaging::quantities::{Quantity, QuantityRow, STORED_S, joined, keep_newest_unit, stored};

use super::layout::Layout;
use super::number;
use crate::failure::Failure;
use crate::output::complain;

/// Three variables for each quantity: ending of the name, meaning, and the value of a row.
type Of = fn(&QuantityRow) -> f64;
const VALUES: [(&str, &str, Of); 3] = [
    ("min", "smallest value", |row| row.min),
    ("mean", "mean", |row| row.mean),
    ("max", "largest value", |row| row.max),
];

/// Adds the stored rows of a session; nothing if it has none. Returns the number of damaged lines, which are left out.
pub(super) fn quantities(
    layout: &mut Layout,
    folder: &Path,
    session: &str,
) -> Result<usize, Failure> {
    let Some((mut rows, damaged)) = stored(folder, session)? else {
        return Ok(0);
    };
    let Some(unit) = rows.last().map(|row| row.of) else {
        return Ok(damaged);
    };
    if keep_newest_unit(&mut rows) > 0 {
        complain("tactus: stored quantities in another unit than the newest are left out");
    }
    // a minute has two rows if the daemon was restarted within it: they are joined
    let rows = joined(&rows, STORED_S);
    let regions = crate::maps::quantities::regions(&rows);
    let mut begins: Vec<i64> = rows.iter().map(|row| row.begin_s).collect();
    begins.dedup();
    layout.dimension("minute", begins.len())?;
    layout.dimension("region", regions.len())?;
    layout.numbers(
        "minute",
        &["minute"],
        begins.iter().map(|begin| *begin as f64).collect(),
        &[
            ("standard_name", "time"),
            ("long_name", "start of the minute"),
            ("units", "seconds since 1970-01-01 00:00:00"),
            ("calendar", "standard"),
        ],
    )?;
    layout.whole_numbers(
        "region",
        &["region"],
        (0..regions.len()).map(number).collect(),
        &[
            ("long_name", "region: `sheet` is the whole sheet"),
            ("names", &regions.join(" ")),
        ],
    )?;
    let place = |row: &QuantityRow| -> Option<usize> {
        let region = regions.iter().position(|name| *name == row.region)?;
        let minute = begins.binary_search(&row.begin_s).ok()?;
        Some(minute * regions.len() + region)
    };
    for quantity in Quantity::ALL {
        let of: Vec<&QuantityRow> = rows.iter().filter(|row| row.quantity == quantity).collect();
        if of.is_empty() {
            continue;
        }
        for (ending, meaning, value) in VALUES {
            let mut values = vec![f64::NAN; begins.len() * regions.len()];
            for row in &of {
                if let Some(place) = place(row) {
                    values[place] = value(row);
                }
            }
            layout.numbers(
                &format!("{}_{ending}", quantity.name().replace('-', "_")),
                &["minute", "region"],
                values,
                &[
                    (
                        "long_name",
                        &format!("{}, {meaning} in the minute", quantity.words()),
                    ),
                    ("units", quantity.unit(unit)),
                ],
            )?;
        }
    }
    Ok(damaged)
}
