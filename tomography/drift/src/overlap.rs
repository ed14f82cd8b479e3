//! The exact area of the intersection of a disc and a triangle.

/// Area of the intersection of the triangle (counter-clockwise, m) and a disc, m2.
pub(crate) fn overlap(corners: [[f64; 2]; 3], centre: [f64; 2], radius: f64) -> f64 {
    let [a, b, c] = corners.map(|p| [p[0] - centre[0], p[1] - centre[1]]);
    let area = edge(a, b, radius) + edge(b, c, radius) + edge(c, a, radius);
    area.max(0.0)
}

/// Maps corners so that the ellipse with these stretches becomes a disc of the same area about the same centre; areas
/// do not change. The first stretch is half of the logarithm of the ratio of the axes along x and y, the second the
/// same along the diagonals.
pub(crate) fn unstretched(
    corners: [[f64; 2]; 3],
    centre: [f64; 2],
    [along, across]: [f64; 2],
) -> [[f64; 2]; 3] {
    // exp(-M) of the symmetric matrix M with this first row, whose trace is zero
    let size = along.hypot(across);
    let share = if size > 0.0 { size.sinh() / size } else { 1.0 };
    let (even, a, b) = (size.cosh(), share * along, share * across);
    corners.map(|[x, y]| {
        let (x, y) = (x - centre[0], y - centre[1]);
        [
            centre[0] + (even - a) * x - b * y,
            centre[1] - b * x + (even + a) * y,
        ]
    })
}

/// Signed area of the disc about the origin within the triangle of the origin, p and q.
fn edge(p: [f64; 2], q: [f64; 2], radius: f64) -> f64 {
    let cross = |p: [f64; 2], q: [f64; 2]| p[0] * q[1] - p[1] * q[0];
    let dot = |p: [f64; 2], q: [f64; 2]| p[0] * q[0] + p[1] * q[1];
    let sector = |p: [f64; 2], q: [f64; 2]| 0.5 * radius * radius * cross(p, q).atan2(dot(p, q));
    let along = [q[0] - p[0], q[1] - p[1]];
    let square = dot(along, along);
    if square == 0.0 {
        return 0.0;
    }
    // |p + t along| = radius
    let half = -dot(p, along) / square;
    let root = half * half - (dot(p, p) - radius * radius) / square;
    if root <= 0.0 {
        return sector(p, q);
    }
    let root = root.sqrt();
    let (enters, leaves) = (half - root, half + root);
    if leaves <= 0.0 || enters >= 1.0 {
        return sector(p, q);
    }
    let at = |t: f64| [p[0] + t * along[0], p[1] + t * along[1]];
    let (from, to) = (at(enters.max(0.0)), at(leaves.min(1.0)));
    let mut area = 0.5 * cross(from, to);
    if enters > 0.0 {
        area += sector(p, from);
    }
    if leaves < 1.0 {
        area += sector(to, q);
    }
    area
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    const TRIANGLE: [[f64; 2]; 3] = [[0.0, 0.0], [2.0, 0.0], [0.0, 2.0]];

    #[test]
    fn disc_inside_outside_and_around() {
        assert!((overlap(TRIANGLE, [0.5, 0.5], 0.2) - PI * 0.04).abs() < 1e-12);
        assert!(overlap(TRIANGLE, [3.0, 3.0], 1.0).abs() < 1e-12);
        assert!((overlap(TRIANGLE, [0.5, 0.5], 9.0) - 2.0).abs() < 1e-12);
        // a quarter of the disc is inside the right-angled corner
        assert!((overlap(TRIANGLE, [0.0, 0.0], 1.0) - 0.25 * PI).abs() < 1e-12);
    }

    #[test]
    fn ellipse_becomes_a_disc_of_its_area() {
        // axes of 2 and 1/2 along x and y, in a triangle around it
        let wide = [[-9.0, -9.0], [9.0, -9.0], [0.0, 9.0]];
        let of_disc =
            |corners, stretch| overlap(unstretched(corners, [0.0; 2], stretch), [0.0; 2], 1.0);
        assert!((of_disc(wide, [2.0_f64.ln(), 0.0]) - PI).abs() < 1e-12);
        // the right half of it: x from 0 to 2
        let right = [[0.0, -9.0], [9.0, 0.0], [0.0, 9.0]];
        assert!((of_disc(right, [2.0_f64.ln(), 0.0]) - 0.5 * PI).abs() < 1e-12);
        // the ellipse ends at x = 2, at x = 0.5 if stretched along y, and at `reach` if stretched along the diagonal
        let far = |x: f64| [[x, -9.0], [9.0, 0.0], [x, 9.0]];
        assert!(of_disc(far(1.99), [2.0_f64.ln(), 0.0]) > 0.0);
        assert!(of_disc(far(2.01), [2.0_f64.ln(), 0.0]) < 1e-12);
        assert!(of_disc(far(0.51), [-(2.0_f64.ln()), 0.0]) < 1e-12);
        let reach = (0.5 * (4.0 + 0.25_f64)).sqrt();
        assert!(of_disc(far(reach - 0.01), [0.0, 2.0_f64.ln()]) > 0.0);
        assert!(of_disc(far(reach + 0.01), [0.0, 2.0_f64.ln()]) < 1e-12);
    }

    #[test]
    fn partial_overlap_agrees_with_counted_points() {
        let (centre, radius) = ([0.9, 0.8], 0.7);
        let n = 1000;
        let mut inside = 0;
        for i in 0..n {
            for j in 0..n {
                let p = [
                    2.0 * (i as f64 + 0.5) / n as f64,
                    2.0 * (j as f64 + 0.5) / n as f64,
                ];
                let near = (p[0] - centre[0]).hypot(p[1] - centre[1]) < radius;
                if p[0] + p[1] < 2.0 && near {
                    inside += 1;
                }
            }
        }
        let counted = 4.0 * f64::from(inside) / (n * n) as f64;
        assert!((overlap(TRIANGLE, centre, radius) - counted).abs() < 2e-3);
    }
}
