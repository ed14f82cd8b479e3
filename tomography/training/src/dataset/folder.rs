//! The files of a set in a folder: names, manifests, and refusal of files of another set.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::ops::Range;
use std::path::{Path, PathBuf};

use eit::{Case, TrainingSettings};
use outfile::Existing;
use serde_json::{Value, json};
use shards::{PartFile, Shard, ShardError};

use super::{DataSetError, header, read};

/// Upper limit of the length of a header, bytes. Settings with the noise of measured frames are the longest.
const LONGEST: u64 = 1 << 28;

/// The files of a shard.
pub(super) struct Paths {
    name: String,
    pub(super) whole: PathBuf,
    pub(super) part: PathBuf,
    pub(super) manifest: PathBuf,
}

impl Paths {
    pub(super) fn new(folder: &Path, shard: Shard) -> Self {
        let name = shard.name();
        Self {
            whole: folder.join(format!("{name}.tset")),
            part: folder.join(format!("{name}.part")),
            manifest: folder.join(format!("{name}.json")),
            name,
        }
    }
}

/// Numbers of the shards of a set that are not complete in a folder.
///
/// # Errors
/// A shard of another set, or a folder that cannot be read.
pub fn missing(
    case: &Case,
    settings: &TrainingSettings,
    of: usize,
    folder: &Path,
) -> Result<Vec<usize>, DataSetError> {
    let mut missing = Vec::new();
    for shard in Shard::all(of) {
        let paths = Paths::new(folder, shard);
        match read::manifest(&paths.manifest)? {
            None => missing.push(shard.index()),
            Some(manifest) => {
                let here = header(case, settings, shard);
                ShardError::refuse_difference(&paths.manifest, &manifest["header"], &here)?;
            }
        }
    }
    Ok(missing)
}

/// Locks the part of a shard; `None` if another process completed the shard before the lock was taken.
pub(super) fn lock(
    folder: &Path,
    paths: &Paths,
    header: &Value,
    shard: Shard,
) -> Result<Option<PartFile>, DataSetError> {
    let part = PartFile::lock(&paths.part)?;
    if paths.manifest.exists() {
        part.remove()?;
        return Ok(None);
    }
    // another process may have changed the folder, too
    refuse_others(folder, header, shard)?;
    Ok(Some(part))
}

/// Renames a complete part to its final name, then writes its manifest; returns the SHA-256 of the file, hex.
pub(super) fn close(
    part: PartFile,
    paths: &Paths,
    header: &Value,
    cases: &Range<usize>,
) -> Result<String, DataSetError> {
    let bytes = std::fs::metadata(&paths.part).map_or(0, |data| data.len());
    let hash = read::hash_of(&paths.part)?;
    part.finish(&paths.whole)?;
    let manifest = json!({
        "file": format!("{}.tset", paths.name),
        "bytes": bytes,
        "sha256": hash,
        "first": cases.start,
        "cases": cases.len(),
        "header": header,
    });
    // another process that waited for the lock may have written the same manifest
    outfile::write(
        &paths.manifest,
        Existing::Replace,
        format!("{manifest:#}\n").as_bytes(),
    )?;
    Ok(hash)
}

/// Refuses a folder with a shard of another set, complete or not, because the new shard could not be used together with
/// it.
pub(super) fn refuse_others(
    folder: &Path,
    header: &Value,
    shard: Shard,
) -> Result<(), DataSetError> {
    let entries = match std::fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        Err(cause) => return Err(ShardError::io(folder)(cause).into()),
    };
    let mut paths = Vec::new();
    for entry in entries {
        paths.push(entry.map_err(ShardError::io(folder))?.path());
    }
    paths.sort();
    let own = Paths::new(folder, shard);
    for path in paths {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if !name.starts_with("shard-") {
            continue;
        }
        let there = match path.extension().and_then(|ending| ending.to_str()) {
            Some("json") => read::manifest(&path)?.map(|manifest| manifest["header"].clone()),
            // a `.tset` file without a manifest: a run may have been killed after the rename and before it wrote the
            // manifest
            Some("part" | "tset") => {
                let own = path == own.part || path == own.whole;
                first_line(&path, own.then_some(header))?
            }
            _ => None,
        };
        let Some(there) = there else { continue };
        let mut here = header.clone();
        // other shards of the same division belong to the set
        if there["shard"][1] == here["shard"][1] && path != own.part && path != own.whole {
            here["shard"] = there["shard"].clone();
        }
        ShardError::refuse_difference(&path, &there, &here)?;
    }
    Ok(())
}

/// The header of a shard; `None` if the writing process was killed before the header was complete. `own`: the header of
/// the shard that will be written to this file.
fn first_line(path: &Path, own: Option<&Value>) -> Result<Option<Value>, DataSetError> {
    let failed = |cause| DataSetError::from(ShardError::io(path)(cause));
    let refused = || {
        DataSetError::unusable(
            path,
            " is not a shard of this set: remove it, or give another --out",
        )
    };
    // another process may have completed and renamed its part since the folder was listed
    let absent = |cause: &std::io::Error| cause.kind() == std::io::ErrorKind::NotFound;
    let found = match std::fs::symlink_metadata(path) {
        Ok(found) => found,
        Err(cause) if absent(&cause) => return Ok(None),
        Err(cause) => return Err(failed(cause)),
    };
    if !found.is_file() {
        return if own.is_some() {
            Err(refused())
        } else {
            Ok(None)
        };
    }
    let file = match File::open(path) {
        Ok(file) => file,
        Err(cause) if absent(&cause) => return Ok(None),
        Err(cause) => return Err(failed(cause)),
    };
    let mut line = Vec::new();
    BufReader::new(file.take(LONGEST))
        .read_until(b'\n', &mut line)
        .map_err(failed)?;
    if line.ends_with(b"\n") {
        return serde_json::from_slice(&line)
            .map(Some)
            .map_err(|_| refused());
    }
    match own {
        Some(own) if !own.to_string().as_bytes().starts_with(&line) => Err(refused()),
        _ => Ok(None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checks_are_repeated_after_a_part_is_locked() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let paths = Paths::new(folder, Shard::WHOLE);
        let header = json!({ "seed": 1, "shard": [0, 1] });
        let part = lock(folder, &paths, &header, Shard::WHOLE).unwrap();
        close(part.unwrap(), &paths, &header, &(0..0)).unwrap();
        // the shard was completed between the first checks and the lock
        let part = lock(folder, &paths, &header, Shard::WHOLE).unwrap();
        assert!(part.is_none() && !paths.part.exists());
        // the shard became that of another set
        std::fs::remove_file(&paths.manifest).unwrap();
        let other = json!({ "seed": 2, "shard": [0, 1] });
        std::fs::write(&paths.whole, format!("{other}\n")).unwrap();
        let refused = lock(folder, &paths, &header, Shard::WHOLE).unwrap_err();
        assert!(refused.to_string().contains("seed"), "{refused}");
    }
}
