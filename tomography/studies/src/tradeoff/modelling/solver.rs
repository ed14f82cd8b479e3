//! Diagram 2: solvers of the same discrete system, at three contrasts.

use std::sync::Arc;

use eit::{Forward, PaperSheet};
use faer::Mat;
use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{SparseColMat, Triplet};
use faer::traits::ComplexField;
use phantom::Load;
use survey::{Measurement, Protocol};

use super::iterative::{Preconditioner, conjugate_gradients};
use super::system::System;
use crate::failure::{Attempt, Failure};
use crate::progress;
use crate::sheet;
use crate::stability::Number;
use crate::tradeoff::Effort;
use crate::tradeoff::panel::{Panel, Point, Times, timed};

/// Conductance of a disc of 40 mm relative to that of the sheet.
const CONTRASTS: [(f64, &str); 3] = [(1.0, "1"), (1e-8, "1e-8"), (1e6, "1e6")];
const DISC_MM: f64 = 40.0;

/// A system with its protocol and the exact readings.
struct Task<'a> {
    system: System,
    protocol: &'a Protocol,
    exact: Vec<f64>,
    times: usize,
    contrast: &'a str,
}

pub(crate) fn panel(effort: &Effort) -> Result<Panel, Failure> {
    let sheet = PaperSheet {
        fineness: effort.of(0.5, 1.0),
        ..PaperSheet::default()
    };
    let mesh = Arc::new(sheet.mesh().attempt("the mesh")?);
    let contacts = sheet.contact_ohm_m();
    let failed = |fault| Failure::of("the forward model", &fault);
    let forward = Forward::new(Arc::clone(&mesh), &contacts).map_err(failed)?;
    let protocol = sheet::protocol(sheet.electrodes())?;
    let covered = Load::disc([107.0, 115.0], DISC_MM, 0.5)
        .coverage(&mesh)
        .attempt("the disc")?;
    let sigma0 = vec![sheet.conductance(); mesh.triangles().len()];
    let bar = progress::bar(CONTRASTS.len(), "contrasts");
    let mut points = Vec::new();
    for (contrast, name) in CONTRASTS {
        let mut sigma = sigma0.clone();
        for (triangle, _) in covered.iter().filter(|(_, share)| *share > 0.5) {
            sigma[*triangle] *= contrast;
        }
        let system = System::new(&mesh, &contacts, &sigma);
        let exact = exact(&system, &protocol)?;
        let task = Task {
            system,
            protocol: &protocol,
            exact,
            times: Effort::RUNS,
            contrast: name,
        };
        let none = forward.workspace(&protocol).map_err(failed)?;
        let about = none.clone().about(&sigma0).map_err(failed)?;
        let own = [
            ("ours", "plain", none.clone().plain()),
            ("ours", "refined", none),
            ("ours, about a known state", "plain", about.clone().plain()),
            ("ours, about a known state", "refined", about),
        ];
        for (line, setting, mut workspace) in own {
            let found = workspace.readings(&sigma).map_err(failed)?;
            let times = timed(task.times, || {
                workspace.readings(&sigma).map(drop).map_err(failed)
            })?;
            points.push(task.point(line, setting, found.as_slice(), times));
        }
        direct::<f64>(&task, "sparse Cholesky, f64", &[0], &mut points)?;
        direct::<f32>(&task, "sparse Cholesky, f32", &[0, 1, 2, 4, 6], &mut points)?;
        let tolerances: &[f64] = effort.of(&[1e-6][..], &[1e-4, 1e-6, 1e-8, 1e-10, 1e-12]);
        for (line, preconditioner) in [
            ("CG, Jacobi", Some(Preconditioner::jacobi(&task.system))),
            (
                "CG, incomplete factor",
                Preconditioner::cholesky(&task.system),
            ),
        ] {
            let Some(preconditioner) = preconditioner else {
                continue;
            };
            for &tolerance in tolerances {
                iterative(&task, line, &preconditioner, tolerance, &mut points)?;
            }
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(Panel {
        panel: "solver".to_owned(),
        title: "Solvers: the same system, contrasts 1, 1e-8 and 1e6".to_owned(),
        across: "26 solutions, s".to_owned(),
        up: "relative error".to_owned(),
        shows: format!(
            "598 readings of one mesh of {} triangles with a {DISC_MM} mm disc of another conductance, against a solution refined \
             in twice the precision, largest error over the largest reading; our elimination needs no iteration and keeps its \
             digits at every contrast.",
            mesh.triangles().len()
        ),
        not_proved: "The others are given the assembled matrix, whose diagonal rounds to a leak to ground at contrast 1e6 (ours never assembles \
                     one, and the residuals of refinement look past it); one mesh on one \
                     machine is no statement on meshes of millions; the time of a factor in f32 is that of the library (faer), \
                     not the best that single precision could be."
            .to_owned(),
        not_built: Vec::new(),
        costs: true,
        points,
    })
}

impl Task<'_> {
    fn point(&self, line: &str, setting: &str, found: &[f64], times: Times) -> Point {
        Point::new(line, setting, times.median, &[self.error(found)])
            .of(&format!("contrast {}", self.contrast))
            .with("cold, s", times.cold)
            .with("p99, s", times.p99)
    }

    /// Largest error relative to the largest reading; at least one rounding error.
    fn error(&self, found: &[f64]) -> f64 {
        let top = self.exact.iter().fold(0.0_f64, |top, v| top.max(v.abs()));
        let worst = found
            .iter()
            .zip(&self.exact)
            .fold(0.0_f64, |worst, (found, exact)| {
                worst.max((found - exact).abs())
            });
        (worst / top).max(f64::EPSILON / 2.0)
    }

    fn readings(&self, solutions: &[Vec<f64>]) -> Vec<f64> {
        readings(&self.system, self.protocol, solutions)
    }
}

/// Readings computed from the solutions for drives of adjacent electrodes, in order.
fn readings(system: &System, protocol: &Protocol, solutions: &[Vec<f64>]) -> Vec<f64> {
    let of = |question: &Measurement| {
        let solution = &solutions[question.drive.plus.0];
        system.voltage(solution, question.sense.plus.0)
            - system.voltage(solution, question.sense.minus.0)
    };
    protocol.measurements().iter().map(of).collect()
}

/// Readings of a solution that was refined with residuals in twice the precision.
fn exact(system: &System, protocol: &Protocol) -> Result<Vec<f64>, Failure> {
    let factor = Factor::<f64>::new(system, None)?;
    let solutions: Vec<Vec<f64>> = (0..system.electrodes)
        .map(|electrode| {
            let right = system.drive(electrode);
            let mut x = factor.solve(&right);
            let mut rest = vec![0.0; x.len()];
            for _ in 0..6 {
                let step = factor.solve(&system.residual(&right, &x, &rest));
                for i in 0..x.len() {
                    let wanted = rest[i] + step[i];
                    let sum = x[i] + wanted;
                    rest[i] = wanted - (sum - x[i]);
                    x[i] = sum;
                }
            }
            x
        })
        .collect();
    Ok(readings(system, protocol, &solutions))
}

/// The sparse Cholesky factor of a library (faer), in single or double precision.
struct Factor<T: ComplexField> {
    symbolic: SymbolicLlt<usize>,
    factor: Llt<usize, T>,
    /// Scales the matrix to a unit diagonal, because the range of single precision is small.
    scale: Vec<f64>,
}

impl<T: Number + ComplexField> Factor<T> {
    fn new(system: &System, symbolic: Option<&SymbolicLlt<usize>>) -> Result<Self, Failure> {
        let n = system.size();
        let scale: Vec<f64> = (0..n)
            .map(|i| {
                let diagonal = system.rows[i].iter().find(|(j, _)| *j == i);
                diagonal.map_or(1.0, |(_, value)| value.sqrt().recip())
            })
            .collect();
        let entries: Vec<Triplet<usize, usize, T>> = (0..n)
            .flat_map(|i| {
                let scale = &scale;
                system.rows[i]
                    .iter()
                    .filter(move |(j, _)| *j <= i)
                    .map(move |(j, value)| Triplet::new(i, *j, T::of(value * scale[i] * scale[*j])))
            })
            .collect();
        let failed = |what: String| Failure::because(format!("sparse Cholesky: {what}"));
        let matrix = SparseColMat::<usize, T>::try_new_from_triplets(n, n, &entries)
            .map_err(|fault| failed(format!("{fault:?}")))?;
        let symbolic = match symbolic {
            Some(symbolic) => symbolic.clone(),
            None => SymbolicLlt::try_new(matrix.symbolic(), faer::Side::Lower)
                .map_err(|fault| failed(format!("{fault:?}")))?,
        };
        let factor =
            Llt::try_new_with_symbolic(symbolic.clone(), matrix.as_ref(), faer::Side::Lower)
                .map_err(|fault| failed(format!("{fault:?}")))?;
        Ok(Self {
            symbolic,
            factor,
            scale,
        })
    }

    fn solve(&self, right: &[f64]) -> Vec<f64> {
        // the right side is scaled, because small residuals would underflow in single precision
        let size = right.iter().fold(0.0_f64, |size, v| size.max(v.abs()));
        if size == 0.0 {
            return vec![0.0; right.len()];
        }
        let mut x = Mat::<T>::from_fn(right.len(), 1, |i, _| {
            T::of(right[i] * self.scale[i] / size)
        });
        self.factor.solve_in_place(x.as_mut());
        (0..right.len())
            .map(|i| x[(i, 0)].plain() * self.scale[i] * size)
            .collect()
    }
}

fn direct<T: Number + ComplexField>(
    task: &Task<'_>,
    line: &str,
    refinements: &[usize],
    points: &mut Vec<Point>,
) -> Result<(), Failure> {
    let first = match Factor::<T>::new(&task.system, None) {
        Ok(first) => first,
        // a pivot that is not positive in this precision is a result, not an error
        Err(_) => return Ok(()),
    };
    for &steps in refinements {
        let solve = || -> Result<Vec<Vec<f64>>, Failure> {
            let factor = Factor::<T>::new(&task.system, Some(&first.symbolic))?;
            let rest = vec![0.0; task.system.size()];
            Ok((0..task.system.electrodes)
                .map(|electrode| {
                    let right = task.system.drive(electrode);
                    let mut x = factor.solve(&right);
                    for _ in 0..steps {
                        let residual = task.system.residual(&right, &x, &rest);
                        let step = factor.solve(&residual);
                        x.iter_mut().zip(step).for_each(|(x, step)| *x += step);
                    }
                    x
                })
                .collect())
        };
        let found = task.readings(&solve()?);
        let times = timed(task.times, || solve().map(drop))?;
        points.push(task.point(line, &format!("{steps} refinements"), &found, times));
    }
    Ok(())
}

fn iterative(
    task: &Task<'_>,
    line: &str,
    preconditioner: &Preconditioner,
    tolerance: f64,
    points: &mut Vec<Point>,
) -> Result<(), Failure> {
    let (mut steps, mut there) = (0, true);
    let mut solutions = Vec::new();
    let mut solve = || {
        (steps, there) = (0, true);
        solutions = (0..task.system.electrodes)
            .map(|electrode| {
                let right = task.system.drive(electrode);
                let (x, needed, done) =
                    conjugate_gradients(&task.system, &right, preconditioner, tolerance);
                steps += needed;
                there &= done;
                x
            })
            .collect();
        Ok(())
    };
    // for solvers that take seconds, the median of a few runs is sufficient
    let first = timed(1, &mut solve)?;
    let times = match first.cold > 0.5 {
        true => timed(3, &mut solve)?,
        false => timed(task.times, &mut solve)?,
    };
    let found = task.readings(&solutions);
    let setting = match there {
        true => format!("residual {tolerance:.0e}"),
        false => format!("residual {tolerance:.0e} not reached"),
    };
    points.push(task.point(line, &setting, &found, times).with(
        "steps a drive",
        steps as f64 / task.system.electrodes as f64,
    ));
    Ok(())
}
