//! Format of model files: tensors and one JSON entry. Reading validates shapes, checksum and version.

mod reading;
#[cfg(test)]
mod tests;
mod writing;

use safetensors::tensor::Dtype;
use sha2::{Digest, Sha256};

pub(super) use reading::parse;
pub(super) use writing::bytes;

/// Name of the one metadata entry.
const KEY: &str = "tactus";

fn layer_name(index: usize, what: &str) -> String {
    format!("layer{}.{what}", index + 1)
}

/// The checksum as written in the metadata.
fn stated_checksum(checksum: &str) -> String {
    format!("\"checksum\":\"{checksum}\"")
}

/// SHA-256 over metadata with an empty checksum and all tensors in the order of their names.
fn checksum<'a>(
    metadata: &str,
    tensors: impl Iterator<Item = (&'a str, Dtype, &'a [usize], &'a [u8])>,
) -> String {
    let mut hasher = Sha256::new();
    hasher.update(metadata.as_bytes());
    for (name, kind, shape, bytes) in tensors {
        hasher.update(format!("{name} {kind:?} {shape:?}").as_bytes());
        hasher.update(bytes);
    }
    survey::hex(&hasher.finalize())
}
