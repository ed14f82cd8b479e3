//! Case folders are written and read back; errors name file and line.

use std::path::Path;
use std::sync::Arc;

use eit::{
    Case, CaseError, Depth, DiscTank, Existing, PaperSheet, frames_text, read_frames,
    read_named_frames, read_protocol,
};
use survey::Protocol;

fn tank_case() -> Case {
    let tank = DiscTank {
        fineness: 0.5,
        ..DiscTank::default()
    };
    let mesh = tank.mesh().unwrap();
    let protocol = Protocol::sheffield(16).unwrap();
    let sigma = vec![tank.conductance() / 3.0; mesh.triangles().len()];
    Case {
        contact_ohm_m: tank.contact_ohm_m(),
        currents: vec![1e-3; protocol.len()],
        protocol,
        sigma: [("homog".to_owned(), sigma)].into(),
        mesh: Arc::new(mesh),
        has_region: false,
    }
}

fn source_chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        text = format!("{text}: {cause}");
        source = cause.source();
    }
    text
}

#[test]
fn a_case_comes_back_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let case = tank_case();
    case.write(folder.path(), Existing::Refuse).unwrap();
    let read = Case::read(folder.path()).unwrap();
    assert_eq!(read, case);
    assert_eq!(read.mesh.hash(), case.mesh.hash());
    assert_eq!(read.sigma("homog").unwrap(), case.sigma["homog"]);
    let file = folder.path().join("sigma_homog.csv");
    assert_eq!(
        read.sigma(file.to_str().unwrap()).unwrap(),
        case.sigma["homog"]
    );
    assert!(
        read.sigma("nobody")
            .unwrap_err()
            .to_string()
            .contains("homog")
    );
}

#[test]
fn a_region_comes_back_in_its_order() {
    let folder = tempfile::tempdir().unwrap();
    let sheet = PaperSheet {
        fineness: 0.5,
        ..PaperSheet::default()
    };
    let protocol = Protocol::sheffield(26).unwrap();
    let case = Case {
        mesh: Arc::new(sheet.mesh().unwrap()),
        contact_ohm_m: sheet.contact_ohm_m(),
        currents: vec![1.0; protocol.len()],
        protocol,
        sigma: [].into(),
        has_region: true,
    };
    case.write(folder.path(), Existing::Refuse).unwrap();
    assert_eq!(Case::read(folder.path()).unwrap(), case);
}

#[test]
fn a_case_written_over_another_keeps_nothing_of_it() {
    let folder = tempfile::tempdir().unwrap();
    let flat = Case {
        sigma: [].into(),
        ..tank_case()
    };
    let depth = Depth::new(0.26, 0.01, 0.13, Depth::MODES).unwrap();
    let deep = Case {
        mesh: Arc::new(flat.mesh.with_depth(Some(depth))),
        has_region: true,
        ..tank_case()
    };
    deep.write(folder.path(), Existing::Refuse).unwrap();
    assert_eq!(Case::read(folder.path()).unwrap(), deep);
    flat.write(folder.path(), Existing::Replace).unwrap();
    assert_eq!(Case::read(folder.path()).unwrap(), flat);
    // if existing files must not be replaced, the write is refused because of the earlier depth
    let other = tempfile::tempdir().unwrap();
    std::fs::write(other.path().join("depth.csv"), "").unwrap();
    let refused = flat.write(other.path(), Existing::Refuse).unwrap_err();
    assert!(refused.to_string().contains("depth.csv"), "{refused}");
}

fn change(folder: &Path, file: &str, change: impl Fn(Vec<String>) -> Vec<String>) -> String {
    let path = folder.join(file);
    let before = std::fs::read_to_string(&path).unwrap();
    let lines = change(before.lines().map(str::to_owned).collect());
    std::fs::write(&path, lines.join("\n")).unwrap();
    let fault = Case::read(folder).unwrap_err();
    std::fs::write(&path, before).unwrap();
    source_chain(&fault)
}

