//! Fills a polygon with triangles of given sizes: greedy packing of points from the boundary inwards, smoothing towards
//! the given sizes, constrained Delaunay triangulation by `spade`. Deterministic.

use spade::{ConstrainedDelaunayTriangulation, HasPosition, Point2, Triangulation};

use crate::mesh::bounding_box;

/// Rounds in which every inner point moves to the middle of its triangles.
const ROUNDS: usize = 60;

/// Smallest distance of packed points as a share of the target edge length; at this value the edges have about the
/// target length.
const PACKING: f64 = 0.82;

/// The domain to fill. Lengths in any one unit.
pub(crate) struct Domain<'a> {
    /// Points on the boundary, in order of their index in the result.
    pub(crate) boundary: Vec<[f64; 2]>,
    /// Pairs of boundary points that stay edges.
    pub(crate) segments: Vec<[usize; 2]>,
    /// Whether a point lies inside.
    pub(crate) inside: &'a dyn Fn([f64; 2]) -> bool,
    /// The target edge length at a point.
    pub(crate) size: &'a dyn Fn([f64; 2]) -> f64,
    /// Largest target edge length.
    pub(crate) largest: f64,
    /// A different number gives a different mesh with the same sizes.
    pub(crate) seeding: u32,
}

pub(crate) type Filled = (Vec<[f64; 2]>, Vec<[usize; 3]>);

/// Points and counter-clockwise triangles of the domain; the boundary points come first.
pub(crate) fn fill(domain: &Domain) -> Result<Filled, String> {
    let fixed = domain.boundary.len();
    let mut points = pack(domain);
    let mut triangles = triangulate(domain, &points)?;
    for _ in 0..ROUNDS {
        smooth(domain, fixed, &mut points, &triangles);
        triangles = triangulate(domain, &points)?;
    }
    Ok((points, triangles))
}

/// Cuts a segment into edges of the target length: the inner points, without its ends.
pub(crate) fn cut(a: [f64; 2], b: [f64; 2], size: &dyn Fn([f64; 2]) -> f64) -> Vec<[f64; 2]> {
    const SAMPLES: usize = 2000;
    let whole = length(b[0] - a[0], b[1] - a[1]);
    let at = |s: f64| [a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1])];
    let mut edges = vec![0.0];
    for sample in 0..SAMPLES {
        let middle = at((sample as f64 + 0.5) / SAMPLES as f64);
        edges.push(edges[sample] + whole / SAMPLES as f64 / size(middle));
    }
    let count = edges[SAMPLES].round().max(1.0);
    let mut points = Vec::new();
    let mut sample = 0;
    for edge in 1..count as usize {
        let wanted = edges[SAMPLES] * edge as f64 / count;
        while edges[sample + 1] < wanted {
            sample += 1;
        }
        let within = (wanted - edges[sample]) / (edges[sample + 1] - edges[sample]);
        points.push(at((sample as f64 + within) / SAMPLES as f64));
    }
    points
}

/// Instead of `hypot`, whose last bit differs between systems: a mesh must have the same hash everywhere.
pub(crate) fn length(x: f64, y: f64) -> f64 {
    (x * x + y * y).sqrt()
}

fn distance([ax, ay]: [f64; 2], [bx, by]: [f64; 2]) -> f64 {
    length(ax - bx, ay - by)
}

/// Spatial buckets, so that only near points are compared.
struct Buckets {
    origin: [f64; 2],
    cell: f64,
    columns: usize,
    rows: usize,
    points: Vec<Vec<[f64; 2]>>,
}

impl Buckets {
    fn new(low: [f64; 2], high: [f64; 2], cell: f64) -> Self {
        let columns = ((high[0] - low[0]) / cell) as usize + 1;
        let rows = ((high[1] - low[1]) / cell) as usize + 1;
        Self {
            origin: low,
            cell,
            columns,
            rows,
            points: vec![Vec::new(); columns * rows],
        }
    }

    fn place(&self, point: [f64; 2]) -> (usize, usize) {
        let along = |axis: usize, most: usize| {
            (((point[axis] - self.origin[axis]) / self.cell).max(0.0) as usize).min(most - 1)
        };
        (along(0, self.columns), along(1, self.rows))
    }

    fn insert(&mut self, point: [f64; 2]) {
        let (column, row) = self.place(point);
        self.points[row * self.columns + column].push(point);
    }

