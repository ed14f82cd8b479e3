//! Training sets in files, in shards that can be made on any machine, in any order, and resumed. `samples` provides the
//! cases; the command line is `tactus-lab dataset`.
//!
//! A shard `shard-I-of-N.tset` holds the cases c with c * N / cases = I of one set: a header line of JSON, then a
//! record for each case, little-endian: the number of changed triangles (u32), the normalised readings (f32), and (u32,
//! f32) for each change. When it is complete, its manifest `shard-I-of-N.json` with the SHA-256 of the file is written.
//! An incomplete shard is `.part`, locked by the process that makes it; its complete records are reused when the
//! command is repeated. Case c depends on settings and seed only, so merged shards are equal to the file of an
//! undivided run.

mod error;
mod folder;
mod merge;
mod read;
mod recorded;

use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use eit::model::fingerprint;
use eit::{Case, TrainingSettings};
use outfile::Existing;
use rayon::prelude::*;
use serde_json::{Value, json};
use shards::{PartFile, Shard, ShardError, StopRequest};

use crate::samples::{Sample, Samples, Simulation};
pub use error::DataSetError;
use folder::Paths;
pub use folder::missing;
pub use merge::merge;
pub use read::DataSet;
pub use recorded::keep_recorded;

/// Cases solved in parallel between two writes.
const BLOCK: usize = 64;
const LAYOUT: u32 = 1;

/// A shard of a set, new or existing.
#[derive(Debug)]
pub struct MadeShard {
    /// Its file.
    pub file: PathBuf,
    /// The cases of the set in it.
    pub cases: Range<usize>,
    /// Number of cases made by an earlier run.
    pub kept: usize,
    /// SHA-256 of the file, hex; `None` if the shard existed already.
    pub sha256: Option<String>,
}

/// Makes or resumes a shard in `folder`; an existing shard is unchanged. `progress` is called with the number of
/// completed cases and the number of cases in the shard.
///
/// # Errors
/// Files that cannot be read or written, that belong to another set, or that another process writes; a case that cannot
/// be solved; SIGTERM, after the cases in progress.
pub fn make_shard(
    case: &Case,
    settings: &TrainingSettings,
    shard: Shard,
    folder: &Path,
    stop: &StopRequest,
    progress: &dyn Fn(usize, usize),
) -> Result<MadeShard, DataSetError> {
    outfile::check_folder(folder, Existing::Replace)?;
    let header = header(case, settings, shard);
    folder::refuse_others(folder, &header, shard)?;
    let paths = Paths::new(folder, shard);
    let cases = shard.items(settings.cases);
    let complete = || MadeShard {
        file: paths.whole.clone(),
        kept: cases.len(),
        cases: cases.clone(),
        sha256: None,
    };
    if paths.manifest.exists() {
        return Ok(complete());
    }
    let simulation = Simulation::of_case(case, settings)?;
    outfile::make_folder(folder, Existing::Replace)?;
    let Some(mut part) = folder::lock(folder, &paths, &header, shard)? else {
        return Ok(complete());
    };
    let head = format!("{header}\n");
    let kept = make(&simulation, &head, cases.clone(), &mut part, stop, progress)?;
    let hash = folder::close(part, &paths, &header, &cases)?;
    Ok(MadeShard {
        file: paths.whole,
        cases,
        kept,
        sha256: Some(hash),
    })
}

/// Hash of the contacts and the unloaded conductance of a case.
fn contacts_and_sigma0(case: &Case) -> String {
    let sheet = json!({
        "contact_ohm_m": case.contact_ohm_m,
        "sigma0": case.unloaded_conductance(),
    });
    fingerprint(sheet.to_string().as_bytes())
}

/// The header, which contains everything that determines the bits of a shard.
fn header(case: &Case, settings: &TrainingSettings, shard: Shard) -> Value {
    json!({
        "layout": LAYOUT,
        "geometry": case.mesh.hash(),
        "survey": case.protocol.hash(),
        "contacts_and_sigma0": contacts_and_sigma0(case),
        "settings": settings,
        "inputs": case.protocol.len(),
        "outputs": case.mesh.region().len(),
        "shard": [shard.index(), shard.of()],
    })
}

/// Writes the missing records; returns the number of records that existed.
fn make(
    simulation: &Simulation,
    head: &str,
    range: Range<usize>,
    part: &mut PartFile,
    stop: &StopRequest,
    progress: &dyn Fn(usize, usize),
) -> Result<usize, DataSetError> {
    let path = part.path().to_owned();
    let failed = |cause: std::io::Error| full(&path, &cause);
    let (kept, end) = resume(&part.file, head, simulation.inputs(), range.len()).map_err(failed)?;
    part.file.set_len(end).map_err(failed)?;
    let mut writer = BufWriter::new(&part.file);
    writer.seek(SeekFrom::Start(end)).map_err(failed)?;
    if end == 0 {
        writer.write_all(head.as_bytes()).map_err(failed)?;
        baseline(&mut writer, simulation.baseline()).map_err(failed)?;
    }
    progress(kept, range.len());
    let mut first = range.start + kept;
    while first < range.end {
        if stop.is_set() {
            part.file.sync_all().map_err(failed)?;
            return Err(DataSetError::Shard(ShardError::Stopped {
                done: first - range.start,
                of: range.len(),
                path,
            }));
        }
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
    writer.flush().map_err(failed)?;
    Ok(kept)
}

/// The error for a failed write: the written part is kept, and the message explains how to continue.
fn full(part: &Path, cause: &std::io::Error) -> DataSetError {
    DataSetError::unusable(
        part,
        format!(
            ": {cause}; the cases written so far are kept: free space and run the same command again"
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

/// Number of complete records after a matching header, and the offset of their end; both are 0 if the header does not
/// match.
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

    /// A writer that fails after this number of bytes, like a full disk.
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
