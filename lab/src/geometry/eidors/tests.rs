//! MAT-files built byte by byte in both byte orders; errors name the fault.

use std::io::Write;

use super::mat::{MatError, Value, variables};
use super::{BTreeMap, Fields, of_model, voltages};

/// Writes elements in one byte order.
#[derive(Clone, Copy)]
struct Order(bool);

impl Order {
    fn word(self, word: u32) -> [u8; 4] {
        if self.0 {
            word.to_be_bytes()
        } else {
            word.to_le_bytes()
        }
    }

    fn element(self, kind: u32, content: &[u8]) -> Vec<u8> {
        let mut bytes = [self.word(kind), self.word(content.len() as u32)].concat();
        bytes.extend(content);
        bytes.resize(bytes.len().next_multiple_of(8), 0);
        bytes
    }

    fn words(self, kind: u32, words: &[u32]) -> Vec<u8> {
        let bytes: Vec<u8> = words.iter().flat_map(|word| self.word(*word)).collect();
        self.element(kind, &bytes)
    }

    fn doubles(self, values: &[f64]) -> Vec<u8> {
        let one = |value: &f64| {
            if self.0 {
                value.to_be_bytes()
            } else {
                value.to_le_bytes()
            }
        };
        let bytes: Vec<u8> = values.iter().flat_map(one).collect();
        self.element(9, &bytes)
    }

    fn array(self, class: u32, dimensions: [u32; 2], name: &str, content: &[Vec<u8>]) -> Vec<u8> {
        let head = [
            self.words(6, &[class, 0]),
            self.words(5, &dimensions),
            self.element(1, name.as_bytes()),
        ];
        self.element(14, &[head.concat(), content.concat()].concat())
    }

    fn file(self, variables: &[Vec<u8>]) -> Vec<u8> {
        let mut bytes = vec![b' '; 124];
        bytes.extend(if self.0 { b"\x01\x00MI" } else { b"\x00\x01IM" });
        bytes.extend(variables.concat());
        bytes
    }
}

fn example(order: Order) -> Vec<u8> {
    // a content of at most four bytes is in the tag itself
    let small: Vec<u8> = match order.0 {
        false => vec![2, 0, 2, 0, 7, 9, 0, 0],
        true => vec![0, 2, 0, 2, 7, 9, 0, 0],
    };
    let matrix = order.array(6, [1, 2], "m", &[small]);
    let text = order.array(
        4,
        [1, 2],
        "",
        &[order.element(4, &[order.word(0x41_0042), order.word(0)].concat()[..4])],
    );
    let handle = order.array(16, [1, 1], "", &[]);
    let names = order.element(1, b"a\0\0\0b\0\0\0");
    let structure = order.array(2, [1, 1], "s", &[order.words(5, &[4]), names, text, handle]);
    // column 0 has 5 in row 1, column 1 nothing, column 2 has 6 in row 0
    let sparse = [
        order.words(5, &[1, 0]),
        order.words(5, &[0, 1, 1, 2]),
        order.doubles(&[5.0, 6.0]),
    ];
    let sparse = order.array(5, [2, 3], "p", &sparse);
    order.file(&[matrix, structure, sparse])
}

#[test]
fn both_byte_orders_are_read() {
    for order in [Order(false), Order(true)] {
        let file = variables(&example(order)).unwrap();
        let numbers = |rows, columns, values: &[f64]| Value::Numbers {
            rows,
            columns,
            values: values.to_vec(),
        };
        assert_eq!(file["m"], numbers(1, 2, &[7.0, 9.0]));
        assert_eq!(file["p"], numbers(2, 3, &[0.0, 5.0, 0.0, 0.0, 6.0, 0.0]));
        let Value::Structs(structs) = &file["s"] else {
            panic!("{:?}", file["s"])
        };
        assert!(matches!(&structs[0]["a"], Value::Text(text) if text.len() == 2));
        assert!(matches!(structs[0]["b"], Value::Other(_)));
    }
}

#[test]
fn deflated_variables_are_read() {
    let order = Order(false);
    let matrix = order.array(6, [1, 1], "m", &[order.doubles(&[0.5])]);
    let mut deflated = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
    deflated.write_all(&matrix).unwrap();
    let deflated = deflated.finish().unwrap();
    let mut bytes = order.file(&[]);
    // a compressed element is not padded
    bytes.extend([order.word(15), order.word(deflated.len() as u32)].concat());
    bytes.extend(deflated);
    let file = variables(&bytes).unwrap();
    assert!(matches!(&file["m"], Value::Numbers { values, .. } if values == &[0.5]));
}

#[test]
fn cut_or_changed_files_are_errors_or_other_values() {
    let whole = example(Order(false));
    let all = variables(&whole).unwrap();
    for length in 0..whole.len() {
        // a file cut between two variables is valid
        if let Ok(some) = variables(&whole[..length]) {
            assert!(some.len() < all.len(), "{length}");
        }
    }
    for at in 128..whole.len() {
        for bit in 0..8 {
            let mut changed = whole.clone();
            changed[at] ^= 1 << bit;
            let _ = variables(&changed);
        }
    }
    assert_eq!(variables(b"\x89HDF\r\n"), Err(MatError::Newer));
    assert_eq!(variables(&[0; 200]), Err(MatError::Foreign));
}

fn numbers<const N: usize>(rows: &[[f64; N]]) -> Value {
    let columns = (0..N).flat_map(|column| rows.iter().map(move |row| row[column]));
    Value::Numbers {
        rows: rows.len(),
        columns: N,
        values: columns.collect(),
    }
}

