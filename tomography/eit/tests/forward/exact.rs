//! Readings against the exact solution of the discrete system, at the paper's size and for contacts of any size.
//!
//! With x(a) a solution of the drive a in double precision and r(a) its residual in the system K, assembled
//! independently in twice that precision from the nodes, the exact voltage of the pair c is bᵀ(c) x(a) + x(c)ᵀ r(a), up
//! to the square of the error of x: about 30 digits.

#[allow(dead_code)] // also holds functions for other tests
use std::ops::{Add, Mul, Sub};
use std::sync::Arc;

use crate::parts::spread;
use eit::{Case, Fields, Forward, Mesh, PaperSheet};
use survey::{Dipole, Protocol};

/// A number as a sum of two: about 32 digits (Dekker 1971).
#[derive(Clone, Copy)]
struct Twice(f64, f64);

impl From<f64> for Twice {
    fn from(x: f64) -> Self {
        Self(x, 0.0)
    }
}

/// The sum of two numbers and its rounding.
fn sum(a: f64, b: f64) -> Twice {
    let s = a + b;
    let t = s - a;
    Twice(s, (a - (s - t)) + (b - t))
}

impl Add for Twice {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        let Self(s, e) = sum(self.0, other.0);
        sum(s, e + self.1 + other.1)
    }
}

impl Sub for Twice {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + Self(-other.0, -other.1)
    }
}

impl Mul for Twice {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        let p = self.0 * other.0;
        let e = self.0.mul_add(other.0, -p);
        sum(p, e + (self.0 * other.1 + self.1 * other.0))
    }
}

impl Twice {
    fn over(self, other: Self) -> Self {
        let mut quotient = Self::from(self.0 / other.0);
        for _ in 0..2 {
            let rest = self - quotient * other;
            quotient = quotient + Self::from(rest.0 / other.0);
        }
        quotient
    }

    fn root(self) -> Self {
        let mut root = Self::from(self.0.sqrt());
        for _ in 0..2 {
            root = (root + self.over(root)) * Self::from(0.5);
        }
        root
    }
}

/// r = b - K x of every drive: rows of nodes, then electrodes.
fn residuals(
    mesh: &Mesh,
    contacts: &[f64],
    sigma: &[f64],
    fields: &Fields,
    drives: &[Dipole],
) -> Vec<Vec<Twice>> {
    let nodes = mesh.nodes().len();
    let node = |k: usize| mesh.nodes()[k].map(Twice::from);
    let sides = |t: usize| {
        let [a, b, c] = mesh.triangles()[t].map(node);
        [[b, c], [c, a], [a, b]].map(|[p, q]| [q[0] - p[0], q[1] - p[1]])
    };
    let stiffness: Vec<[[Twice; 3]; 3]> = (0..sigma.len())
        .map(|t| {
            let s = sides(t);
            let twice_area = s[0][0] * s[1][1] - s[0][1] * s[1][0];
            let factor = Twice::from(sigma[t]).over(twice_area * Twice::from(2.0));
            [0, 1, 2].map(|i| [0, 1, 2].map(|j| (s[i][0] * s[j][0] + s[i][1] * s[j][1]) * factor))
        })
        .collect();
    let mut all = Vec::new();
    for (column, drive) in drives.iter().enumerate() {
        let u = |k: usize| Twice::from(fields.potentials[(k, column)]);
        let v = |e: usize| Twice::from(fields.electrodes[(e, column)]);
        let mut rest = vec![Twice(0.0, 0.0); nodes + mesh.electrodes()];
        rest[nodes + drive.plus.0] = Twice(1.0, 0.0);
        rest[nodes + drive.minus.0] = Twice(-1.0, 0.0);
        for (triangle, stiffness) in mesh.triangles().iter().zip(&stiffness) {
            for i in 0..3 {
                for j in 0..3 {
                    rest[triangle[i]] = rest[triangle[i]] - stiffness[i][j] * u(triangle[j]);
                }
            }
        }
        for (e, edges) in mesh.electrode_edges().iter().enumerate() {
            for &[a, b] in edges {
                let (p, q) = (node(a), node(b));
                let (dx, dy) = (q[0] - p[0], q[1] - p[1]);
                let h = (dx * dx + dy * dy).root();
                let share = h.over(Twice::from(6.0) * Twice::from(contacts[e]));
                let (da, db) = (u(a) - v(e), u(b) - v(e));
                let two = Twice::from(2.0);
                rest[a] = rest[a] - share * (two * da + db);
                rest[b] = rest[b] - share * (da + two * db);
                let three = Twice::from(3.0);
                rest[nodes + e] = rest[nodes + e] + share * three * (da + db);
            }
        }
        all.push(rest);
    }
    all
}

