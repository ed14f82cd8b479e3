//! The mathematics: mesh, forward model, sensitivity, reconstructors, model files.
