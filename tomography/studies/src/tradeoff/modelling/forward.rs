//! Diagram 1: error of the voltages against the size of the mesh.

use std::sync::Arc;
use std::time::Instant;

use eit::{Forward, ForwardError, Mesh, PaperSheet};
use nalgebra::DVector;
use phantom::Load;
use survey::Protocol;

use crate::failure::{Attempt, Failure};
use crate::progress;
use crate::sheet;
use crate::tradeoff::Effort;
use crate::tradeoff::panel::{Panel, Point, Times, timed};

/// Position of a press of 10 mm that halves the conductance, mm; not in the middle of the sheet.
const PRESS_MM: [f64; 2] = [75.0, 140.0];

/// Edge length of the uniform meshes at fineness 1, mm.
const EVEN_MM: f64 = 4.0;

/// Readings of the unloaded and of the pressed sheet, V at 1 A.
struct Solved {
    empty: DVector<f64>,
    change: DVector<f64>,
}

pub(crate) fn panel(effort: &Effort) -> Result<Panel, Failure> {
    let uniform: &[f64] = effort.of(
        &[8.0, 4.0, 2.8][..],
        &[8.0, 5.6, 4.0, 2.8, 2.0, 1.4, 1.0, 0.7, 0.5],
    );
    let graded: &[f64] = effort.of(&[0.5, 0.7, 1.0][..], &[0.5, 0.7, 1.0, 1.4, 2.0, 2.8]);
    // 2 times (full run: 2.9 times) finer than the finest graded mesh
    let reference_fineness = effort.of(2.0, 8.0);
    let reference = Model::new(PaperSheet {
        fineness: reference_fineness,
        seeding: 1000,
        ..PaperSheet::default()
    })?
    .solved()?;
    let bar = progress::bar(uniform.len() + graded.len(), "meshes");
    let mut points = Vec::new();
    let even = |&h: &f64| {
        let of = PaperSheet {
            edge_mm: EVEN_MM,
            largest_mm: EVEN_MM,
            fineness: EVEN_MM / h,
            ..PaperSheet::default()
        };
        ("uniform", format!("{h} mm"), of)
    };
    let fine = |&fineness: &f64| {
        let of = PaperSheet {
            fineness,
            ..PaperSheet::default()
        };
        let setting = format!("{:.2} to {:.1} mm", 1.5 / fineness, 5.4 / fineness);
        ("graded", setting, of)
    };
    for (line, setting, of) in uniform.iter().map(even).chain(graded.iter().map(fine)) {
        // each `seeding` gives a different mesh with the same sizes; the first one is timed
        let model = |seeding: u64| {
            Model::new(PaperSheet {
                seeding: seeding as u32,
                ..of.clone()
            })
        };
        let first = model(0)?;
        let mut errors = [Vec::new(), Vec::new()];
        for seeding in 0..Effort::SEEDS {
            let found = match seeding {
                0 => first.solved()?,
                seeding => model(seeding)?.solved()?,
            };
            errors[0].push((&found.empty - &reference.empty).amax() / reference.empty.amax());
            errors[1].push((&found.change - &reference.change).norm() / reference.change.norm());
        }
        let triangles = first.mesh.triangles().len();
        let times = first.times(match triangles > 100_000 {
            true => 5,
            false => Effort::RUNS,
        })?;
        for (what, errors) in ["voltages", "differences"].into_iter().zip(&errors) {
            points.push(
                Point::new(line, setting.clone(), times.median, errors)
                    .of(what)
                    .with("triangles", triangles as f64)
                    .with("set-up, s", first.set_up_s)
                    .with("cold, s", times.cold)
                    .with("p99, s", times.p99),
            );
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(Panel {
        panel: "forward".to_owned(),
        title: "Forward model: what a finer mesh buys".to_owned(),
        across: "598 readings, s".to_owned(),
        up: "relative error".to_owned(),
        shows: format!(
            "Readings of the paper's sheet from ever finer meshes against a graded mesh of fineness {reference_fineness} \
             ({:.2} mm at electrodes, {:.2} mm far from them): the unloaded voltages (largest error over the largest reading) \
             and the change by a 10 mm press (root mean square); for voltages a mesh that is \
             fine where electrodes are needs half the triangles, for the change an even one is better, since it is finer under the press.",
            1.5 / reference_fineness,
            5.4 / reference_fineness
        ),
        not_proved: "Bars are over five meshes of each size, times are medians of twenty runs (of five above 100,000 triangles); the reference is a mesh too, so errors near its own (the last points \
                     of the uniform line are finer than it far from electrodes, and coarser at them) are only as good as it is."
            .to_owned(),
        not_built: vec!["quadratic elements".to_owned()],
        costs: true,
        points,
    })
}

/// A sheet with its mesh, ready to be solved.
struct Model {
    sheet: PaperSheet,
    mesh: Arc<Mesh>,
    forward: Forward,
    protocol: Protocol,
    /// Time to create the mesh and analyse its matrix, s.
    set_up_s: f64,
}

impl Model {
    fn new(sheet: PaperSheet) -> Result<Self, Failure> {
        let start = Instant::now();
        let mesh = sheet.mesh().attempt("the mesh")?;
        let mesh = Arc::new(mesh);
        let forward = Forward::new(Arc::clone(&mesh), &sheet.contact_ohm_m()).map_err(unsolved)?;
        let set_up_s = start.elapsed().as_secs_f64();
        let protocol = sheet::protocol(sheet.electrodes())?;
        Ok(Self {
            sheet,
            mesh,
            forward,
            protocol,
            set_up_s,
        })
    }

    fn unloaded(&self) -> Vec<f64> {
        vec![self.sheet.conductance(); self.mesh.triangles().len()]
    }

    fn solved(&self) -> Result<Solved, Failure> {
        let readings = |sigma: &[f64]| {
            self.forward
                .readings(sigma, &self.protocol)
                .map_err(unsolved)
        };
        let mut sigma = self.unloaded();
        let empty = readings(&sigma)?;
        let load = Load::disc(PRESS_MM, 10.0, 0.5);
        let covered = load.coverage(&self.mesh).attempt("the press")?;
        for (triangle, share) in covered {
            sigma[triangle] *= 1.0 - load.loss * share;
        }
        let change = readings(&sigma)? - &empty;
        Ok(Solved { empty, change })
    }

    fn times(&self, runs: usize) -> Result<Times, Failure> {
        let mut sigma = self.unloaded();
        let mut workspace = self.forward.workspace(&self.protocol).map_err(unsolved)?;
        timed(runs, || {
            // the conductance differs each time, so that no result can be reused
            sigma.iter_mut().for_each(|value| *value *= 1.001);
            workspace.readings(&sigma).map(drop).map_err(unsolved)
        })
    }
}

fn unsolved(fault: ForwardError) -> Failure {
    Failure::of("the forward model", &fault)
}
