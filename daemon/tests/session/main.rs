//! Sessions from the bus to the record: measuring, recording, resuming and ending. Faults of instruments are tested in
//! `instruments`, the service itself in `service`.

mod endings;
mod latency;
mod lifecycle;
mod map_times;
mod measuring;
#[path = "../../../logbook/tests/mounts/mod.rs"]
mod mounts;
mod noise;
mod pressure;
mod read_only;
mod recording;
mod resume;
#[path = "../stage/mod.rs"]
mod stage;
