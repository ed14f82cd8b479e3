//! Loads over time: the times at which a load is on the sheet, its path, and the pressure distribution under it.
//!
//! Between two waypoints a load moves in a straight line and its force changes linearly, in steps. Each step is
//! computed once, at its middle, so that the error is at most half of [`STEP_MM`] in position and half of
//! [`STEP_SHARE`] in force. A constant load has no steps.

#[cfg(test)]
mod tests;

use std::f64::consts::PI;
use std::time::Duration;

use eit::Mesh;

use crate::law::Law;
use crate::load::{GRAVITY, Load, LoadError, Shape, pressure_kpa};
use crate::repeat::Repeat;

/// Length of one step, mm.
pub(crate) const STEP_MM: f64 = 0.25;

/// Change of the force in one step, as a share of the larger force of the two waypoints.
pub(crate) const STEP_SHARE: f64 = 0.02;

/// Number of rings of constant pressure that approximate a pressure distribution; each has the mean pressure of its
/// part.
const RINGS: u32 = 24;

/// Size of a load.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Amount {
    /// Share of the conductance that is lost, 0 to 1.
    Loss(f64),
    /// A mass, g; the loss is computed from its pressure.
    Mass(f64),
}

impl Amount {
    fn number(self) -> f64 {
        match self {
            Self::Loss(number) | Self::Mass(number) => number,
        }
    }

    fn with(self, number: f64) -> Self {
        match self {
            Self::Loss(_) => Self::Loss(number),
            Self::Mass(_) => Self::Mass(number),
        }
    }
}

/// A point on a load's path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Waypoint {
    /// Time at this point.
    pub at: Duration,
    /// Position of the load's centre, mm.
    pub centre_mm: [f64; 2],
    /// Size of the load.
    pub amount: Amount,
}

/// Distribution of the force under a load (fact sheet, section 2.4).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Contact {
    /// Uniform, for foam that is thinner than the load is wide (Winkler).
    #[default]
    Even,
    /// As under a rigid flat disc on thick foam: F / (2 pi a²) (1 - r² / a²)^(-1/2).
    Punch,
    /// As under a rigid sphere on thick foam (Hertz): p_0 (1 - r² / a²)^(1/2), a³ = 3 F R / (4 E).
    Sphere {
        /// Radius of the sphere, mm.
        radius_mm: f64,
    },
}

impl Contact {
    /// Share of the force within a share of the contact's radius, 0 to 1.
    pub(crate) fn within(self, radius: f64) -> f64 {
        let rest = 1.0 - radius * radius;
        match self {
            Self::Even => radius * radius,
            Self::Punch => 1.0 - rest.sqrt(),
            Self::Sphere { .. } => 1.0 - rest * rest.sqrt(),
        }
    }
}

/// Hertz radius of the contact, mm, of a sphere (radius in mm) under a mass (g) on foam of a modulus (kPa).
pub(crate) fn hertz_radius_mm(radius_mm: f64, mass_g: f64, modulus_kpa: f64) -> f64 {
    let force = mass_g * 1e-3 * GRAVITY;
    1e3 * (0.75 * force * radius_mm * 1e-3 / (modulus_kpa * 1e3)).cbrt()
}

/// A load on the time line.
#[derive(Debug, Clone, PartialEq)]
pub struct TimedLoad {
    /// The load at its start.
    pub load: Load,
    /// Start.
    pub from: Duration,
    /// End, excluded; `None` for never.
    pub to: Option<Duration>,
    /// Repetition; each time is like the first. `None` if there is only one.
    pub repeat: Option<Repeat>,
    /// The size at its start.
    pub amount: Amount,
    /// Later positions and sizes, in order of time; empty for a constant load.
    pub path: Vec<Waypoint>,
    /// Distribution of its force.
    pub contact: Contact,
}

/// Step of a load's path: index of the last waypoint, and number of the step since that waypoint.
pub(crate) type Stage = [u32; 2];

/// The triangles covered by a load, with the share of conductance that each loses.
pub(crate) type Print = Vec<(usize, f64)>;

impl TimedLoad {
    /// A constant load from one time to another, or without an end.
    pub fn still(load: Load, from: Duration, to: Option<Duration>) -> Self {
        Self {
            amount: Amount::Loss(load.loss),
            load,
            from,
            to,
            repeat: None,
            path: Vec::new(),
            contact: Contact::Even,
        }
    }

    /// The time of its last removal; `None` if it is never removed.
    pub fn end(&self) -> Option<Duration> {
        let last = self.repeat.map_or(0, |repeat| repeat.times() - 1);
        Some(self.to?.saturating_add(self.delay(last)))
    }

