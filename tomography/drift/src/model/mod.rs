//! The drift of one sheet as covariances of its relative data: noise, gain, contacts, smooth fields, local change.
//!
//! D(s) = gain^2 v v' + contact^2 C C' + (contact / 0.1)^4 N N' + field^2 F F' + local^2 X X'; C: first order of the
//! contacts, N: effect of contacts drawn at 10 % beyond first order, F: Matern 80 mm, X: Matern 8 mm.

mod cells;
mod covariances;

use std::sync::Arc;

use eit::linear_algebra::{product, view};
use eit::{Forward, Mesh, Parameters, bounding_box};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use survey::{Dipole, Electrode, Reading, Volts};

use crate::DriftError;
use crate::model::cells::{Cells, PITCH_M};
use crate::model::covariances::{SECOND_ORDER_SD, matern, noise_covariance, second_order};
use crate::overlap::{overlap, unstretched};
use crate::pairs::{NEARLY_ZERO, Pairs, Relative, baseline_volts};
use crate::sheet::{FitOptions, SheetFit};
use crate::sizes::Sizes;

/// Correlation lengths of smooth fields and of local change, m.
const FIELD_M: f64 = 80e-3;
const LOCAL_M: f64 = 8e-3;
/// Grid spacing of the load test's places, m, and its diameters, m.
const PLACES_M: f64 = 10e-3;
const DIAMETERS_M: [f64; 2] = [20e-3, 50e-3];
/// Factor of the contact impedance of an electrode that has lost its contact.
const LOST: f64 = 1e6;
/// Standard deviations by which a reading of the baseline must differ from 0 V, so that noise does not make a reading
/// nearly 0 V.
const ABOVE_NOISE: f64 = 8.0;
/// Smallest distance of the load test's places from the sheet's edge, m.
const EDGE_M: f64 = 12e-3;

/// Noise of the instruments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Standard deviation of one reading, V.
    pub reading_v: f64,
    /// Thermal voltage of a sensing pair, V.
    pub emf_v: f64,
}

/// A disc of the load test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Place {
    pub(crate) centre: [f64; 2],
    pub(crate) diameter: f64,
}

/// One sheet with its first baseline; the constructor precomputes the covariances.
pub struct DriftModel {
    pairs: Pairs,
    fit: SheetFit,
    mesh: Arc<Mesh>,
    baseline: Vec<f64>,
    ratios: Vec<f64>,
    /// Derivative of the data by ln conductance of each triangle, V.
    sensitivity: DMatrix<f64>,
    cells: Cells,
    /// The same derivative by cell.
    by_cell: DMatrix<f64>,
    /// Whether each cell is in the region where loads are possible.
    within: Vec<bool>,
    /// Derivative of the data by ln contact impedance of each electrode, V.
    pub(crate) contacts: DMatrix<f64>,
    pub(crate) noise: DMatrix<f64>,
    pub(crate) contact_gram: DMatrix<f64>,
    pub(crate) second_gram: DMatrix<f64>,
    pub(crate) field_gram: DMatrix<f64>,
    pub(crate) local_gram: DMatrix<f64>,
    /// Prior covariance of local change times sensitivity: a row per cell.
    pub(crate) local_map: DMatrix<f64>,
    /// Prior covariance of the smooth field times sensitivity, over the whole sheet: a row per cell.
    field_map: DMatrix<f64>,
    pub(crate) places: Vec<Place>,
    /// Noise of the instruments.
    instruments: Noise,
    /// Injected current, A.
    current_a: f64,
    /// Row of each reading of the protocol.
    row_of: Vec<usize>,
    /// Change of the data caused by a disc at each place (column), per unit change of ln conductance.
    pub(crate) atoms: DMatrix<f64>,
    /// Voltage of each electrode (row) at 1 A from electrode e to e + 1 (column), V.
    pub(crate) potentials: DMatrix<f64>,
}

