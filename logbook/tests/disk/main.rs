//! Content of the disk after power cuts, failed syncs, kills and on a full disk, and the number of bytes written for
//! a frame. A separate test binary, because [`vfs`] becomes the default file layer of the whole process.

#[path = "../example_frames/mod.rs"]
mod example_frames;
mod image;
mod kills;
#[path = "../mounts/mod.rs"]
mod mounts;
mod power_cuts;
mod read_only;
mod vfs;
mod writes;
