//! Receipts of the archive: a session is pruned only if the archive has its current content.

use std::path::{Path, PathBuf};

use crate::example_frames::taken::{at, taken};
use logbook::{
    ArchiveReceipt, Retention, SessionHeader, SessionWriter, append_quantities, archived,
    mark_archived, prune, sha256_of,
};
use survey::{Protocol, Reading};

fn session(dir: &Path, id: &str) -> PathBuf {
    let protocol = Protocol::sheffield(8).unwrap();
    let readings = vec![Reading::NotMeasured; protocol.len()];
    let mut writer =
        SessionWriter::create(dir, &SessionHeader::new(id, at(0), protocol.clone())).unwrap();
    writer
        .append(&taken(&protocol, 1, 1, readings), None)
        .unwrap();
    let path = writer.path().to_owned();
    writer.close(at(2), "done").unwrap();
    path
}

fn mark(path: &Path, quantity_lines: u64) {
    let (sha256, bytes) = sha256_of(std::fs::File::open(path).unwrap()).unwrap();
    let receipt = ArchiveReceipt {
        at: at(3),
        sha256,
        bytes,
        stored_as: "berlin/bed3/m1/m1.tactus".into(),
        quantity_lines,
    };
    mark_archived(path, &receipt).unwrap();
}

#[test]
fn only_sessions_archived_as_they_are_now_are_pruned() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let paths = ["m1", "m2", "m3", "m4"].map(|id| session(dir, id));
    mark(&paths[0], 0);
    // altered since in one byte that no reader uses: SQLite's version number
    mark(&paths[1], 0);
    let mut bytes = std::fs::read(&paths[1]).unwrap();
    bytes[99] ^= 1;
    std::fs::write(&paths[1], bytes).unwrap();
    // a line of quantities that the archive does not have
    append_quantities(dir, "m3", "{}").unwrap();
    mark(&paths[2], 0);
    assert!(archived(&paths[2]).is_none());
    let only = Retention {
        archived_only: true,
        ..Retention::default()
    };
    let pruned = prune(dir, &only, at(60), false).unwrap();
    let ids: Vec<&str> = pruned.removed.iter().map(|gone| gone.id.as_str()).collect();
    assert_eq!(ids, ["m1"]);
    assert_eq!(pruned.removed[0].why, "it has been archived");
    assert_eq!(pruned.spared.len(), 3, "{pruned:?}");
    assert_eq!(paths.map(|path| path.exists()), [false, true, true, true]);
    assert!(!dir.join("m1.archived.json").exists());
    // with the line in the archive it goes too
    mark(&dir.join("m3.tactus"), 1);
    let pruned = prune(dir, &only, at(60), false).unwrap();
    assert_eq!(pruned.removed.len(), 1, "{pruned:?}");
}