impl DriftModel {
    /// Fits the sheet to the baseline and computes the covariances. The whole mesh is fitted; local change is
    /// restricted to its region. `contact_ohm_m` and `sigma0` (S per square, one per triangle) describe the nominal
    /// sheet.
    ///
    /// # Errors
    /// A baseline with missing readings, or a sheet that cannot be solved.
    pub fn new(
        mesh: &Mesh,
        contact_ohm_m: &[f64],
        sigma0: &[f64],
        protocol: &survey::Protocol,
        baseline: &[Reading],
        noise: Noise,
        options: &FitOptions,
    ) -> Result<Self, DriftError> {
        let region = mesh.region();
        let mesh = Arc::new(mesh.whole());
        let pairs = Pairs::new(protocol);
        let baseline = baseline_volts(&pairs, baseline)?;
        let fit = SheetFit::new(&mesh, contact_ohm_m, sigma0, &pairs, &baseline, options)?;
        let current_a = options.current_a;
        let forward = Forward::new(Arc::clone(&mesh), &fit.contact_ohm_m)?;
        let sensitivity = by_triangle(&forward, &fit.sigma, &pairs, current_a)?;
        let mut contacts = forward.contact_jacobian(&fit.sigma, pairs.half())?;
        for (mut column, contact) in contacts.column_iter_mut().zip(&fit.contact_ohm_m) {
            column *= current_a * contact;
        }
        let second_gram = second_order(&mesh, &fit, &pairs, &contacts, current_a)?;
        let cells = Cells::new(&mesh);
        let by_cell = cells.sum(&sensitivity);
        let within = cells.within(region, &mesh);
        let mut inner = by_cell.clone();
        for (mut column, _) in inner
            .column_iter_mut()
            .zip(&within)
            .filter(|(_, within)| !**within)
        {
            column.fill(0.0);
        }
        let local_map = product(
            view(&matern(&cells.centres, LOCAL_M)),
            view(&inner.transpose()),
        );
        let field = product(
            view(&matern(&cells.centres, FIELD_M)),
            view(&by_cell.transpose()),
        );
        let ratios = pairs.ratios(&fit.readings, &baseline);
        let electrodes = mesh.electrodes();
        let drives: Vec<Dipole> = (0..electrodes)
            .map(|e| Dipole {
                plus: Electrode(e),
                minus: Electrode((e + 1) % electrodes),
            })
            .collect();
        let potentials = forward.solve(&fit.sigma, &drives)?.electrodes;
        let mut model = Self {
            noise: noise_covariance(&pairs, &ratios, noise),
            instruments: noise,
            current_a,
            row_of: row_of_readings(&pairs),
            contact_gram: product(view(&contacts), view(&contacts.transpose())),
            second_gram,
            field_gram: product(view(&by_cell), view(&field)),
            local_gram: product(view(&inner), view(&local_map)),
            local_map,
            field_map: field,
            contacts,
            potentials,
            by_cell,
            within,
            cells,
            sensitivity,
            ratios,
            baseline,
            places: Vec::new(),
            atoms: DMatrix::zeros(0, 0),
            pairs,
            mesh,
            fit,
        };
        model.places = model.load_places();
        let atoms: Vec<DVector<f64>> = model
            .places
            .par_iter()
            .map(|place| model.disc(place.centre, place.diameter))
            .collect();
        model.atoms = DMatrix::from_columns(&atoms);
        Ok(model)
    }

    /// The readings of the baseline after a change of the data, V (one per pair): the baseline for a frame of a sheet
    /// with this drift.
    pub fn baseline_with(&self, change: &DVector<f64>) -> Vec<Reading> {
        let mut volts = self.baseline.clone();
        for (row, change) in change.iter().enumerate() {
            let [first, second] = self.pairs.readings(row);
            for reading in [first, second] {
                volts[reading] = self.baseline[reading] + change / self.ratios[reading];
            }
        }
        Reading::of_volts(volts)
    }

