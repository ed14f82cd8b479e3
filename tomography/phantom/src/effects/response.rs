//! What a prediction of an effect's size is computed from. [`crate::Preview`] provides it.

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
    /// How it is taken in the first frame.
    pub(crate) context: ReadingContext,
}

/// How the readings of an unloaded sheet respond to changes of sheet, contacts, network and loads.
pub(crate) trait SheetResponse {
    /// How readings are taken.
    fn scan(&self) -> &Scan;

    /// Rms of something over the readings of a frame.
    fn rms(&self, of: &dyn Fn(&UnloadedReading) -> f64) -> f64;

    /// Rms over the frames of something that changes with time, s.
    fn over_time(&self, of: &dyn Fn(f64) -> f64) -> f64;

    /// What readings change by for each unit of ln(conductance) of the whole sheet, V. By Euler's identity (fact sheet,
    /// section 1) -V plus what the contacts take: sum(sigma dV/dsigma) = -V + sum(z dV/dz).
    fn uniform(&self) -> f64;

    /// What readings change by when each contact's ln(impedance) has a standard deviation of one, each its own, V.
    fn contacts(&self) -> f64;

    /// What a random field of ln(conductance) changes readings by, its covariance given by distance (m), V.
    fn random_field(&self, covariance: &dyn Fn(f64) -> f64) -> f64;

    /// Rms of what readings change by when the network between the electrodes (ohm) is changed, V.
    fn network(&self, change: &dyn Fn(&mut DMatrix<f64>)) -> f64;

    /// The same for a change of conductances (S, at centroids in m) and contacts (ohm m), by one solution; infinite where
    /// there is none.
    fn solved(&self, change: &SheetChange<'_>) -> f64;

    /// What an effect on the loads changes readings by: rms over some frames of the scene's loads, solved with it and
    /// without. Nothing without loads.
    fn on_loads(&self, set: &dyn Fn(&mut EffectSettings, bool)) -> f64;

    /// What an effect on the unloaded sheet's mesh changes readings by, with the scene's own draws.
    fn misplaced(&self, set: &dyn Fn(&mut EffectSettings)) -> f64;

    /// What the voltmeter's input has, ohm; without bound where the scene does not say.
    fn input_ohm(&self) -> f64;
}
