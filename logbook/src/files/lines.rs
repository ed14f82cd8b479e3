//! Files to which lines are only appended.

use std::fs::File;
use std::io::{Result, Write};
use std::os::unix::fs::FileExt;
use std::path::Path;

/// Opens a file for [`append_line`]; creates it if it is missing.
pub(crate) fn open_for_lines(path: &Path) -> Result<File> {
    File::options()
        .create(true)
        .read(true)
        .append(true)
        .open(path)
}

/// Appends a line and a line end to a file opened by [`open_for_lines`]. If the last line has no line end,
/// after a power cut or on a full disk, one is written first, so that the new line is separate. If the write fails,
/// the file is truncated to its former length if possible.
pub(crate) fn append_line(file: &mut File, line: &[u8]) -> Result<()> {
    let before = file.metadata()?.len();
    let mut last = [b'\n'];
    if before > 0 {
        file.read_exact_at(&mut last, before - 1)?;
    }
    let torn: &[u8] = if last == *b"\n" { b"" } else { b"\n" };
    let written = file.write_all(&[torn, line, b"\n"].concat());
    if written.is_err() {
        let _ = file.set_len(before);
    }
    written
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn torn_line_takes_no_later_one_with_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lines");
        let mut file = open_for_lines(&path).unwrap();
        append_line(&mut file, b"one").unwrap();
        append_line(&mut file, b"two").unwrap();
        file.write_all(b"thr").unwrap();
        append_line(&mut file, b"four").unwrap();
        assert_eq!(std::fs::read(path).unwrap(), b"one\ntwo\nthr\nfour\n");
    }
}
