//! Charts of quantities against time.

use chrono::{DateTime, Local, TimeZone, Utc};
use imaging::quantities::Quantity;
use render::{Course, CourseLine};

use super::{Facts, MapFacts};
use crate::failure::Failure;

/// The charted quantities.
const CHARTS: [Quantity; 6] = [
    Quantity::Load,
    Quantity::Ppi,
    Quantity::Contact,
    Quantity::Unrelieved,
    Quantity::Dose,
    Quantity::Known,
];
/// Most regions in a chart: more lines cannot be distinguished.
const LINES: usize = 6;
/// Possible distances of labelled times, s.
const TICKS: [i64; 14] = [
    10, 60, 300, 600, 1800, 3600, 7200, 10_800, 21_600, 43_200, 86_400, 172_800, 604_800, 2_592_000,
];
/// Most labels of an axis.
const LABELS: i64 = 9;

/// An SVG for each quantity that has values.
pub(super) fn svgs(facts: &Facts<'_>, maps: &MapFacts<'_>) -> Result<Vec<String>, Failure> {
    let (Some(first), Some(last)) = (maps.rows.rows.first(), maps.rows.rows.last()) else {
        return Ok(Vec::new());
    };
    let span_s = f64::from(maps.rows.span_s);
    let span = [first.begin_s as f64, last.begin_s as f64 + span_s];
    let mut charts = Vec::new();
    for quantity in CHARTS {
        let regions = maps.rows.regions().into_iter().take(LINES);
        // minutes and per cent are read more easily
        let (factor, unit) = match quantity {
            Quantity::Unrelieved => (1.0 / 60.0, "min"),
            Quantity::Known => (100.0, "% of the frames"),
            other => (1.0, other.unit(first.of)),
        };
        let lines: Vec<CourseLine> = regions
            .map(|region| CourseLine {
                name: region.to_owned(),
                points: maps
                    .rows
                    .of_region(quantity, region)
                    .map(|row| {
                        let values = match quantity {
                            // the share of frames, and not 0 and 1
                            Quantity::Known => [row.mean; 3],
                            _ => [row.min, row.mean, row.max],
                        };
                        let [min, mean, max] = values.map(|value| factor * value);
                        [row.begin_s as f64 + 0.5 * span_s, min, mean, max]
                    })
                    .collect(),
            })
            .filter(|line| !line.points.is_empty())
            // whether a map is known does not depend on the region: one line
            .take(if quantity == Quantity::Known {
                1
            } else {
                LINES
            })
            .collect();
        if lines.is_empty() {
            continue;
        }
        let title = format!("{}, {unit}", quantity.words());
        let course = Course {
            title: &title,
            span,
            ticks: ticks(span),
            lines,
            apart: 1.5 * span_s,
            gaps: gaps(facts),
            marks: alarms(facts),
        };
        charts.push(
            render::course_svg(&course)
                .map_err(|error| Failure::failed("a chart cannot be drawn", &error))?,
        );
    }
    Ok(charts)
}

/// Begin and end of each gap, s.
fn gaps(facts: &Facts<'_>) -> Vec<[f64; 2]> {
    let of = |gap: &logbook::Gap| {
        let before = facts.session.frame(gap.after).ok()?;
        let begin = before.frame.wall.timestamp_micros() as f64 / 1e6;
        Some([begin, begin + gap.seconds])
    };
    facts.verified.gaps.iter().filter_map(of).collect()
}

/// Times at which alarms became active, s.
fn alarms(facts: &Facts<'_>) -> Vec<f64> {
    facts
        .alarms()
        .map(|event| event.at.timestamp_micros() as f64 / 1e6)
        .collect()
}

/// Labelled times at round local times.
fn ticks([first, last]: [f64; 2]) -> Vec<(f64, String)> {
    let span = (last - first).max(1.0) as i64;
    let every = TICKS
        .into_iter()
        .find(|every| span / every < LABELS)
        .unwrap_or(span / LABELS + 1);
    let shift = Local
        .timestamp_opt(first as i64, 0)
        .earliest()
        .map_or(0, |time| i64::from(time.offset().local_minus_utc()));
    let begin = (first as i64 + shift).div_euclid(every) * every - shift;
    let form = match every {
        ..60 => "%H:%M:%S",
        60..86_400 => "%H:%M",
        _ => "%m-%d",
    };
    (0..=LABELS + 2)
        .map(|k| begin + k * every)
        .filter(|at| *at as f64 >= first && *at as f64 <= last)
        .filter_map(|at| {
            let time = DateTime::<Utc>::from_timestamp(at, 0)?;
            let words = time.with_timezone(&Local).format(form).to_string();
            Some((at as f64, words))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_has_a_few_round_times() {
        for (span, every) in [
            (60.0, 10.0),
            (3600.0, 600.0),
            (86_400.0, 10_800.0),
            (3e6, 604_800.0),
        ] {
            let ticks = ticks([1_800_000_007.0, 1_800_000_007.0 + span]);
            assert!((2..=10).contains(&ticks.len()), "{span}: {ticks:?}");
            assert!(
                ticks.windows(2).all(|pair| pair[1].0 - pair[0].0 == every),
                "{ticks:?}"
            );
        }
    }
}
