//! Errors of the position and the width of electrodes.
//!
//! Each electrode is displaced by up to +-0.5 mm and its width differs by up to +-10 %, both uniformly distributed
//! (fact sheet, section 2.3). The unloaded readings change by some percent. The nodes of the phantom's mesh move with
//! the electrodes, weighted by the inverse square of the distance (Shepard 1968), so that each electrode has exactly
//! its own error; the sheet's edge stays fixed. Electrodes on the edge move along it. The contact impedance (ohm m)
//! stays the same, so a wider electrode has a smaller resistance.

use eit::{Preset, SheetElectrode};
use rand::RngExt;

use super::bounds::parameters;
use super::{Effect, Effects, OnMesh, SheetResponse, stream};

parameters! {
    /// Size of the placement errors.
    ElectrodePlacementSettings {
        /// Largest displacement along each axis, mm.
        off_mm = 0.5, in [0.0, 1.0], "mm";
        /// Largest error of the width, %.
        width_percent = 10.0, in [0.0, 20.0], "%";
    }
}

impl Effect for ElectrodePlacementSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.misplaced(&|effects| effects.electrode_placement = Some(self.clone()))
    }

    fn add(&self, seed: u64, effects: &mut Effects) {
        effects.mesh.push(Box::new(ElectrodePlacement {
            settings: self.clone(),
            seed,
        }));
    }
}

#[derive(Debug)]
struct ElectrodePlacement {
    settings: ElectrodePlacementSettings,
    seed: u64,
}

/// Errors of one electrode.
struct PlacementError {
    /// m
    off: [f64; 2],
    /// Relative error of its width.
    wider: f64,
}

impl OnMesh for ElectrodePlacement {
    fn displace(&self, sheet: &Preset, nodes: &mut [[f64; 2]]) {
        let drawn: Vec<PlacementError> = (0..sheet.electrodes())
            .map(|electrode| {
                let mut stream = stream(self.seed, &format!("electrode-placement {electrode}"));
                let mut draw = || 2.0 * stream.random::<f64>() - 1.0;
                let [x, y, wider] = [draw(), draw(), draw()];
                PlacementError {
                    off: [x, y].map(|share| share * self.settings.off_mm * 1e-3),
                    wider: wider * self.settings.width_percent / 100.0,
                }
            })
            .collect();
        for node in nodes {
            let by = match sheet {
                Preset::PaperSheet(sheet) => on_sheet(sheet, &drawn, *node),
                Preset::DiscTank(tank) => on_tank(tank, &drawn, *node),
            };
            *node = [node[0] + by[0], node[1] + by[1]];
        }
    }
}

/// Weights of the electrodes' errors at a point; `outside` are the distances of the point from each electrode. The
/// weight of an electrode is 1 on the electrode itself, 0 on any other, and 0 from `reach` on.
fn weights(outside: &[f64], reach: f64) -> Vec<f64> {
    let nearest = outside.iter().copied().fold(f64::INFINITY, f64::min);
    if nearest == 0.0 {
        return outside.iter().map(|away| f64::from(*away == 0.0)).collect();
    }
    let left = (1.0 - nearest / reach).clamp(0.0, 1.0);
    let fade = left * left * (3.0 - 2.0 * left);
    let near = outside.iter().map(|away| (nearest / away).powi(2));
    let all: f64 = near.clone().sum();
    near.map(|near| fade * near / all).collect()
}

/// Displacement of a point of a rectangular sheet, m.
fn on_sheet(sheet: &eit::PaperSheet, drawn: &[PlacementError], place: [f64; 2]) -> [f64; 2] {
    let size = [sheet.width_mm * 1e-3, sheet.height_mm * 1e-3];
    let each = [sheet.electrodes_per_width, sheet.electrodes_per_height];
    let half = 0.5e-3 * sheet.void_mm;
    let pitch = (size[0] / each[0] as f64).min(size[1] / each[1] as f64);
    // half extent of an electrode along x and y; an electrode on the edge is a line
    let across = |index: usize| match sheet.electrode {
        SheetElectrode::Void => [half, half],
        SheetElectrode::Edge => {
            // bottom, right, top, left
            let upright =
                (each[0]..each[0] + each[1]).contains(&index) || index >= 2 * each[0] + each[1];
            if upright { [0.0, half] } else { [half, 0.0] }
        }
    };
    let away: Vec<[f64; 2]> = sheet
        .centres_mm()
        .into_iter()
        .map(|centre| [0, 1].map(|axis| place[axis] - centre[axis] * 1e-3))
        .collect();
    let outside: Vec<f64> = (0..)
        .zip(&away)
        .map(|(index, away)| {
            let beyond = |axis: usize| (away[axis].abs() - across(index)[axis]).max(0.0);
            beyond(0).max(beyond(1))
        })
        .collect();
    let weights = weights(&outside, 0.5 * pitch - half);
    let mut by = [0.0, 0.0];
    for (index, wrong) in drawn.iter().enumerate() {
        for axis in 0..2 {
            if across(index)[axis] > 0.0 {
                let stretched = away[index][axis].clamp(-half, half) * wrong.wider;
                by[axis] += weights[index] * (wrong.off[axis] + stretched);
            }
        }
    }
    if sheet.electrode == SheetElectrode::Void {
        // the sheet's edge is fixed, so the part between a void and the edge is stretched
        for axis in 0..2 {
            let to_rim = place[axis].min(size[axis] - place[axis]).max(0.0);
            by[axis] *= (to_rim / (sheet.inset_mm * 1e-3 - half)).min(1.0);
        }
    }
    by
}

