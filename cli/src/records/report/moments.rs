//! The worst moments of a session, with their maps.

use chrono::DateTime;
use imaging::quantities::{Quantity, QuantityRow, SHEET, rounded};
use imaging::recorded::{RecordedFrame, Recording};
use render::Style;
use survey::Map;

use super::rows::SessionRows;
use crate::args::Report;
use crate::failure::Failure;
use crate::maps::pictures::{PictureMap, Pictures};
use crate::maps::quantities::usable::unusable;
use crate::maps::reconstruction::Reconstruction;
use crate::options::choices::Scale;
use crate::options::duration::display_long;
use crate::output::progress::progress;
use crate::output::time::local;

/// The quantities for whose largest value a moment is shown.
const WORST: [Quantity; 3] = [Quantity::Ppi, Quantity::Load, Quantity::Unrelieved];
/// Most maps that are made to find the frame in its span.
const MAPS: usize = 60;

/// A moment with its map.
pub(super) struct Moment {
    /// The quantity that was largest, with its value, as text.
    what: String,
    /// Why the map is not reliable.
    doubt: Option<String>,
    pub(super) map: Map,
    pub(super) style: Style,
}

impl Moment {
    /// Why the moment is shown, and why its map is not reliable.
    pub(super) fn reason(&self) -> String {
        match &self.doubt {
            Some(doubt) => format!("{}; the map is not known to be true: {doubt}", self.what),
            None => self.what.clone(),
        }
    }
}

/// The worst moments.
pub(super) struct Moments {
    pub(super) shown: Vec<Moment>,
    /// How many of the examined frames have no usable map, as a sentence; `None` if all have one.
    pub(super) left_out: Option<String>,
}

/// A span in which a quantity was largest, and the best frame in it so far.
struct Search<'a> {
    row: &'a QuantityRow,
    every: usize,
    seen: usize,
    best: Option<(f64, Moment)>,
}

impl Search<'_> {
    fn holds(&self, frame: &RecordedFrame, span_s: u32) -> bool {
        let end = self.row.begin_s + i64::from(span_s);
        let span = self.row.begin_s as f64..end as f64;
        frame.time_s(None).is_some_and(|at_s| span.contains(&at_s))
    }
}

/// The maps of the worst moments, in the order of [`WORST`]; moments in the same frame have one map.
pub(super) fn worst(
    rows: &SessionRows,
    recording: &Recording,
    reconstruction: &Reconstruction,
    requested: &Report,
    on_terminal: bool,
) -> Result<Moments, Failure> {
    let spans = WORST
        .into_iter()
        .filter_map(|quantity| rows.worst(quantity));
    let mut searches: Vec<Search<'_>> = spans
        .map(|row| Search {
            row,
            every: 1,
            seen: 0,
            best: None,
        })
        .collect();
    for frame in recording.frames().filter_map(Result::ok) {
        for search in &mut searches {
            search.seen += usize::from(search.holds(&frame, rows.span_s));
        }
    }
    for search in &mut searches {
        search.every = search.seen.div_ceil(MAPS).max(1);
        search.seen = 0;
    }
    let mut pictures = Pictures::new(reconstruction, &requested.asked.tracked, recording)?;
    let bar = progress(Some(recording.len()? as u64), on_terminal);
    let (mut looked_at, mut without) = (0, 0);
    let mut first: Option<String> = None;
    for frame in recording.frames().filter_map(Result::ok) {
        bar.inc(1);
        let mut wanted = Vec::new();
        for (index, search) in searches.iter_mut().enumerate() {
            if search.holds(&frame, rows.span_s) {
                if search.seen.is_multiple_of(search.every) {
                    wanted.push(index);
                }
                search.seen += 1;
            }
        }
        if wanted.is_empty() {
            pictures.pass(&frame)?;
            continue;
        }
        looked_at += 1;
        let usable = |picture: PictureMap| match unusable(&picture.quantities) {
            None => Ok(picture),
            Some(why) => Err(why),
        };
        let picture = match pictures.attempt(&frame)?.and_then(usable) {
            Ok(picture) => picture,
            Err(why) => {
                without += 1;
                first.get_or_insert(why);
                continue;
            }
        };
        let sheet = picture
            .quantities
            .regions
            .iter()
            .find(|region| region.name == SHEET);
        for index in wanted {
            let search = &mut searches[index];
            // the unrelieved time grows within the span: its largest value is that of the last frame
            let value = match search.row.quantity {
                Quantity::Unrelieved => search.seen as f64,
                quantity => match sheet.and_then(|sheet| sheet.values.get(quantity)) {
                    Some(value) => value,
                    None => continue,
                },
            };
            if search.best.as_ref().is_none_or(|(best, ..)| value > *best) {
                let style = pictures.style(&frame, &picture, Scale::Own)?;
                let time = frame.wall.map_or_else(|| frame.label.clone(), local);
                let moment = Moment {
                    what: words(search.row),
                    doubt: picture.quantities.reason.clone(),
                    map: picture.shown.clone(),
                    style: Style {
                        title: time,
                        ..style
                    },
                };
                search.best = Some((value, moment));
            }
        }
    }
    bar.finish_and_clear();
    let mut shown: Vec<Moment> = Vec::new();
    for (_, moment) in searches.into_iter().filter_map(|search| search.best) {
        match shown
            .iter_mut()
            .find(|other| other.style.title == moment.style.title)
        {
            Some(same) => same.what = format!("{}; {}", same.what, moment.what),
            None => shown.push(moment),
        }
    }
    let left_out = |why: String| {
        format!("Left out: {without} of {looked_at} frames examined; the first: {why}.")
    };
    Ok(Moments {
        shown,
        left_out: first.map(left_out),
    })
}

/// A quantity with its largest value, as text.
fn words(row: &QuantityRow) -> String {
    let name = match row.quantity {
        Quantity::Unrelieved => row.quantity.words().to_owned(),
        quantity => format!("largest {}", quantity.words()),
    };
    format!("{name}: {}", value(row))
}

/// The largest value with its unit.
pub(super) fn value(row: &QuantityRow) -> String {
    match row.quantity {
        Quantity::Unrelieved => display_long(row.max),
        quantity => format!("{} {}", rounded(row.max), quantity.unit(row.of)),
    }
}

/// The begin of the span of a row.
pub(super) fn begin(row: &QuantityRow) -> String {
    DateTime::from_timestamp(row.begin_s, 0).map_or_else(String::new, local)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_that_is_not_known_is_marked_beside_its_moment() {
        let mut moment = Moment {
            what: "largest load: 3.00 N".to_owned(),
            doubt: None,
            map: Map::relative("m", vec![-0.5], "test"),
            style: Style::default(),
        };
        assert_eq!(moment.reason(), "largest load: 3.00 N");
        moment.doubt = Some("never empty since the baseline".to_owned());
        assert_eq!(
            moment.reason(),
            "largest load: 3.00 N; the map is not known to be true: never empty since the baseline"
        );
    }
}
