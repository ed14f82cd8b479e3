//! The companion tables of a table of maps: the triangle of each column, the frame of each row, and standard deviations.

use std::path::{Path, PathBuf};

use chrono::{DateTime, SecondsFormat, Utc};
use eit::{Mesh, Pressure, digits};
use serde::Serialize;
use survey::Map;

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

/// How exactly a frame tells its map, in two numbers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct DeviationSummary {
    /// Share of the region's area of which the frame says something.
    pub resolved: f64,
    /// Median of the standard deviations there, ln conductance; `None` where the frame says nothing at all.
    pub median: Option<f64>,
}

impl DeviationSummary {
    /// Of the standard deviation of each triangle, NaN where the frame says nothing of it, and their areas.
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

/// A time in a table: UTC, always with six digits of seconds, because readers infer the format of a column from its first
/// row (`pandas.to_datetime` refuses a mix). A session keeps times in microseconds.
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

/// A map and its frame.
#[derive(Debug, Clone, Copy)]
pub struct MapRow<'a> {
    /// Number of the frame.
    pub frame: u64,
    /// Its label in the recording.
    pub label: &'a str,
    /// Time of the frame.
    pub time: Option<DateTime<Utc>>,
    /// The map, relative.
    pub map: &'a Map,
    /// Position of the load, m.
    pub found: Option<[f64; 2]>,
    /// The significance threshold: the largest loss by noise alone.
    pub noise: Option<f64>,
    /// The map converted by a calibration.
    pub pressure: Option<&'a Pressure>,
}

impl MapRow<'_> {
    /// The line in the table of frames.
    pub fn text(&self) -> String {
        let number = |value: Option<f64>| value.map(digits).unwrap_or_default();
        let largest = self.map.largest_loss().map_or(0.0, |(_, loss)| loss);
        let significant = self.map.is_significant(self.noise);
        let quality = self.map.quality.as_ref();
        format!(
            "{},{},{},{},{},{},{},{},{},{},{},{},{},{}\n",
            self.frame,
            self.label,
            self.time.map(table_time).unwrap_or_default(),
            number(self.found.map(|[x, _]| x)),
            number(self.found.map(|[_, y]| y)),
            match self.pressure {
                Some(_) => survey::MapUnit::Pressure.label(),
                None => self.map.unit.label(),
            },
            digits(largest),
            number(self.noise),
            significant.map(|yes| yes.to_string()).unwrap_or_default(),
            self.map.masked,
            number(self.pressure.map(|pressure| pressure.newtons)),
            number(self.pressure.map(Pressure::largest_kpa)),
            quality.map_or("", |quality| quality.verdict.word()),
            // the sentences contain commas
            quality.map_or(String::new(), |quality| quality.text().replace(',', "")),
        )
    }

    /// The values: kPa with a calibration, otherwise relative changes of conductance.
    pub fn values(&self) -> &[f64] {
        self.pressure
            .map_or(&self.map.values, |pressure| &pressure.kpa)
    }
}