    /// The fitted sheet.
    pub fn fit(&self) -> &SheetFit {
        &self.fit
    }

    /// The pairs of the protocol.
    pub fn pairs(&self) -> &Pairs {
        &self.pairs
    }

    /// The whole sheet.
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// A frame relative to the first baseline.
    ///
    /// # Errors
    /// Another number of readings, or too few with a value.
    pub fn relative(&self, frame: &[Reading]) -> Result<Relative, DriftError> {
        let frame = self.without_zeros(frame);
        self.pairs.relative(&self.ratios, &self.baseline, &frame)
    }

    /// The frame without the readings that are nearly 0 V.
    pub fn without_zeros(&self, frame: &[Reading]) -> Vec<Reading> {
        let each = frame.iter().enumerate();
        each.map(|(index, reading)| match reading.volts() {
            Some(Volts(volts)) if self.is_nearly_zero(index, volts) => Reading::NotMeasured,
            _ => *reading,
        })
        .collect()
    }

    /// Whether a reading (V) is nearly 0 V although that of the first baseline is far above the noise: the pair is
    /// shorted, or no current flowed. Taken as a change of the sheet, such a reading would be regained conductance. Load
    /// and drift do this only where pairs interlace (`survey.skip` of 1 or more): such a reading can have either sign,
    /// and counts as nearly 0 V too while it passes 0 V.
    pub(crate) fn is_nearly_zero(&self, reading: usize, volts: f64) -> bool {
        let noise = self.instruments.reading_v.hypot(self.instruments.emf_v);
        self.baseline.get(reading).is_some_and(|before| {
            before.abs() > ABOVE_NOISE * noise && volts.abs() < NEARLY_ZERO * before.abs()
        })
    }

    /// Readings of the first baseline, V.
    pub(crate) fn baseline(&self) -> &[f64] {
        &self.baseline
    }

    /// Derivative of the data (row) with respect to ln conductance of each triangle of [`DriftModel::mesh`] (column),
    /// V.
    pub fn sensitivity(&self) -> &DMatrix<f64> {
        &self.sensitivity
    }

    /// The cell of each triangle, for maps by cell.
    pub fn cell_of_triangle(&self) -> &[usize] {
        &self.cells.of
    }

    /// Derivative of the data (row) with respect to ln conductance of each cell (column), V.
    pub fn cell_sensitivity(&self) -> &DMatrix<f64> {
        &self.by_cell
    }

    /// Cells in the region that are less than `reach` (m) away from one of these cells, ascending.
    pub(crate) fn cells_around(&self, of: &[usize], reach: f64) -> Vec<usize> {
        let mut out: Vec<usize> = of
            .iter()
            .flat_map(|&cell| self.cells.near(self.cells.centres[cell], reach))
            .filter(|&cell| self.within[cell])
            .collect();
        out.sort_unstable();
        out.dedup();
        out
    }

    /// Correlation of local change between these cells.
    pub(crate) fn local_correlation(&self, of: &[usize]) -> DMatrix<f64> {
        let centres: Vec<[f64; 2]> = of.iter().map(|&cell| self.cells.centres[cell]).collect();
        matern(&centres, LOCAL_M)
    }

    /// Change of the data caused by an electrode that loses its contact, V: for a complete loss, and per unit change of
    /// the logarithm of its impedance. Readings of other electrodes change too, because current no longer flows through
    /// the electrode's metal.
    ///
    /// # Errors
    /// A sheet that cannot be solved.
    pub(crate) fn lost_contact(&self, electrode: usize) -> Result<DMatrix<f64>, DriftError> {
        let mut contacts = self.fit.contact_ohm_m.clone();
        contacts[electrode] *= LOST;
        let forward = Forward::new(Arc::clone(&self.mesh), &contacts)?;
        let volts = forward
            .workspace(self.pairs.half())?
            .plain()
            .readings(&self.fit.sigma)?;
        let lost = volts * self.current_a - &self.fit.readings;
        let little = self.contacts.column(electrode).into_owned();
        Ok(DMatrix::from_columns(&[lost, little]))
    }

