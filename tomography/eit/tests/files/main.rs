//! Case folders and model files: written files are read back, damaged ones are refused.

mod case_folders;
mod hostile_files;
#[cfg(feature = "onnx")]
mod onnx;
