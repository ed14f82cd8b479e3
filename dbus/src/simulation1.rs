//! The interface for loads on a simulated sheet.

use crate::Fault;

/// `org.tactus.Tactus1.Simulation1`, on the root object and only for a simulated rig.
#[zbus::proxy(
    interface = "org.tactus.Tactus1.Simulation1",
    default_service = "org.tactus.Tactus1",
    default_path = "/org/tactus/Tactus1"
)]
pub trait Simulation1 {
    /// Places a load, which replaces the previous one. `shape`: `disc` (size = diameter), `rectangle` (size = longer
    /// side, 5 : 3), `triangle` (size = side), `figure-eight` (size = length). Position and size in metres, `loss` of
    /// conductance from 0 to 1. Takes effect with the next frame.
    fn press(&self, shape: &str, x_m: f64, y_m: f64, size_m: f64, loss: f64) -> Result<(), Fault>;

    /// Removes the load.
    fn release(&self) -> Result<(), Fault>;
}
