//! Reads cases of a training set in files by index, without loading the set into memory.

use std::fs::File;
use std::io::{BufReader, Read};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use eit::{Case, TrainingSettings};
use sha2::{Digest, Sha256};
use shards::ShardError;

use super::{DataSetError, contacts_and_sigma0};
use crate::samples::{Sample, SampleError, Samples};

/// A training set in files: all its shards.
pub struct DataSet {
    shards: Vec<Shard>,
    /// First case of each shard.
    firsts: Vec<usize>,
    cases: usize,
    inputs: usize,
    outputs: usize,
    baseline: Vec<f64>,
    settings: TrainingSettings,
    recorded: bool,
}

struct Shard {
    path: PathBuf,
    file: File,
    /// Offset of each record, and of the end of the last.
    at: Vec<u64>,
}

impl DataSet {
    /// Opens a folder filled by [`make_shard`](super::make_shard); all shards must exist, belong to one set and match
    /// their checksums.
    ///
    /// # Errors
    /// Files that cannot be read, a set for another mesh, protocol or sheet, shards that are missing or damaged.
    pub fn open(folder: &Path, case: &Case) -> Result<Self, DataSetError> {
        let mut manifests = Vec::new();
        let entries = std::fs::read_dir(folder).map_err(ShardError::io(folder))?;
        for entry in entries {
            let path = entry.map_err(ShardError::io(folder))?.path();
            if path
                .extension()
                .is_some_and(|extension| extension == "json")
                && let Some(manifest) = manifest(&path)?
            {
                manifests.push((path, manifest));
            }
        }
        manifests.sort_by_key(|(_, manifest)| manifest["first"].as_u64());
        let wrong = |path: &Path, why: &str| DataSetError::unusable(path, format!(": {why}"));
        let Some((path, first)) = manifests.first() else {
            return Err(wrong(
                folder,
                "the folder has no shard; make one with tactus-lab dataset",
            ));
        };
        let head = first["header"].clone();
        let damaged = || wrong(path, "not a manifest of a training set");
        let settings: TrainingSettings =
            serde_json::from_value(head["settings"].clone()).map_err(|_| damaged())?;
        let number =
            |value: &serde_json::Value| value.as_u64().map(|n| n as usize).ok_or_else(damaged);
        let (inputs, outputs) = (number(&head["inputs"])?, number(&head["outputs"])?);
        if head["geometry"] != case.mesh.hash() || head["survey"] != case.protocol.hash() {
            return Err(wrong(
                path,
                "the set was made for another mesh or protocol than the case's",
            ));
        }
        if head["contacts_and_sigma0"] != contacts_and_sigma0(case) {
            return Err(wrong(
                path,
                "the set was made for a sheet with other contacts or another unloaded conductance (homog) than the case's: take that \
                 case, or make the set again for this one with tactus-lab dataset",
            ));
        }
        let mut set = Self {
            shards: Vec::new(),
            firsts: Vec::new(),
            cases: 0,
            inputs,
            outputs,
            baseline: Vec::new(),
            settings,
            recorded: head.get("recorded").is_some(),
        };
        for (path, manifest) in &manifests {
            let mut same = manifest["header"].clone();
            same["shard"] = head["shard"].clone();
            if same != head || manifest["header"]["shard"][1] != head["shard"][1] {
                return Err(wrong(
                    path,
                    &format!(
                        "a shard of another set than {}: remove one of them",
                        manifests[0].0.display()
                    ),
                ));
            }
            if number(&manifest["first"])? != set.cases {
                return Err(wrong(
                    path,
                    &format!(
                        "case {} and those after it are missing before this shard: make {} with tactus-lab dataset",
                        set.cases,
                        missing(&manifests)
                    ),
                ));
            }
            let file = folder.join(manifest["file"].as_str().ok_or_else(damaged)?);
            let hash = hash_of(&file)?;
            if manifest["sha256"] != hash {
                return Err(wrong(
                    &file,
                    &format!(
                        "its checksum is {hash}, its manifest says {}: make this shard again",
                        manifest["sha256"]
                    ),
                ));
            }
            set.firsts.push(set.cases);
            set.cases += number(&manifest["cases"])?;
            let shard = set.shard(&file, number(&manifest["cases"])?)?;
            set.shards.push(shard);
        }
        if set.cases != set.settings.cases {
            return Err(wrong(
                folder,
                &format!(
                    "{} of {} cases are there: make {} with tactus-lab dataset",
                    set.cases,
                    set.settings.cases,
                    missing(&manifests)
                ),
            ));
        }
        Ok(set)
    }

    /// Whether the cases were recorded, so that further cases cannot be simulated.
    pub fn is_recorded(&self) -> bool {
        self.recorded
    }