/// Displacement of a point of a tank, m: a rotation about the centre.
fn on_tank(tank: &eit::DiscTank, drawn: &[PlacementError], place: [f64; 2]) -> [f64; 2] {
    let radius = tank.radius_mm * 1e-3;
    let pitch = std::f64::consts::TAU / tank.electrodes as f64;
    let half = 0.5 * tank.arc_deg.to_radians();
    let inwards = (1.0 - place[0].hypot(place[1]) / radius).max(0.0);
    let direction = place[1].atan2(place[0]);
    let away: Vec<f64> = (0..drawn.len())
        .map(|index| {
            let centre = tank.first_deg.to_radians() + index as f64 * pitch;
            let (sin, cos) = (direction - centre).sin_cos();
            sin.atan2(cos)
        })
        .collect();
    // straight edges between points of the wall are slightly inside of it
    let inwards = if inwards < 1e-2 * half { 0.0 } else { inwards };
    let outside: Vec<f64> = away
        .iter()
        .map(|away| {
            let beyond = away.abs() - half;
            let beyond = if beyond < 1e-9 { 0.0 } else { beyond };
            beyond.max(inwards)
        })
        .collect();
    let turn: f64 = weights(&outside, 0.5 * pitch - half)
        .into_iter()
        .zip(&away)
        .zip(drawn)
        .map(|((weight, away), wrong)| {
            let stretched = away.clamp(-half, half) * wrong.wider;
            weight * (wrong.off[0] / radius + stretched)
        })
        .sum();
    let (sin, cos) = turn.sin_cos();
    [
        (cos - 1.0) * place[0] - sin * place[1],
        sin * place[0] + (cos - 1.0) * place[1],
    ]
}

#[cfg(test)]
mod tests {
    use eit::{DiscTank, Mesh, PaperSheet};

    use super::super::bounds::Parameters;
    use super::*;

    fn displaced(drawn: &Mesh, sheet: &Preset, off_mm: f64, width_percent: f64, seed: u64) -> Mesh {
        let settings = ElectrodePlacementSettings {
            off_mm,
            width_percent,
        };
        settings.check().unwrap();
        let mut nodes = drawn.nodes().to_vec();
        ElectrodePlacement { settings, seed }.displace(sheet, &mut nodes);
        let (triangles, edges) = (drawn.triangles().to_vec(), drawn.electrode_edges().to_vec());
        Mesh::new(nodes, triangles, edges, None).unwrap()
    }

    #[test]
    fn electrodes_are_displaced_as_drawn_and_edge_is_kept() {
        let sheets = [
            Preset::default(),
            Preset::PaperSheet(PaperSheet {
                electrode: SheetElectrode::Edge,
                ..PaperSheet::default()
            }),
            Preset::DiscTank(DiscTank::default()),
        ];
        for sheet in sheets {
            let drawn = sheet.mesh().unwrap();
            let moved = displaced(&drawn, &sheet, 0.5, 10.0, 4);
            let [after, before] = [&moved, &drawn].map(Mesh::quality);
            println!("angles {} {}", before.smallest_angle, after.smallest_angle);
            assert!((after.area / before.area - 1.0).abs() < 1e-3);
            assert!(after.smallest_angle > 0.5 * before.smallest_angle);
            let (mut furthest, mut widest) = (0.0_f64, 0.0_f64);
            let centres = moved.electrode_centres().into_iter();
            for (k, (now, then)) in centres.zip(drawn.electrode_centres()).enumerate() {
                let [x, y] = [0, 1].map(|axis| now[axis] - then[axis]);
                let off = match sheet {
                    Preset::PaperSheet(_) => x.abs().max(y.abs()),
                    Preset::DiscTank(_) => x.hypot(y),
                };
                furthest = furthest.max(off);
                let wider = moved.electrode_length(k) / drawn.electrode_length(k) - 1.0;
                widest = widest.max(wider.abs());
            }
            // the largest of 16 or more uniform draws is close to the bound and within it
            assert!((0.3e-3..0.501e-3).contains(&furthest), "{furthest}");
            assert!((0.08..0.1001).contains(&widest), "{widest}");
        }
    }

    #[test]
    fn the_worst_that_is_allowed_leaves_a_mesh() {
        let sheet = Preset::default().remeshed(1.5, 1);
        let drawn = sheet.mesh().unwrap();
        for seed in 0..20 {
            let quality = displaced(&drawn, &sheet, 1.0, 20.0, seed).quality();
            assert!(quality.smallest_angle > 3.0, "{}", quality.smallest_angle);
        }
    }
}
