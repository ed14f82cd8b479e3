//! One diagram: its table of points, Pareto front and pictures.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

use render::{Axis, Curve, Curves};
use serde::{Deserialize, Serialize};

use super::Effort;
use crate::artifact_cache::ArtifactCache;
use crate::evaluation::{mean_and_deviation, median, quantile};
use crate::failure::Failure;

/// Half the diagonal of the paper's sheet, mm: the error assigned to a map without a loss.
pub(crate) const FARTHEST_MM: f64 = 157.0;
/// Of curves with more points only those on the front are drawn.
const MANY: usize = 24;

/// One measured setting.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Point {
    /// Name of the picture that contains the point; empty if the diagram has only one.
    #[serde(default)]
    pub group: String,
    /// Name of the curve of the point.
    pub line: String,
    /// The setting on that curve.
    pub setting: String,
    /// Abscissa: in most diagrams the median time, s.
    pub time: f64,
    /// Ordinate.
    pub error: f64,
    /// Half the error bar: standard deviation over draws.
    pub spread: f64,
    /// Further results; the names contain the units.
    #[serde(default)]
    pub also: BTreeMap<String, f64>,
    /// Whether no other point is both faster and more accurate.
    #[serde(default)]
    pub front: bool,
}

impl Point {
    pub(crate) fn new(
        line: impl Into<String>,
        setting: impl Into<String>,
        time: f64,
        errors: &[f64],
    ) -> Self {
        let (error, spread) = mean_and_deviation(errors);
        Self {
            group: String::new(),
            line: line.into(),
            setting: setting.into(),
            time,
            error,
            spread,
            also: BTreeMap::new(),
            front: false,
        }
    }

    /// Moves the point to another picture.
    pub(crate) fn of(mut self, group: &str) -> Self {
        group.clone_into(&mut self.group);
        self
    }

    /// Adds a further result, if it is finite.
    pub(crate) fn with(mut self, name: &str, value: f64) -> Self {
        if value.is_finite() {
            self.also.insert(name.to_owned(), value);
        }
        self
    }
}

/// A diagram with its texts.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Panel {
    /// Its name, as on the command line.
    pub panel: String,
    /// Its heading.
    pub title: String,
    /// Label of the abscissa, with its unit.
    pub across: String,
    /// Label of the ordinate, with its unit.
    pub up: String,
    /// What the diagram shows.
    pub shows: String,
    /// What the diagram does not prove.
    pub not_proved: String,
    /// Missing features.
    #[serde(default)]
    pub not_built: Vec<String>,
    /// Whether both axes are costs, so that a Pareto front is meaningful.
    pub costs: bool,
    /// The measured settings.
    pub points: Vec<Point>,
}

impl Panel {
    /// Marks the points of the Pareto front.
    pub(crate) fn with_front(mut self) -> Self {
        if !self.costs {
            return self;
        }
        let all: Vec<(String, [f64; 2])> = self
            .points
            .iter()
            .map(|point| (point.group.clone(), [point.time, point.error]))
            .collect();
        for point in &mut self.points {
            let rivals = all.iter().filter(|(group, _)| *group == point.group);
            point.front = !rivals
                .map(|(_, at)| at)
                .any(|at| beats(*at, [point.time, point.error]));
        }
        self
    }

    pub(crate) fn described(&self, effort: &Effort) -> serde_json::Value {
        let mut value = serde_json::to_value(self).expect("plain data");
        value["settings"] = effort.described();
        value
    }

    /// Reads an existing table; `None` if there is none, or if it has other settings.
    pub(crate) fn read(path: &Path, effort: &Effort) -> Result<Option<Self>, Failure> {
        let text = match std::fs::read_to_string(path) {
            Ok(text) => text,
            Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(cause) => return Err(Failure::of(&format!("{}", path.display()), &cause)),
        };
        let damaged = |cause: serde_json::Error| {
            Failure::because(format!(
                "{} is damaged ({cause}): delete it, and it is made again",
                path.display()
            ))
        };
        let mut value: serde_json::Value = serde_json::from_str(&text).map_err(damaged)?;
        let settings = value["settings"].take();
        if settings != effort.described() {
            return Ok(None);
        }
        if let Some(fields) = value.as_object_mut() {
            fields.remove("settings");
        }
        serde_json::from_value(value).map(Some).map_err(damaged)
    }

    /// One line per point: text, or JSON if `json`.
    pub fn lines(&self, json: bool) -> Vec<String> {
        let point = |point: &Point| {
            if json {
                let mut value = serde_json::to_value(point).expect("plain data");
                value["panel"] = self.panel.clone().into();
                return value.to_string();
            }
            let mark = if point.front { '*' } else { ' ' };
            format!(
                "{mark} {:<44} {:<34} {:>11.4e} {:>11.3e} +- {:.1e}",
                match point.group.is_empty() {
                    true => point.line.clone(),
                    false => format!("{}: {}", point.group, point.line),
                },
                point.setting,
                point.time,
                point.error,
                point.spread
            )
        };
        let head = format!(
            "\n{}\n  {:<44} {:<34} {} | {}   (*: nothing is quicker and better)",
            self.title, "line", "setting", self.across, self.up
        );
        let head = (!json).then_some(head).into_iter();
        let missing = self.not_built.iter().map(|what| match json {
            true => serde_json::json!({ "panel": self.panel, "not_built": what }).to_string(),
            false => format!("  not built: {what}"),
        });
        head.chain(self.points.iter().map(point))
            .chain(missing)
            .collect()
    }

