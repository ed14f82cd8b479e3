//! Hard cases 9, 12 and 13: slivers, the effect of the discretisation error on a difference, and the sensitivity.

use std::sync::Arc;

use eit::{DiscTank, Forward, Mesh, MeshError};
use nalgebra::{DMatrix, DVector};

use crate::failure::{Attempt, Failure};
use crate::stability::outcome::{Check, Naive, Outcome, apart, naive, worst};
use crate::stability::solvers::bordered::{Bordered, Ground};
use crate::stability::solvers::tank::{Tank, refused};

/// 9: a triangle with an angle of a hundredth of a degree.
pub(crate) fn sliver() -> Result<Outcome, Failure> {
    let tank = Tank::small()?;
    let before = tank.exact(&tank.contact, &tank.sigma);
    let flat = with_sliver(&tank, 0.01)?;
    let [ours, single] = sliver_errors(&tank, &before, 0.01)?;
    let sigma = vec![tank.sigma[0]; flat.triangles().len()];
    let forward = Forward::new(Arc::new(flat.clone()), &tank.contact).map_err(refused)?;
    let jacobian = forward.jacobian(&sigma, &tank.protocol).map_err(refused)?;
    let mut off = 0.0;
    let mut abrupt = 0.0;
    // the sliver, and the two triangles that share its corner
    let last = sigma.len() - 1;
    for t in [split(&tank), last - 1, last] {
        let moved = |h: f64| {
            let mut sigma = sigma.clone();
            sigma[t] *= 1.0 + h;
            forward.readings(&sigma, &tank.protocol).map_err(refused)
        };
        let exact = jacobian.column(t) * sigma[t];
        let mut least = f64::INFINITY;
        for h in [1e-2, 3e-3, 1e-3] {
            let central = (moved(h)? - moved(-h)?) / (2.0 * h);
            least = least.min((&central - &exact).amax() / exact.amax());
        }
        off = worst(off, least);
        let hasty = (moved(1e-8)? - moved(0.0)?) / 1e-8;
        abrupt = worst(abrupt, (&hasty - &exact).amax() / exact.amax());
    }
    let quality = flat.quality();
    let mut turned = flat.triangles().to_vec();
    turned[0].swap(1, 2);
    let [a, b, c] = turned[0].map(|node| flat.nodes()[node]);
    let unsigned = ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])).abs();
    // naive: the law of cosines in f32, which rounds the cosine of such an angle to 1
    let by_cosine = flat
        .triangles()
        .iter()
        .flat_map(|corners| [0, 1, 2].map(|k| cosine(&flat, *corners, k).acos().to_degrees()))
        .fold(f64::INFINITY, |least, angle| least.min(f64::from(angle)));
    let inverted = Mesh::new(
        flat.nodes().to_vec(),
        turned,
        flat.electrode_edges().to_vec(),
        None,
    );
    let accepted = !matches!(inverted, Err(MeshError::Inverted { element: 0, .. }));
    Ok(Outcome::of([
        Check::at_most(
            "change of V by one sliver of 0.01 degrees",
            naive(single, "not finite in f32"),
            ours,
            1e-7,
        ),
        Check::at_most(
            "its sensitivity against differences",
            Naive::Error(abrupt),
            off,
            1e-4,
        ),
        Check::at_most(
            "smallest angle as reported, less 0.01 degrees",
            Naive::Error((by_cosine - 0.01).abs()),
            (quality.smallest_angle - 0.01).abs(),
            1e-4,
        ),
        Check::at_most(
            "inverted triangles accepted",
            Naive::Error(f64::from(u8::from(unsigned > 0.0))),
            f64::from(u8::from(accepted)),
            0.0,
        ),
    ])
    .noted("a node inside a triangle of one conductance changes nothing in exact arithmetic: every change is rounding. Naive: f32; a one-sided difference with a step of 1e-8; the law of cosines in f32; |area|, which hides the inversion"))
}

/// Cosine of a triangle's angle at its corner `k`, by the law of cosines in f32.
fn cosine(mesh: &Mesh, corners: [usize; 3], k: usize) -> f32 {
    let [at, one, other] = [0, 1, 2].map(|i| mesh.nodes()[corners[(k + i) % 3]].map(|x| x as f32));
    let square = |a: [f32; 2], b: [f32; 2]| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2);
    let (near, far, opposite) = (square(at, one), square(at, other), square(one, other));
    ((near + far - opposite) / (2.0 * (near * far).sqrt())).min(1.0)
}

/// Errors of V on a mesh with a sliver of the given angle: ours, and the textbook's in f32.
pub(crate) fn sliver_errors(
    tank: &Tank,
    before: &[f64],
    degrees: f64,
) -> Result<[f64; 2], Failure> {
    let flat = with_sliver(tank, degrees)?;
    let sigma = vec![tank.sigma[0]; flat.triangles().len()];
    let single = Bordered::<f32>::new(&flat, &tank.contact, &sigma, &[], Ground::Node)
        .readings(&tank.protocol);
    let ours = Forward::new(Arc::new(flat), &tank.contact)
        .and_then(|forward| forward.readings(&sigma, &tank.protocol))
        .map_err(refused)?;
    Ok([apart(ours.as_slice(), before), apart(&single, before)])
}

/// The triangle to split.
fn split(tank: &Tank) -> usize {
    tank.patch([0.3, 0.3], 0.2)[0]
}

