//! Rules for output files: content, path, permissions.

use std::io::{Read, Write};
use std::os::unix::fs::{FileTypeExt, PermissionsExt, symlink};
use std::path::Path;

use outfile::{Existing, NewFolder, OutFile, OutFileError};

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = entries
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

#[test]
fn a_new_file_appears_whole_or_not_at_all() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("frames.csv");
    let mut file = OutFile::create(&path, Existing::Refuse).unwrap();
    file.put(b"1,2\n").unwrap();
    file.flush().unwrap();
    assert!(!path.exists());
    drop(file);
    assert_eq!(names(folder.path()), Vec::<String>::new());
    outfile::write(&path, Existing::Refuse, b"1,2\n").unwrap();
    assert_eq!(names(folder.path()), ["frames.csv"]);
    assert_eq!(std::fs::read(&path).unwrap(), b"1,2\n");
    // the expected permissions are those that the umask gives to a new file of any other program
    let plain = folder.path().join("plain");
    std::fs::write(&plain, b"").unwrap();
    let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode();
    assert_eq!(mode(&path), mode(&plain));
}

#[test]
fn a_name_that_is_taken_meanwhile_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("frames.csv");
    let mut file = OutFile::create(&path, Existing::Refuse).unwrap();
    file.put(b"new").unwrap();
    std::fs::write(&path, b"somebody else's").unwrap();
    assert!(matches!(file.finish(), Err(OutFileError::Exists(_))));
    assert_eq!(std::fs::read(&path).unwrap(), b"somebody else's");
    assert_eq!(names(folder.path()), ["frames.csv"]);
}

#[test]
fn files_of_one_output_are_replaced_together_or_not() {
    let folder = tempfile::tempdir().unwrap();
    let [maps, frames] = ["maps.csv", "frames.csv"].map(|name| folder.path().join(name));
    let files = || {
        [&maps, &frames].map(|path| {
            let mut file = OutFile::create(path, Existing::Replace).unwrap();
            file.put(b"new").unwrap();
            file
        })
    };
    std::fs::write(&maps, b"earlier").unwrap();
    let begun = files();
    std::fs::create_dir(&frames).unwrap();
    let refused = outfile::finish_all(begun.into());
    assert!(
        matches!(refused, Err(OutFileError::Folder(_))),
        "{refused:?}"
    );
    assert_eq!(std::fs::read(&maps).unwrap(), b"earlier");
    std::fs::remove_dir(&frames).unwrap();
    let placed = outfile::finish_all(files().into()).unwrap();
    assert_eq!(placed, [maps.clone(), frames.clone()]);
    for path in placed {
        assert_eq!(std::fs::read(path).unwrap(), b"new");
    }
    assert_eq!(names(folder.path()), ["frames.csv", "maps.csv"]);
}

#[test]
fn a_forced_file_replaces_a_link_and_not_its_target() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("target");
    std::fs::write(&target, b"kept").unwrap();
    let path = folder.path().join("latest.csv");
    symlink(&target, &path).unwrap();
    outfile::write(&path, Existing::Replace, b"new").unwrap();
    assert_eq!(std::fs::read(&target).unwrap(), b"kept");
    assert_eq!(std::fs::read(&path).unwrap(), b"new");
    assert!(!std::fs::symlink_metadata(&path).unwrap().is_symlink());
}

#[test]
fn a_device_is_written_to_and_stays_a_device() {
    for existing in [Existing::Refuse, Existing::Replace] {
        let null = Path::new("/dev/null");
        assert!(outfile::is_stream(null));
        outfile::write(null, existing, b"gone").unwrap();
        let kind = std::fs::symlink_metadata(null).unwrap().file_type();
        assert!(kind.is_char_device());
    }
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("null");
    symlink("/dev/null", &link).unwrap();
    outfile::write(&link, Existing::Replace, b"gone").unwrap();
    assert!(std::fs::symlink_metadata(&link).unwrap().is_symlink());
    let full = outfile::write(Path::new("/dev/full"), Existing::Refuse, b"x").unwrap_err();
    assert!(matches!(full, OutFileError::Io { .. }), "{full}");
}

#[test]
fn a_reader_of_a_fifo_gets_the_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pipe");
    rustix::fs::mknodat(
        rustix::fs::CWD,
        &path,
        rustix::fs::FileType::Fifo,
        rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR,
        0,
    )
    .unwrap();
    let reader = {
        let path = path.clone();
        std::thread::spawn(move || {
            let mut text = String::new();
            let mut pipe = std::fs::File::open(path).unwrap();
            pipe.read_to_string(&mut text).unwrap();
            text
        })
    };
    outfile::write(&path, Existing::Replace, b"through the pipe").unwrap();
    assert_eq!(reader.join().unwrap(), "through the pipe");
    assert!(
        std::fs::symlink_metadata(&path)
            .unwrap()
            .file_type()
            .is_fifo()
    );
    assert_eq!(names(folder.path()), ["pipe"]);
}

#[test]
fn a_standard_stream_is_never_replaced() {
    for name in ["/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"] {
        let before = std::fs::read_link(name).unwrap();
        outfile::write(Path::new(name), Existing::Replace, b"").unwrap();
        assert_eq!(std::fs::read_link(name).unwrap(), before, "{name}");
    }
}

#[test]
fn a_file_is_removed_only_where_it_could_be_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("roi.csv");
    outfile::remove(&path, Existing::Refuse).unwrap();
    std::fs::write(&path, b"element\n").unwrap();
    assert!(matches!(
        outfile::remove(&path, Existing::Refuse),
        Err(OutFileError::Exists(_))
    ));
    let target = folder.path().join("target");
    std::fs::rename(&path, &target).unwrap();
    symlink(&target, &path).unwrap();
    outfile::remove(&path, Existing::Replace).unwrap();
    assert_eq!(names(folder.path()), ["target"]);
}

#[test]
fn a_transcript_grows_under_its_name_in_a_new_file_only() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("talk.jsonl");
    let mut file = outfile::create_in_place(&path).unwrap();
    file.write_all(b"line\n").unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), b"line\n");
    assert!(outfile::create_in_place(&path).is_err());
    symlink("elsewhere", folder.path().join("link")).unwrap();
    assert!(outfile::create_in_place(&folder.path().join("link")).is_err());
    assert_eq!(names(folder.path()), ["link", "talk.jsonl"]);
}

#[test]
fn a_new_folder_appears_whole_or_not_at_all() {
    let parent = tempfile::tempdir().unwrap();
    let path = parent.path().join("report");
    let mut folder = NewFolder::create(&path).unwrap();
    folder.put("a.html", b"one").unwrap();
    assert!(folder.put("a.html", b"two").is_err(), "a name twice");
    assert!(!path.exists());
    drop(folder);
    assert_eq!(names(parent.path()), Vec::<String>::new());
    for existing in [false, true] {
        if existing {
            std::fs::remove_file(path.join("a.html")).unwrap();
        }
        let mut folder = NewFolder::create(&path).unwrap();
        folder.put("a.html", b"one").unwrap();
        assert_eq!(folder.finish().unwrap(), path);
        assert_eq!(names(&path), ["a.html"], "{existing}");
        assert_eq!(names(parent.path()), ["report"]);
    }
    let refused = NewFolder::create(&path).unwrap_err();
    assert!(matches!(refused, OutFileError::NotEmpty(_)), "{refused}");
    assert!(NewFolder::create(&path.join("a.html")).is_err());
    assert!(NewFolder::create(&parent.path().join("no/report")).is_err());
}
