//! The solved case `disc16`, read independently of the code under test.

use std::path::Path;
use std::sync::Arc;

use eit::Mesh;
use survey::{Reading, Volts};

/// Numbers of a CSV file without its header line.
pub fn numbers(path: &Path) -> Vec<Vec<f64>> {
    std::fs::read_to_string(path)
        .unwrap()
        .lines()
        .map(|line| {
            line.split(',')
                .map(str::parse)
                .collect::<Result<Vec<f64>, _>>()
        })
        .filter_map(Result::ok)
        .collect()
}

pub fn column(path: &Path) -> Vec<f64> {
    numbers(path).into_iter().map(|row| row[0]).collect()
}

pub fn mesh(case: &Path) -> (Arc<Mesh>, Vec<f64>) {
    let nodes = numbers(&case.join("nodes.csv"));
    let triangles = numbers(&case.join("elems.csv"));
    let mut edges = vec![Vec::new(); 16];
    for row in numbers(&case.join("electrode_edges.csv")) {
        edges[row[0] as usize].push([row[1] as usize, row[2] as usize]);
    }
    let contact = numbers(&case.join("electrodes.csv"))
        .into_iter()
        .map(|row| row[1])
        .collect();
    let mesh = Mesh::new(
        nodes.into_iter().map(|row| [row[0], row[1]]).collect(),
        triangles
            .into_iter()
            .map(|row| [row[0] as usize, row[1] as usize, row[2] as usize])
            .collect(),
        edges,
        None,
    )
    .unwrap();
    (Arc::new(mesh), contact)
}

pub fn readings(volts: &[f64]) -> Vec<Reading> {
    volts.iter().map(|v| Reading::Ok(Volts(*v))).collect()
}