    /// Whether the load is on the sheet.
    pub fn is_on(&self, at: Duration) -> bool {
        let (_, at) = self.in_first(at);
        self.is_on_first(at)
    }

    /// Whether it is on the sheet at a time of the first repetition.
    fn is_on_first(&self, at: Duration) -> bool {
        at >= self.from && self.to.is_none_or(|to| at < to)
    }

    /// Delay of a repetition relative to the first.
    fn delay(&self, number: u32) -> Duration {
        let repeat = self.repeat;
        repeat.map_or(Duration::ZERO, |repeat| repeat.delay(number))
    }

    /// The number of the repetition at a time, from 0, and the corresponding time of the first repetition.
    fn in_first(&self, at: Duration) -> (u32, Duration) {
        let since = at.saturating_sub(self.from);
        let number = self.repeat.map_or(0, |repeat| repeat.number(since));
        (number, at.saturating_sub(self.delay(number)))
    }

    /// The waypoint with this index; 0 is the start.
    fn waypoint(&self, number: usize) -> Waypoint {
        match number.checked_sub(1) {
            Some(index) => self.path[index],
            None => Waypoint {
                at: self.from,
                centre_mm: self.load.centre_mm,
                amount: self.amount,
            },
        }
    }

    /// The index of the last waypoint passed.
    fn behind(&self, at: Duration) -> usize {
        self.path.partition_point(|waypoint| waypoint.at <= at)
    }

    /// Number of steps from a waypoint to the next; 0 if nothing changes, or if it is the last.
    fn steps(&self, behind: usize) -> u32 {
        if behind == self.path.len() {
            return 0;
        }
        let [from, to] = [behind, behind + 1].map(|number| self.waypoint(number));
        let [x, y] = [0, 1].map(|axis| to.centre_mm[axis] - from.centre_mm[axis]);
        let [before, after] = [from, to].map(|waypoint| waypoint.amount.number());
        let largest = before.abs().max(after.abs());
        let changes = if largest > 0.0 {
            (after - before).abs() / (STEP_SHARE * largest)
        } else {
            0.0
        };
        (x.hypot(y) / STEP_MM).max(changes).ceil() as u32
    }

    /// The step at a time; `None` while the load is not on the sheet.
    pub(crate) fn stage(&self, at: Duration) -> Option<Stage> {
        let (_, at) = self.in_first(at);
        if !self.is_on_first(at) {
            return None;
        }
        let behind = self.behind(at);
        let steps = self.steps(behind);
        let step = if steps == 0 {
            0
        } else {
            let [from, to] = [behind, behind + 1].map(|number| self.waypoint(number).at);
            let share = (at - from).as_secs_f64() / (to - from).as_secs_f64();
            ((share * f64::from(steps)) as u32).min(steps - 1)
        };
        Some([behind as u32, step])
    }

    /// The next time after this one at which the load is placed, begins a step, or is removed.
    pub(crate) fn next_change(&self, after: Duration) -> Option<Duration> {
        let (number, first) = self.in_first(after);
        match (self.next_change_of_first(first), self.repeat) {
            (Some(change), _) => Some(change.saturating_add(self.delay(number))),
            (None, Some(repeat)) if number + 1 < repeat.times() => {
                Some(self.from.saturating_add(repeat.delay(number + 1)))
            }
            (None, _) => None,
        }
    }

    /// As [`TimedLoad::next_change`], for the first repetition.
    fn next_change_of_first(&self, after: Duration) -> Option<Duration> {
        if after < self.from {
            return Some(self.from);
        }
        if !self.is_on_first(after) {
            return None;
        }
        let stage = self.stage(after)?;
        let behind = stage[0] as usize;
        let next = (behind < self.path.len()).then(|| {
            let [from, to] = [behind, behind + 1].map(|number| self.waypoint(number).at);
            let steps = self.steps(behind);
            // a time that rounding puts before its step is skipped
            (stage[1] + 1..steps)
                .map(|step| {
                    from + survey::duration(
                        f64::from(step) / f64::from(steps) * (to - from).as_secs_f64(),
                    )
                })
                .find(|moment| *moment > after)
                .unwrap_or(to)
        });
        match (next, self.to) {
            (Some(next), Some(to)) => Some(next.min(to)),
            (next, to) => next.or(to),
        }
    }

