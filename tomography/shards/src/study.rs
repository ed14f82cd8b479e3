//! A list of independent items, computed in shards and read back.
//!
//! A complete shard is `shard-I-of-N.jsonl`: a header line with the name and the settings of the work, a line for each
//! item, and a line with the number of items and the SHA-256 of the lines before it. An incomplete shard is
//! `shard-I-of-N.part`; its complete lines are kept when the command is repeated.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use outfile::Existing;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use crate::{PartFile, Shard, ShardError, StopRequest, exact};

const LAYOUT: u32 = 1;

/// Independent items of work in a fixed order.
#[derive(Debug)]
pub struct Study<'a> {
    /// Name of the command.
    pub name: &'a str,
    /// Everything that determines the results. Shards with other settings are refused.
    pub settings: Value,
    /// A name for each item.
    pub items: Vec<String>,
}

/// The part of a study that a command computes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Division {
    /// All items, in this process.
    Whole,
    /// One shard, written to this folder.
    Shard(Shard, PathBuf),
    /// No item: lists which of this number of shards are not complete in the folder.
    Missing(usize, PathBuf),
    /// No item: reads the results from this number of shards in the folder.
    Merge(usize, PathBuf),
}

/// A complete shard.
#[derive(Debug, PartialEq, Eq)]
pub struct Made {
    /// Its file.
    pub file: PathBuf,
    /// Number of items.
    pub items: usize,
    /// Number of items from an earlier run.
    pub kept: usize,
}

/// Result of a command.
#[derive(Debug)]
pub enum Outcome<R> {
    /// All results, in the order of the items, or the report on them.
    All(R),
    /// One shard.
    Made(Made),
    /// The numbers of the shards that are not complete.
    Missing(Vec<usize>),
}

impl<R> Outcome<R> {
    /// Converts all results with `report`; the other outcomes are unchanged.
    ///
    /// # Errors
    /// Those of `report`.
    pub fn then<S, E>(self, report: impl FnOnce(R) -> Result<S, E>) -> Result<Outcome<S>, E> {
        Ok(match self {
            Self::All(results) => Outcome::All(report(results)?),
            Self::Made(made) => Outcome::Made(made),
            Self::Missing(numbers) => Outcome::Missing(numbers),
        })
    }
}

