//! Memory for one solution, and the computations that use it.

use nalgebra::DMatrix;

use super::ring::{Ring, neighbours};
use super::system::{Form, System};
use super::{Admitted, Forward, ForwardError, Solution};
use crate::linear_algebra::sparse::{Block, Factor, SparseError, gram};

/// A correction below this share of the solution ends the refinement.
const REFINED: f64 = 1e-11;

/// Corrections before giving up.
const MOST_CORRECTIONS: usize = 12;

/// Below this first correction a reading needs no second: the remaining error is about its square.
const SQUARED: f64 = 1e-8;

/// Memory for solving one conductance after another.
#[derive(Clone)]
pub(super) struct Scratch {
    pub(super) system: System,
    pub(super) factor: Factor,
    pub(super) x: Block,
    rest: Block,
}

/// A conductance whose factor is kept.
pub(crate) struct Base {
    system: System,
    factor: Factor,
}

impl Scratch {
    pub(super) fn new(forward: &Forward) -> Result<Self, ForwardError> {
        let factor = Factor::passing(&forward.layout.analysis)
            .map_err(|fault| refusal(forward, fault, &[]))?;
        Ok(Self {
            system: System::default(),
            factor,
            x: Block::zeros(0, 0),
            rest: Block::zeros(0, 0),
        })
    }

    /// Factors a conductance on which later ones are based.
    pub(super) fn base(forward: &Forward, sigma: &[f64]) -> Result<Base, ForwardError> {
        let sigma = forward.admit(sigma)?.sigma;
        let failed = |fault| refusal(forward, fault, &sigma);
        let mut system = System::default();
        let mut factor = Factor::keeping(&forward.layout.analysis).map_err(failed)?;
        system.set(forward, &sigma);
        factor
            .make(&forward.layout.analysis, &system.values)
            .map_err(failed)?;
        Ok(Base { system, factor })
    }

    /// Takes a conductance and factors its matrix; returns the number of floored triangles.
    fn factor(
        &mut self,
        forward: &Forward,
        sigma: &[f64],
        base: Option<&Base>,
    ) -> Result<usize, ForwardError> {
        let Admitted { sigma, floored } = forward.admit(sigma)?;
        self.system.set(forward, &sigma);
        let made = match base {
            Some(base) => self.factor.make_from(
                &forward.layout.analysis,
                &self.system.values,
                &base.factor,
                &base.system.values,
            ),
            None => self
                .factor
                .make(&forward.layout.analysis, &self.system.values),
        };
        made.map_err(|fault| refusal(forward, fault, &sigma))?;
        Ok(floored)
    }

    /// Corrects a solution until the corrections vanish.
    fn correct(
        &mut self,
        forward: &Forward,
        currents: &DMatrix<f64>,
        base: Option<&Factor>,
    ) -> Result<(), ForwardError> {
        let Self {
            system,
            factor,
            x,
            rest,
        } = self;
        let mut last = f64::INFINITY;
        for _ in 0..MOST_CORRECTIONS {
            system.right_side(forward, currents, rest);
            system.subtract_product(forward, x, rest);
            factor.solve(&forward.layout.analysis, base, rest);
            let correction = largest(&rest.values) / largest(&x.values).max(f64::MIN_POSITIVE);
            x.values
                .iter_mut()
                .zip(&rest.values)
                .for_each(|(x, d)| *x += d);
            if correction <= REFINED {
                return Ok(());
            }
            if correction.is_nan() || correction >= 0.5 * last {
                return Err(ForwardError::NotAccurate {
                    achieved: correction,
                });
            }
            last = correction;
        }
        Err(ForwardError::NotAccurate { achieved: last })
    }

    /// Resizes the blocks as needed.
    pub(super) fn fit(&mut self, forward: &Forward, columns: usize) {
        let fresh = Block::zeros(0, columns);
        let rows = forward.layout.unknown.len();
        if self.x.width != fresh.width || self.x.values.len() != rows * fresh.width {
            self.x = Block::zeros(rows, columns);
            self.rest = Block::zeros(rows, columns);
        }
    }

