//! The Python package `tactus_eit`: numpy arrays in, numpy arrays out, SI units, frames in rows.
//!
//! Not in this crate: mathematics (crates `eit` and `imaging`), reading of session files (crate `logbook`), records of
//! the daemon's stream (crate `dbus`). Arguments are copied before the interpreter's lock is released.

mod arguments;
mod baseline;
mod drift;
mod forward;
mod live;
mod maps;
mod mesh;
mod outcome;
mod protocol;
mod session;
mod sizes;

/// The engine behind `tactus_eit`.
#[pyo3::pymodule(gil_used = false)]
mod _native {
    #[pymodule_export]
    use crate::drift::Tracker;
    #[pymodule_export]
    use crate::forward::Forward;
    #[pymodule_export]
    use crate::live::Stream;
    #[pymodule_export]
    use crate::maps::{Maps, as_frames, likeness, merit};
    #[pymodule_export]
    use crate::mesh::Mesh;
    #[pymodule_export]
    use crate::protocol::Protocol;
    #[pymodule_export]
    use crate::session::{SessionFile, quality_flags};
}
