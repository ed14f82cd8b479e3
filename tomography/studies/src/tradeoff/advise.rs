//! Recommends a setting of the rig from the table that is part of the program (`tactus-lab advise`).

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer};

use super::panel::{Panel, Point};
use crate::failure::Failure;

/// The table of the full run stored in `docs`.
const KEPT: &str = include_str!("../../../../docs/tradeoff-2026-11-26/acquisition.json");

/// Requirements on a setting.
#[derive(Debug)]
pub struct Request {
    /// Largest acceptable location error, mm.
    pub error_mm: f64,
    /// Longest acceptable frame time, s.
    pub max_seconds: f64,
    /// Only settings with this number of electrodes.
    pub electrodes: Option<u64>,
    /// Only settings with this module, e.g. 34924A.
    pub module: Option<String>,
    /// Only settings with this current, mA.
    pub current_ma: Option<f64>,
    /// Only settings with at most this current, mA.
    pub most_ma: Option<f64>,
    /// A table created by the diagram `acquisition`, instead of the built-in one.
    pub table: Option<PathBuf>,
}

/// Finds the fastest setting that meets the requirements.
///
/// # Errors
/// An unreadable table, or no such setting; the error names the closest ones.
pub fn advise(options: &Request) -> Result<Point, Failure> {
    for (name, value) in [
        ("--error-mm", options.error_mm),
        ("--max-seconds", options.max_seconds),
    ] {
        if !(value > 0.0 && value.is_finite()) {
            return Err(Failure::usage(format!(
                "{name} {value}: a number above 0 is expected"
            )));
        }
    }
    let panel = match &options.table {
        None => parsed("the kept table", KEPT)?,
        Some(path) => {
            let text = std::fs::read_to_string(path)
                .map_err(|cause| Failure::of(&format!("cannot read {}", path.display()), &cause))?;
            parsed(&path.display().to_string(), &text)?
        }
    };
    let points: Vec<&Point> = panel
        .points
        .iter()
        .filter(|point| fits(point, options))
        .collect();
    if points.is_empty() {
        let wanted = [
            options
                .electrodes
                .map(|count| format!("{count} electrodes")),
            options.module.as_ref().map(|name| format!("module {name}")),
            options.current_ma.map(|current| format!("{current} mA")),
            options
                .most_ma
                .map(|current| format!("at most {current} mA")),
        ];
        let wanted: Vec<String> = wanted.into_iter().flatten().collect();
        return Err(Failure::usage(format!(
            "no setting of the table has {}; --electrodes, --module and --current-ma choose others",
            wanted.join(", ")
        )));
    }
    match chosen(&points, options.error_mm, options.max_seconds) {
        Advice::This(point) => Ok(point.clone()),
        Advice::None { quickest, best } => {
            let mut message = format!(
                "no setting finds a 10 mm press within {} mm in {} s.",
                options.error_mm, options.max_seconds
            );
            message += &match quickest {
                Some(point) => format!(
                    "\nThe fastest that is good enough takes {:.2} s: {}, {}.",
                    point.time, point.line, point.setting
                ),
                None => "\nNo setting of the table is good enough.".to_owned(),
            };
            message += &match best {
                Some(point) => format!(
                    "\nThe best in that time is {:.2} mm: {}, {} ({:.2} s).",
                    point.error, point.line, point.setting, point.time
                ),
                None => "\nNo setting of the table is fast enough.".to_owned(),
            };
            Err(Failure::because(message))
        }
    }
}

/// Results that every point of the table must have, because the lines of the configuration contain them.
const SETTINGS: [&str; 6] = [
    "electrodes",
    "current, mA",
    "NPLC",
    "averages",
    "half",
    "skip",
];

/// A table whose points all have the [`SETTINGS`].
#[derive(Deserialize)]
struct Complete {
    #[serde(rename = "points")]
    _points: Vec<CompletePoint>,
}

#[derive(Deserialize)]
struct CompletePoint {
    #[serde(rename = "also", deserialize_with = "all_settings")]
    _also: (),
}

fn all_settings<'de, D: Deserializer<'de>>(from: D) -> Result<(), D::Error> {
    let also = BTreeMap::<String, f64>::deserialize(from)?;
    let absent = SETTINGS.iter().find(|name| !also.contains_key(**name));
    absent.map_or(Ok(()), |name| {
        let why = format!("a setting of the rig without '{name}'");
        Err(D::Error::custom(why))
    })
}

