//! The test sets and methods that `tactus-lab evaluate` compares.

use std::cell::OnceCell;
use std::path::{Path, PathBuf};

use eit::PaperSheet;
use eit::model::fingerprint;
use outfile::Existing;
use studies::Failure;
use studies::evaluation::has_load;
use studies::evaluation::test_set::{self, TestSet, TestSetName};
use tempfile::TempDir;

use crate::args::EvaluateOptions;

/// Default methods.
const METHODS: [&str; 6] = [
    "one-step",
    "one-step --loss-only",
    "tv",
    "tv --loss-only",
    "linear",
    "best",
];
/// A method or a model.
pub(super) struct Method {
    pub(super) name: String,
    /// Options of `reconstruct`.
    pub(super) words: Vec<String>,
}

/// The methods and models of the command line, or the default methods.
pub(super) fn methods(options: &EvaluateOptions) -> Vec<Method> {
    let method = |text: &str| Method {
        name: text.to_owned(),
        words: ["--method"]
            .into_iter()
            .chain(text.split_whitespace())
            .map(str::to_owned)
            .collect(),
    };
    let model = |path: &PathBuf| {
        let text = path.display().to_string();
        Method {
            name: path
                .file_stem()
                .map_or(text.clone(), |stem| stem.to_string_lossy().into_owned()),
            words: vec!["--model".to_owned(), text],
        }
    };
    if options.method.is_empty() && options.model.is_empty() {
        return METHODS.into_iter().map(method).collect();
    }
    let methods = options.method.iter().map(|text| method(text));
    methods.chain(options.model.iter().map(model)).collect()
}

/// The standard sets: loads, standard deviation of one reading (V), name.
const STANDARD: [(TestSetName, f64, &str); 4] = [
    (TestSetName::Presses10, 2e-6, "presses-10"),
    (TestSetName::Presses30, 2e-6, "presses-30"),
    (TestSetName::Polygons, 2e-6, "polygons"),
    (TestSetName::Polygons, 396e-6, "polygons-396uV"),
];

/// Test sets of the command line, or the standard sets. These are made at their first use, in a new temporary folder
/// that is removed afterwards.
pub(super) enum Sets<'a> {
    Named(&'a [PathBuf]),
    Standard {
        folder: OnceCell<TempDir>,
        seed: u64,
        count: Option<usize>,
    },
}

impl<'a> Sets<'a> {
    pub(super) fn of(options: &'a EvaluateOptions) -> Self {
        if !options.set.is_empty() {
            return Self::Named(&options.set);
        }
        Self::Standard {
            folder: OnceCell::new(),
            seed: options.seed,
            count: options.count,
        }
    }

    pub(super) fn len(&self) -> usize {
        match self {
            Self::Named(folders) => folders.len(),
            Self::Standard { .. } => STANDARD.len(),
        }
    }

    /// Name of a set for messages and tables.
    pub(super) fn name(&self, set: usize) -> String {
        match self {
            Self::Named(folders) => folders[set]
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned(),
            Self::Standard { .. } => STANDARD[set].2.to_owned(),
        }
    }

    /// Whether a frame of a set has a load, as some of the standard sets have.
    pub(super) fn have_load(&self) -> bool {
        match self {
            Self::Named(folders) => folders.iter().any(|folder| has_load(folder)),
            Self::Standard { .. } => true,
        }
    }

    /// The folder of a set; makes a standard set at its first use.
    pub(super) fn folder(&self, set: usize) -> Result<PathBuf, Failure> {
        match self {
            Self::Named(folders) => Ok(folders[set].clone()),
            Self::Standard {
                folder,
                seed,
                count,
            } => {
                let (loads, noise_v, name) = STANDARD[set];
                let folder = made(folder)?.join(name);
                if !folder.exists() {
                    let set = TestSet {
                        set: loads,
                        noise_v,
                        seed: *seed,
                        count: *count,
                        spray: None,
                        sheet_seed: None,
                        sheet: PaperSheet::default(),
                        case: None,
                    };
                    test_set::make(&set, &folder, Existing::Refuse)?;
                }
                Ok(folder)
            }
        }
    }

    /// Everything that determines the content of the sets.
    fn described(&self) -> Result<serde_json::Value, Failure> {
        match self {
            Self::Named(folders) => folders
                .iter()
                .map(|folder| content(folder).map(serde_json::Value::from))
                .collect(),
            Self::Standard { seed, count, .. } => {
                Ok(serde_json::json!({ "seed": seed, "count": count }))
            }
        }
    }
}

/// The temporary folder, created by the first call. It is always a new one, because an existing folder could contain
/// the sets of a killed process.
fn made(folder: &OnceCell<TempDir>) -> Result<&Path, Failure> {
    if let Some(folder) = folder.get() {
        return Ok(folder.path());
    }
    let new = tempfile::Builder::new()
        .prefix("tactus-evaluate-")
        .tempdir()
        .map_err(|cause| Failure::of("cannot create a temporary folder", &cause))?;
    Ok(folder.get_or_init(|| new).path())
}

/// Everything that determines the results, for the header of a shard: the content of files, and not their paths, which
/// may differ between machines.
pub(super) fn settings(
    options: &EvaluateOptions,
    sets: &Sets<'_>,
) -> Result<serde_json::Value, Failure> {
    let models: Vec<String> = options
        .model
        .iter()
        .map(|file| Ok(fingerprint(&read(file)?)))
        .collect::<Result<_, Failure>>()?;
    Ok(serde_json::json!({
        "build": studies::build(),
        "sets": sets.described()?,
        "methods": options.method,
        "models": models,
    }))
}

fn read(file: &Path) -> Result<Vec<u8>, Failure> {
    std::fs::read(file).map_err(|cause| Failure::of(&format!("{}", file.display()), &cause))
}

/// Hash of the names and contents of the files of a folder.
fn content(folder: &Path) -> Result<String, Failure> {
    let failed = |cause: std::io::Error| Failure::of(&format!("{}", folder.display()), &cause);
    let mut lines = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.is_file() {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            lines.push(format!("{name} {}\n", fingerprint(&read(&path)?)));
        }
    }
    lines.sort();
    Ok(fingerprint(lines.concat().as_bytes()))
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::{Sets, made};
    use crate::args::{Arguments, Command};

    #[test]
    fn standard_sets_have_a_new_folder_removed_afterwards() {
        let arguments = Arguments::try_parse_from(["tactus-lab", "evaluate"]).unwrap();
        let Command::Evaluate(options) = &arguments.command else {
            panic!("another command");
        };
        let sets = [(); 2].map(|()| Sets::of(options));
        let folders = sets.each_ref().map(|sets| match sets {
            Sets::Standard { folder, .. } => {
                assert!(folder.get().is_none(), "no set was made yet");
                made(folder).unwrap().to_owned()
            }
            Sets::Named(_) => panic!("no set was named"),
        });
        assert_ne!(folders[0], folders[1]);
        assert!(folders.iter().all(|folder| folder.is_dir()));
        drop(sets);
        assert!(!folders.iter().any(|folder| folder.exists()));
    }
}
