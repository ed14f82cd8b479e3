//! Errors of shards.

use std::path::{Path, PathBuf};

use outfile::OutFileError;
use serde_json::Value;

/// Errors of shards.
#[derive(Debug, thiserror::Error)]
pub enum ShardError {
    /// Another process is making this shard. Its file is unchanged.
    #[error(
        "{}: another process is making this shard; its file is unchanged. Try again when that process has ended", .0.display()
    )]
    Held(PathBuf),
    /// SIGTERM was received; the item in progress was completed first.
    #[error("stopped by SIGTERM: {done} of {of} are in {}; the same command continues there", .path.display())]
    Stopped {
        /// The incomplete file.
        path: PathBuf,
        /// Number of completed items.
        done: usize,
        /// Number of items of the shard.
        of: usize,
    },
    /// The file was made with another setting.
    #[error("{} is a shard of another set of work: {difference}. Give the same options, or another folder", .path.display())]
    Differs {
        /// The file.
        path: PathBuf,
        /// The setting and both values, see [`difference`].
        difference: String,
    },
    /// Shards that are absent or incomplete.
    #[error("{}: {} missing or incomplete: make {names} first, each by the same command with --shard", .folder.display(), if names.contains(',') { "shards are" } else { "a shard is" })]
    Missing {
        /// The folder.
        folder: PathBuf,
        /// Their file names.
        names: String,
    },
    /// A file that is not a shard, or whose content has changed since it was written.
    #[error("{}: {why}", .path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The problem and what to do.
        why: String,
    },
    /// A file cannot be read or written.
    #[error("{}", .path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The cause.
        #[source]
        cause: std::io::Error,
    },
    /// A folder that may not be written to.
    #[error(transparent)]
    Output(#[from] OutFileError),
}

impl ShardError {
    /// The error for a file or folder that cannot be read or written.
    pub fn io(path: &Path) -> impl Fn(std::io::Error) -> Self {
        |cause| Self::Io {
            path: path.to_owned(),
            cause,
        }
    }

    pub(crate) fn damaged(path: &Path, why: impl Into<String>) -> Self {
        Self::Damaged {
            path: path.to_owned(),
            why: why.into(),
        }
    }

    /// The error for missing shards in `folder`, given their names.
    pub fn missing(folder: &Path, names: &[String]) -> Self {
        Self::Missing {
            folder: folder.to_owned(),
            names: names.join(", "),
        }
    }

    /// Refuses a header that differs from the expected one.
    ///
    /// # Errors
    /// [`ShardError::Differs`].
    pub fn refuse_difference(path: &Path, there: &Value, here: &Value) -> Result<(), Self> {
        match difference(there, here) {
            None => Ok(()),
            Some(difference) => Err(Self::Differs {
                path: path.to_owned(),
                difference,
            }),
        }
    }
}

/// Name of the first setting that differs, with both values; `None` if the settings are equal. Numbers are compared as
/// text: reading a number and writing it again may change its last digit.
pub fn difference(there: &Value, here: &Value) -> Option<String> {
    fn search(name: &str, there: &Value, here: &Value) -> Option<String> {
        if let (Value::Object(old), Value::Object(new)) = (there, here) {
            let keys = old
                .keys()
                .chain(new.keys().filter(|key| !old.contains_key(*key)));
            return keys
                .filter_map(|key| {
                    let inner = match name {
                        "" => key.clone(),
                        name => format!("{name}.{key}"),
                    };
                    let absent = &Value::Null;
                    search(
                        &inner,
                        old.get(key).unwrap_or(absent),
                        new.get(key).unwrap_or(absent),
                    )
                })
                .next();
        }
        (there != here)
            .then(|| format!("{name} is {} there and {} here", shown(there), shown(here)))
    }
    // round trip of both values through the same text and parser
    let again = |value: &Value| serde_json::from_str(&value.to_string()).unwrap_or(Value::Null);
    search("", &again(there), &again(here))
}

/// A value as text, shortened.
fn shown(value: &Value) -> String {
    const MOST: usize = 60;
    match value {
        Value::Null => "absent".to_owned(),
        value => {
            let text = value.to_string();
            match text.char_indices().nth(MOST) {
                Some((end, _)) => format!("{}...", &text[..end]),
                None => text,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn first_different_setting_is_named_with_both_values() {
        let one = json!({"a": 1, "settings": {"seed": 3, "radius_m": 0.07}});
        assert_eq!(difference(&one, &one), None);
        let other = json!({"a": 1, "settings": {"seed": 4, "radius_m": 0.07}});
        assert_eq!(
            difference(&one, &other).unwrap(),
            "settings.seed is 3 there and 4 here"
        );
        let fewer = json!({"a": 1, "settings": {"seed": 3}});
        assert_eq!(
            difference(&fewer, &one).unwrap(),
            "settings.radius_m is absent there and 0.07 here"
        );
        let long = json!({"a": "x".repeat(200)});
        assert!(difference(&long, &one).unwrap().len() < 120);
    }
}
