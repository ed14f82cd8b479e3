//! A round tank with electrodes on arcs of its wall.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use super::{FINENESS, positive, refused, within};
use crate::mesh::generation::{Domain, fill, length};
use crate::{Mesh, MeshError};

const PRESET: &str = "disc-tank";

/// A disc with its centre at the origin, `electrodes` arcs counter-clockwise on its wall, evenly spaced.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DiscTank {
    /// Radius, mm.
    pub radius_mm: f64,
    /// Number of electrodes.
    pub electrodes: usize,
    /// Width of an electrode as seen from the centre, degrees.
    pub arc_deg: f64,
    /// Direction of the first electrode's centre, degrees counter-clockwise from +x.
    pub first_deg: f64,
    /// Divides every edge length: 2 gives about four times the triangles.
    pub fineness: f64,
    /// Edges under an electrode at fineness 1, at least four; they are shorter towards its ends.
    pub electrode_edges: usize,
    /// Edge length far from every electrode at fineness 1, as a share of the radius.
    pub largest_share: f64,
    /// Growth of the edge length with the distance from the nearest electrode end at fineness 1.
    pub growth: f64,
    /// A different number gives a different mesh with the same sizes.
    pub seeding: u32,
    /// Resistance of the unloaded tank, ohm per square.
    pub sheet_ohm: f64,
    /// Resistance of one contact, ohm.
    pub contact_ohm: f64,
}

impl Default for DiscTank {
    fn default() -> Self {
        Self {
            radius_mm: 150.0,
            electrodes: 16,
            arc_deg: 5.0,
            first_deg: 0.0,
            fineness: 1.0,
            electrode_edges: 8,
            largest_share: 1.0 / 14.0,
            growth: 0.22,
            seeding: 0,
            sheet_ohm: 1000.0,
            contact_ohm: 100.0,
        }
    }
}

impl DiscTank {
    /// Sheet conductance of the unloaded tank, siemens per square.
    pub fn conductance(&self) -> f64 {
        1.0 / self.sheet_ohm
    }

    /// Contact impedance of each electrode, ohm m: contact resistance times the arc's length.
    pub fn contact_ohm_m(&self) -> Vec<f64> {
        let length = self.radius_mm * 1e-3 * self.arc_deg.to_radians();
        vec![self.contact_ohm * length; self.electrodes]
    }

    /// The mesh: a polygon with its corners on the circle, one at both ends of every electrode.
    ///
    /// # Errors
    /// Inconsistent dimensions; the key is named.
    pub fn mesh(&self) -> Result<Mesh, MeshError> {
        self.check()?;
        let pitch = TAU / self.electrodes as f64;
        let arc = self.arc_deg.to_radians();
        let under = ((self.electrode_edges as f64 * self.fineness).round() as usize).max(4);
        // cosine spacing: the first of n edges is about (pi/2n)^2 of the arc; mixed with even spacing to limit the
        // ratio
        let graded: Vec<f64> = (0..=under)
            .map(|k| {
                let even = k as f64 / under as f64;
                0.5 * (even + 0.5 * (1.0 - (std::f64::consts::PI * even).cos()))
            })
            .collect();
        let end = (graded[1] * arc).min(0.5 * (pitch - arc));
        let far = (self.largest_share / self.fineness).max(end);
        // lengths in units of the radius
        let growth = self.growth / self.fineness;
        let gap = cut_gap(pitch - arc, end, growth, far);
        let mut angles = Vec::new();
        let mut electrode_edges = Vec::new();
        for electrode in 0..self.electrodes {
            let start = self.first_deg.to_radians() + electrode as f64 * pitch - 0.5 * arc;
            let first = angles.len();
            angles.extend(graded.iter().map(|share| start + share * arc));
            electrode_edges.push((first..first + under).map(|k| [k, k + 1]).collect());
            angles.extend(gap.iter().map(|at| start + arc + at));
        }
        let boundary: Vec<[f64; 2]> = angles.iter().map(|a| [a.cos(), a.sin()]).collect();
        let count = boundary.len();
        let segments = (0..count).map(|k| [k, (k + 1) % count]).collect();
        let ends: Vec<[f64; 2]> = (0..self.electrodes)
            .flat_map(|electrode| {
                let middle = self.first_deg.to_radians() + electrode as f64 * pitch;
                [middle - 0.5 * arc, middle + 0.5 * arc].map(|a| [a.cos(), a.sin()])
            })
            .collect();
        let size = |p: [f64; 2]| {
            // one root of the smallest square: the same bits as the smallest root
            let nearest = ends
                .iter()
                .map(|q| square(p[0] - q[0], p[1] - q[1]))
                .fold(f64::INFINITY, f64::min)
                .sqrt();
            (end + growth * nearest).min(far)
        };
        let safe = inscribed(&boundary);
        let inside = |p: [f64; 2]| square(p[0], p[1]) < safe || in_polygon(p, &boundary);
        let (nodes, triangles) = fill(&Domain {
            boundary: boundary.clone(),
            segments,
            inside: &inside,
            size: &size,
            largest: far,
            seeding: self.seeding,
        })
        .map_err(|fault| refused(PRESET, fault))?;
        let radius = self.radius_mm * 1e-3;
        let metres = nodes
            .iter()
            .map(|p| [p[0] * radius, p[1] * radius])
            .collect();
        Mesh::new(metres, triangles, electrode_edges, None)
    }

