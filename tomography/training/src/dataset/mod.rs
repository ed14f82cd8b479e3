//! Training sets in files, in shards that can be made on any machine, in any order, and resumed. `samples` provides the
//! cases; the command line is `tactus-lab dataset`.
//!
//! A shard `shard-I-of-N.tset` holds the cases c with c * N / cases = I of one set: a header line of JSON, then a
//! record for each case, little-endian: the number of changed triangles (u32), the normalised readings (f32), and (u32,
//! f32) for each change. When it is complete, its manifest `shard-I-of-N.json` with the SHA-256 of the file is written.
//! An incomplete shard is `.part`; its complete records are reused when the command is repeated. Case c depends on
//! settings and seed only.

mod error;
mod read;

use std::fs::{File, OpenOptions};
use std::io::{BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use eit::model::fingerprint;
use eit::{Case, TrainingSettings};
use outfile::Existing;
use rayon::prelude::*;
use rustix::fs::OFlags;
use serde_json::json;

use crate::samples::{Sample, Samples, Simulation};
pub use error::DataSetError;
pub use read::DataSet;

/// Cases solved in parallel between two writes.
const BLOCK: usize = 64;
const LAYOUT: u32 = 1;

/// A shard of a set, new or existing.
#[derive(Debug)]
pub struct Shard {
    /// Its file.
    pub file: PathBuf,
    /// The cases of the set in it.
    pub cases: Range<usize>,
    /// Number of cases made by an earlier run.
    pub kept: usize,
    /// SHA-256 of the file, hex; `None` if the shard existed already.
    pub sha256: Option<String>,
}

/// Makes or resumes shard `index` of `of` in `folder`; an existing shard is unchanged. `progress` is called with the
/// number of completed cases and the number of cases in the shard.
///
/// # Errors
/// Files that cannot be read or written, or that belong to another set; a case that cannot be solved.
pub fn make_shard(
    case: &Case,
    settings: &TrainingSettings,
    [index, of]: [usize; 2],
    folder: &Path,
    progress: &dyn Fn(usize, usize),
) -> Result<Shard, DataSetError> {
    outfile::make_folder(folder, Existing::Replace)?;
    let sigma0 = case.unloaded_conductance();
    let simulation = Simulation::new(
        &case.mesh,
        &case.contact_ohm_m,
        &sigma0,
        &case.protocol,
        settings,
    )?;
    let header = header(case, settings, &simulation, index, of);
    let name = format!("shard-{index}-of-{of}");
    let paths = Paths {
        whole: folder.join(format!("{name}.tset")),
        part: folder.join(format!("{name}.part")),
        manifest: folder.join(format!("{name}.json")),
    };
    let cases = cases_of(index, of, settings.cases);
    if let Some(manifest) = read::manifest(&paths.manifest)? {
        if manifest["header"] == header {
            return Ok(Shard {
                file: paths.whole,
                kept: cases.len(),
                cases,
                sha256: None,
            });
        }
        return Err(DataSetError::unusable(
            &paths.manifest,
            ": is a shard of another set (settings, seed or geometry differ); give another --out",
        ));
    }
    let head = format!("{header}\n");
    // a run may have been killed between the rename after the last record and the manifest
    for path in [&paths.part, &paths.whole] {
        if !begins(path, &head)? {
            return Err(DataSetError::unusable(
                path,
                " is no shard of this set: remove it, or give another --out",
            ));
        }
    }
    let kept = make(&simulation, &head, cases.clone(), &paths.part, progress)?;
    let bytes = std::fs::metadata(&paths.part).map_or(0, |data| data.len());
    let hash = read::hash_of(&paths.part)?;
    std::fs::rename(&paths.part, &paths.whole)
        .map_err(|cause| DataSetError::io(&paths.whole, cause))?;
    let manifest = json!({
        "file": format!("{name}.tset"),
        "bytes": bytes,
        "sha256": hash,
        "first": cases.start,
        "cases": cases.len(),
        "header": header,
    });
    outfile::write(
        &paths.manifest,
        Existing::Refuse,
        format!("{manifest:#}\n").as_bytes(),
    )?;
    Ok(Shard {
        file: paths.whole,
        cases,
        kept,
        sha256: Some(hash),
    })
}

struct Paths {
    whole: PathBuf,
    part: PathBuf,
    manifest: PathBuf,
}

/// The cases of a shard.
fn cases_of(index: usize, of: usize, cases: usize) -> Range<usize> {
    cases * index / of..cases * (index + 1) / of
}

/// The header, which contains everything that determines the bits of a shard.
fn header(
    case: &Case,
    settings: &TrainingSettings,
    simulation: &Simulation,
    index: usize,
    of: usize,
) -> serde_json::Value {
    let sheet = json!({
        "contact_ohm_m": case.contact_ohm_m,
        "sigma0": case.unloaded_conductance(),
    });
    json!({
        "layout": LAYOUT,
        "geometry": case.mesh.hash(),
        "survey": case.protocol.hash(),
        "contacts_and_sigma0": fingerprint(sheet.to_string().as_bytes()),
        "settings": settings,
        "inputs": simulation.inputs(),
        "outputs": simulation.outputs(),
        "shard": [index, of],
    })
}

/// Whether a file is absent, or begins with the header or with a part of it written by a killed run.
fn begins(path: &Path, head: &str) -> Result<bool, DataSetError> {
    let failed = |cause: std::io::Error| DataSetError::io(path, cause);
    match std::fs::symlink_metadata(path) {
        Ok(found) if found.is_file() => {}
        Ok(_) => return Ok(false),
        Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => return Ok(true),
        Err(cause) => return Err(failed(cause)),
    }
    let mut begin = Vec::new();
    let file = File::open(path).map_err(failed)?;
    file.take(head.len() as u64)
        .read_to_end(&mut begin)
        .map_err(failed)?;
    Ok(head.as_bytes().starts_with(&begin))
}

/// Writes the missing records; returns the number of existing ones.
fn make(
    simulation: &Simulation,
    head: &str,
    range: Range<usize>,
    part: &Path,
    progress: &dyn Fn(usize, usize),
) -> Result<usize, DataSetError> {
    let failed = |cause: std::io::Error| full(part, &cause);
    let file = OpenOptions::new()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .custom_flags((OFlags::NOFOLLOW | OFlags::CLOEXEC).bits() as i32)
        .open(part)
        .map_err(failed)?;
    let (kept, end) = resume(&file, head, simulation.inputs(), range.len()).map_err(failed)?;
    file.set_len(end).map_err(failed)?;
    let mut writer = BufWriter::new(file);
    writer.seek(SeekFrom::Start(end)).map_err(failed)?;
    if end == 0 {
        writer.write_all(head.as_bytes()).map_err(failed)?;
        baseline(&mut writer, simulation.baseline()).map_err(failed)?;
    }
    progress(kept, range.len());
    let mut first = range.start + kept;
    while first < range.end {
        let last = (first + BLOCK).min(range.end);
        let samples = (first..last)
            .into_par_iter()
            .map(|case| simulation.sample(case))
            .collect::<Result<Vec<_>, _>>()?;
        for sample in &samples {
            record(&mut writer, sample).map_err(failed)?;
        }
        writer.flush().map_err(failed)?;
        first = last;
        progress(first - range.start, range.len());
    }
    writer.get_ref().sync_all().map_err(failed)?;
    Ok(kept)
}

/// The error for a failed write: the written part is kept, and the message explains how to continue.
fn full(part: &Path, cause: &std::io::Error) -> DataSetError {
    DataSetError::unusable(
        part,
        format!(
            ": {cause}; the cases written so far stay: make room and run the same command again"
        ),
    )
}

fn baseline(out: &mut impl Write, volts: &[f64]) -> std::io::Result<()> {
    for value in volts {
        out.write_all(&value.to_le_bytes())?;
    }
    Ok(())
}

fn record(out: &mut impl Write, sample: &Sample) -> std::io::Result<()> {
    out.write_all(&(sample.target.len() as u32).to_le_bytes())?;
    for value in &sample.input {
        out.write_all(&value.to_le_bytes())?;
    }
    for (unknown, change) in &sample.target {
        out.write_all(&unknown.to_le_bytes())?;
        out.write_all(&change.to_le_bytes())?;
    }
    Ok(())
}

/// Number of complete records after a matching header, and where they end; 0 if the header does not match.
fn resume(file: &File, head: &str, inputs: usize, most: usize) -> std::io::Result<(usize, u64)> {
    let length = file.metadata()?.len();
    let mut reader = BufReader::new(file);
    let start = (head.len() + 8 * inputs) as u64;
    let mut found = vec![0; head.len().min(length as usize)];
    reader.read_exact(&mut found)?;
    if found != head.as_bytes() || length < start {
        return Ok((0, 0));
    }
    let (mut count, mut at) = (0, start);
    reader.seek(SeekFrom::Start(at))?;
    while count < most && at + 4 <= length {
        let mut changes = [0; 4];
        reader.read_exact(&mut changes)?;
        let size = 4 * inputs as u64 + 8 * u64::from(u32::from_le_bytes(changes));
        if at + 4 + size > length {
            break;
        }
        reader.seek_relative(size as i64)?;
        at += 4 + size;
        count += 1;
    }
    Ok((count, at))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_cover_every_case_once() {
        for cases in [1, 7, 100] {
            for of in [1, 3, 8] {
                let all: Vec<usize> = (0..of).flat_map(|i| cases_of(i, of, cases)).collect();
                assert_eq!(all, (0..cases).collect::<Vec<_>>());
            }
        }
    }

    /// A disk that is full after this number of bytes.
    struct Small(usize);

    impl Write for Small {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            if self.0 == 0 {
                return Err(std::io::ErrorKind::StorageFull.into());
            }
            let taken = bytes.len().min(self.0);
            self.0 -= taken;
            Ok(taken)
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn full_disk_is_reported_with_the_next_step() {
        let sample = Sample {
            input: vec![1.0; 10],
            target: vec![(1, -0.5)],
        };
        let fault = record(&mut Small(20), &sample).unwrap_err();
        let message = full(Path::new("a.part"), &fault).to_string();
        assert!(
            message.contains("a.part") && message.contains("again"),
            "{message}"
        );
    }
}