    /// The load at a time, with the number of the repetition in its name; `None` while it is not on the sheet.
    pub(crate) fn at(&self, at: Duration, law: &Law) -> Option<Load> {
        let mut load = self.momentary(self.stage(at)?, law);
        if self.repeat.is_some() {
            let (number, _) = self.in_first(at);
            load.name = format!("{} {}", load.name, number + 1);
        }
        Some(load)
    }

    /// Position and size in the middle of a step.
    fn middle(&self, [behind, step]: Stage) -> Waypoint {
        let here = self.waypoint(behind as usize);
        let steps = self.steps(behind as usize);
        if steps == 0 {
            return here;
        }
        let next = self.waypoint(behind as usize + 1);
        let share = (f64::from(step) + 0.5) / f64::from(steps);
        let between = |from: f64, to: f64| from + share * (to - from);
        Waypoint {
            at: here.at,
            centre_mm: [0, 1].map(|axis| between(here.centre_mm[axis], next.centre_mm[axis])),
            amount: here
                .amount
                .with(between(here.amount.number(), next.amount.number())),
        }
    }

    /// The load during a step, with the loss of its mean pressure.
    pub(crate) fn momentary(&self, stage: Stage, law: &Law) -> Load {
        let now = self.middle(stage);
        let mut load = Load {
            centre_mm: now.centre_mm,
            ..self.load.clone()
        };
        match now.amount {
            Amount::Loss(loss) => load.loss = loss,
            Amount::Mass(mass_g) => {
                if let Contact::Sphere { radius_mm } = self.contact {
                    let modulus = law.pressure.modulus_kpa;
                    let diameter_mm = 2.0 * hertz_radius_mm(radius_mm, mass_g, modulus);
                    load.shape = Shape::Disc { diameter_mm };
                }
                load.loss = match mass_g {
                    0.0 => 0.0,
                    _ => law.loss(pressure_kpa(mass_g, load.shape.area())),
                };
            }
        }
        load
    }

    /// The load at its start.
    pub(crate) fn momentary_start(&self, law: &Law) -> Load {
        let start = Self {
            path: Vec::new(),
            ..self.clone()
        };
        start.momentary([0, 0], law)
    }

    /// The loss of each triangle during a step; empty if the load is outside the sheet or its force is zero.
    ///
    /// # Errors
    /// An invalid load.
    pub(crate) fn print(&self, stage: Stage, law: &Law, mesh: &Mesh) -> Result<Print, LoadError> {
        let load = self.momentary(stage, law);
        let covered = |load: &Load| match load.covered(mesh) {
            Err(LoadError::Beside { .. }) if !self.path.is_empty() => Ok(Vec::new()),
            covered => covered,
        };
        let (mass_g, diameter_mm) = match (self.contact, self.middle(stage).amount, &load.shape) {
            (Contact::Even, ..) | (_, Amount::Loss(_), _) => {
                let covered = covered(&load)?.into_iter();
                return Ok(covered.map(|(t, share)| (t, load.loss * share)).collect());
            }
            (_, Amount::Mass(mass_g), Shape::Disc { diameter_mm }) => (mass_g, *diameter_mm),
            // scenes refuse other shapes
            _ => return Ok(Vec::new()),
        };
        if mass_g == 0.0 {
            return Ok(Vec::new());
        }
        let mut lost = vec![0.0; mesh.triangles().len()];
        let mut last = vec![0.0; mesh.triangles().len()];
        for (share, kpa) in rings(self.contact, mass_g, diameter_mm) {
            let inner = Load {
                shape: Shape::Disc {
                    diameter_mm: share * diameter_mm,
                },
                ..load.clone()
            };
            let loss = law.loss(kpa);
            for (t, covered) in covered(&inner)? {
                lost[t] += loss * (covered - last[t]);
                last[t] = covered;
            }
        }
        let print = lost.into_iter().enumerate();
        Ok(print.filter(|(_, lost)| *lost != 0.0).collect())
    }
}

/// Outer radius (as a share of the contact's radius) and mean pressure (kPa) of each ring, from the centre outwards.
fn rings(contact: Contact, mass_g: f64, diameter_mm: f64) -> Vec<(f64, f64)> {
    let area = PI * (0.5e-3 * diameter_mm).powi(2);
    (1..=RINGS)
        .map(|ring| {
            let [inner, outer] = [ring - 1, ring].map(|ring| f64::from(ring) / f64::from(RINGS));
            let force = contact.within(outer) - contact.within(inner);
            let share = outer * outer - inner * inner;
            (outer, pressure_kpa(mass_g, area) * force / share)
        })
        .collect()
}