fn parsed(name: &str, text: &str) -> Result<Panel, Failure> {
    let wrong = |why: String| {
        Failure::because(format!(
            "{name}: {why}; tactus-lab tradeoff --only acquisition makes such a table"
        ))
    };
    let damaged = |fault: serde_json::Error| wrong(fault.to_string());
    let panel: Panel = serde_json::from_str(text).map_err(damaged)?;
    if panel.panel != "acquisition" {
        return Err(wrong(format!("is the table of '{}'", panel.panel)));
    }
    // parsed again from the text, because errors then contain the line of the point
    serde_json::from_str::<Complete>(text).map_err(damaged)?;
    Ok(panel)
}

fn fits(point: &Point, options: &Request) -> bool {
    let is = |name: &str, wanted: Option<f64>| {
        wanted.is_none_or(|wanted| {
            point
                .also
                .get(name)
                .is_some_and(|value| (value / wanted - 1.0).abs() < 1e-6)
        })
    };
    let module = options.module.as_ref().is_none_or(|name| {
        let (line, name) = (point.line.to_lowercase(), name.to_lowercase());
        line.contains(&name)
    });
    let current = point.also.get("current, mA").copied().unwrap_or(0.0);
    module
        && options
            .most_ma
            .is_none_or(|most| current <= most * (1.0 + 1e-6))
        && is("electrodes", options.electrodes.map(|count| count as f64))
        && is("current, mA", options.current_ma)
}

enum Advice<'a> {
    This(&'a Point),
    None {
        quickest: Option<&'a Point>,
        best: Option<&'a Point>,
    },
}

/// The fastest setting that is accurate enough; of two equally fast ones the more accurate one.
fn chosen<'a>(points: &[&'a Point], error_mm: f64, max_seconds: f64) -> Advice<'a> {
    let good = |point: &&&Point| point.error <= error_mm;
    let quick = |point: &&&Point| point.time <= max_seconds;
    let quickest = points
        .iter()
        .filter(good)
        .min_by(|a, b| {
            (a.time, a.error)
                .partial_cmp(&(b.time, b.error))
                .expect("numbers")
        })
        .copied();
    match quickest {
        Some(point) if point.time <= max_seconds => Advice::This(point),
        quickest => Advice::None {
            quickest,
            best: points
                .iter()
                .filter(quick)
                .min_by(|a, b| a.error.total_cmp(&b.error))
                .copied(),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_quickest_that_is_good_enough_or_what_is_nearest() {
        let point = |time, error| Point::new("m", "s", time, &[error]);
        let all = [
            point(1.0, 9.0),
            point(2.0, 1.5),
            point(3.0, 1.0),
            point(9.0, 0.1),
        ];
        let points: Vec<&Point> = all.iter().collect();
        let Advice::This(chosen_one) = chosen(&points, 2.0, 5.0) else {
            panic!("2 s and 1.5 mm are there")
        };
        assert_eq!(chosen_one.time, 2.0);
        let Advice::None { quickest, best } = chosen(&points, 0.5, 5.0) else {
            panic!("0.1 mm takes 9 s")
        };
        assert_eq!(quickest.map(|p| p.time), Some(9.0));
        assert_eq!(best.map(|p| p.error), Some(1.0));
        let Advice::None { quickest, best } = chosen(&points, 0.01, 0.5) else {
            panic!("nothing is that good or that quick")
        };
        assert!(quickest.is_none() && best.is_none());
    }

    #[test]
    fn points_without_a_setting_are_refused_by_line() {
        let whole = serde_json::to_value(parsed("kept", KEPT).unwrap()).unwrap();
        for setting in SETTINGS {
            let mut table = whole.clone();
            table["points"].as_array_mut().unwrap().truncate(3);
            let also = table["points"][1]["also"].as_object_mut().unwrap();
            also.remove(setting);
            let text = serde_json::to_string_pretty(&table).unwrap();
            let fault = parsed("a.json", &text).unwrap_err().to_string();
            // the line on which the results of the second point end
            let mut ends = text
                .lines()
                .enumerate()
                .filter(|(_, line)| *line == "      },");
            let line = 1 + ends.nth(1).unwrap().0;
            assert!(fault.starts_with("a.json: "), "{fault}");
            let says = format!("without '{setting}' at line {line} ");
            assert!(fault.contains(&says), "{fault}");
        }
    }

    #[test]
    fn the_kept_table_is_one() {
        let panel = parsed("kept", KEPT).unwrap();
        assert!(
            panel
                .points
                .iter()
                .all(|point| point.time > 0.0 && point.error > 0.0)
        );
        assert!(
            parsed("x", "{}")
                .unwrap_err()
                .to_string()
                .contains("tradeoff --only")
        );
    }
}
