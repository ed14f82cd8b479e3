//! Hard cases 1 to 4: no conductance, insulators, metal, and single precision.

use std::sync::Arc;

use eit::{Forward, Mesh};
use qd::Quad;
use survey::Dipole;

use crate::failure::{Attempt, Failure};
use crate::stability::outcome::{Check, Naive, Outcome, apart, naive, worst};
use crate::stability::solvers::bordered::{Bordered, Factored, Ground, read};
use crate::stability::solvers::conjugate::{self, Until};
use crate::stability::solvers::tank::{Tank, refused};

/// Centre of the load, in units of the radius: away from electrodes and from the ground node.
pub(crate) const CENTRE: [f64; 2] = [0.45, 0.1];
pub(crate) const RADIUS: f64 = 0.3;

/// 1: a hole that is removed from the mesh, or kept in the mesh without conductance.
pub(crate) fn no_conductance() -> Result<Outcome, Failure> {
    let tank = Tank::small()?;
    let hole = tank.patch(CENTRE, RADIUS);
    let sigma = tank.with(&hole, 0.0);
    let forward = tank.forward(&tank.contact)?;
    let fields = forward
        .solve(&sigma, &[Dipole::adjacent(0, 8)])
        .map_err(refused)?;
    let left = tank.ours(&tank.contact, &sigma)?;
    let out = without(&tank, &hole)?;
    let textbook = tank.textbook::<f64>(&tank.contact, &sigma, Ground::Node);
    let not_finite = left.iter().filter(|v| !v.is_finite()).count();
    Ok(Outcome::of([
        Check::at_most(
            "V of the floor against the hole meshed out",
            naive(apart(&textbook, &out), "0/0 at a node without conductance"),
            apart(&left, &out),
            1e-7,
        ),
        Check::at_most(
            "readings that are not numbers",
            Naive::Error(textbook.iter().filter(|v| !v.is_finite()).count() as f64),
            not_finite as f64,
            0.0,
        ),
        Check::at_most(
            "floored triangles not counted",
            Naive::Error(hole.len() as f64),
            hole.len().abs_diff(fields.floored) as f64,
            0.0,
        ),
    ]))
}

/// Readings of the sheet with a hole in its mesh.
fn without(tank: &Tank, hole: &[usize]) -> Result<Vec<f64>, Failure> {
    let mesh = &tank.mesh;
    let mut new = vec![usize::MAX; mesh.nodes().len()];
    let mut nodes = Vec::new();
    let mut triangles = Vec::new();
    for t in (0..mesh.triangles().len()).filter(|t| !hole.contains(t)) {
        triangles.push(mesh.triangles()[t].map(|node| {
            if new[node] == usize::MAX {
                new[node] = nodes.len();
                nodes.push(mesh.nodes()[node]);
            }
            new[node]
        }));
    }
    let edges = mesh.electrode_edges().iter();
    let edges = edges
        .map(|edges| edges.iter().map(|e| e.map(|node| new[node])).collect())
        .collect();
    let sigma = vec![tank.sigma[0]; triangles.len()];
    let cut = Mesh::new(nodes, triangles, edges, None).attempt("the mesh with a hole")?;
    let readings = Forward::new(Arc::new(cut), &tank.contact)
        .and_then(|forward| forward.readings(&sigma, &tank.protocol))
        .map_err(refused)?;
    Ok(readings.as_slice().to_vec())
}

const INSULATING: [f64; 4] = [1e-4, 1e-8, 1e-12, 1e-16];

/// 2: a load that removes nearly all conductance.
pub(crate) fn insulator() -> Result<Outcome, Failure> {
    let tank = Tank::small()?;
    let patch = tank.patch(CENTRE, RADIUS);
    let limit = tank.exact(&tank.contact, &tank.with(&patch, 1e-30));
    let (mut slope, mut feared, mut rounding, mut single) = (0.0, 0.0, 0.0, 0.0);
    for contrast in INSULATING {
        let sigma = tank.with(&patch, contrast);
        let ours = tank.ours(&tank.contact, &sigma)?;
        let cut = tank.ours(&tank.contact, &tank.with(&patch, contrast.max(1e-3)))?;
        let over = |found: &[f64]| (apart(found, &limit) - 1e-13).max(0.0) / contrast;
        slope = worst(slope, over(&ours));
        feared = worst(feared, over(&cut));
        let exact = tank.exact(&tank.contact, &sigma);
        rounding = worst(rounding, apart(&ours, &exact));
        let f32s = tank.textbook::<f32>(&tank.contact, &sigma, Ground::Node);
        single = worst(single, apart(&f32s, &exact));
    }
    Ok(Outcome::of([
        Check::at_most(
            "(V - limit - 1e-13) over contrast, 1e-4 to 1e-16",
            Naive::Error(feared),
            slope,
            2.0,
        ),
        Check::at_most(
            "V against extended precision",
            naive(single, "not finite in f32"),
            rounding,
            1e-12,
        ),
    ])
    .noted(
        "f64 is accurate enough for this condition number; the errors come from a floor of 1e-3, which is meant to avoid it, and from f32",
    ))
}

const CONDUCTING: [f64; 4] = [1e2, 1e4, 1e6, 1e8];

