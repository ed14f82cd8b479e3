//! A case folder with one file damaged or replaced by arbitrary text is read, or refused with file and line; it never
//! panics. A folder that is read is written again and must read back equal. The same text also goes through the readers
//! of single files, which do not know the numbers of electrodes and readings.

#![no_main]

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use eit::{Case, Existing, Mesh, Table, frames_text, read_frames, read_protocol};
use libfuzzer_sys::fuzz_target;
use survey::Protocol;

const FILES: [&str; 8] = [
    "nodes.csv",
    "elems.csv",
    "electrode_edges.csv",
    "electrodes.csv",
    "protocol.csv",
    "roi.csv",
    "sigma_homog.csv",
    "frames.csv",
];

struct Folder {
    path: PathBuf,
    again: PathBuf,
    texts: Vec<Vec<u8>>,
}

static FOLDER: OnceLock<Folder> = OnceLock::new();

fuzz_target!(|bytes: &[u8]| {
    let Some((&[kind, which], bytes)) = bytes.split_first_chunk() else {
        return;
    };
    let folder = FOLDER.get_or_init(small);
    let which = usize::from(which) % FILES.len();
    let text = match kind % 4 {
        0 => bytes.to_vec(),
        _ => damaged(&folder.texts[which], bytes),
    };
    let path = folder.path.join(FILES[which]);
    put(&path, &text);
    if let Ok(case) = Case::read(&folder.path) {
        case.write(&folder.again, Existing::Replace)
            .expect("a case that was read");
        let again = Case::read(&folder.again).expect("a case that was written");
        assert_eq!(again, case);
        let _ = std::fs::remove_dir_all(&folder.again);
    }
    if let Ok(table) = Table::read(&path) {
        assert!(table.rows.iter().all(|row| row.len() == table.width()));
    }
    for readings in [1, 4, 8] {
        let Ok(frames) = read_frames(&path, readings) else {
            continue;
        };
        put(&path, frames_text(&frames).as_bytes());
        if !frames.is_empty() {
            let again = read_frames(&path, readings);
            assert_eq!(again.expect("frames that were written"), frames);
        }
        put(&path, &text);
    }
    let _ = read_protocol(&path, None);
    let _ = read_protocol(&path, Some(4));
    put(&path, &folder.texts[which]);
});

/// Each order: position, number of bytes removed, number of bytes inserted.
fn damaged(text: &[u8], mut orders: &[u8]) -> Vec<u8> {
    let mut damaged = text.to_vec();
    while let Some((&[at, sizes], rest)) = orders.split_first_chunk() {
        let (new, rest) = rest.split_at(usize::from(sizes & 15).min(rest.len()));
        orders = rest;
        let at = usize::from(at) * damaged.len() / 256;
        let end = (at + usize::from(sizes >> 4)).min(damaged.len());
        damaged.splice(at..end, new.iter().copied());
    }
    damaged
}

fn put(path: &Path, bytes: &[u8]) {
    std::fs::write(path, bytes).expect("a temporary file");
}

/// Eight triangles around a node, four electrodes.
fn small() -> Folder {
    let memory = Path::new("/dev/shm");
    let base = if memory.is_dir() {
        memory.to_owned()
    } else {
        std::env::temp_dir()
    };
    let path = tempfile::Builder::new()
        .prefix("fuzz")
        .tempdir_in(base)
        .expect("a temporary folder")
        .keep();
    let ring = (0..8).map(|k| {
        let angle = f64::from(k) * std::f64::consts::FRAC_PI_4;
        [0.1 * angle.cos(), 0.1 * angle.sin()]
    });
    let nodes = std::iter::once([0.0, 0.0]).chain(ring).collect();
    let triangles: Vec<_> = (0..8).map(|k| [0, 1 + k, 1 + (k + 1) % 8]).collect();
    let edges = (0..4).map(|k| vec![[1 + 2 * k, 2 + 2 * k]]).collect();
    let mesh = Mesh::new(nodes, triangles, edges, Some(vec![1, 3, 5])).expect("a small mesh");
    let protocol = Protocol::sheffield(4).expect("4 electrodes");
    let case = Case {
        contact_ohm_m: vec![0.3; 4],
        currents: vec![1e-3; protocol.len()],
        sigma: [("homog".to_owned(), vec![1e-3; 8])].into(),
        mesh: Arc::new(mesh),
        has_region: true,
        protocol: protocol.clone(),
    };
    case.write(&path, Existing::Replace).expect("a small case");
    assert_eq!(Case::read(&path).expect("a small case"), case);
    let frames = [vec![Some(1e-3); protocol.len()], vec![None; protocol.len()]];
    put(&path.join("frames.csv"), frames_text(&frames).as_bytes());
    let texts = FILES
        .iter()
        .map(|file| std::fs::read(path.join(file)).expect("a file of the case"))
        .collect();
    Folder {
        again: path.join("again"),
        path,
        texts,
    }
}
