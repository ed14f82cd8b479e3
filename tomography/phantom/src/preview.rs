//! Prediction of the size of each effect without a simulation: rms over the readings and frames of a scan, in volts.
//!
//! Predictions use the readings of the unloaded sheet, their first-order sensitivities to contacts and conductance, the
//! resistances between electrodes, and the scan's settings, all of which are fast to compute. An effect beyond first
//! order (a crack, a detached electrode) needs one solution of the changed sheet. An effect on loads needs a dozen
//! solutions with it and a dozen without, on a coarse mesh.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use eit::{Forward, Parameters, Preset};
use nalgebra::DMatrix;

use crate::effects::{EffectSettings, SheetChange, SheetResponse, UnloadedReading};
use crate::scan::{ReadingContext, Scan, across};
use crate::scene::Scene;
use crate::sheet::{Phantom, PhantomError};

/// Side of the squares for the sensitivity, m.
const CELL: f64 = 8e-3;
/// Largest fineness of the mesh for the sensitivity.
const FINENESS: f64 = 0.6;
/// Number of frames sampled for quantities that change with time.
const MOMENTS: usize = 240;
/// Number of frames sampled for the signal of the loads.
const LOADED: usize = 24;
/// Number of frames solved with and without an effect on loads.
const PRESSED: usize = 12;

/// Precomputed inputs of the predictions for a scene and its scan.
#[derive(Debug)]
pub struct Preview {
    scan: Scan,
    sights: Vec<UnloadedReading>,
    effects: EffectSettings,
    /// The scene with its loads, without effects, on a coarse mesh.
    pressed: Scene,
    phantom: Phantom,
    z: DMatrix<f64>,
    signal: Option<f64>,
    /// Change of each reading (row) with ln(contact impedance) of each electrode, V.
    contacts: DMatrix<f64>,
    /// Change of each reading (row) with ln(conductance) of each cell, V, and the cells' centres, m.
    cells: DMatrix<f64>,
    centres: Vec<[f64; 2]>,
}

/// Predicted size of one effect.
#[derive(Debug, Clone, PartialEq)]
pub struct Prediction {
    /// Name as in scenes.
    pub name: &'static str,
    /// Description.
    pub what: &'static str,
    /// Whether the scene names it; otherwise the prediction uses the default parameters.
    pub named: bool,
    /// Rms over readings and frames, V.
    pub volts: f64,
    /// For an effect that is a fault: the event that the prediction assumes.
    pub assumes: Option<String>,
}

impl Preview {
    /// Prepares predictions for a scene.
    ///
    /// # Errors
    /// A sheet that cannot be meshed or solved.
    pub fn new(scene: &Scene, scan: Scan) -> Result<Self, PhantomError> {
        let untouched = Scene {
            effects: EffectSettings::default(),
            loads: Vec::new(),
            ..scene.clone()
        };
        let mut phantom = Phantom::new(untouched.clone())?;
        let z = phantom.transfer_impedance(Duration::ZERO)?.clone();
        let sights: Vec<UnloadedReading> = scan
            .protocol
            .measurements()
            .iter()
            .zip(scan.contexts(Duration::ZERO))
            .map(|(measurement, context)| UnloadedReading {
                exact: scan.current.0 * across(&z, measurement.sense, measurement.drive),
                context: ReadingContext {
                    source_resistance: survey::Ohms(across(
                        &z,
                        measurement.sense,
                        measurement.sense,
                    )),
                    load_resistance: survey::Ohms(across(&z, measurement.drive, measurement.drive)),
                    ..context
                },
            })
            .collect();
        let sigma = phantom.conductance(Duration::ZERO);
        let forward = phantom.forward();
        let mut contacts = forward.contact_jacobian(&sigma, &scan.protocol)?;
        for (mut column, z) in contacts.column_iter_mut().zip(forward.contact_ohm_m()) {
            column *= scan.current.0 * z;
        }
        let (cells, centres) = cells(&untouched, &scan)?;
        let mut preview = Self {
            sights,
            effects: scene.effects.clone(),
            pressed: Scene {
                sheet: coarse(&scene.sheet),
                effects: EffectSettings::default(),
                ..scene.clone()
            },
            phantom,
            z,
            signal: None,
            contacts,
            cells,
            centres,
            scan,
        };
        preview.signal = preview.load_signal(scene)?;
        Ok(preview)
    }