/// 3: metal on the sheet.
pub(crate) fn metal() -> Result<Outcome, Failure> {
    let tank = Tank::small()?;
    let patch = tank.patch(CENTRE, RADIUS);
    let limit = merged(&tank, &patch);
    let (mut slope, mut steep, mut rounding, mut single) = (0.0, 0.0, 0.0, 0.0);
    let (mut stalled, mut direct) = (0.0, 0.0);
    for contrast in CONDUCTING {
        let sigma = tank.with(&patch, contrast);
        let over = |found: &[f64]| (apart(found, &limit) - 1e-9).max(0.0) * contrast;
        let ours = tank.ours(&tank.contact, &sigma)?;
        slope = worst(slope, over(&ours));
        let f32s = tank.textbook::<f32>(&tank.contact, &sigma, Ground::Node);
        steep = worst(steep, over(&f32s));
        let exact = tank.exact(&tank.contact, &sigma);
        single = worst(single, apart(&f32s, &exact));
        rounding = worst(rounding, apart(&ours, &exact));
        if contrast == 1e8 {
            direct = apart(&ours, &exact);
            let matrix = Bordered::<f64>::new(&tank.mesh, &tank.contact, &sigma, &[], Ground::Node);
            let iterated = read(&tank.protocol, &matrix.electrode, |pair| {
                conjugate::solve(&matrix, &matrix.drive(pair), Until::Residual(1e-12), 20_000)
            });
            stalled = apart(&iterated, &exact);
        }
    }
    Ok(Outcome::of([
        Check::at_most(
            "(V - merged nodes - 1e-9) times contrast, 1e2 to 1e8",
            naive(steep, "not finite in f32"),
            slope,
            2.0,
        ),
        Check::at_most(
            "V at 1e8, residual said to be 1e-12",
            Naive::Error(stalled),
            direct,
            1e-12,
        ),
        Check::at_most(
            "V against extended precision",
            naive(single, "not finite in f32"),
            rounding,
            1e-12,
        ),
    ]))
}

/// Readings with the patch as a single node.
fn merged(tank: &Tank, patch: &[usize]) -> Vec<f64> {
    let nodes: Vec<usize> = patch
        .iter()
        .flat_map(|&t| tank.mesh.triangles()[t])
        .collect();
    Bordered::<Quad>::new(&tank.mesh, &tank.contact, &tank.sigma, &nodes, Ground::Node)
        .readings(&tank.protocol)
}

/// 4: a factor in single precision, alone and refined.
pub(crate) fn single_precision() -> Result<Outcome, Failure> {
    let tank = Tank::small()?;
    let patch = tank.patch(CENTRE, RADIUS);
    let (mut alone, mut refined, mut ours, mut rounds) = (0.0, 0.0, 0.0, 0);
    for contrast in [1.0, 1e-2, 1e2] {
        let sigma = tank.with(&patch, contrast);
        let exact = tank.exact(&tank.contact, &sigma);
        let f32s = tank.textbook::<f32>(&tank.contact, &sigma, Ground::Node);
        alone = worst(alone, apart(&f32s, &exact));
        let (found, took) = refine(&tank, &sigma, true);
        refined = worst(refined, apart(&found, &exact));
        rounds = rounds.max(took);
        ours = worst(ours, apart(&tank.ours(&tank.contact, &sigma)?, &exact));
    }
    let sigma = tank.with(&patch, 1e10);
    let exact = tank.exact(&tank.contact, &sigma);
    let (blind, _) = refine(&tank, &sigma, false);
    let (fallen_back, _) = refine(&tank, &sigma, true);
    Ok(Outcome::of([
        Check::at_most("V in f64, refined", naive(alone, "not finite in f32"), ours, 1e-12),
        Check::at_most(
            "V of an f32 factor, refined in f64",
            naive(alone, "not finite in f32"),
            refined,
            1e-12,
        ),
        Check::at_most(
            "its steps",
            Naive::Absent("one solution has no steps".into()),
            f64::from(rounds),
            6.0,
        ),
        Check::at_most(
            "V at 1e10 where steps do not halve and f64 takes over",
            naive(apart(&blind, &exact), "the steps diverge"),
            apart(&fallen_back, &exact),
            1e-4,
        ),
    ])
    .noted(
        "no program of the project factors in f32; this measures up to which contrast a refined f32 solution would be usable. Above it the naive form uses the textbook's f64 matrix, which loses digits at 1e10 that ours keeps",
    ))
}

/// An f32 factor refined by f64 residuals; with `care`, falls back to the f64 factor if a step does not halve the
/// residual.
fn refine(tank: &Tank, sigma: &[f64], care: bool) -> (Vec<f64>, u32) {
    let matrix = |_| Bordered::<f64>::new(&tank.mesh, &tank.contact, sigma, &[], Ground::Node);
    let wide = matrix(());
    let narrow: Factored<f32> =
        Bordered::<f32>::new(&tank.mesh, &tank.contact, sigma, &[], Ground::Node).factored();
    let fall_back = matrix(()).factored();
    let most = std::cell::Cell::new(0);
    let readings = read(&tank.protocol, &wide.electrode, |pair| {
        let right = wide.drive(pair);
        let norm = |r: &[f64]| r.iter().map(|r| r * r).sum::<f64>().sqrt();
        let mut x = vec![0.0; wide.size];
        let mut left = right.clone();
        for step in 1..=8 {
            // the residual is scaled so that it does not underflow in f32
            let size = norm(&left);
            let scaled = left.iter().map(|r| (r / size) as f32).collect();
            for (x, dx) in x.iter_mut().zip(narrow.solve(scaled)) {
                *x += f64::from(dx) * size;
            }
            let now: Vec<f64> = wide
                .times(&x)
                .iter()
                .zip(&right)
                .map(|(a, b)| b - a)
                .collect();
            if norm(&now) < 1e-14 * norm(&right) {
                break;
            }
            // false for NaN
            let halved = norm(&now) <= 0.5 * size;
            if care && !halved {
                // a residual of the size of the rounding error cannot be halved either
                let settled = size <= 1e-9 * norm(&right);
                if !settled {
                    return fall_back.solve(right);
                }
                break;
            }
            most.set(most.get().max(step));
            left = now;
        }
        x
    });
    (readings, most.get())
}
