//! Position and velocity of a load after every injection, while the frame is still being measured.

use std::fmt;

use drift::{Disc, DriftError, INJECTIONS, Injection, MovingLoad};
use serde::{Deserialize, Serialize};
use survey::Dipole;

use super::Tracking;
use super::tracked::{MOST_PLACE_SD_M, REGION_95, principal_axes};

/// Longest pause between two injections of one path, s.
const PAUSE_S: f64 = 2.0;

/// The last injections, oldest first, to which one path of a load is fitted.
#[derive(Debug, Default)]
pub struct InjectionWindow {
    injections: Vec<Injection>,
    ended_s: f64,
}

impl InjectionWindow {
    /// Adds an injection of duration `lasted_s`, s. Its time is that of its middle, by a monotonic clock.
    pub fn push(&mut self, injection: Injection, lasted_s: f64) {
        let began_s = injection.at_s - 0.5 * lasted_s;
        if began_s - self.ended_s > PAUSE_S {
            self.clear();
        }
        if self.injections.len() == *INJECTIONS.end() {
            self.injections.remove(0);
        }
        self.ended_s = injection.at_s + 0.5 * lasted_s;
        self.injections.push(injection);
    }

    /// Discards all injections, if their readings cannot be relied on.
    pub fn clear(&mut self) {
        self.injections.clear();
    }
}

/// Result after an injection.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AfterInjection {
    /// The electrodes between which the current flowed, counted from 1.
    pub electrodes: [usize; 2],
    /// Number of injections used.
    pub injections: usize,
    /// Whether the result can be relied on.
    pub known: bool,
    /// Why the result cannot be relied on, and what to do about it; `None` if it can.
    pub text: Option<String>,
    /// The load; `None` if the readings agree with an empty sheet, or show nothing because too few are left.
    pub load: Option<MovingPlace>,
}

/// Position and movement of a load.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MovingPlace {
    /// Centre at the middle of the injection, mm.
    pub centre_mm: [f64; 2],
    /// Half axes of the 95 % ellipse of the centre, mm, the longer first.
    pub half_axes_mm: [f64; 2],
    /// Angle of the longer half axis from the x axis, degrees, counter-clockwise.
    pub angle_deg: f64,
    /// Velocity, mm/s.
    pub velocity_mm_s: [f64; 2],
    /// Diameter, mm.
    pub diameter_mm: f64,
    /// Share of the conductance lost; negative for a gain.
    pub loss: f64,
}

impl MovingPlace {
    fn new(load: &MovingLoad) -> Self {
        let (deviations, angle_deg) = principal_axes(load.covariance);
        Self {
            centre_mm: load.disc.centre.map(|metres| 1e3 * metres),
            half_axes_mm: deviations.map(|metres| 1e3 * REGION_95 * metres),
            angle_deg,
            velocity_mm_s: load.velocity.map(|metres| 1e3 * metres),
            diameter_mm: 1e3 * load.disc.diameter,
            loss: load.disc.loss,
        }
    }

    /// Speed, mm/s.
    pub fn speed_mm_s(&self) -> f64 {
        self.velocity_mm_s[0].hypot(self.velocity_mm_s[1])
    }
}

impl Tracking {
    /// The result after the last injection, at `at_s` (s, on the clock of the frames), and the disc of the load. The
    /// tracked baseline is not updated; the complete frame does that.
    ///
    /// # Errors
    /// A covariance that cannot be factored, or a reading that the protocol does not have.
    pub fn after_injection(
        &self,
        window: &InjectionWindow,
        drive: Dipole,
        at_s: f64,
    ) -> Result<(AfterInjection, Option<Disc>), DriftError> {
        let injections = &window.injections;
        let (load, few_readings) = match self.tracker.moving_load(injections, at_s) {
            Ok(load) => (load, false),
            Err(DriftError::FewReadings { .. }) => (None, true),
            Err(other) => return Err(other),
        };
        let text = self.doubt(injections.len(), few_readings, load.as_ref());
        let after = AfterInjection {
            electrodes: [drive.plus.number(), drive.minus.number()],
            injections: load
                .as_ref()
                .map_or(injections.len(), |load| load.injections),
            known: text.is_none(),
            text,
            load: load.as_ref().map(MovingPlace::new),
        };
        Ok((after, load.map(|load| load.disc)))
    }

    fn doubt(
        &self,
        injections: usize,
        few_readings: bool,
        load: Option<&MovingLoad>,
    ) -> Option<String> {
        if self.tracker.is_blind() {
            return Some("too many electrodes are faulty; repair their contacts".to_owned());
        }
        let fewest = *INJECTIONS.start();
        if injections < fewest {
            return Some(format!(
                "{injections} injections since the last pause; {fewest} are needed"
            ));
        }
        if few_readings {
            return Some(
                "fewer than half of the readings of the last injections are left: readings are missing or nearly 0 V; \
                 wait for the next injections"
                    .to_owned(),
            );
        }
        let load = load?;
        if !load.accepted {
            return Some(
                "one load on a straight path does not explain the readings: it was placed, changed direction or was \
                 removed within the last injections, or there are several loads; wait for the next injections or the \
                 map of the frame"
                    .to_owned(),
            );
        }
        let ([sd_m, _], _) = principal_axes(load.covariance);
        (sd_m > MOST_PLACE_SD_M).then(|| {
            let sd_mm = 1e3 * sd_m;
            format!("the position is uncertain by {sd_mm:.1} mm; wait for the next injections")
        })
    }
}

impl fmt::Display for AfterInjection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.load {
            None if self.known => write!(f, "the sheet is empty")?,
            None => write!(f, "no load was found")?,
            Some(load) => {
                let ([x, y], [half, _]) = (load.centre_mm, load.half_axes_mm);
                match self.known {
                    true => write!(
                        f,
                        "a load at ({x:.1}, {y:.1}) mm within {half:.1} mm (95 %)"
                    )?,
                    false => write!(f, "a load near ({x:.0}, {y:.0}) mm")?,
                }
                write!(f, ", {:.1} mm/s", load.speed_mm_s())?;
            }
        }
        match &self.text {
            Some(text) => write!(f, "; not known: {text}"),
            None => Ok(()),
        }
    }
}