    /// Rms over the readings of the change by loads, V, in the frame where it is largest; `None` without a change.
    fn load_signal(&self, scene: &Scene) -> Result<Option<f64>, PhantomError> {
        if scene.loads.is_empty() {
            return Ok(None);
        }
        let mut loaded = Phantom::new(Scene {
            effects: self.laws(),
            ..scene.clone()
        })?;
        let mut largest: Option<f64> = None;
        for at in self.moments(LOADED) {
            let z = loaded.transfer_impedance(at)?.clone();
            let changed = self.changed_by(&z);
            if changed > 0.0 {
                largest = Some(largest.map_or(changed, |most| most.max(changed)));
            }
        }
        Ok(largest)
    }

    /// Settings of the acquisition.
    pub fn scan(&self) -> &Scan {
        &self.scan
    }

    /// Noise of one reading, V: the scene's voltmeter noise if named, otherwise that of the voltmeter's table.
    pub fn noise(&self) -> f64 {
        self.effects
            .voltmeter_noise
            .clone()
            .unwrap_or_default()
            .volts(&self.sights[0].context)
    }

    /// Rms over the readings of the change by loads, V, in the frame where it is largest; `None` without a change.
    pub fn signal(&self) -> Option<f64> {
        self.signal
    }

    /// Every effect, named or not, in the order in which they act.
    pub fn predictions(&self) -> Vec<Prediction> {
        self.effects
            .with_usual()
            .into_iter()
            .map(|(name, what, named, effect)| Prediction {
                name,
                what,
                named,
                volts: effect.predict(self),
                assumes: effect.assumes(),
            })
            .collect()
    }

    /// The middle times of at most `most` frames, spread from the first to the last.
    fn moments(&self, most: usize) -> impl ExactSizeIterator<Item = Duration> {
        let frames = self.scan.frames.max(1);
        let half = self.scan.frame_time() / 2;
        let count = frames.min(most);
        (0..count).map(move |k| {
            let frame = if count == 1 {
                0
            } else {
                k * (frames - 1) / (count - 1)
            };
            self.scan.begin(frame) + half
        })
    }

    /// The effects of the scene that determine the law from pressure to conductance.
    fn laws(&self) -> EffectSettings {
        EffectSettings {
            foam: self.effects.foam.clone(),
            gauge_law: self.effects.gauge_law.clone(),
            exponential_law: self.effects.exponential_law.clone(),
            log_law: self.effects.log_law.clone(),
            ..EffectSettings::default()
        }
    }

    /// Rms difference of the readings between two networks (ohm), V.
    fn apart(&self, one: &DMatrix<f64>, other: &DMatrix<f64>) -> f64 {
        let differ = one - other;
        root_mean_square(self.scan.protocol.measurements().iter().map(|measurement| {
            self.scan.current.0 * across(&differ, measurement.sense, measurement.drive)
        }))
    }

    fn changed_by(&self, z: &DMatrix<f64>) -> f64 {
        let measurements = self.scan.protocol.measurements().iter();
        root_mean_square(measurements.zip(&self.sights).map(|(measurement, sight)| {
            self.scan.current.0 * across(z, measurement.sense, measurement.drive) - sight.exact
        }))
    }
}

impl SheetResponse for Preview {
    fn scan(&self) -> &Scan {
        &self.scan
    }

    fn rms(&self, of: &dyn Fn(&UnloadedReading) -> f64) -> f64 {
        root_mean_square(self.sights.iter().map(of))
    }

    fn over_time(&self, of: &dyn Fn(f64) -> f64) -> f64 {
        root_mean_square(self.moments(MOMENTS).map(|at| of(at.as_secs_f64())))
    }

    fn uniform(&self) -> f64 {
        let rows = self.sights.iter().zip(self.contacts.row_iter());
        root_mean_square(rows.map(|(sight, contacts)| contacts.sum() - sight.exact))
    }

    fn contacts(&self) -> f64 {
        (self.contacts.norm_squared() / self.sights.len() as f64).sqrt()
    }

    fn random_field(&self, covariance: &dyn Fn(f64) -> f64) -> f64 {
        let together = self.cells.tr_mul(&self.cells);
        let mut sum = 0.0;
        for (i, a) in self.centres.iter().enumerate() {
            for (j, b) in self.centres.iter().enumerate() {
                sum += together[(i, j)] * covariance((a[0] - b[0]).hypot(a[1] - b[1]));
            }
        }
        (sum / self.sights.len() as f64).sqrt()
    }