#[test]
fn faults_name_file_and_line() {
    let folder = tempfile::tempdir().unwrap();
    tank_case().write(folder.path(), Existing::Refuse).unwrap();
    let line = |at: usize, text: &'static str| {
        move |mut lines: Vec<String>| {
            text.clone_into(&mut lines[at - 1]);
            lines
        }
    };
    for (file, at, text, wanted) in [
        (
            "nodes.csv",
            1,
            "x_mm,y_mm",
            "nodes.csv:1: column 'x_mm' is not 'x_m'",
        ),
        (
            "protocol.csv",
            1,
            "meas,source,sink,v_plus,v_minus,current_mA",
            "protocol.csv:1: column 'current_mA' is not 'current_A'",
        ),
        (
            "nodes.csv",
            3,
            "0.1,x",
            "nodes.csv:3: column 2 is 'x', which is not a number",
        ),
        (
            "nodes.csv",
            4,
            "0.1",
            "nodes.csv:4: 1 columns, 2 are needed",
        ),
        (
            "elems.csv",
            2,
            "0,1,99999",
            "elems.csv:2: node 99999 does not exist",
        ),
        (
            "elems.csv",
            2,
            "0,1.5,2",
            "elems.csv:2: node is 1.5, which is not an index",
        ),
        (
            "electrode_edges.csv",
            5,
            "16,0,1",
            "electrode_edges.csv:5: electrode 16 does not exist",
        ),
        (
            "electrodes.csv",
            3,
            "0,1,1,0,0",
            "electrodes.csv:3: electrode 0 where electrode 1",
        ),
        (
            "protocol.csv",
            7,
            "5,0,1,2,16,1",
            "protocol.csv:7: electrode 16 does not exist",
        ),
        (
            "protocol.csv",
            7,
            "5,0,0,2,3,1",
            "reading 5 joins electrode 1 to itself",
        ),
    ] {
        let fault = change(folder.path(), file, line(at, text));
        assert!(fault.contains(wanted), "{fault}");
    }
    let millimetres = |lines: Vec<String>| {
        let scaled = |field: &str| (1e3 * field.parse::<f64>().unwrap()).to_string();
        let row = |line: &String| line.split(',').map(scaled).collect::<Vec<_>>().join(",");
        let rows = lines[1..].iter().map(row);
        std::iter::once(lines[0].clone()).chain(rows).collect()
    };
    let fault = change(folder.path(), "nodes.csv", millimetres);
    let sizes = "nodes.csv: the sheet is 300 m x 300 m, and at most 20 m are possible. If the values are in mm, it is 300 mm x 300 mm";
    assert!(fault.contains(sizes), "{fault}");
    let short = |mut lines: Vec<String>| {
        lines.pop();
        lines
    };
    let fault = change(folder.path(), "sigma_homog.csv", short);
    assert!(
        fault.contains("sigma_homog.csv: ") && fault.contains("one an element"),
        "{fault}"
    );
    std::fs::remove_file(folder.path().join("elems.csv")).unwrap();
    let fault = source_chain(&Case::read(folder.path()).unwrap_err());
    assert!(fault.contains("elems.csv: No such file"), "{fault}");
}

/// An invalid mesh: the error names file and line.
#[test]
fn faulty_meshes_name_file_and_line() {
    let folder = tempfile::tempdir().unwrap();
    let case = tank_case();
    case.write(folder.path(), Existing::Refuse).unwrap();
    let [a, b, c] = case.mesh.triangles()[4];
    let count = case.mesh.nodes().len();
    let of_line = |at: usize, text: String| {
        move |mut lines: Vec<String>| {
            text.clone_into(&mut lines[at - 1]);
            lines
        }
    };
    let without = |electrode: &'static str| {
        move |lines: Vec<String>| {
            let kept = |line: &String| !line.starts_with(electrode);
            lines.into_iter().filter(kept).collect()
        }
    };
    let with = |lines_more: Vec<String>| {
        move |mut lines: Vec<String>| {
            lines.extend(lines_more.clone());
            lines
        }
    };
    let path = folder.path();
    let faults = [
        (
            change(path, "elems.csv", of_line(6, format!("{a},{c},{b}"))),
            "elems.csv:6: the mesh is refused: element 4 is inverted",
        ),
        (
            change(path, "elems.csv", of_line(6, format!("{a},{b},{b}"))),
            "elems.csv:6: the mesh is refused: element 4 has no area",
        ),
        (
            change(path, "nodes.csv", with(vec!["0.3,0.3".to_owned()])),
            "belongs to no element",
        ),
        (
            change(path, "electrode_edges.csv", without("3,")),
            "electrodes.csv:5: the mesh is refused: electrode 4 touches nothing",
        ),
        (
            change(
                path,
                "electrode_edges.csv",
                of_line(2, format!("0,{a},{count}")),
            ),
            "electrode_edges.csv:2: node",
        ),
        (
            change(
                path,
                "electrode_edges.csv",
                of_line(2, format!("0,{a},{b}")),
            ),
            "is not a boundary edge of the mesh",
        ),
        (
            change(
                path,
                "electrodes.csv",
                of_line(4, "2,-1,0.01,0,0".to_owned()),
            ),
            "electrodes.csv:4: contact impedance -1 ohm m is negative",
        ),
        (
            change(path, "sigma_homog.csv", of_line(9, "-0.001".to_owned())),
            "sigma_homog.csv:9: conductance -0.001 S is negative",
        ),
        (
            change(path, "sigma_homog.csv", of_line(9, "nan".to_owned())),
            "sigma_homog.csv:9: column 1 is empty or not a finite number",
        ),
    ];
    for (fault, wanted) in &faults {
        assert!(fault.contains(wanted), "{fault}");
    }
    // labels are a column of the file
    let labelled = path.join("labelled.csv");
    std::fs::write(&labelled, "a,1\nb,nan\n").unwrap();
    let fault = case.sigma(labelled.to_str().unwrap()).unwrap_err();
    let wanted = "labelled.csv:2: column 2 is empty or not a finite number";
    assert!(fault.to_string().contains(wanted), "{fault}");
    // a second piece far away
    let nodes = std::fs::read_to_string(path.join("nodes.csv")).unwrap();
    std::fs::write(path.join("nodes.csv"), nodes + "1,1\n2,1\n1,2\n").unwrap();
    let piece = format!("{count},{},{}", count + 1, count + 2);
    let fault = change(path, "elems.csv", with(vec![piece]));
    let line = case.mesh.triangles().len() + 2;
    let wanted = format!("elems.csv:{line}: the mesh is refused: element");
    assert!(
        fault.contains(&wanted) && fault.contains("one piece"),
        "{fault}"
    );
}

