//! Validation of meshes.

use std::collections::{BTreeMap, BTreeSet};

use survey::Electrode;

use super::{MeshError, SMALLEST_AREA, sides_of, signed_area};

pub(super) fn triangles(
    nodes: &[[f64; 2]],
    triangles: &[[usize; 3]],
) -> Result<Vec<f64>, MeshError> {
    if triangles.is_empty() {
        return Err(MeshError::Empty);
    }
    if let Some(node) = nodes
        .iter()
        .position(|p| !(p[0].is_finite() && p[1].is_finite()))
    {
        return Err(MeshError::NotFinite { node });
    }
    let mut used = vec![false; nodes.len()];
    let mut areas = Vec::with_capacity(triangles.len());
    for (element, triangle) in triangles.iter().enumerate() {
        for &node in triangle {
            *used.get_mut(node).ok_or(MeshError::NoSuchNode {
                element,
                node,
                nodes: nodes.len(),
            })? = true;
        }
        areas.push(signed_area(triangle.map(|node| nodes[node])));
    }
    let total: f64 = areas.iter().map(|area| area.abs()).sum();
    for (element, &area) in areas.iter().enumerate() {
        if area.is_nan() || area.abs() <= SMALLEST_AREA * total {
            return Err(MeshError::NoArea { element, area });
        }
        if area < 0.0 {
            return Err(MeshError::Inverted { element, area });
        }
    }
    match used.iter().position(|used| !used) {
        Some(node) => Err(MeshError::UnusedNode { node }),
        None => Ok(areas),
    }
}

/// The element on the left of each directed side.
pub(super) fn sides(triangles: &[[usize; 3]]) -> Result<BTreeMap<[usize; 2], usize>, MeshError> {
    let mut sides = BTreeMap::new();
    for (element, triangle) in triangles.iter().enumerate() {
        for side in sides_of(triangle) {
            if sides.insert(side, element).is_some() {
                return Err(MeshError::Overlap {
                    element,
                    from: side[0],
                    to: side[1],
                });
            }
        }
    }
    Ok(sides)
}

pub(super) fn connected(
    triangles: &[[usize; 3]],
    sides: &BTreeMap<[usize; 2], usize>,
) -> Result<(), MeshError> {
    let mut reached = vec![false; triangles.len()];
    let mut waiting = vec![0];
    reached[0] = true;
    while let Some(element) = waiting.pop() {
        for [a, b] in sides_of(&triangles[element]) {
            if let Some(&neighbour) = sides.get(&[b, a])
                && !reached[neighbour]
            {
                reached[neighbour] = true;
                waiting.push(neighbour);
            }
        }
    }
    match reached.iter().position(|reached| !reached) {
        Some(element) => Err(MeshError::Disconnected { element }),
        None => Ok(()),
    }
}

pub(super) fn electrodes(
    sides: &BTreeMap<[usize; 2], usize>,
    electrode_edges: &[Vec<[usize; 2]>],
) -> Result<(), MeshError> {
    let mut owner: BTreeMap<usize, usize> = BTreeMap::new();
    for (index, edges) in electrode_edges.iter().enumerate() {
        let electrode = Electrode(index);
        if edges.is_empty() {
            return Err(MeshError::NoEdge { electrode });
        }
        let mut seen = BTreeSet::new();
        for &[from, to] in edges {
            if sides.contains_key(&[from, to]) == sides.contains_key(&[to, from]) {
                return Err(MeshError::NotBoundary {
                    electrode,
                    from,
                    to,
                });
            }
            if !seen.insert([from.min(to), from.max(to)]) {
                return Err(MeshError::EdgeTwice {
                    electrode,
                    from,
                    to,
                });
            }
            for node in [from, to] {
                let first = *owner.entry(node).or_insert(index);
                if first != index {
                    return Err(MeshError::ElectrodesMeet {
                        first: Electrode(first),
                        second: electrode,
                        node,
                    });
                }
            }
        }
    }
    Ok(())
}

pub(super) fn region(
    region: Option<Vec<usize>>,
    triangles: usize,
) -> Result<Vec<usize>, MeshError> {
    let Some(region) = region else {
        return Ok((0..triangles).collect());
    };
    if region.is_empty() {
        return Err(MeshError::Region {
            fault: "is empty".to_owned(),
        });
    }
    let mut seen = vec![false; triangles];
    for &element in &region {
        match seen.get_mut(element) {
            None => {
                return Err(MeshError::Region {
                    fault: format!("names element {element}, but there are {triangles}"),
                });
            }
            Some(seen) if *seen => {
                return Err(MeshError::Region {
                    fault: format!("names element {element} twice"),
                });
            }
            Some(seen) => *seen = true,
        }
    }
    Ok(region)
}