    /// The model linearised about a sheet with this change (ln conductance, by cell): its data extrapolated to zero
    /// change, V, and their derivative with respect to ln conductance of each cell (column), V.
    ///
    /// # Errors
    /// A sheet that cannot be solved.
    pub(crate) fn linear_about(
        &self,
        change: &DVector<f64>,
    ) -> Result<(DVector<f64>, DMatrix<f64>), DriftError> {
        let forward = Forward::new(Arc::clone(&self.mesh), &self.fit.contact_ohm_m)?;
        let sigma = self.fit.sigma.iter().zip(&self.cells.of);
        let sigma: Vec<f64> = sigma
            .map(|(sigma, &cell)| sigma * change[cell].exp())
            .collect();
        let half = self.pairs.half();
        let volts = forward.workspace(half)?.plain().readings(&sigma)?;
        let by_triangle = by_triangle(&forward, &sigma, &self.pairs, self.current_a)?;
        let by_cell = self.cells.sum(&by_triangle);
        let changed = volts * self.current_a - &self.fit.readings;
        Ok((changed - &by_cell * change, by_cell))
    }

    /// The covariance R of one frame's noise, V2.
    pub fn noise(&self) -> &DMatrix<f64> {
        &self.noise
    }

    /// D(s), V2.
    pub fn drift(&self, sizes: &Sizes) -> DMatrix<f64> {
        let v = &self.fit.readings;
        let mut out = (v * v.transpose()) * sizes.gain.powi(2);
        for (gram, factor) in [
            (&self.contact_gram, sizes.contact.powi(2)),
            (&self.second_gram, (sizes.contact / SECOND_ORDER_SD).powi(4)),
            (&self.field_gram, sizes.field.powi(2)),
            (&self.local_gram, sizes.local.powi(2)),
        ] {
            if factor > 0.0 {
                out.zip_apply(gram, |out, value| *out += factor * value);
            }
        }
        out
    }

    /// Change of the data caused by a disc (centre and diameter, m), per unit change of ln conductance, linear (Born),
    /// V.
    pub fn disc(&self, centre: [f64; 2], diameter: f64) -> DVector<f64> {
        self.ellipse(centre, diameter, [0.0; 2])
    }

    /// Change of the data caused by an ellipse with the area of the disc, stretched as defined by [`unstretched`].
    pub(crate) fn ellipse(
        &self,
        centre: [f64; 2],
        diameter: f64,
        stretch: [f64; 2],
    ) -> DVector<f64> {
        let mut out = DVector::zeros(self.pairs.len());
        for (triangle, share) in self.covered_by_ellipse(centre, 0.5 * diameter, stretch) {
            out.axpy(share, &self.sensitivity.column(triangle), 1.0);
        }
        out
    }

    /// Change of the data caused by a disc, for these rows only.
    pub(crate) fn disc_in(&self, centre: [f64; 2], diameter: f64, rows: &[usize]) -> DVector<f64> {
        let mut out = DVector::zeros(rows.len());
        for (triangle, share) in self.covered(centre, 0.5 * diameter) {
            let column = self.sensitivity.column(triangle);
            for (value, &row) in out.iter_mut().zip(rows) {
                *value += share * column[row];
            }
        }
        out
    }

    /// The noise of the instruments.
    pub(crate) fn instruments(&self) -> Noise {
        self.instruments
    }

    /// Row of a reading of the protocol.
    pub(crate) fn row_of(&self, reading: usize) -> usize {
        self.row_of[reading]
    }

    /// Change of one reading since the first baseline, scaled to the model's readings, V.
    pub(crate) fn change_of(&self, reading: usize, volts: f64) -> f64 {
        self.ratios[reading] * (volts - self.baseline[reading])
    }

