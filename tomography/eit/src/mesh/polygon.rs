//! Polygons as lists of corners, the first not repeated.

/// Whether a polygon contains a point, by the even-odd rule; nothing is inside fewer than three corners.
pub fn polygon_contains(corners: &[[f64; 2]], [x, y]: [f64; 2]) -> bool {
    if corners.len() < 3 {
        return false;
    }
    let mut inside = false;
    let mut from = corners[corners.len() - 1];
    for &to in corners {
        if (from[1] > y) != (to[1] > y)
            && x < from[0] + (y - from[1]) / (to[1] - from[1]) * (to[0] - from[0])
        {
            inside = !inside;
        }
        from = to;
    }
    inside
}

/// The area of a polygon, positive if its corners are counter-clockwise.
pub fn polygon_area(corners: &[[f64; 2]]) -> f64 {
    let Some(o) = corners.first() else {
        return 0.0;
    };
    // coordinates relative to one corner, to avoid cancellation far from the origin
    0.5 * corners
        .windows(2)
        .map(|w| (w[0][0] - o[0]) * (w[1][1] - o[1]) - (w[0][1] - o[1]) * (w[1][0] - o[0]))
        .sum::<f64>()
}

/// Twice the signed area of the triangle a, b, p: positive if p is to the left of the line from a to b.
pub fn left_of([a, b]: [[f64; 2]; 2], p: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])
}

/// Sutherland-Hodgman: keeps the part of a polygon to the left of a line. If a concave polygon is cut into pieces, these
/// remain connected by slits of zero area along the line. `spare` is memory that further cuts use again.
pub fn clip_by(line: [[f64; 2]; 2], points: &mut Vec<[f64; 2]>, spare: &mut Vec<[f64; 2]>) {
    spare.clear();
    let Some(&last) = points.last() else { return };
    let mut previous = (last, left_of(line, last));
    for &p in points.iter() {
        let side = left_of(line, p);
        if (side >= 0.0) != (previous.1 >= 0.0) {
            let s = previous.1 / (previous.1 - side);
            spare.push([0, 1].map(|i| previous.0[i] + s * (p[i] - previous.0[i])));
        }
        if side >= 0.0 {
            spare.push(p);
        }
        previous = (p, side);
    }
    std::mem::swap(points, spare);
}
