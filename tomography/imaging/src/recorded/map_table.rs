//! The companion tables of a table of maps: the triangle of each column, the frame of each row, and the standard
//! deviations.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use chrono::{DateTime, SecondsFormat, Utc};
use eit::{Mesh, Pressure, digits};
use serde::Serialize;
use survey::{Evidence, Map, MapQuality, MapUnit};

use crate::tracking::Tracked;

/// The companions of a table of maps `NAME.csv`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MapCompanions {
    /// `NAME.frames.csv`: a line for each row of the maps.
    pub frames: PathBuf,
    /// `NAME.triangles.csv`: a line for each column of the maps.
    pub triangles: PathBuf,
    /// `NAME.sd.csv`: the standard deviation of each value, on request.
    pub deviations: PathBuf,
}

/// Summary of the standard deviations of a map.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct DeviationSummary {
    /// Share of the region's area in triangles that the frame determines.
    pub resolved: f64,
    /// Median of the standard deviations of ln conductance in these triangles; `None` if there are none.
    pub median: Option<f64>,
}

impl DeviationSummary {
    /// Summarises the standard deviation of each triangle (NaN if the frame does not determine it), given the
    /// triangles' areas.
    pub fn of(deviations: &[f64], areas: &[f64]) -> Self {
        let each = deviations.iter().zip(areas);
        let known = each.filter(|(deviation, _)| !deviation.is_nan());
        let (mut values, known): (Vec<f64>, Vec<f64>) = known.unzip();
        values.sort_by(f64::total_cmp);
        let sum = |areas: &[f64]| areas.iter().fold(0.0, |sum, area| sum + area);
        Self {
            resolved: sum(&known) / sum(areas),
            median: values.get(values.len() / 2).copied(),
        }
    }
}

/// A time in a table: UTC, always with six digits of seconds, because readers infer the format of a column from its
/// first row (`pandas.to_datetime` refuses a mix). A session keeps times in microseconds.
pub fn table_time(time: DateTime<Utc>) -> String {
    time.to_rfc3339_opts(SecondsFormat::Micros, true)
}

/// First line of the table of frames.
pub const FRAMES_HEADING: &str = "frame,label,time_utc,found_x_m,found_y_m,unit,largest_loss,noise,significant,masked,newtons,largest_kpa,quality,doubts\n";

impl MapCompanions {
    /// The companions' paths for a table of maps.
    pub fn of(maps: &Path) -> Self {
        Self {
            frames: maps.with_extension("frames.csv"),
            triangles: maps.with_extension("triangles.csv"),
            deviations: maps.with_extension("sd.csv"),
        }
    }
}

/// The table of triangles: number in the mesh (from 0, as in `elems.csv`), centroid, area.
pub fn triangles_text(mesh: &Mesh) -> String {
    let mut text = String::from("element,x_m,y_m,area_m2\n");
    let centroids = mesh.region_centroids();
    for ((element, [x, y]), area) in mesh.region().iter().zip(centroids).zip(mesh.region_areas()) {
        text += &format!("{element},{},{},{}\n", digits(x), digits(y), digits(area));
    }
    text
}

/// First line of a table of maps with a leading column `frame`: the number of each triangle in the mesh.
pub fn maps_heading(mesh: &Mesh) -> String {
    let elements = mesh.region().iter().map(|element| format!(",e{element}"));
    format!("frame{}\n", elements.collect::<String>())
}

/// A frame and its map.
#[derive(Debug, Clone, Copy)]
pub struct MapRow<'a> {
    /// Number of the frame.
    pub frame: u64,
    /// Its label in the recording.
    pub label: &'a str,
    /// Time of the frame.
    pub time: Option<DateTime<Utc>>,
    /// Result of the tracked baseline for the frame.
    pub tracked: Option<&'a Tracked>,
    /// The map, or why the frame has none.
    pub map: Result<MapOfRow<'a>, &'a str>,
}

/// A map with the values derived from it.
#[derive(Debug, Clone, Copy)]
pub struct MapOfRow<'a> {
    /// The map, relative.
    pub map: &'a Map,
    /// Position of the load, m.
    pub found: Option<[f64; 2]>,
    /// The significance threshold: the largest loss by noise alone.
    pub noise: Option<f64>,
    /// The map converted by a calibration.
    pub pressure: Option<&'a Pressure>,
    /// Summary of its standard deviations.
    pub deviation: Option<DeviationSummary>,
}

impl<'a> MapOfRow<'a> {
    /// The displayed map: kPa with a calibration.
    pub fn shown(&self) -> Cow<'a, Map> {
        match self.pressure {
            Some(pressure) => Cow::Owned(pressure.map(self.map)),
            None => Cow::Borrowed(self.map),
        }
    }

    fn unit(&self) -> MapUnit {
        self.pressure.map_or(self.map.unit, |_| MapUnit::Pressure)
    }

    fn largest_loss(&self) -> f64 {
        self.map.largest_loss().map_or(0.0, |(_, loss)| loss)
    }

    /// The values: kPa with a calibration, otherwise relative changes of conductance.
    fn values(&self) -> &'a [f64] {
        self.pressure
            .map_or(&self.map.values, |pressure| &pressure.kpa)
    }
}

