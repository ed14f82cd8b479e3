//! A method whose parameters are chosen from the first frames of a live measurement.

use std::sync::{Arc, Mutex, PoisonError};

use eit::{Mesh, Novelty, ReconstructError, Reconstructor, Scale};
use survey::{Amps, Map, Protocol, Reading, error_chain};

use crate::conditions::{Conditions, Sample};
use crate::error::BuildError;
use crate::geometry::Geometry;
use crate::settings::{Method, ReconstructionSettings};

/// Number of frames from which such a method chooses its parameters: the first that are to be mapped.
pub const FRAMES_LOOKED_AT: usize = 8;

/// Inputs for building the reconstructor once the frames are available.
struct Plan {
    settings: ReconstructionSettings,
    geometry: Geometry,
    protocol: Protocol,
    current: Amps,
    noise_v: Option<f64>,
    scale: Scale,
    method: String,
    /// Built without frames: gives the properties that stay the same, and detects errors early.
    provisional: Arc<dyn Reconstructor>,
}

enum State {
    Waits(Vec<Vec<Reading>>),
    Settled {
        reconstructor: Arc<dyn Reconstructor>,
        /// The decision, until it is read.
        decided: Option<String>,
    },
    Refused(String),
}

/// A reconstructor that refuses frames until it has enough of them, then maps the last of these and all later ones.
pub(crate) struct AfterFrames {
    plan: Arc<Plan>,
    state: Mutex<State>,
}

impl AfterFrames {
    /// # Errors
    /// As for [`build`](crate::build).
    pub(crate) fn new(
        settings: &ReconstructionSettings,
        conditions: &Conditions<'_>,
    ) -> Result<Self, BuildError> {
        // preparing shapes takes a second; the general method is enough to detect errors
        let best = settings.method == Some(Method::Best);
        let early = ReconstructionSettings {
            method: match best {
                true => Some(Method::OneStep),
                false => settings.method,
            },
            ..settings.clone()
        };
        let provisional = super::prepare(&early, conditions)?.reconstructor;
        let plan = Plan {
            settings: settings.clone(),
            geometry: conditions.geometry.clone(),
            protocol: conditions.protocol.clone(),
            current: conditions.current,
            noise_v: conditions.noise_v,
            scale: conditions.scale.clone(),
            method: match best {
                true => Method::Best.name().to_owned(),
                false => provisional.method().to_owned(),
            },
            provisional,
        };
        Ok(Self::of(Arc::new(plan)))
    }

    fn of(plan: Arc<Plan>) -> Self {
        Self {
            plan,
            state: Mutex::new(State::Waits(Vec::new())),
        }
    }

    /// The same before any frame.
    pub(crate) fn fresh(&self) -> Self {
        Self::of(Arc::clone(&self.plan))
    }

    /// The decision; `None` on later calls.
    pub(crate) fn decided(&self) -> Option<String> {
        match &mut *self.state.lock().unwrap_or_else(PoisonError::into_inner) {
            State::Settled { decided, .. } => decided.take(),
            State::Waits(_) | State::Refused(_) => None,
        }
    }

    /// Whether its maps can be by this method.
    pub(crate) fn may_make(&self, method: &str) -> bool {
        self.plan.settings.method == Some(Method::Best) || self.plan.method == method
    }

    /// The reconstructor for this frame.
    fn settled(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Arc<dyn Reconstructor>, ReconstructError> {
        let plan = &self.plan;
        let refused = |cause: String| ReconstructError::Numerical {
            method: plan.method.clone(),
            cause,
        };
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let seen = match &mut *state {
            State::Settled { reconstructor, .. } => return Ok(Arc::clone(reconstructor)),
            State::Refused(why) => return Err(refused(why.clone())),
            State::Waits(seen) => seen,
        };
        seen.push(frame.to_vec());
        if seen.len() < FRAMES_LOOKED_AT {
            return Err(ReconstructError::FramesAwaited {
                method: plan.method.clone(),
                has: seen.len(),
                wants: FRAMES_LOOKED_AT,
            });
        }
        let sample = Sample {
            baseline: baseline.to_vec(),
            frames: std::mem::take(seen),
        };
        let conditions = Conditions {
            noise_v: plan.noise_v,
            scale: plan.scale.clone(),
            sample: Some(&sample),
            ..Conditions::live(&plan.geometry, &plan.protocol, plan.current)
        };
        match super::prepare(&plan.settings, &conditions) {
            Ok(prepared) => {
                *state = State::Settled {
                    reconstructor: Arc::clone(&prepared.reconstructor),
                    decided: Some(prepared.notes.join("; ")),
                };
                Ok(prepared.reconstructor)
            }
            Err(error) => {
                let why = error_chain(&error);
                *state = State::Refused(why.clone());
                Err(refused(why))
            }
        }
    }

    /// The current reconstructor, which may be provisional.
    fn present(&self) -> Arc<dyn Reconstructor> {
        match &*self.state.lock().unwrap_or_else(PoisonError::into_inner) {
            State::Settled { reconstructor, .. } => Arc::clone(reconstructor),
            State::Waits(_) | State::Refused(_) => Arc::clone(&self.plan.provisional),
        }
    }
}

impl Reconstructor for AfterFrames {
    fn method(&self) -> &str {
        &self.plan.method
    }

    fn protocol(&self) -> &Protocol {
        &self.plan.protocol
    }

    fn mesh(&self) -> &Arc<Mesh> {
        &self.plan.geometry.mesh
    }

    fn reconstruct(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Map, ReconstructError> {
        self.settled(baseline, frame)?.reconstruct(baseline, frame)
    }

    fn assumptions(&self) -> Vec<String> {
        self.present().assumptions()
    }

    fn noise_figure(&self) -> Option<f64> {
        self.present().noise_figure()
    }

    fn novelty(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Option<Novelty>, ReconstructError> {
        self.present().novelty(baseline, frame)
    }
}
