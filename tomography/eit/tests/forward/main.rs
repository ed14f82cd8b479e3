//! Meshes, presets and the forward problem: exact values, references, laws, derivatives.

mod depth;
mod exact;
mod known_values;
mod laws;
mod parts;
mod presets;
mod references;
mod sensitivity;
mod stability;
mod workspace;