    fn network(&self, change: &dyn Fn(&mut DMatrix<f64>)) -> f64 {
        let mut z = self.z.clone();
        change(&mut z);
        self.changed_by(&z)
    }

    fn solved(&self, change: &SheetChange<'_>) -> f64 {
        let mesh = self.phantom.mesh();
        let places: Vec<[f64; 2]> = (0..mesh.triangles().len())
            .map(|t| mesh.centroid(t))
            .collect();
        let mut sigma = vec![self.phantom.scene().sheet.conductance(); places.len()];
        let mut contacts = self.phantom.forward().contact_ohm_m().to_vec();
        change(&places, &mut sigma, &mut contacts);
        Forward::new(Arc::clone(mesh), &contacts)
            .and_then(|forward| forward.transfer_impedance(&sigma))
            .map_or(f64::INFINITY, |z| self.changed_by(&z))
    }

    fn on_loads(&self, set: &dyn Fn(&mut EffectSettings, bool)) -> f64 {
        if self.pressed.loads.is_empty() {
            return 0.0;
        }
        let apart = || {
            let solved = |on| {
                let mut effects = self.laws();
                set(&mut effects, on);
                Phantom::new(Scene {
                    effects,
                    ..self.pressed.clone()
                })
            };
            let (mut with, mut without) = (solved(true)?, solved(false)?);
            self.moments(PRESSED)
                .map(|at| {
                    let one = with.transfer_impedance(at)?;
                    Ok(self.apart(one, without.transfer_impedance(at)?))
                })
                .collect::<Result<Vec<f64>, PhantomError>>()
        };
        apart().map_or(f64::INFINITY, |apart| root_mean_square(apart.into_iter()))
    }

    fn misplaced(&self, set: &dyn Fn(&mut EffectSettings)) -> f64 {
        let mut scene = Scene {
            loads: Vec::new(),
            ..self.pressed.clone()
        };
        let apart = || {
            let mut drawn = Phantom::new(scene.clone())?;
            set(&mut scene.effects);
            let mut displaced = Phantom::new(scene)?;
            let at = Duration::ZERO;
            let one = displaced.transfer_impedance(at)?;
            Ok::<f64, PhantomError>(self.apart(one, drawn.transfer_impedance(at)?))
        };
        apart().unwrap_or(f64::INFINITY)
    }

    fn input_ohm(&self) -> f64 {
        let named = self.effects.input_resistance.as_ref();
        named.map_or(f64::INFINITY, |input| input.mohm * 1e6)
    }
}

fn root_mean_square(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    (values.map(|value| value.powi(2)).sum::<f64>() / count).sqrt()
}

/// The sheet with a mesh of at most [`FINENESS`], which is sufficient to first order.
fn coarse(sheet: &Preset) -> Preset {
    let fineness = match sheet {
        Preset::PaperSheet(sheet) => sheet.fineness,
        Preset::DiscTank(tank) => tank.fineness,
    };
    sheet.clone().remeshed((FINENESS / fineness).min(1.0), 0)
}

/// The sensitivity of readings (V) to ln(conductance) of squares of the whole sheet, and the squares' centres (m).
/// Computed on a coarse mesh, which is sufficient to first order.
fn cells(scene: &Scene, scan: &Scan) -> Result<(DMatrix<f64>, Vec<[f64; 2]>), PhantomError> {
    let coarse = Phantom::new(Scene {
        sheet: coarse(&scene.sheet),
        ..scene.clone()
    })?;
    let mesh = coarse.mesh();
    let sigma = vec![scene.sheet.conductance(); mesh.triangles().len()];
    let parameters = Parameters::elements().logarithmic();
    let elements = coarse
        .forward()
        .sensitivity(&sigma, &scan.protocol, &parameters)?;
    let mut squares = BTreeMap::<[i64; 2], Vec<usize>>::new();
    for t in 0..mesh.triangles().len() {
        let square = mesh.centroid(t).map(|m| (m / CELL).floor() as i64);
        squares.entry(square).or_default().push(t);
    }
    let mut cells = DMatrix::zeros(elements.nrows(), squares.len());
    for (k, triangles) in squares.values().enumerate() {
        for t in triangles {
            cells
                .column_mut(k)
                .axpy(scan.current.0, &elements.column(*t), 1.0);
        }
    }
    let centres = squares
        .keys()
        .map(|square| square.map(|k| (k as f64 + 0.5) * CELL))
        .collect();
    Ok((cells, centres))
}