/// A frame and its map as one line of JSON, as printed by `tactus replay` and `tactus-lab reconstruct`. If the frame
/// has no map, the fields of the map are `None`.
#[derive(Debug, Serialize)]
pub struct MapLine<'a> {
    /// Number of the frame.
    pub frame: u64,
    /// Its label in the recording.
    pub label: &'a str,
    /// How the map was made.
    pub method: Option<&'a str>,
    /// Position of the load, mm.
    pub found_mm: Option<[f64; 2]>,
    /// Largest relative loss of conductance.
    pub largest_loss: Option<f64>,
    /// Whether the largest loss is more than `noise`; `None` if the noise is unknown.
    pub significant: Option<bool>,
    /// The largest loss by noise alone.
    pub noise: Option<f64>,
    /// Unit of the map as drawn and written: `kPa` with a calibration.
    pub unit: Option<&'static str>,
    /// Total load, N.
    pub newtons: Option<f64>,
    /// Largest pressure, kPa.
    pub largest_kpa: Option<f64>,
    /// Number of readings that were not used.
    pub masked: Option<usize>,
    /// The evidence by which the method chose the kind of map.
    pub evidence: Option<&'a Evidence>,
    /// Summary of the map's standard deviations, if requested.
    pub map_sd: Option<DeviationSummary>,
    /// Whether the map can be relied on.
    pub quality: Option<&'a MapQuality>,
    /// Result of the tracked baseline for the frame.
    pub tracked: Option<&'a Tracked>,
    /// Why the frame has no map.
    pub no_map: Option<&'a str>,
}

/// Count of the frames without a map.
#[derive(Debug, Default)]
pub struct WithoutMap {
    frames: usize,
    without: usize,
    first: Option<String>,
}

impl WithoutMap {
    /// Counts a frame.
    pub fn take(&mut self, row: &MapRow<'_>) {
        self.frames += 1;
        if let Err(why) = row.map {
            self.without += 1;
            self.first
                .get_or_insert_with(|| format!("frame {}: {why}", row.label));
        }
    }

    /// Whether no frame has a map.
    pub fn is_all(&self) -> bool {
        self.without > 0 && self.without == self.frames
    }

    /// A sentence with the number of frames without a map and the reason for the first; `None` if every frame has a
    /// map.
    pub fn text(&self) -> Option<String> {
        let (first, without, frames) = (self.first.as_ref()?, self.without, self.frames);
        Some(match self.is_all() {
            true => format!("none of the {frames} frames has a map; {first}"),
            false => format!(
                "{without} of {frames} frames have no map (nan in a table of maps), the others are written; {first}"
            ),
        })
    }
}

impl<'a> MapRow<'a> {
    /// The line in the table of frames.
    pub fn text(&self) -> String {
        let time = self.time.map(table_time).unwrap_or_default();
        let frame = format!("{},{},{time}", self.frame, self.label);
        // sentences contain commas, which separate the fields
        let field = |text: &str| text.replace([',', '\n', '\r'], "");
        let found = match &self.map {
            Ok(found) => found,
            Err(why) => return format!("{frame}{}none,{}\n", ",".repeat(10), field(why)),
        };
        let number = |value: Option<f64>| value.map(digits).unwrap_or_default();
        let significant = found.map.is_significant(found.noise);
        let quality = found.map.quality.as_ref();
        format!(
            "{frame},{},{},{},{},{},{},{},{},{},{},{}\n",
            number(found.found.map(|[x, _]| x)),
            number(found.found.map(|[_, y]| y)),
            found.unit().label(),
            digits(found.largest_loss()),
            number(found.noise),
            significant.map(|yes| yes.to_string()).unwrap_or_default(),
            found.map.masked,
            number(found.pressure.map(|pressure| pressure.newtons)),
            number(found.pressure.map(Pressure::largest_kpa)),
            quality.map_or("", |quality| quality.verdict.word()),
            quality.map_or(String::new(), |quality| field(&quality.text())),
        )
    }

    /// The line of JSON.
    pub fn line(&self) -> MapLine<'a> {
        let found = self.map.as_ref().ok();
        let pressure = found.and_then(|found| found.pressure);
        MapLine {
            frame: self.frame,
            label: self.label,
            method: found.map(|found| found.map.method.as_str()),
            found_mm: found
                .and_then(|found| found.found)
                .map(|place| place.map(|metres| 1e3 * metres)),
            largest_loss: found.map(MapOfRow::largest_loss),
            significant: found.and_then(|found| found.map.is_significant(found.noise)),
            noise: found.and_then(|found| found.noise),
            unit: found.map(|found| match found.unit() {
                MapUnit::Pressure => MapUnit::Pressure.label(),
                other => other.caption(),
            }),
            newtons: pressure.map(|pressure| pressure.newtons),
            largest_kpa: pressure.map(Pressure::largest_kpa),
            masked: found.map(|found| found.map.masked),
            evidence: found.and_then(|found| found.map.evidence.as_ref()),
            map_sd: found.and_then(|found| found.deviation),
            quality: found.and_then(|found| found.map.quality.as_ref()),
            tracked: self.tracked,
            no_map: self.map.err(),
        }
    }

    /// The values of the map, one for each of `triangles`: kPa with a calibration, otherwise relative changes of
    /// conductance; NaN without a map.
    pub fn values(&self, triangles: usize) -> Cow<'a, [f64]> {
        match &self.map {
            Ok(found) => Cow::Borrowed(found.values()),
            Err(_) => Cow::Owned(vec![f64::NAN; triangles]),
        }
    }
}
