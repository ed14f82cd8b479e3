//! The loads of a test set, drawn from its random stream.

use std::f64::consts::TAU;

use eit::{Mesh, bounding_box};
use phantom::{Load, Shape, loss_of_pressure, paper, pressure_kpa};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::TestSetName;
use crate::failure::{Attempt, Failure};

/// Loss of conductance under a press.
const LOSS: f64 = 0.5;
/// Algorithm 1 of the paper: maximum number of polygons, their radius (mm), and their number of vertices.
const POLYGONS: usize = 4;
const RADIUS_MM: f64 = 70.0;
const VERTICES: usize = 5;

/// Masses (kg) and diameters (mm) of the presses of known mass, used in turn.
const MASSES_KG: [f64; 6] = [0.2, 0.5, 1.0, 2.0, 3.0, 4.0];
const DIAMETERS_MM: [f64; 4] = [25.0, 30.0, 40.0, 50.0];

/// The load of one frame.
pub(crate) struct Pressed {
    /// Mass, kg, if known.
    pub(super) mass: Option<f64>,
    pub(crate) loads: Vec<Load>,
    /// Centre and diameter, mm, if the load is one disc.
    pub(super) disc: Option<([f64; 2], f64)>,
}

/// The load of frame `k` of a set.
pub(super) fn draw(set: TestSetName, k: usize, mesh: &Mesh, random: &mut ChaCha8Rng) -> Pressed {
    match set {
        TestSetName::Presses10 => press(mesh, 10.0, random),
        TestSetName::Presses30 => press(mesh, 30.0, random),
        TestSetName::Polygons => polygons(mesh, random),
        TestSetName::Test1 => disc(paper::s1(paper::test1_positions()[k]), 10.0),
        TestSetName::Test2 => {
            let shape = [paper::s2, paper::s3, paper::s4][k / 3];
            Pressed {
                mass: None,
                loads: vec![shape(paper::TEST2_MM[k % 3])],
                disc: None,
            }
        }
        TestSetName::Masses => mass(mesh, k, random),
        TestSetName::Sizes => press(mesh, 20.0 * (1 + k / 4) as f64, random),
    }
}

/// Refuses loads that reach beyond the region of a mesh, because maps would show only a part of them. Polygons are cut at
/// its border when they are drawn.
///
/// # Errors
/// The first such load, and the extent of the region.
pub(super) fn check_extent(
    set: TestSetName,
    drawn: &[Pressed],
    mesh: &Mesh,
) -> Result<(), Failure> {
    if set == TestSetName::Polygons {
        return Ok(());
    }
    let [low, high] = bounds(mesh);
    let beyond = |load: &&Load| {
        let outline = load.outline().into_iter();
        let [from, to] = bounding_box(outline.map(|at| at.map(|metres| 1e3 * metres)));
        (0..2).any(|axis| {
            // the polygon of a disc reaches 3e-5 of its radius beyond the circle, and a disc may fit exactly
            let allowed = 1e-4 * (to[axis] - from[axis]);
            from[axis] < low[axis] - allowed || to[axis] > high[axis] + allowed
        })
    };
    let mut loads = drawn.iter().flat_map(|pressed| &pressed.loads);
    loads.find(beyond).map_or(Ok(()), |load| {
        let [x, y] = load.centre_mm;
        let shape = match load.shape {
            Shape::Disc { diameter_mm } => format!("a press of {diameter_mm} mm"),
            _ => format!("the shape {}", load.name),
        };
        Err(Failure::usage(format!(
            "the set {} has {shape} at ({x:.1}, {y:.1}) mm, which does not fit into the region: the middles of its \
             triangles lie from {:.1} to {:.1} mm in x, from {:.1} to {:.1} mm in y; take a larger sheet or region (--measure), or a set of smaller presses",
            set.name(),
            low[0],
            high[0],
            low[1],
            high[1]
        )))
    })
}

/// Relative change of every triangle of a mesh's region, in proportion to its covered share; the remaining shares under
/// overlapping loads are multiplied.
///
/// # Errors
/// A load without an area.
pub fn true_map(mesh: &Mesh, loads: &[Load]) -> Result<Vec<f64>, Failure> {
    let mut kept = vec![1.0; mesh.triangles().len()];
    for load in loads {
        let covered = load.coverage(mesh).attempt("the truth")?;
        for (triangle, share) in covered {
            kept[triangle] *= 1.0 - load.loss * share;
        }
    }
    Ok(mesh.region().iter().map(|&t| kept[t] - 1.0).collect())
}

