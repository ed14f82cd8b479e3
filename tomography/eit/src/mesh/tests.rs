//! Invalid meshes are refused.

use super::*;

fn square() -> (Vec<[f64; 2]>, Vec<[usize; 3]>) {
    (
        vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]],
        vec![[0, 1, 2], [0, 2, 3]],
    )
}

fn with(edges: Vec<Vec<[usize; 2]>>) -> Result<Mesh, MeshError> {
    let (nodes, triangles) = square();
    Mesh::new(nodes, triangles, edges, None)
}

fn with_region(region: Vec<usize>) -> Result<Mesh, MeshError> {
    let (nodes, triangles) = square();
    Mesh::new(
        nodes,
        triangles,
        vec![vec![[3, 0]], vec![[1, 2]]],
        Some(region),
    )
}

#[test]
fn a_square_with_two_electrodes() {
    let mesh = with(vec![vec![[3, 0]], vec![[1, 2]]]).unwrap();
    assert_eq!(mesh.electrode_centres(), [[0.0, 0.5], [1.0, 0.5]]);
    assert_eq!(mesh.outline().len(), 1);
    assert_eq!(mesh.outline()[0].len(), 4);
    let quality = mesh.quality();
    assert_eq!(quality.coarse_electrodes.len(), 2);
    assert!((quality.smallest_angle - 45.0).abs() < 1e-12);
    assert_eq!(mesh.region(), [0, 1]);
    let half = with_region(vec![1]).unwrap();
    assert_ne!(half.hash(), mesh.hash());
}

#[test]
fn faults_are_named() {
    let (nodes, _) = square();
    let refuse = |triangles: Vec<[usize; 3]>| {
        Mesh::new(nodes.clone(), triangles, Vec::new(), None).unwrap_err()
    };
    assert!(matches!(
        refuse(vec![[0, 1, 2], [0, 3, 2]]),
        MeshError::Inverted { element: 1, .. }
    ));
    assert!(matches!(
        refuse(vec![[0, 1, 2], [0, 2, 2]]),
        MeshError::NoArea { element: 1, .. }
    ));
    assert!(matches!(
        refuse(vec![[0, 1, 2]]),
        MeshError::UnusedNode { node: 3 }
    ));
    assert!(matches!(
        refuse(vec![[0, 1, 7]]),
        MeshError::NoSuchNode { node: 7, .. }
    ));
    assert!(matches!(
        refuse(vec![[0, 1, 2], [0, 1, 3]]),
        MeshError::Overlap { element: 1, .. }
    ));
    let apart = Mesh::new(
        vec![
            [0.0, 0.0],
            [1.0, 0.0],
            [0.0, 1.0],
            [5.0, 0.0],
            [6.0, 0.0],
            [5.0, 1.0],
        ],
        vec![[0, 1, 2], [3, 4, 5]],
        Vec::new(),
        None,
    );
    assert_eq!(apart, Err(MeshError::Disconnected { element: 1 }));
    assert!(matches!(
        Mesh::new(vec![[f64::NAN, 0.0]; 3], vec![[0, 1, 2]], Vec::new(), None),
        Err(MeshError::NotFinite { node: 0 })
    ));
}

#[test]
fn electrode_faults_are_named() {
    assert_eq!(
        with(vec![vec![]]),
        Err(MeshError::NoEdge {
            electrode: Electrode(0)
        })
    );
    let inner = with(vec![vec![[0, 2]]]).unwrap_err();
    assert_eq!(
        inner.to_string(),
        "electrode 1: the edge between nodes 0 and 2 is not a boundary edge of the mesh"
    );
    assert!(matches!(
        with(vec![vec![[0, 1]], vec![[1, 2]]]),
        Err(MeshError::ElectrodesMeet { node: 1, .. })
    ));
    assert!(matches!(
        with(vec![vec![[0, 1], [1, 0]]]),
        Err(MeshError::EdgeTwice { .. })
    ));
}

#[test]
fn region_faults_are_named() {
    for region in [vec![], vec![2], vec![0, 0]] {
        assert!(matches!(with_region(region), Err(MeshError::Region { .. })));
    }
}