    fn is_free(&self, point: [f64; 2], radius: f64) -> bool {
        let (column, row) = self.place(point);
        (row.saturating_sub(1)..=(row + 1).min(self.rows - 1)).all(|row| {
            (column.saturating_sub(1)..=(column + 1).min(self.columns - 1)).all(|column| {
                self.points[row * self.columns + column]
                    .iter()
                    .all(|other| distance(*other, point) >= radius)
            })
        })
    }
}

fn pack(domain: &Domain) -> Vec<[f64; 2]> {
    let [low, high] = bounding_box(domain.boundary.iter().copied());
    // the golden ratio's multiples never come close to repeating
    let shift = |golden: f64| domain.largest * (f64::from(domain.seeding) * golden).fract();
    let side = (high[0] - low[0]).max(high[1] - low[1]) + domain.largest;
    let corner = [
        low[0] - shift(0.618_033_988_749_894_9),
        low[1] - shift(0.381_966_011_250_105_1),
    ];
    let mut candidates = Vec::new();
    let mut squares = vec![(corner, side)];
    while let Some((corner, side)) = squares.pop() {
        let half = 0.5 * side;
        let middle = [corner[0] + half, corner[1] + half];
        if side > (domain.size)(middle) / 3.0 {
            for [right, up] in [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]] {
                squares.push(([corner[0] + right * half, corner[1] + up * half], half));
            }
        } else if (domain.inside)(middle) {
            let nearest = domain
                .boundary
                .iter()
                .map(|point| (point[0] - middle[0]).powi(2) + (point[1] - middle[1]).powi(2))
                .fold(f64::INFINITY, f64::min);
            candidates.push((nearest, middle));
        }
    }
    candidates.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut buckets = Buckets::new(low, high, domain.largest);
    let mut points = domain.boundary.clone();
    points.iter().for_each(|point| buckets.insert(*point));
    for (_, point) in candidates {
        if buckets.is_free(point, PACKING * (domain.size)(point)) {
            buckets.insert(point);
            points.push(point);
        }
    }
    points
}

struct Corner {
    at: Point2<f64>,
}

impl HasPosition for Corner {
    type Scalar = f64;
    fn position(&self) -> Point2<f64> {
        self.at
    }
}

fn triangulate(domain: &Domain, points: &[[f64; 2]]) -> Result<Vec<[usize; 3]>, String> {
    let corners: Vec<Corner> = points
        .iter()
        .map(|point| Corner {
            at: Point2::new(point[0], point[1]),
        })
        .collect();
    let mut crossing = Vec::new();
    let cdt = ConstrainedDelaunayTriangulation::<Corner>::try_bulk_load_cdt(
        corners,
        domain.segments.clone(),
        |segment| crossing.push(segment),
    )
    .map_err(|fault| fault.to_string())?;
    if !crossing.is_empty() {
        return Err("its boundary crosses itself".to_owned());
    }
    if cdt.num_vertices() != points.len() {
        return Err("two of its boundary points are the same".to_owned());
    }
    Ok(cdt
        .inner_faces()
        .map(|face| face.vertices().map(|corner| corner.fix().index()))
        .filter(|&[a, b, c]| {
            let middle = [0, 1].map(|i| (points[a][i] + points[b][i] + points[c][i]) / 3.0);
            (domain.inside)(middle)
        })
        .collect())
}

/// Moves each inner point to the mean of its triangles' centroids, weighted by each triangle's area in units of the
/// target.
fn smooth(domain: &Domain, fixed: usize, points: &mut [[f64; 2]], triangles: &[[usize; 3]]) {
    let mut sums = vec![[0.0; 3]; points.len()];
    for triangle in triangles {
        let corners = triangle.map(|node| points[node]);
        let middle = [0, 1].map(|i| (corners[0][i] + corners[1][i] + corners[2][i]) / 3.0);
        let weight = crate::mesh::signed_area(corners).abs() / (domain.size)(middle).powi(2);
        for &node in triangle {
            sums[node][0] += weight * middle[0];
            sums[node][1] += weight * middle[1];
            sums[node][2] += weight;
        }
    }
    for (point, [x, y, weight]) in points.iter_mut().zip(sums).skip(fixed) {
        if weight > 0.0 {
            *point = [x / weight, y / weight];
        }
    }
}
