//! Elimination order for points in the plane.

/// An elimination order by nested dissection: cuts the plane at the median of its longer side, eliminates both halves
/// first and the points between them last. `neighbours` must be symmetric. Returns the order and the lengths of the
/// parts that are eliminated together.
pub(crate) fn dissect(points: &[[f64; 2]], neighbours: &[Vec<usize>]) -> (Vec<usize>, Vec<usize>) {
    let mut order = Vec::with_capacity(points.len());
    let mut parts = Vec::new();
    let mut side = vec![0; points.len()];
    let mut mark = 0;
    split(
        points,
        neighbours,
        (0..points.len()).collect(),
        &mut side,
        &mut mark,
        &mut order,
        &mut parts,
    );
    (order, parts)
}

/// Parts up to this size are not cut any further.
const LEAF: usize = 12;

fn split(
    points: &[[f64; 2]],
    neighbours: &[Vec<usize>],
    mut part: Vec<usize>,
    side: &mut [usize],
    mark: &mut usize,
    order: &mut Vec<usize>,
    parts: &mut Vec<usize>,
) {
    if part.len() <= LEAF {
        parts.push(part.len());
        order.extend(part);
        return;
    }
    let extent = |axis: usize| {
        let along = part.iter().map(|&node| points[node][axis]);
        along.clone().fold(f64::NEG_INFINITY, f64::max) - along.fold(f64::INFINITY, f64::min)
    };
    let axis = usize::from(extent(1) > extent(0));
    part.sort_by(|&a, &b| points[a][axis].total_cmp(&points[b][axis]).then(a.cmp(&b)));
    let (low, high) = part.split_at(part.len() / 2);
    *mark += 2;
    let (is_low, is_high) = (*mark, *mark + 1);
    low.iter().for_each(|&node| side[node] = is_low);
    high.iter().for_each(|&node| side[node] = is_high);
    let touching = |nodes: &[usize], other: usize, side: &[usize]| -> Vec<usize> {
        nodes
            .iter()
            .copied()
            .filter(|&node| neighbours[node].iter().any(|&near| side[near] == other))
            .collect()
    };
    let from_low = touching(low, is_high, side);
    let from_high = touching(high, is_low, side);
    let (mut separator, keep) = if from_low.len() <= from_high.len() {
        (from_low, is_low)
    } else {
        (from_high, is_high)
    };
    separator.iter().for_each(|&node| side[node] = 0);
    let rest = |nodes: &[usize], own: usize, side: &[usize]| -> Vec<usize> {
        nodes
            .iter()
            .copied()
            .filter(|&node| own != keep || side[node] == own)
            .collect()
    };
    let low = rest(low, is_low, side);
    let high = rest(high, is_high, side);
    split(points, neighbours, low, side, mark, order, parts);
    split(points, neighbours, high, side, mark, order, parts);
    // along the cut, so that unknowns adjacent in a front are adjacent in its parent
    let across = 1 - axis;
    separator.sort_by(|&a, &b| {
        points[a][across]
            .total_cmp(&points[b][across])
            .then(a.cmp(&b))
    });
    parts.push(separator.len());
    order.extend(separator);
}