    /// The settings of the set.
    pub fn settings(&self) -> &TrainingSettings {
        &self.settings
    }

    fn shard(&mut self, path: &Path, cases: usize) -> Result<Shard, DataSetError> {
        let failed = |cause| DataSetError::from(ShardError::io(path)(cause));
        let file = File::open(path).map_err(failed)?;
        let mut reader = BufReader::with_capacity(1 << 16, &file);
        let mut head = Vec::new();
        std::io::BufRead::read_until(&mut reader, b'\n', &mut head).map_err(failed)?;
        let mut baseline = vec![0; 8 * self.inputs];
        reader.read_exact(&mut baseline).map_err(failed)?;
        let (values, _) = baseline.as_chunks::<8>();
        self.baseline = values
            .iter()
            .map(|bytes| f64::from_le_bytes(*bytes))
            .collect();
        let mut at = vec![(head.len() + baseline.len()) as u64];
        for _ in 0..cases {
            let mut count = [0; 4];
            reader.read_exact(&mut count).map_err(failed)?;
            let size = 4 * self.inputs as u64 + 8 * u64::from(u32::from_le_bytes(count));
            reader.seek_relative(size as i64).map_err(failed)?;
            at.push(at[at.len() - 1] + 4 + size);
        }
        drop(reader);
        Ok(Shard {
            path: path.to_owned(),
            file,
            at,
        })
    }
}

impl Samples for DataSet {
    fn len(&self) -> usize {
        self.cases
    }

    fn outputs(&self) -> usize {
        self.outputs
    }

    fn baseline(&self) -> &[f64] {
        &self.baseline
    }

    fn sample(&self, case: usize) -> Result<Sample, SampleError> {
        let shard = self.firsts.partition_point(|first| *first <= case) - 1;
        let (first, shard) = (self.firsts[shard], &self.shards[shard]);
        let [from, to] = [shard.at[case - first], shard.at[case - first + 1]];
        let mut bytes = vec![0; (to - from) as usize];
        let place = || shard.path.display().to_string();
        shard
            .file
            .read_exact_at(&mut bytes, from)
            .map_err(|cause| SampleError::Unreadable {
                place: place(),
                cause: Box::new(cause),
            })?;
        let (words, _) = bytes[4..].as_chunks::<4>();
        let (input, target) = words.split_at(self.inputs);
        let sample = Sample {
            input: input.iter().map(|word| f32::from_le_bytes(*word)).collect(),
            target: target
                .chunks_exact(2)
                .map(|pair| (u32::from_le_bytes(pair[0]), f32::from_le_bytes(pair[1])))
                .collect(),
        };
        sample.check(&place(), case)?;
        if let Some((unknown, _)) = sample
            .target
            .iter()
            .find(|(u, _)| *u as usize >= self.outputs)
        {
            return Err(SampleError::Unreadable {
                place: format!("{}, case {case}", place()),
                cause: format!("it names triangle {unknown} of {}", self.outputs).into(),
            });
        }
        Ok(sample)
    }
}

/// Names of the missing shards; their total number is taken from the manifests.
fn missing(manifests: &[(PathBuf, serde_json::Value)]) -> String {
    let shard = |manifest: &serde_json::Value, part: usize| {
        manifest["header"]["shard"][part].as_u64().unwrap_or(0)
    };
    let of = manifests
        .first()
        .map_or(0, |(_, manifest)| shard(manifest, 1));
    let absent: Vec<String> = (0..of)
        .filter(|k| manifests.iter().all(|(_, there)| shard(there, 0) != *k))
        .map(|k| format!("shard-{k}-of-{of}.tset"))
        .collect();
    absent.join(", ")
}

/// The content of a manifest; `None` if it does not exist.
pub(super) fn manifest(path: &Path) -> Result<Option<serde_json::Value>, DataSetError> {
    let text = match std::fs::read_to_string(path) {
        Ok(text) => text,
        Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(cause) => return Err(ShardError::io(path)(cause).into()),
    };
    serde_json::from_str(&text)
        .map(Some)
        .map_err(|cause| ShardError::io(path)(cause.into()).into())
}

/// SHA-256 of a file, hex; the file is read in pieces.
pub(super) fn hash_of(path: &Path) -> Result<String, DataSetError> {
    let failed = |cause| DataSetError::from(ShardError::io(path)(cause));
    let mut file = File::open(path).map_err(failed)?;
    let mut hasher = Sha256::new();
    let mut piece = vec![0; 1 << 20];
    loop {
        let read = file.read(&mut piece).map_err(failed)?;
        if read == 0 {
            break;
        }
        hasher.update(&piece[..read]);
    }
    Ok(survey::hex(&hasher.finalize()))
}
