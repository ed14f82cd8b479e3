//! Assigns replies to readings, and invalidates readings taken in compliance.

use survey::{Dipole, Extra, Measurement, Reading, Step};
use tokio::time::Instant;

use super::Run;
use crate::{Compliance, RigError};

impl Run<'_> {
    /// Stores the readings of a step; in the second polarity as half the difference of the two.
    ///
    /// # Errors
    /// [`RigError::ReadingCount`] if the number of readings is not that of the step.
    pub(super) fn take(&mut self, step: &Step, came: Vec<Reading>) -> Result<(), RigError> {
        let counted = |expected: usize| match came.len() {
            came if came == expected => Ok(()),
            came => Err(RigError::ReadingCount { came, expected }),
        };
        match step {
            Step::Scan { channels } => {
                counted(channels.len())?;
                for (channel, reading) in channels.iter().zip(came) {
                    match (channel.reading, self.driven.now) {
                        (Some(index), _) => self.store(index, reading),
                        (None, Some(drive)) => self.store_extra(drive, channel.sense, reading),
                        (None, None) => {}
                    }
                }
            }
            Step::Chain { routes } => {
                counted(routes.len())?;
                for (route, reading) in routes.iter().zip(came) {
                    self.store(route.reading, reading);
                }
            }
            Step::Read { reading, .. } => {
                counted(1)?;
                self.store(*reading, came[0]);
            }
            _ => {}
        }
        if let Some((_, _, last)) = &mut self.driven.unreported {
            *last = Instant::now();
        }
        // A reply of the mainframe arrives when its relays have moved.
        self.driven.settled = true;
        Ok(())
    }

    fn store(&mut self, index: usize, reading: Reading) {
        let place = &mut self.readings[index];
        *place = match self.driven.reversed {
            true => half_difference(*place, reading),
            false => reading,
        };
    }

    fn store_extra(&mut self, drive: Dipole, sense: Dipole, reading: Reading) {
        let measurement = Measurement { drive, sense };
        if !self.driven.reversed {
            self.extra.push(Extra {
                measurement,
                reading,
            });
            return;
        }
        let forward = self
            .extra
            .iter_mut()
            .find(|one| one.measurement == measurement);
        if let Some(forward) = forward {
            forward.reading = half_difference(forward.reading, reading);
        }
    }

    /// Invalidates the injections at which the source was in compliance: the present one, and the previous one if it
    /// was applied after the last query. Only if the source is in compliance now and the relays are known to have moved
    /// (`moved`) is the previous injection not affected.
    pub(super) fn invalidate_by_compliance(&mut self, compliance: Compliance, moved: bool) {
        self.driven.compliance |= compliance.occurred();
        let here = self.driven.now.filter(|_| compliance.occurred());
        let unqueried = self.driven.unqueried.take();
        let before = unqueried.filter(|_| compliance.occurred() && !(moved && compliance.now));
        for drive in here.into_iter().chain(before) {
            if !self.compliance.contains(&drive.plus) {
                self.compliance.push(drive.plus);
            }
            let measurements = self.plan.protocol.measurements().iter();
            for (measurement, reading) in measurements.zip(&mut self.readings) {
                if measurement.drive == drive {
                    *reading = Reading::NotMeasured;
                }
            }
            for extra in &mut self.extra {
                if extra.measurement.drive == drive {
                    extra.reading = Reading::NotMeasured;
                }
            }
        }
    }
}

/// Half the difference of the two polarities: cancels what does not change sign with the current.
fn half_difference(forward: Reading, backward: Reading) -> Reading {
    match (forward, backward) {
        (Reading::Ok(forward), Reading::Ok(backward)) => Reading::Ok((forward - backward) * 0.5),
        (Reading::Ok(_), lacking) => lacking,
        (lacking, _) => lacking,
    }
}
