//! What reaches the disk: after power cuts, failed syncs, kills and on a full disk; and how many bytes a frame writes.
//! A process of its own, because [`vfs`] becomes the default file layer of all of it.

#[path = "../common/mod.rs"]
mod common;
mod image;
mod kills;
mod power_cuts;
mod vfs;
mod writes;
