//! The values of the parameters, including those that depend on others.

use crate::parameter::Subject;
use crate::range::LARGEST_CURRENT;
use crate::{Ask, Parameter};

/// Indices of the choice [`Parameter::Spacing`].
pub(super) const LINEAR: f64 = 0.0;
pub(super) const LOGARITHMIC: f64 = 1.0;

/// A value for each parameter.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Values {
    held: Vec<f64>,
    /// Whether the number of points of a linear sweep was set last, and determines the step; otherwise the step
    /// determines the number of points.
    points_lead: bool,
    /// Whether the duration of the wave was set in cycles, which determine its time; otherwise the time determines the
    /// cycles.
    cycles_lead: bool,
}

impl Values {
    pub(super) fn reset() -> Self {
        Self {
            held: Parameter::ALL
                .iter()
                .map(|parameter| parameter.kind().reset_value())
                .collect(),
            points_lead: false,
            cycles_lead: false,
        }
    }

    /// Takes the values of `other`, except the communication settings.
    pub(super) fn copy_settings(&mut self, other: &Values) {
        for &parameter in Parameter::ALL {
            if parameter.subject() != Subject::Communication {
                self.held[parameter as usize] = other.held[parameter as usize];
            }
        }
        self.points_lead = other.points_lead;
        self.cycles_lead = other.cycles_lead;
    }

    fn held(&self, parameter: Parameter) -> f64 {
        self.held[parameter as usize]
    }

    pub(super) fn is_on(&self, parameter: Parameter) -> bool {
        self.held(parameter) != 0.0
    }

    pub(super) fn get(&self, parameter: Parameter) -> f64 {
        let span = self.held(Parameter::Stop) - self.held(Parameter::Start);
        let linear = self.held(Parameter::Spacing) == LINEAR;
        match parameter {
            Parameter::Center => self.held(Parameter::Start) + span / 2.0,
            Parameter::Span => span.abs(),
            Parameter::Points if linear && !self.points_lead => self.linear_points().min(65_535.0),
            Parameter::Step if linear && self.points_lead && self.held(Parameter::Points) > 1.0 => {
                span.abs() / (self.held(Parameter::Points) - 1.0)
            }
            Parameter::WaveTime if self.cycles_lead => {
                self.held(Parameter::WaveCycles) / self.held(Parameter::Frequency)
            }
            Parameter::WaveCycles if !self.cycles_lead => {
                self.held(Parameter::WaveTime) * self.held(Parameter::Frequency)
            }
            other => self.held(other),
        }
    }

    /// Points of a linear sweep, possibly more than a sweep can have.
    pub(super) fn linear_points(&self) -> f64 {
        if self.points_lead {
            return self.held(Parameter::Points);
        }
        let span = (self.held(Parameter::Stop) - self.held(Parameter::Start)).abs();
        // A relative tolerance of 1e-9 keeps the last point if span / step is slightly below its decimal value.
        (span / self.held(Parameter::Step) * (1.0 + 1e-9)).floor() + 1.0
    }

    /// Sets a value that its kind allows. While centre and span are changed one after the other, a sweep may
    /// temporarily exceed the instrument's current; a sweep that still does so is rejected when it is armed.
    ///
    /// When the ends of a sweep change, its number of points stays and the step is adapted (corrections of 2026-11-22).
    pub(super) fn set(&mut self, parameter: Parameter, value: f64) {
        if matches!(
            parameter,
            Parameter::Start | Parameter::Stop | Parameter::Center | Parameter::Span
        ) {
            self.held[Parameter::Points as usize] = self.get(Parameter::Points);
            self.points_lead = true;
        }
        match parameter {
            Parameter::Center => self.sweep_over(value, self.get(Parameter::Span)),
            Parameter::Span => self.sweep_over(self.get(Parameter::Center), value),
            Parameter::Points => self.points_lead = true,
            Parameter::Step => self.points_lead = false,
            Parameter::WaveTime => self.cycles_lead = false,
            Parameter::WaveCycles => self.cycles_lead = true,
            Parameter::DeltaHigh => self.held[Parameter::DeltaLow as usize] = -value,
            _ => {}
        }
        self.held[parameter as usize] = value;
    }

    fn sweep_over(&mut self, center: f64, span: f64) {
        let most = LARGEST_CURRENT.0;
        let ends = [center - span / 2.0, center + span / 2.0];
        // an end computed from centre and span may exceed the limit by a rounding error
        let [start, stop] = ends.map(|end| {
            let exact = end.clamp(-most, most);
            if (end - exact).abs() <= 1e-12 * most {
                exact
            } else {
                end
            }
        });
        self.held[Parameter::Start as usize] = start;
        self.held[Parameter::Stop as usize] = stop;
    }

    pub(super) fn cycles_lead(&self) -> bool {
        self.cycles_lead
    }

    /// The value in the form of a query's reply.
    pub(super) fn read(&self, parameter: Parameter, ask: Ask) -> String {
        let kind = parameter.kind();
        kind.read_back(kind.queried(ask, self.get(parameter)))
    }
}