impl Study<'_> {
    /// Computes or reads the part of the study that `division` selects. `compute` receives the index of an item.
    ///
    /// # Errors
    /// The error of the first item that fails; a file that cannot be read or written; shards that are missing, damaged,
    /// made with other settings or locked by another process; SIGTERM.
    pub fn perform<T: Serialize + DeserializeOwned, E: From<ShardError>>(
        &self,
        division: &Division,
        stop: &StopRequest,
        compute: &mut dyn FnMut(usize) -> Result<T, E>,
    ) -> Result<Outcome<Vec<T>>, E> {
        Ok(match division {
            Division::Whole => Outcome::All(
                (0..self.items.len())
                    .map(compute)
                    .collect::<Result<_, E>>()?,
            ),
            Division::Shard(shard, folder) => {
                Outcome::Made(self.make(*shard, folder, stop, compute)?)
            }
            Division::Missing(of, folder) => Outcome::Missing(self.missing(*of, folder)?),
            Division::Merge(of, folder) => Outcome::All(self.merge(*of, folder)?),
        })
    }

    fn make<T: Serialize, E: From<ShardError>>(
        &self,
        shard: Shard,
        folder: &Path,
        stop: &StopRequest,
        compute: &mut dyn FnMut(usize) -> Result<T, E>,
    ) -> Result<Made, E> {
        let range = shard.items(self.items.len());
        let whole = self.file(shard, folder);
        let complete = || Made {
            file: whole.clone(),
            items: range.len(),
            kept: range.len(),
        };
        // check every shard in the folder first, so that no work is done that cannot be merged
        for other in Shard::all(shard.of()) {
            for path in [self.file(other, folder), part(other, folder)] {
                self.check(&path, other)?;
            }
        }
        if whole.exists() {
            return Ok(complete());
        }
        outfile::make_folder(folder, Existing::Replace).map_err(ShardError::from)?;
        let mut held = PartFile::lock(&part(shard, folder))?;
        if whole.exists() {
            held.remove()?;
            return Ok(complete());
        }
        self.check(held.path(), shard)?;
        let (lines, mut hasher) = self.resume(&mut held, shard)?;
        let path = held.path().to_owned();
        let failed = ShardError::io(&path);
        for (done, item) in range.clone().enumerate().skip(lines) {
            if stop.is_set() {
                held.file.sync_all().map_err(&failed)?;
                return Err(E::from(ShardError::Stopped {
                    path: path.clone(),
                    done,
                    of: range.len(),
                }));
            }
            let result = serde_json::to_value(compute(item)?)
                .map_err(|cause| failed(std::io::Error::from(cause)))?;
            let line = json!({
                "item": item,
                "name": self.items[item],
                "result": exact::encode(result),
            });
            put(&held.file, &mut hasher, &line).map_err(&failed)?;
        }
        let end = json!({ "items": range.len(), "sha256": hex(hasher.clone()) });
        put(&held.file, &mut hasher, &end).map_err(&failed)?;
        held.finish(&whole)?;
        Ok(Made {
            file: whole,
            items: range.len(),
            kept: lines,
        })
    }

    fn missing(&self, of: usize, folder: &Path) -> Result<Vec<usize>, ShardError> {
        let mut missing = Vec::new();
        for shard in Shard::all(of) {
            let path = self.file(shard, folder);
            self.check(&path, shard)?;
            if !path.exists() {
                missing.push(shard.index());
            }
        }
        Ok(missing)
    }

    fn merge<T: DeserializeOwned>(&self, of: usize, folder: &Path) -> Result<Vec<T>, ShardError> {
        let missing = self.missing(of, folder)?;
        if !missing.is_empty() {
            let names: Vec<String> = Shard::all(of)
                .filter(|shard| missing.contains(&shard.index()))
                .map(|shard| format!("{}.jsonl", shard.name()))
                .collect();
            return Err(ShardError::missing(folder, &names));
        }
        let mut all = Vec::new();
        for shard in Shard::all(of) {
            self.read(&self.file(shard, folder), shard, &mut all)?;
        }
        Ok(all)
    }

    /// Reads a complete shard and appends its results to `all`.
    fn read<T: DeserializeOwned>(
        &self,
        path: &Path,
        shard: Shard,
        all: &mut Vec<T>,
    ) -> Result<(), ShardError> {
        let damaged = |why: &str| {
            ShardError::damaged(path, format!("{why}: delete it and make this shard again"))
        };
        let text = std::fs::read_to_string(path).map_err(ShardError::io(path))?;
        let range = shard.items(self.items.len());
        let (content, end) = text
            .strip_suffix('\n')
            .and_then(|text| text.rsplit_once('\n'))
            .ok_or_else(|| damaged("its last line is missing"))?;
        let mut hasher = Sha256::new();
        hasher.update(content);
        hasher.update("\n");
        let end: Value =
            serde_json::from_str(end).map_err(|_| damaged("its last line is not JSON"))?;
        if end["sha256"] != hex(hasher) || end["items"] != range.len() {
            return Err(damaged("its content does not match its checksum"));
        }
        let mut lines = content.lines().skip(1);
        for item in range {
            let result = lines
                .next()
                .and_then(|line| result_of(line, item))
                .and_then(|value| serde_json::from_value(exact::decode(value)).ok());
            all.push(result.ok_or_else(|| {
                damaged(&format!("item {item} ({}) is missing", self.items[item]))
            })?);
        }
        Ok(())
    }

    fn file(&self, shard: Shard, folder: &Path) -> PathBuf {
        folder.join(format!("{}.jsonl", shard.name()))
    }

    fn header(&self, shard: Shard) -> Value {
        json!({
            "layout": LAYOUT,
            "work": self.name,
            "version": env!("CARGO_PKG_VERSION"),
            "settings": self.settings,
            "names": self.items,
            "shard": [shard.index(), shard.of()],
        })
    }

    /// Refuses an existing file with another header. An incomplete header was written by a killed process and is
    /// accepted.
    fn check(&self, path: &Path, shard: Shard) -> Result<(), ShardError> {
        let mut file = match File::open(path) {
            Ok(file) => file,
            Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => return Ok(()),
            Err(cause) => return Err(ShardError::io(path)(cause)),
        };
        match first_line(&mut file).map_err(ShardError::io(path))? {
            None => Ok(()),
            Some(line) => {
                let there: Value = serde_json::from_slice(&line).map_err(|_| {
                    ShardError::damaged(
                        path,
                        "it is not a shard: remove it, or name another folder",
                    )
                })?;
                ShardError::refuse_difference(path, &there, &self.header(shard))
            }
        }
    }

    /// Truncates a part file after its last complete item, or writes the header of a new one. Returns the number of
    /// complete items and the hash of the lines.
    fn resume(&self, held: &mut PartFile, shard: Shard) -> Result<(usize, Sha256), ShardError> {
        let path = held.path().to_owned();
        let failed = ShardError::io(&path);
        let mut bytes = Vec::new();
        held.file.read_to_end(&mut bytes).map_err(&failed)?;
        let mut hasher = Sha256::new();
        let (mut at, mut count) = (0, 0);
        let range = shard.items(self.items.len());
        for line in bytes.split_inclusive(|byte| *byte == b'\n') {
            let known = match at {
                0 => line.ends_with(b"\n"),
                _ => {
                    let text = std::str::from_utf8(line).ok();
                    let item = range.start + count;
                    let complete = item < range.end
                        && text
                            .and_then(|text| text.strip_suffix('\n'))
                            .and_then(|text| result_of(text, item))
                            .is_some();
                    count += usize::from(complete);
                    complete
                }
            };
            if !known {
                break;
            }
            hasher.update(line);
            at += line.len();
        }
        held.file.set_len(at as u64).map_err(&failed)?;
        held.file
            .seek(SeekFrom::Start(at as u64))
            .map_err(&failed)?;
        if at == 0 {
            put(&held.file, &mut hasher, &self.header(shard)).map_err(&failed)?;
        }
        Ok((count, hasher))
    }
}

fn part(shard: Shard, folder: &Path) -> PathBuf {
    folder.join(format!("{}.part", shard.name()))
}

/// The result in the line of an item; `None` if the line is not that of `item`.
fn result_of(line: &str, item: usize) -> Option<Value> {
    let mut value: Value = serde_json::from_str(line).ok()?;
    (value["item"] == item && value.get("result").is_some()).then(|| value["result"].take())
}

fn put(mut file: &File, hasher: &mut Sha256, line: &Value) -> std::io::Result<()> {
    let text = format!("{line}\n");
    hasher.update(&text);
    file.write_all(text.as_bytes())
}

/// The first line without its end; `None` if it has no end.
fn first_line(file: &mut File) -> std::io::Result<Option<Vec<u8>>> {
    let mut reader = std::io::BufReader::new(file);
    let mut line = Vec::new();
    std::io::BufRead::read_until(&mut reader, b'\n', &mut line)?;
    Ok((line.pop() == Some(b'\n')).then_some(line))
}

fn hex(hasher: Sha256) -> String {
    let digest = hasher.finalize();
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
#[path = "study_tests.rs"]
mod tests;
