//! Session files: content, damage, parts, references, order, listing, maintenance, size and reading from Python.
//! Power cuts, kills and the bytes written to the disk are tested in `disk`, random damage in `mutations`.

mod content;
mod damage;
#[path = "../example_frames/mod.rs"]
mod example_frames;
mod folder;
mod hostile;
mod maintenance;
mod order;
mod parts;
mod python;
mod references;
mod size;
mod untouched;
