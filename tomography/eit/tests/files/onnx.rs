//! ONNX networks: a file built here byte by byte, run on machines with ONNX Runtime.
//!
//! Without ONNX Runtime the tests print that and pass, unless TACTUS_REQUIRE_ONNX is set.

use std::path::Path;
use std::sync::Arc;

use eit::inverse::learned::network::{OnnxError, load_onnx};
use eit::{DiscTank, Mesh, Reconstructor};
use survey::{Protocol, Reading, Volts};

/// A length-delimited protobuf field: strings, bytes, messages.
fn field(number: u8, content: &[u8]) -> Vec<u8> {
    let mut out = vec![number << 3 | 2];
    varint(content.len() as u64, &mut out);
    out.extend(content);
    out
}

/// A numeric protobuf field.
fn number(field: u8, value: u64) -> Vec<u8> {
    let mut out = vec![field << 3];
    varint(value, &mut out);
    out
}

fn varint(mut value: u64, out: &mut Vec<u8>) {
    while value > 127 {
        out.push(value as u8 | 128);
        value >>= 7;
    }
    out.push(value as u8);
}

/// An input or output of f32 with the shape [1, count].
fn outlet(name: &str, count: usize) -> Vec<u8> {
    let dims = [1, count as u64].map(|n| field(1, &number(1, n))).concat();
    let tensor = [number(1, 1), field(2, &dims)].concat();
    [field(1, name.as_bytes()), field(2, &field(1, &tensor))].concat()
}

/// A model with one more metadata property.
fn reported(mut model: Vec<u8>, key: &str, value: &str) -> Vec<u8> {
    let entry = [field(1, key.as_bytes()), field(2, value.as_bytes())].concat();
    model.extend(field(14, &entry));
    model
}

/// y = x W with W[i][j] = 0.1 where j % inputs = i: an ONNX model of opset 13, written byte by byte.
fn onnx(inputs: usize, outputs: usize) -> Vec<u8> {
    let weights: Vec<u8> = (0..inputs)
        .flat_map(|i| (0..outputs).map(move |j| if j % inputs == i { 0.1_f32 } else { 0.0 }))
        .flat_map(f32::to_le_bytes)
        .collect();
    let tensor = [
        number(1, inputs as u64),
        number(1, outputs as u64),
        number(2, 1),
        field(8, b"w"),
        field(9, &weights),
    ]
    .concat();
    let node = [
        field(1, b"x"),
        field(1, b"w"),
        field(2, b"y"),
        field(4, b"MatMul"),
    ]
    .concat();
    let graph = [
        field(1, &node),
        field(2, b"g"),
        field(5, &tensor),
        field(11, &outlet("x", inputs)),
        field(12, &outlet("y", outputs)),
    ]
    .concat();
    [number(1, 8), field(7, &graph), field(8, &number(2, 13))].concat()
}

fn tank() -> (Arc<Mesh>, Protocol) {
    let tank = DiscTank {
        electrodes: 8,
        fineness: 0.4,
        ..DiscTank::default()
    };
    (
        Arc::new(tank.mesh().unwrap()),
        Protocol::sheffield(8).unwrap(),
    )
}

/// Loads a model, or prints why the test cannot run here.
fn load(path: &Path) -> Option<Result<Box<dyn Reconstructor>, OnnxError>> {
    let (mesh, protocol) = tank();
    match load_onnx(path, mesh, &protocol) {
        Err(fault @ OnnxError::Runtime { .. }) => {
            needs::lacking("ONNX", &fault.to_string());
            None
        }
        other => Some(other),
    }
}

#[test]
fn a_network_made_elsewhere_makes_a_map() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("elsewhere.onnx");
    let (mesh, protocol) = tank();
    let (readings, triangles) = (protocol.len(), mesh.region().len());
    std::fs::write(&path, onnx(readings, triangles)).unwrap();
    let Some(network) = load(&path) else { return };
    let network = network.unwrap();
    let baseline: Vec<Reading> = (0..readings)
        .map(|r| Reading::Ok(Volts(1.0 + r as f64 * 0.01)))
        .collect();
    let frame: Vec<Reading> = (0..readings)
        .map(|r| Reading::Ok(Volts(1.0 + r as f64 * 0.02)))
        .collect();
    let map = network.reconstruct(&baseline, &frame).unwrap();
    assert_eq!(map.method, "onnx elsewhere");
    let top = 1.0 + (readings - 1) as f64 * 0.01;
    for (triangle, value) in map.values.iter().enumerate() {
        let exact = 0.1 * ((triangle % readings) as f64 * 0.01) / top;
        assert!((value - exact).abs() < 1e-7, "{triangle}: {value} {exact}");
    }
}

#[test]
fn a_network_of_another_shape_is_refused_by_its_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("wrong.onnx");
    let (mesh, protocol) = tank();
    let (readings, triangles) = (protocol.len(), mesh.region().len());
    for (inputs, outputs, what) in [
        (readings + 1, triangles, "input"),
        (readings, triangles - 1, "output"),
    ] {
        std::fs::write(&path, onnx(inputs, outputs)).unwrap();
        let Some(refusal) = load(&path) else { return };
        let message = refusal.err().expect("its shape is wrong").to_string();
        let has = if what == "input" { inputs } else { outputs };
        let wants = if what == "input" { readings } else { triangles };
        for word in ["wrong.onnx", what, &has.to_string(), &wants.to_string()] {
            assert!(message.contains(word), "{word}: {message}");
        }
    }
    std::fs::write(&path, b"nothing of the kind").unwrap();
    let Some(refusal) = load(&path) else { return };
    assert!(matches!(refusal, Err(OnnxError::File { .. })));
}

#[test]
fn a_network_that_names_another_survey_is_refused_by_both_names() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("told.onnx");
    let (mesh, protocol) = tank();
    let model = onnx(protocol.len(), mesh.region().len());
    let here = reported(
        reported(model.clone(), "tactus.survey", &protocol.hash()),
        "tactus.geometry",
        mesh.hash(),
    );
    std::fs::write(&path, here).unwrap();
    let Some(network) = load(&path) else { return };
    let message = network.unwrap().assumptions().join("; ");
    assert!(
        message.contains("names this survey and geometry"),
        "{message}"
    );
    for (key, here) in [
        ("tactus.survey", protocol.hash()),
        ("tactus.geometry", mesh.hash().to_owned()),
    ] {
        std::fs::write(&path, reported(model.clone(), key, "abc123")).unwrap();
        let Some(refusal) = load(&path) else { return };
        let message = refusal
            .err()
            .expect("it was trained for another")
            .to_string();
        for word in ["told.onnx", "abc123", &here] {
            assert!(message.contains(word), "{word}: {message}");
        }
    }
}