fn structure(fields: &[(&str, Value)]) -> Fields {
    fields
        .iter()
        .map(|(name, value)| ((*name).to_owned(), value.clone()))
        .collect()
}

/// A square of four triangles round a fifth node, one of them clockwise, with an electrode on each side. Node 1 is
/// unused.
fn model() -> Fields {
    let nodes = numbers(&[
        [9.0, 9.0],
        [0.0, 0.0],
        [1.0, 0.0],
        [1.0, 1.0],
        [0.0, 1.0],
        [0.5, 0.5],
    ]);
    let elems = numbers(&[
        [2.0, 3.0, 6.0],
        [3.0, 4.0, 6.0],
        [4.0, 5.0, 6.0],
        [2.0, 5.0, 6.0],
    ]);
    let sides = [[2.0, 3.0], [3.0, 4.0], [4.0, 5.0], [5.0, 2.0]];
    // electrodes must not share a node: take two on opposite sides
    let electrodes = [sides[0], sides[2]].map(|side| {
        structure(&[
            ("nodes", numbers(&[side])),
            ("z_contact", numbers(&[[0.1]])),
        ])
    });
    let stimulation = structure(&[
        ("stimulation", Value::Text("mA".to_owned())),
        ("stim_pattern", numbers(&[[2.0], [-2.0]])),
        ("meas_pattern", numbers(&[[-1.0, 1.0]])),
    ]);
    structure(&[
        ("nodes", nodes),
        ("elems", elems),
        ("electrode", Value::Structs(electrodes.to_vec())),
        ("stimulation", Value::Structs(vec![stimulation])),
    ])
}

fn file(model: Fields) -> Fields {
    BTreeMap::from([("fmdl".to_owned(), Value::Structs(vec![model]))])
}

#[test]
fn model_becomes_a_case() {
    let case = of_model(&file(model())).unwrap();
    assert_eq!(case.mesh.nodes().len(), 5);
    assert_eq!(case.mesh.triangles()[3], [4, 3, 0], "turned");
    assert_eq!(case.mesh.electrode_edges(), [vec![[0, 1]], vec![[2, 3]]]);
    assert_eq!(
        (case.contact_ohm_m.as_slice(), case.currents.as_slice()),
        ([0.1, 0.1].as_slice(), [2e-3].as_slice())
    );
    let reading = case.protocol.measurements()[0];
    let pair = |dipole: survey::Dipole| (dipole.plus.0, dipole.minus.0);
    assert_eq!((pair(reading.drive), pair(reading.sense)), ((0, 1), (1, 0)));
}

#[test]
fn what_a_model_lacks_is_named() {
    let refused = |change: &dyn Fn(&mut Fields), text: &str| {
        let mut changed = model();
        change(&mut changed);
        let why = of_model(&file(changed)).unwrap_err();
        assert!(why.contains(text), "{why}");
    };
    assert!(
        of_model(&Fields::new())
            .unwrap_err()
            .contains("no variable fmdl")
    );
    for name in ["nodes", "elems", "electrode", "stimulation"] {
        refused(
            &|model| drop(model.remove(name)),
            &format!("fmdl has no field {name}"),
        );
    }
    let inner = |list: &'static str, name: &'static str, value: Option<Value>| {
        move |model: &mut Fields| {
            let Some(Value::Structs(structs)) = model.get_mut(list) else {
                panic!("{list}")
            };
            structs[0].remove(name);
            structs[0].extend(value.clone().map(|value| (name.to_owned(), value)));
        }
    };
    refused(
        &inner("electrode", "z_contact", None),
        "fmdl.electrode(1) has no field z_contact",
    );
    refused(
        &inner("electrode", "nodes", Some(numbers(&[[2.0]]))),
        "fmdl.electrode(1) covers no edge",
    );
    refused(
        &inner("electrode", "nodes", Some(numbers(&[[7.0]]))),
        "fmdl.electrode(1).nodes names node 7",
    );
    refused(
        &inner("stimulation", "stim_pattern", None),
        "fmdl.stimulation(1) has no field stim_pattern",
    );
    refused(
        &inner(
            "stimulation",
            "stim_pattern",
            Some(numbers(&[[1.0], [-2.0]])),
        ),
        "stim_pattern names 2 electrodes",
    );
    refused(
        &inner("stimulation", "meas_pattern", Some(numbers(&[[2.0, -2.0]]))),
        "a gain of 2",
    );
    refused(
        &inner(
            "stimulation",
            "stimulation",
            Some(Value::Text("V".to_owned())),
        ),
        "'V'",
    );
    refused(
        &|model| drop(model.insert("nodes".to_owned(), numbers(&[[0.0; 3]]))),
        "fmdl.nodes is 1 x 3; nodes x 2",
    );
}

#[test]
fn voltages_of_another_shape_are_named() {
    let of = |value: Value| {
        voltages(
            &BTreeMap::from([("vv".to_owned(), value)]),
            &["vv"],
            3,
            false,
        )
    };
    let frames = of(numbers(&[[1.0, 2.0], [3.0, f64::NAN], [5.0, 6.0]]))
        .unwrap()
        .unwrap();
    assert_eq!(frames.len(), 2);
    assert!(
        frames[0].iter().all(|reading| reading.volts().is_some()) && frames[1][1].volts().is_none()
    );
    assert!(
        of(numbers(&[[1.0, 2.0, 3.0]]))
            .unwrap_err()
            .contains("transpose")
    );
    assert!(
        of(Value::Text("x".to_owned()))
            .unwrap_err()
            .contains("vv is text")
    );
    assert_eq!(voltages(&Fields::new(), &["vv"], 3, false), Ok(None));
}