    fn check(&self) -> Result<(), MeshError> {
        positive(
            PRESET,
            &[
                ("radius_mm", self.radius_mm),
                ("arc_deg", self.arc_deg),
                ("fineness", self.fineness),
                ("electrode_edges", self.electrode_edges as f64),
                ("largest_share", self.largest_share),
                ("growth", self.growth),
                ("sheet_ohm", self.sheet_ohm),
                ("contact_ohm", self.contact_ohm),
            ],
        )?;
        let refuse = |fault| Err(refused(PRESET, fault));
        within(PRESET, "electrodes", self.electrodes, [2, 256])?;
        within(PRESET, "fineness", self.fineness, FINENESS)?;
        if self.electrode_edges > 64 {
            return refuse(format!(
                "electrode_edges is {}, it must be at most 64",
                self.electrode_edges
            ));
        }
        within(PRESET, "largest_share", self.largest_share, [0.005, 0.5])?;
        if !self.first_deg.is_finite() {
            return refuse("first_deg is not a number".into());
        }
        let most = 360.0 / self.electrodes as f64;
        if self.arc_deg >= 0.95 * most || self.arc_deg < 0.01 * most {
            return refuse(format!(
                "arc_deg is {}, {} electrodes leave room for {:.2} to {:.2}",
                self.arc_deg,
                self.electrodes,
                0.01 * most,
                0.95 * most
            ));
        }
        Ok(())
    }
}

/// Inner points of a gap of the given length: edges grow from its ends to its middle.
fn cut_gap(length: f64, end: f64, growth: f64, far: f64) -> Vec<f64> {
    let size = |p: [f64; 2]| (end + growth * p[0].min(length - p[0])).min(far);
    crate::mesh::generation::cut([0.0, 0.0], [length, 0.0], &size)
        .into_iter()
        .map(|p| p[0])
        .collect()
}

/// Square of a radius about the origin within which every point is inside the polygon, despite rounding: this test
/// alone decides most points.
fn inscribed(corners: &[[f64; 2]]) -> f64 {
    let middles = corners
        .iter()
        .zip(corners.iter().cycle().skip(1))
        .map(|(a, b)| square(0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])));
    middles.fold(1.0, f64::min) * (1.0 - 1e-6)
}

fn square(x: f64, y: f64) -> f64 {
    x * x + y * y
}

/// Whether a point lies inside a polygon inscribed in the unit circle.
fn in_polygon(p: [f64; 2], corners: &[[f64; 2]]) -> bool {
    length(p[0], p[1]) < 1.0
        && corners
            .iter()
            .zip(corners.iter().cycle().skip(1))
            .all(|(a, b)| (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) > 0.0)
}