/// The mesh with a triangle split at a point so close to the middle of its first side that two angles have this size,
/// degrees.
fn with_sliver(tank: &Tank, degrees: f64) -> Result<Mesh, Failure> {
    let mesh = &tank.mesh;
    let t = split(tank);
    let [a, b, c] = mesh.triangles()[t];
    let [p, q, _] = mesh.corners(t);
    let length = mesh.edge_length([a, b]);
    let up = 0.5 * length * degrees.to_radians().tan();
    let normal = [-(q[1] - p[1]) / length, (q[0] - p[0]) / length];
    let mut nodes = mesh.nodes().to_vec();
    nodes.push([0, 1].map(|i| 0.5 * (p[i] + q[i]) + up * normal[i]));
    let n = nodes.len() - 1;
    let mut triangles = mesh.triangles().to_vec();
    triangles[t] = [a, b, n];
    triangles.extend([[b, c, n], [c, a, n]]);
    Mesh::new(nodes, triangles, mesh.electrode_edges().to_vec(), None)
        .attempt("the mesh with a sliver")
}

/// 12: the discretisation error of a voltage, and of a difference.
pub(crate) fn mesh_error() -> Result<Outcome, Failure> {
    let solve = |fineness: f64, seeding: [u32; 2]| -> Result<[DVector<f64>; 2], Failure> {
        let of = |seeding, loaded| -> Result<DVector<f64>, Failure> {
            let tank = Tank::of(DiscTank {
                electrodes: 8,
                arc_deg: 12.0,
                fineness,
                seeding,
                ..DiscTank::default()
            })?;
            let r = tank.radius();
            let sigma: Vec<f64> = (0..tank.sigma.len())
                .map(|t| {
                    let [x, y] = tank.mesh.centroid(t);
                    let square = ((x / r - 0.3).powi(2) + (y / r).powi(2)) / 0.04;
                    let loss = if loaded { 0.05 * (-square).exp() } else { 0.0 };
                    tank.sigma[t] * (1.0 - loss)
                })
                .collect();
            let readings = tank
                .forward(&tank.contact)?
                .readings(&sigma, &tank.protocol);
            readings.map_err(refused)
        };
        let (before, after) = (of(seeding[0], false)?, of(seeding[1], true)?);
        Ok([before.clone(), after - before])
    };
    let [exact, exact_change] = solve(4.0, [0, 0])?;
    let [volts, change] = solve(0.7, [0, 0])?;
    let [_, mixed] = solve(0.7, [0, 1])?;
    let off = |a: &DVector<f64>, b: &DVector<f64>| (a - b).norm() / b.norm();
    let whole = off(&volts, &exact);
    let in_change = off(&change, &exact_change);
    Ok(Outcome::of([
        Check::at_most(
            "error of dv on a coarse mesh, of dv",
            Naive::Error(off(&mixed, &exact_change)),
            in_change,
            0.016,
        ),
        Check::at_most(
            "the same error, of V",
            Naive::Error(whole),
            in_change * exact_change.norm() / exact.norm(),
            1e-4,
        ),
    ])
    .noted("naive: another mesh for the loaded sheet; and, in the line below, the error of V itself, which fine meshes reduce"))
}

/// 13: the sensitivity compared with finite differences.
pub(crate) fn sensitivity() -> Result<Outcome, Failure> {
    let tank = Tank::small()?;
    let sigma: Vec<f64> = (0..tank.sigma.len())
        .map(|t| tank.sigma[t] * (0.8 * (3.7 * t as f64).sin()).exp())
        .collect();
    let forward = tank.forward(&tank.contact)?;
    let at = |sigma: &[f64]| forward.readings(sigma, &tank.protocol).map_err(refused);
    let jacobian = forward.jacobian(&sigma, &tank.protocol).map_err(refused)?;
    let volts = at(&sigma)?;
    let (mut least, mut hasty, mut not_v) = (0.0, 0.0, 0);
    for t in (0..sigma.len()).step_by(sigma.len() / 5) {
        let exact = jacobian.column(t) * sigma[t];
        let moved = |h: f64| {
            let mut sigma = sigma.clone();
            sigma[t] *= 1.0 + h;
            at(&sigma)
        };
        let error = |h: f64| -> Result<f64, Failure> {
            let central = (moved(h)? - moved(-h)?) / (2.0 * h);
            Ok((central - &exact).amax() / exact.amax())
        };
        let best = error(1e-3)?.min(error(3e-4)?).min(error(1e-4)?);
        least = worst(least, best);
        not_v += u8::from(error(1e-1)? < 10.0 * best) + u8::from(error(1e-9)? < 10.0 * best);
        let forward_only = (moved(1e-3)? - &volts) / 1e-3;
        hasty = worst(hasty, (forward_only - &exact).amax() / exact.amax());
    }
    let by_contact: DMatrix<f64> = forward
        .contact_jacobian(&sigma, &tank.protocol)
        .map_err(refused)?;
    let along_sigma = &jacobian * DVector::from_column_slice(&sigma);
    let along_contact = by_contact * DVector::from_column_slice(&tank.contact);
    let euler =
        |contacts: f64| (&along_sigma - contacts * &along_contact + &volts).amax() / volts.amax();
    Ok(Outcome::of([
        Check::at_most(
            "against central differences, best of 1e-3 to 1e-4",
            Naive::Error(hasty),
            least,
            1e-6,
        ),
        Check::at_most(
            "ends of the curve of errors that do not rise",
            Naive::Absent("a property of all differences".into()),
            f64::from(not_v),
            0.0,
        ),
        Check::at_most(
            "sum sigma dV/dsigma - sum z dV/dz + V, of V",
            Naive::Error(euler(-1.0)),
            euler(1.0),
            1e-10,
        ),
    ])
    .noted("naive: a one-sided difference with a step of 1e-3; and a wrong sign in dV/dz"))
}
