//! Quantities of the maps of a session, in the thread of its maps. One row for each minute is stored beside the session.

use std::path::PathBuf;

use imaging::Model;
use imaging::quantities::{
    FrameQuantities, JudgedMap, Quantifier, QuantityRow, QuantitySettings, RegionSettings, Rows,
    STORED_S, store,
};
use survey::error_chain as chain;

use super::{Failure, Mapped};

/// What is needed for the quantities of a session.
pub(crate) struct QuantityContext {
    pub settings: QuantitySettings,
    pub regions: Vec<RegionSettings>,
    /// Folder of the sessions.
    pub folder: PathBuf,
    /// The session, without its part.
    pub session: String,
}

/// Computes the quantities of frame after frame.
pub(super) struct Quantified {
    quantifier: Quantifier,
    rows: Rows,
    folder: PathBuf,
    session: String,
    /// Whether rows could not be stored, which is reported once.
    failed: bool,
}

impl Quantified {
    /// # Errors
    /// A region that lies beside the maps of the session's model.
    pub(super) fn new(context: QuantityContext, model: &Model) -> Result<Self, String> {
        let quantifier = Quantifier::new(model, &context.settings, &context.regions);
        Ok(Self {
            quantifier: quantifier.map_err(|error| chain(&error))?,
            rows: Rows::new(STORED_S),
            folder: context.folder,
            session: context.session,
            failed: false,
        })
    }

    /// The quantities of the next frame for which a map was wanted.
    pub(super) fn take(
        &mut self,
        at_s: f64,
        outcome: &Result<Mapped, Failure>,
        remarks: &mut Vec<String>,
    ) -> FrameQuantities {
        let found = match outcome {
            Ok(mapped) => {
                let judged = JudgedMap {
                    map: &mapped.map,
                    pressure: mapped.pressure.as_ref(),
                    noise: mapped.noise,
                    tracked: mapped.tracked.as_ref(),
                    compared: None,
                };
                self.quantifier.take(at_s, Some(&judged))
            }
            Err(Failure::Refused(why) | Failure::Broken(why)) => FrameQuantities {
                reason: Some(why.clone()),
                ..self.quantifier.take(at_s, None)
            },
        };
        let ended = self.rows.take(at_s, &found);
        self.store(&ended, remarks);
        found
    }

    /// Stores the rows of the last minute.
    pub(super) fn finish(mut self) {
        let ended = self.rows.end();
        self.store(&ended, &mut Vec::new());
    }

    fn store(&mut self, rows: &[QuantityRow], remarks: &mut Vec<String>) {
        let Err(error) = store(&self.folder, &self.session, rows) else {
            return;
        };
        if !std::mem::replace(&mut self.failed, true) {
            remarks.push(format!(
                "quantities cannot be stored with the session; `tactus quantities --recompute` computes them from the frames: {}",
                chain(&error)
            ));
        }
    }
}
