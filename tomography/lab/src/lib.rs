//! Offline work: meshes, forward solutions, sensitivities, training, reconstruction of recorded data.