    /// Solves for any currents.
    pub(super) fn solution<'s>(
        &'s mut self,
        forward: &Forward,
        sigma: &[f64],
        currents: &'s DMatrix<f64>,
        base: Option<&Base>,
        refined: bool,
    ) -> Result<Solution<'s>, ForwardError> {
        let floored = self.factor(forward, sigma, base)?;
        let base = base.map(|base| &base.factor);
        self.fit(forward, currents.ncols());
        self.system.right_side(forward, currents, &mut self.x);
        self.factor
            .solve(&forward.layout.analysis, base, &mut self.x);
        if refined {
            self.correct(forward, currents, base)?;
        }
        Ok(Solution {
            x: &self.x,
            forms: &self.system.forms,
            currents,
            floored,
        })
    }

    /// Voltages of neighbours for currents through neighbours.
    ///
    /// With x a solution for the pair a and r its residual for the right side b(a), the voltage of the pair c is bᵀ(c)
    /// x(a) + x(c)ᵀ r(a) up to the square of the error: one product replaces a second solution.
    pub(super) fn ring(
        &mut self,
        forward: &Forward,
        sigma: &[f64],
        base: Option<&Base>,
        refined: bool,
    ) -> Result<Ring, ForwardError> {
        self.factor(forward, sigma, base)?;
        let count = forward.layout.electrodes.len();
        let currents = neighbours(count);
        self.fit(forward, count);
        let factor = base.map(|base| &base.factor);
        self.system.right_side(forward, &currents, &mut self.x);
        if !refined {
            self.factor
                .halve(&forward.layout.analysis, factor, &mut self.x);
            let volts = gram(&self.x, &self.x, count);
            return self.read(forward, sigma, volts);
        }
        self.factor
            .solve(&forward.layout.analysis, factor, &mut self.x);
        let mut volts = self.between(forward);
        self.system.right_side(forward, &currents, &mut self.rest);
        self.system
            .subtract_product(forward, &self.x, &mut self.rest);
        let correction = gram(&self.x, &self.rest, count);
        let size = largest(&correction);
        if size.is_nan() || size > SQUARED * largest(&volts) {
            self.correct(forward, &currents, factor)?;
            volts = self.between(forward);
        } else {
            volts.iter_mut().zip(&correction).for_each(|(v, d)| *v += d);
        }
        self.read(forward, sigma, volts)
    }

    /// Voltages of neighbours (rows) in each column of x, without the drops over eliminated contacts.
    fn between(&self, forward: &Forward) -> Vec<f64> {
        let nodes = forward.mesh.nodes().len();
        let count = forward.layout.electrodes.len();
        let mut voltages = vec![0.0; count];
        let mut volts = Vec::with_capacity(count * count);
        for column in 0..count {
            for (e, (voltage, contact)) in voltages
                .iter_mut()
                .zip(&forward.layout.electrodes)
                .enumerate()
            {
                let at = |unknown: usize| self.x.row(forward.layout.unknown[unknown])[column];
                *voltage = match self.system.forms[e] {
                    Form::Difference | Form::Shunt => at(nodes + e),
                    Form::Eliminated => contact.mean(at),
                };
            }
            volts.extend((0..count).map(|e| voltages[e] - voltages[(e + 1) % count]));
        }
        volts
    }

    fn read(
        &mut self,
        forward: &Forward,
        sigma: &[f64],
        mut volts: Vec<f64>,
    ) -> Result<Ring, ForwardError> {
        let forms = self.system.forms.iter();
        let drops = forms
            .zip(forward.layout.electrodes.iter().zip(&forward.contact))
            .map(|(form, (contact, z))| match form {
                Form::Eliminated => z / contact.length,
                Form::Difference | Form::Shunt => 0.0,
            })
            .collect();
        if let Some(added) = self.depth_impedance(forward, sigma)? {
            let count = forward.layout.electrodes.len();
            let next = |electrode: usize| (electrode + 1) % count;
            for (a, volts) in volts.chunks_exact_mut(count).enumerate() {
                for (b, volts) in volts.iter_mut().enumerate() {
                    *volts += (added[(a, b)] - added[(next(a), b)])
                        - (added[(a, next(b))] - added[(next(a), next(b))]);
                }
            }
        }
        Ok(Ring { volts, drops })
    }
}

/// The largest absolute value; NaN if there is one.
fn largest(values: &[f64]) -> f64 {
    let most = |most: f64, x: f64| if x <= most || most.is_nan() { most } else { x };
    let mut lanes = [0.0; 8];
    let (chunks, rest) = values.as_chunks::<8>();
    for chunk in chunks {
        for (lane, x) in lanes.iter_mut().zip(chunk) {
            *lane = most(*lane, x.abs());
        }
    }
    lanes
        .into_iter()
        .chain(rest.iter().map(|x| x.abs()))
        .fold(0.0, most)
}

pub(super) fn refusal(forward: &Forward, fault: SparseError, sigma: &[f64]) -> ForwardError {
    match fault {
        SparseError::Memory => ForwardError::Memory {
            unknowns: forward.layout.unknown.len(),
        },
        SparseError::NotDefinite => ForwardError::NotDefinite {
            smallest: sigma.iter().copied().fold(f64::INFINITY, f64::min),
            largest: sigma.iter().copied().fold(0.0, f64::max),
        },
    }
}
