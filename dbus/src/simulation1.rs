//! A hand on the simulated sheet.

use crate::Fault;

/// `org.tactus.Tactus1.Simulation1`, on the root object and only when the rig is simulated: a real sheet is pressed by
/// hand.
#[zbus::proxy(
    interface = "org.tactus.Tactus1.Simulation1",
    default_service = "org.tactus.Tactus1",
    default_path = "/org/tactus/Tactus1"
)]
pub trait Simulation1 {
    /// Puts a load down in place of the last one. `shape`: `disc` (size = diameter), `rectangle` (size = longer side,
    /// 5 : 3), `triangle` (size = side), `figure-eight` (size = length). Place and size in metres, `loss` of
    /// conductance from 0 to 1. Acts on the next frame.
    fn press(&self, shape: &str, x_m: f64, y_m: f64, size_m: f64, loss: f64) -> Result<(), Fault>;

    /// Takes the load away.
    fn release(&self) -> Result<(), Fault>;
}
