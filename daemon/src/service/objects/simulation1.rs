//! The D-Bus interface for loads on the simulated sheet.

use std::sync::Arc;

use dbus::Fault;
use zbus::interface;

use crate::instruments::simulation;
use crate::session::controller::Controller;
use crate::session::option_values;
use crate::session::option_values::checked;

/// Registered on the root object, only if the rig is simulated.
pub(crate) struct Simulation1(pub(crate) Arc<Controller>);

/// Loads on the simulated sheet. The interface exists only if the rig is simulated.
#[interface(name = "org.tactus.Tactus1.Simulation1")]
impl Simulation1 {
    /// Places a load, which replaces the previous one: `disc` (size: diameter), `rectangle` (longer side), `triangle`
    /// (side) or `figure-eight` (length). Position and size in metres, loss of conductance from 0 to 1. Takes effect
    /// with the next frame.
    async fn press(
        &self,
        shape: &str,
        x_m: f64,
        y_m: f64,
        size_m: f64,
        loss: f64,
    ) -> Result<(), Fault> {
        for (what, value, bounds) in [
            ("x_m", x_m, option_values::PLACE_M),
            ("y_m", y_m, option_values::PLACE_M),
            ("size_m", size_m, option_values::SIZE_M),
            ("loss", loss, option_values::LOSS),
        ] {
            checked(what, value, bounds)?;
        }
        let simulated_rig = self.simulated_rig()?;
        simulation::press(&simulated_rig, shape, [x_m, y_m], size_m, loss)
            .map_err(Fault::InvalidOption)
    }

    /// Removes the load.
    async fn release(&self) -> Result<(), Fault> {
        simulation::release(&self.simulated_rig()?);
        Ok(())
    }
}

impl Simulation1 {
    fn simulated_rig(&self) -> Result<simulation::SimulatedRig, Fault> {
        self.0
            .runtime()
            .simulated_rig
            .clone()
            .ok_or_else(|| Fault::Unsupported("the rig is not simulated".into()))
    }
}