#[test]
fn a_missing_current_is_one_ampere() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("protocol.csv");
    std::fs::write(
        &path,
        "meas,source,sink,v_plus,v_minus\n0,0,1,2,3\n1,0,1,3,4\n",
    )
    .unwrap();
    let (protocol, currents) = read_protocol(&path, None).unwrap();
    assert_eq!(protocol.electrodes(), 5);
    assert_eq!(currents, [1.0, 1.0]);
    std::fs::write(&path, "0,0,1,2,3,0.002\n").unwrap();
    let (protocol, currents) = read_protocol(&path, Some(16)).unwrap();
    assert_eq!(protocol.electrodes(), 16);
    assert_eq!(currents, [2e-3]);
}

#[test]
fn frames_lie_or_stand() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("frames.csv");
    let put = |text: &str| std::fs::write(&path, text).unwrap();
    let two = vec![
        vec![Some(1.0), Some(2.0), None],
        vec![Some(4.0), Some(5.0), Some(6.0)],
    ];
    // rows of frames: plain, with a header, with labels, with both
    put("1,2,nan\n4,5,6\n");
    assert_eq!(read_frames(&path, 3).unwrap(), two);
    put(&frames_text(&two));
    assert_eq!(read_frames(&path, 3).unwrap(), two);
    put("empty,1,2,\nball,4,5,6\n");
    assert_eq!(read_frames(&path, 3).unwrap(), two);
    put("frame,m0,m1,m2\nempty,1,2,\nball,4,5,6\n");
    let named = read_named_frames(&path, 3).unwrap();
    assert_eq!(named[1], ("ball".to_owned(), two[1].clone()));
    // a label that is a number
    put("frame,m0,m1,m2\n3,1,2,\n7,4,5,6\n");
    let named = read_named_frames(&path, 3).unwrap();
    assert_eq!(named[1], ("7".to_owned(), two[1].clone()));
    // columns of frames
    put("ref,train\n1,4\n2,5\nnan,6\n");
    let named = read_named_frames(&path, 3).unwrap();
    assert_eq!(named[0], ("ref".to_owned(), two[0].clone()));
    assert_eq!(named[1], ("train".to_owned(), two[1].clone()));
    // one column of values
    put("v_V\n1\n2\n3\n");
    assert_eq!(read_frames(&path, 3).unwrap().len(), 1);
    // an overload is a missing reading
    put("1,+9.90000000E+37,3\n");
    assert_eq!(read_frames(&path, 3).unwrap()[0][1], None);
    put("1,inf,3\n");
    assert_eq!(read_frames(&path, 3).unwrap()[0][1], None);
    put("m0,m1,m2\n1,2,3\n1,2\n");
    let fault = read_frames(&path, 3).unwrap_err().to_string();
    assert!(
        fault.ends_with("frames.csv:3: 2 columns, 3 are needed"),
        "{fault}"
    );
    put("1,2,3,4\n");
    let fault = read_frames(&path, 3).unwrap_err().to_string();
    assert!(fault.contains("frames.csv:1: 4 columns, 3 "), "{fault}");
}

#[test]
fn files_of_other_formats_are_named_with_a_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("frames.csv");
    for (bytes, what) in [
        (&b"m0\tm1\n1\t2\n"[..], "separated by tabs"),
        (b"m0;m1\n1,5;2\n", "separated by semicolons"),
        (b"1.5 2 3e-6\n", "separated by spaces"),
        (b"\x93NUMPY\x01\x00v\x00", "numpy.load"),
        (b"MATLAB 5.0 MAT-file, Platform: GLNXA64", "writematrix"),
        (b"MATLAB 7.3 MAT-file, Platform: GLNXA64", "writematrix"),
        (b"\x89HDF\r\n\x1a\n", "h5py"),
        (b"PK\x03\x04", ".xlsx"),
        (b"\xff\xfe1\x00,\x002\x00", "UTF-16"),
        (b"1,\xe9\n", "UTF-8"),
    ] {
        std::fs::write(&path, bytes).unwrap();
        let fault = read_frames(&path, 2).unwrap_err();
        assert!(matches!(fault, CaseError::NotCsv { .. }), "{fault}");
        let text = fault.to_string();
        assert!(
            text.contains("frames.csv") && text.contains(what) && text.contains("CSV"),
            "{text}"
        );
    }
    // blanks round a comma, and a text with blanks, are CSV
    std::fs::write(&path, "the first,the second\n1, 2\n3,\t4\n").unwrap();
    assert_eq!(read_frames(&path, 2).unwrap().len(), 2);
}