/// Lowest and highest corner of the region's centroids, mm.
pub(crate) fn bounds(mesh: &Mesh) -> [[f64; 2]; 2] {
    let centroids = mesh.region_centroids().into_iter();
    bounding_box(centroids.map(|centroid| centroid.map(|m| m * 1e3)))
}

/// A disc at a random position, completely inside the region; diameter in mm.
pub(crate) fn press(mesh: &Mesh, diameter: f64, random: &mut ChaCha8Rng) -> Pressed {
    let [low, high] = bounds(mesh);
    let margin = 0.5 * diameter;
    let centre = [0, 1].map(|axis| {
        let (from, to) = (low[axis] + margin, high[axis] - margin);
        from + random.random::<f64>() * (to - from)
    });
    disc(Load::disc(centre, diameter, LOSS), diameter)
}

fn disc(load: Load, diameter: f64) -> Pressed {
    Pressed {
        mass: None,
        disc: Some((load.centre_mm, diameter)),
        loads: vec![load],
    }
}

/// A press of known mass. Masses and diameters are combined in turn, so that each pressure occurs at several positions.
fn mass(mesh: &Mesh, k: usize, random: &mut ChaCha8Rng) -> Pressed {
    let (mass, diameter) = (MASSES_KG[k % 6], DIAMETERS_MM[(k + k / 12) % 4]);
    let mut pressed = press(mesh, diameter, random);
    let kpa = pressure_kpa(1e3 * mass, pressed.loads[0].shape.area());
    pressed.loads[0].loss = loss_of_pressure(kpa, paper::HALF_KPA);
    pressed.mass = Some(mass);
    pressed
}

/// A case of Algorithm 1, drawn again until it has a load. The polygons are clipped at the region's border as in
/// training.
pub(crate) fn polygons(mesh: &Mesh, random: &mut ChaCha8Rng) -> Pressed {
    let [low, high] = bounds(mesh);
    loop {
        let mut loads = Vec::new();
        for _ in 0..random.random_range(0..=POLYGONS) {
            let centre =
                [0, 1].map(|axis| low[axis] + random.random::<f64>() * (high[axis] - low[axis]));
            let radius = random.random::<f64>() * RADIUS_MM;
            let mut angles: Vec<f64> = (0..random.random_range(0..=VERTICES))
                .map(|_| random.random::<f64>() * TAU)
                .collect();
            let loss = random.random::<f64>();
            angles.sort_by(f64::total_cmp);
            let points: Vec<[f64; 2]> = angles
                .iter()
                .map(|angle| {
                    [
                        centre[0] + radius * angle.cos(),
                        centre[1] + radius * angle.sin(),
                    ]
                })
                .collect();
            let points = within(points, [low, high])
                .into_iter()
                .map(|p| [p[0] - centre[0], p[1] - centre[1]])
                .collect();
            let load = Load {
                name: format!("polygon {}", loads.len() + 1),
                shape: Shape::Polygon { points_mm: points },
                centre_mm: centre,
                turn_deg: 0.0,
                loss,
            };
            if load.check().is_ok() {
                loads.push(load);
            }
        }
        let seen = |load: &Load| load.coverage(mesh).is_ok_and(|covered| !covered.is_empty());
        loads.retain(seen);
        if !loads.is_empty() {
            return Pressed {
                mass: None,
                loads,
                disc: None,
            };
        }
    }
}

/// A convex polygon clipped by a box (Sutherland and Hodgman).
fn within(mut points: Vec<[f64; 2]>, [low, high]: [[f64; 2]; 2]) -> Vec<[f64; 2]> {
    for (axis, border, sign) in [
        (0, low[0], 1.0),
        (0, high[0], -1.0),
        (1, low[1], 1.0),
        (1, high[1], -1.0),
    ] {
        let depth = |p: &[f64; 2]| sign * (p[axis] - border);
        let count = points.len();
        let mut kept: Vec<[f64; 2]> = Vec::with_capacity(count + 1);
        for k in 0..count {
            let (p, q) = (points[(k + count - 1) % count], points[k]);
            if (depth(&p) >= 0.0) != (depth(&q) >= 0.0) {
                let share = depth(&p) / (depth(&p) - depth(&q));
                kept.push([0, 1].map(|i| p[i] + share * (q[i] - p[i])));
            }
            if depth(&q) >= 0.0 {
                kept.push(q);
            }
        }
        points = kept;
    }
    points.dedup_by(|a, b| (a[0] - b[0]).hypot(a[1] - b[1]) < 1e-9);
    points
}
