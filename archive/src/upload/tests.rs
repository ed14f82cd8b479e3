use std::fs::File;

use logbook::{SessionHeader, SessionWriter};
use survey::Protocol;

use super::*;

fn closed(folder: &std::path::Path, id: &str) -> Closed {
    Closed {
        id: id.to_owned(),
        session: "m1".to_owned(),
        path: folder.join(format!("{id}.tactus")),
    }
}

#[test]
fn new_lines_of_quantities_do_not_read_a_part_again() {
    let folder = tempfile::tempdir().unwrap();
    let header = SessionHeader::new("m1", DateTime::UNIX_EPOCH, Protocol::sheffield(8).unwrap());
    let writer = SessionWriter::create(folder.path(), &header).unwrap();
    writer.close(DateTime::UNIX_EPOCH, "done").unwrap();
    let part = closed(folder.path(), "m1");
    let open = || File::options().write(true).open(&part.path).unwrap();
    let (sha256, bytes) = logbook::sha256_of(File::open(&part.path).unwrap()).unwrap();
    let recorded = open().metadata().unwrap().modified().unwrap();
    let owner = Owner {
        site: "berlin".to_owned(),
        daq: "bed3".to_owned(),
    };
    let uploader = Uploader::new(folder.path(), owner);
    let lines = || logbook::receipt(&part.path).unwrap().quantity_lines;
    assert_eq!(uploader.confirm(&part, &sha256, 1), Ok(true));
    assert_eq!(uploader.confirm(&part, &sha256, 1), Ok(false));
    // the content is no longer a session: an attempt to read it would fail
    std::fs::write(&part.path, vec![0; bytes as usize]).unwrap();
    open().set_modified(recorded).unwrap();
    assert_eq!(uploader.confirm(&part, &sha256, 2), Ok(true));
    assert_eq!(lines(), 2);
    let changed = DateTime::<Utc>::from(recorded) + std::time::Duration::from_secs(86_400);
    open().set_modified(changed.into()).unwrap();
    assert!(uploader.confirm(&part, &sha256, 3).is_err());
    assert_eq!(lines(), 2);
}

#[test]
fn first_part_is_the_one_with_the_lowest_number() {
    let parts = ["m1_p10", "m1_p2", "m1_p3"].map(|id| closed("record".as_ref(), id));
    assert_eq!(first_parts(&parts), [("m1", "m1_p2")].into());
}