    /// The groups of the points in order of appearance; each group has a picture.
    pub(crate) fn groups(&self) -> Vec<&str> {
        let mut groups: Vec<&str> = Vec::new();
        for point in &self.points {
            if !groups.contains(&point.group.as_str()) {
                groups.push(&point.group);
            }
        }
        groups
    }

    /// File name of a group's picture, without extension.
    pub(crate) fn picture(&self, group: &str) -> String {
        match group.is_empty() {
            true => self.panel.clone(),
            false => format!("{}-{}", self.panel, group.replace(' ', "-")),
        }
    }

    /// Draws the picture of each group as PNG and SVG.
    pub(crate) fn draw(&self, place: &ArtifactCache<'_>) -> Result<(), Failure> {
        self.groups()
            .into_iter()
            .try_for_each(|group| self.draw_group(place, group))
    }

    fn draw_group(&self, place: &ArtifactCache<'_>, group: &str) -> Result<(), Failure> {
        // a logarithmic axis has no zero
        let of_group =
            |point: &&Point| point.group == group && point.time > 0.0 && point.error > 0.0;
        let points: Vec<&Point> = self.points.iter().filter(of_group).collect();
        let mut curves: Vec<Curve> = Vec::new();
        for point in &points {
            let at = [point.time, point.error, point.spread];
            match curves.iter_mut().find(|curve| curve.name == point.line) {
                Some(curve) => curve.points.push(at),
                None => curves.push(Curve {
                    name: point.line.clone(),
                    points: vec![at],
                }),
            }
        }
        if curves.is_empty() {
            return Ok(());
        }
        // of curves with very many points only those on the front are drawn
        for curve in curves.iter_mut().filter(|curve| curve.points.len() > MANY) {
            let all = curve.points.clone();
            curve.points.retain(|[time, error, _]| {
                !all.iter().any(|[t, e, _]| beats([*t, *e], [*time, *error]))
            });
            curve.points.sort_by(|a, b| a[0].total_cmp(&b[0]));
        }
        let mut front: Vec<[f64; 2]> = points
            .iter()
            .filter(|point| point.front)
            .map(|point| [point.time, point.error])
            .collect();
        front.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let title = match group.is_empty() {
            true => self.title.clone(),
            false => format!("{} - {group}", self.title),
        };
        let chart = Curves {
            title: &title,
            across: &self.across,
            up: &self.up,
            axes: [Axis::Log, Axis::Log],
            marks: Vec::new(),
            curves,
            front,
        };
        let failed = |fault| Failure::of(&format!("the picture of {}", self.panel), &fault);
        let png = render::curves_png(&chart).map_err(failed)?;
        let svg = render::curves_svg(&chart).map_err(failed)?;
        let name = self.picture(group);
        place.write_bytes(&format!("{name}.png"), &png)?;
        place.write_bytes(&format!("{name}.svg"), svg.as_bytes())
    }
}

/// Whether one point is at least as good as another in both coordinates, and better in one.
fn beats(one: [f64; 2], other: [f64; 2]) -> bool {
    one[0] <= other[0] && one[1] <= other[1] && one != other
}

/// Times of a repeated operation, s.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Times {
    /// Time of the first run.
    pub(crate) cold: f64,
    /// Median of the other runs.
    pub(crate) median: f64,
    pub(crate) p99: f64,
}

/// Runs `work` once cold and `runs` times warm.
pub(crate) fn timed(
    runs: usize,
    mut work: impl FnMut() -> Result<(), Failure>,
) -> Result<Times, Failure> {
    let mut once = || -> Result<f64, Failure> {
        let start = Instant::now();
        work()?;
        Ok(start.elapsed().as_secs_f64())
    };
    let cold = once()?;
    let mut warm = (0..runs).map(|_| once()).collect::<Result<Vec<_>, _>>()?;
    let p99 = quantile(&mut warm, 0.99);
    Ok(Times {
        cold,
        median: median(&mut warm),
        p99,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_front_is_what_nothing_beats() {
        let point = |time, error| Point::new("a", "b", time, &[error]);
        let panel = Panel {
            panel: "test".to_owned(),
            title: String::new(),
            across: String::new(),
            up: String::new(),
            shows: String::new(),
            not_proved: String::new(),
            not_built: Vec::new(),
            costs: true,
            points: vec![
                point(1.0, 5.0),
                point(2.0, 5.0),
                point(2.0, 3.0),
                point(3.0, 4.0),
                point(9.0, 1.0),
                // equal to another point, so neither dominates
                point(9.0, 1.0),
            ],
        };
        let front: Vec<bool> = panel.with_front().points.iter().map(|p| p.front).collect();
        assert_eq!(front, [true, false, true, false, true, true]);
    }
}
