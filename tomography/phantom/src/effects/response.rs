//! Inputs for predictions of an effect's size. [`crate::Preview`] implements the trait.

use nalgebra::DMatrix;

use super::EffectSettings;
use crate::scan::{ReadingContext, Scan};

/// A change of conductances (S) at centroids (m) and of contacts (ohm m): centroids, conductances, contacts.
pub(crate) type SheetChange<'a> = dyn Fn(&[[f64; 2]], &mut [f64], &mut [f64]) + 'a;

/// One reading of the unloaded sheet.
#[derive(Debug, Clone)]
pub(crate) struct UnloadedReading {
    /// V
    pub(crate) exact: f64,
    /// Conditions of the reading in the first frame.
    pub(crate) context: ReadingContext,
}

/// Response of an unloaded sheet's readings to changes of sheet, contacts, network and loads; rms over the readings, V.
pub(crate) trait SheetResponse {
    /// Settings of the acquisition.
    fn scan(&self) -> &Scan;

    /// Rms of a quantity over the readings of a frame.
    fn rms(&self, of: &dyn Fn(&UnloadedReading) -> f64) -> f64;

    /// Rms over the frames of a quantity that depends on time, s.
    fn over_time(&self, of: &dyn Fn(f64) -> f64) -> f64;

    /// Change of the readings per unit of ln(conductance) of the whole sheet, V. By Euler's identity (fact sheet,
    /// section 1) -V plus the share of the contacts: sum(sigma dV/dsigma) = -V + sum(z dV/dz).
    fn uniform(&self) -> f64;

    /// Change of the readings if each contact's ln(impedance) independently has a standard deviation of one, V.
    fn contacts(&self) -> f64;

    /// Change of the readings by a random field of ln(conductance) with a covariance given by distance (m), V.
    fn random_field(&self, covariance: &dyn Fn(f64) -> f64) -> f64;

    /// Rms change of the readings by a change of the network between the electrodes (ohm), V.
    fn network(&self, change: &dyn Fn(&mut DMatrix<f64>)) -> f64;

    /// Rms change of the readings by a change of conductances (S, at centroids in m) and contacts (ohm m), V, by one
    /// forward solution; infinite if the changed sheet cannot be solved.
    fn solved(&self, change: &SheetChange<'_>) -> f64;

    /// Change of the readings by an effect on the loads: rms over some frames of the scene's loads, solved with the
    /// effect and without. Zero without loads.
    fn on_loads(&self, set: &dyn Fn(&mut EffectSettings, bool)) -> f64;

    /// Change of the readings by an effect on the unloaded sheet's mesh, with the scene's own draws.
    fn misplaced(&self, set: &dyn Fn(&mut EffectSettings)) -> f64;

    /// Input resistance of the voltmeter, ohm; infinite if the scene does not state it.
    fn input_ohm(&self) -> f64;
}