/// Errors of the refined and of the plain readings, relative to the largest reading.
fn errors(mesh: &Arc<Mesh>, contacts: &[f64], sigma: &[f64], protocol: &Protocol) -> [f64; 2] {
    let forward = Forward::new(mesh.clone(), contacts).unwrap();
    let count = mesh.electrodes();
    let drives: Vec<Dipole> = (0..count).map(|k| Dipole::adjacent(k, count)).collect();
    let fields = forward.solve(sigma, &drives).unwrap();
    let rest = residuals(mesh, contacts, sigma, &fields, &drives);
    let nodes = mesh.nodes().len();
    let exact = |drive: usize, sense: usize| {
        let at = |e: usize| Twice::from(fields.electrodes[(e, drive)]);
        let mut volts = at(drives[sense].plus.0) - at(drives[sense].minus.0);
        for (k, rest) in rest[drive].iter().enumerate() {
            let x = if k < nodes {
                fields.potentials[(k, sense)]
            } else {
                fields.electrodes[(k - nodes, sense)]
            };
            volts = volts + Twice::from(x) * *rest;
        }
        volts
    };
    let mut workspace = forward.workspace(protocol).unwrap();
    let refined = workspace.readings(sigma).unwrap();
    let plain = workspace.plain().readings(sigma).unwrap();
    let mut worst = [0.0_f64; 2];
    for (k, question) in protocol.measurements().iter().enumerate() {
        let volts = exact(question.drive.plus.0, question.sense.plus.0);
        for (worst, found) in worst.iter_mut().zip([refined[k], plain[k]]) {
            *worst = worst.max((Twice::from(found) - volts).0.abs());
        }
    }
    worst.map(|error| error / refined.amax())
}

#[test]
fn the_papers_sheet_at_contacts_of_any_size() {
    let sheet = PaperSheet::default();
    let mesh = Arc::new(sheet.mesh().unwrap());
    let protocol = Protocol::sheffield(26).unwrap();
    let uniform = vec![1e-3; mesh.triangles().len()];
    let uneven = spread(mesh.triangles().len(), 1e-3, 50.0);
    let mut holed = uniform.clone();
    (0..holed.len()).step_by(7).for_each(|t| holed[t] = 1e-11);
    let mixed: Vec<f64> = (0..26).map(|e| 10_f64.powi(e % 6 - 4)).collect();
    for (name, contacts, sigma) in [
        ("100 ohm", sheet.contact_ohm_m(), &uniform),
        ("100 ohm, uneven", sheet.contact_ohm_m(), &uneven),
        ("100 ohm, holes", sheet.contact_ohm_m(), &holed),
        ("z 1e-4", vec![1e-4; 26], &uneven),
        ("z 1e-4 to 10", mixed, &uneven),
        ("z 10", vec![10.0; 26], &uneven),
        ("z 1000", vec![1e3; 26], &uneven),
    ] {
        let [refined, plain] = errors(&mesh, &contacts, sigma, &protocol);
        println!("{name}: refined {refined:.1e}, plain {plain:.1e}");
        assert!(refined < 3e-15, "{name}: {refined:e}");
        assert!(plain < 1e-13, "{name}: {plain:e}");
    }
}

/// Checks the reference itself against an independent solution in 80 bits.
#[test]
fn the_exact_readings_are_those_of_the_solved_case() {
    let folder = needs::case("disc16");
    let case = Case::read(&folder).unwrap();
    for name in ["homog", "one", "random"] {
        let [refined, plain] = errors(
            &case.mesh,
            &case.contact_ohm_m,
            &case.sigma[name],
            &case.protocol,
        );
        println!("disc16 {name}: refined {refined:.1e}, plain {plain:.1e}");
        assert!(refined < 3e-15 && plain < 1e-13, "{name}");
    }
}
