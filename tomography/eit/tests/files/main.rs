//! Case folders and model files: what is written is read back, what is damaged is refused.

mod case_folders;
mod hostile_files;
#[cfg(feature = "onnx")]
mod onnx;