    /// Covariance of the noise of two readings, V2: white noise of a reading with itself (`same`), thermal voltage of a
    /// sensing pair.
    pub(crate) fn noise_between(&self, a: usize, b: usize, same: bool) -> f64 {
        let both = self.ratios[a] * self.ratios[b];
        let measurements = self.pairs.protocol().measurements();
        let white = if same {
            self.instruments.reading_v.powi(2)
        } else {
            0.0
        };
        let thermal = match measurements[a].sense == measurements[b].sense {
            true => self.instruments.emf_v.powi(2),
            false => 0.0,
        };
        both * (white + thermal)
    }

    /// Share of each triangle that a disc covers; triangles that are not covered are omitted.
    fn covered(&self, centre: [f64; 2], radius: f64) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.covered_by_ellipse(centre, radius, [0.0; 2])
    }

    /// The covered shares for a disc that is stretched at constant area, as defined by [`unstretched`].
    fn covered_by_ellipse(
        &self,
        centre: [f64; 2],
        radius: f64,
        stretch: [f64; 2],
    ) -> impl Iterator<Item = (usize, f64)> + '_ {
        let longest = radius * stretch[0].hypot(stretch[1]).exp();
        let is_disc = stretch == [0.0; 2];
        self.cells
            .near(centre, longest + 2.0 * PITCH_M)
            .flat_map(|cell| self.cells.triangles[cell].iter().copied())
            .filter_map(move |triangle| {
                let mut corners = self.mesh.corners(triangle);
                if !is_disc {
                    corners = unstretched(corners, centre, stretch);
                }
                let share = overlap(corners, centre, radius) / self.mesh.area(triangle);
                (share > 1e-9).then_some((triangle, share))
            })
    }

    /// The map of local change for these weights of the data: prior covariance times weights, ln conductance of each
    /// triangle.
    pub(crate) fn local_map(&self, weights: &DVector<f64>) -> Vec<f64> {
        let cells = &self.local_map * weights;
        self.cells.of.iter().map(|&cell| cells[cell]).collect()
    }

    /// The smooth field for these weights of the data, by cell.
    pub(crate) fn field_by_cell(&self, weights: &DVector<f64>) -> DVector<f64> {
        &self.field_map * weights
    }

    /// The map of [`DriftModel::local_map`] by cell, with the centres of the cells, m.
    pub(crate) fn local_by_cell(&self, weights: &DVector<f64>) -> (DVector<f64>, &[[f64; 2]]) {
        (&self.local_map * weights, &self.cells.centres)
    }

    /// Lowest and highest corner of the sheet, m.
    pub(crate) fn bounds(&self) -> [[f64; 2]; 2] {
        bounding_box(self.mesh.nodes().iter().copied())
    }

    fn load_places(&self) -> Vec<Place> {
        let [low, high] = self.bounds();
        let along = |axis: usize| {
            let (from, to) = (low[axis] + EDGE_M, high[axis] - EDGE_M);
            let count = ((to - from) / PLACES_M).round().max(1.0) as usize;
            (0..=count).map(move |k| from + (to - from) * k as f64 / count as f64)
        };
        let mut places = Vec::new();
        for diameter in DIAMETERS_M {
            for y in along(1) {
                places.extend(along(0).map(|x| Place {
                    centre: [x, y],
                    diameter,
                }));
            }
        }
        places
    }
}

/// Derivative of the data with respect to ln conductance of each triangle, V.
fn by_triangle(
    forward: &Forward,
    sigma: &[f64],
    pairs: &Pairs,
    current_a: f64,
) -> Result<DMatrix<f64>, DriftError> {
    let elements = Parameters::elements().logarithmic();
    let sensitivity = forward.sensitivity(sigma, pairs.half(), &elements)?;
    Ok(sensitivity * current_a)
}

fn row_of_readings(pairs: &Pairs) -> Vec<usize> {
    let mut out = vec![0; pairs.protocol().len()];
    for row in 0..pairs.len() {
        for reading in pairs.readings(row) {
            out[reading] = row;
        }
    }
    out
}
