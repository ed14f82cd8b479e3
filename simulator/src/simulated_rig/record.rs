//! Recording of all messages and replies to a file.

use std::time::Duration;

use rig::transcript::{Entry, EntryContent, TranscriptWriter};

use crate::instrument::Instrument;
use crate::simulated_instruments::SimulatedInstruments;
use crate::simulated_rig::SimulatedRig;

impl SimulatedRig {
    /// Starts recording to a file. A full disk ends the recording with a warning.
    pub fn record(&self, writer: TranscriptWriter) {
        self.instruments().recorder = Some(writer);
    }

    pub(super) fn record_line(
        &self,
        instruments: &mut SimulatedInstruments,
        instrument: Instrument,
        session: u32,
        at: Duration,
        content: EntryContent,
    ) {
        let Some(recorder) = &mut instruments.recorder else {
            return;
        };
        let clients = self.clients();
        let from = clients.get(&session).map_or("", |(_, address)| address);
        let entry = Entry {
            t_s: at.as_secs_f64(),
            instrument: format!("{} for {from}", instrument.name()),
            content,
        };
        if let Err(fault) = recorder.write(&entry) {
            tracing::warn!("recording ends: {fault}");
            instruments.recorder = None;
        }
    }
}
