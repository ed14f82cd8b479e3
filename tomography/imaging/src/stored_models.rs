//! Model files found again by the hash that a session keeps.

use std::path::{Path, PathBuf};

use eit::inverse::learned::network::is_onnx;

/// The file with this hash: the configured one, or any in its folder, in `models` or in the current directory.
pub fn find_model(configured: Option<&Path>, hash: &str) -> Option<PathBuf> {
    let folder = configured.and_then(Path::parent);
    configured
        .filter(|file| has_hash(file, hash))
        .map(Path::to_owned)
        .or_else(|| {
            folder
                .into_iter()
                .chain([Path::new("models"), Path::new(".")])
                .find_map(|folder| find_model_in(folder, hash))
        })
}

/// The model file with this hash in a folder.
pub fn find_model_in(folder: &Path, hash: &str) -> Option<PathBuf> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .ok()?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| is_onnx(path) || path.extension().is_some_and(|name| name == "safetensors"))
        .collect();
    files.sort();
    files.into_iter().find(|file| has_hash(file, hash))
}

fn has_hash(file: &Path, hash: &str) -> bool {
    std::fs::read(file).is_ok_and(|bytes| eit::model::fingerprint(&bytes) == hash)
}

/// The first twelve characters of a hash, enough to tell two apart.
pub fn short_hash(hash: &str) -> &str {
    hash.get(..12).unwrap_or(hash)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_is_found_by_its_hash_not_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let [configured, other] =
            ["a.safetensors", "b.safetensors"].map(|name| folder.path().join(name));
        std::fs::write(&configured, "one").unwrap();
        std::fs::write(&other, "two").unwrap();
        let of = |text: &str| eit::model::fingerprint(text.as_bytes());
        let found = |text: &str| find_model(Some(&configured), &of(text));
        assert_eq!(found("one"), Some(configured.clone()));
        assert_eq!(found("two"), Some(other));
        assert_eq!(found("three"), None);
    }
}
