//! After a fault of the rig: looked for until it is back, and then verified off before anybody measures.

use std::sync::Arc;
use std::time::Duration;

use super::Keeper;
use crate::herald::Notice;
use crate::model::chain;
use crate::rig_assembly::assemble;
use crate::session::Event;
use crate::watch::FrameSource;

/// A lost rig is looked for again after so long, and then ever less often up to the second value.
const LOOK_AGAIN: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(10));

impl Keeper {
    /// After a fault of the rig: until every instrument is back and verified off, or a session has found it first.
    pub(super) async fn look_for_rig(self: Arc<Self>) {
        let mut pause = LOOK_AGAIN.0;
        loop {
            tokio::time::sleep(pause).await;
            if self.rig_fault().is_none() {
                return;
            }
            if self.state().is_busy() {
                continue;
            }
            match self.find_rig_again().await {
                Ok(()) => {
                    let _ = self.happened(Event::Recovered);
                    return;
                }
                Err(text) => tracing::warn!("{text}"),
            }
            pause = (pause * 2).min(LOOK_AGAIN.1);
        }
    }

    /// Puts the rig together anew; it is verified off afterwards.
    pub(super) async fn find_rig_again(&self) -> Result<(), String> {
        let mut source = self.source.lock().await;
        let FrameSource::Rig { rig, plan } = &mut *source else {
            return Ok(());
        };
        if rig.is_none() {
            let assembled = assemble(plan, &self.house.bench)
                .await
                .map_err(|error| chain(&error))?;
            tracing::info!("the rig is back; its source is off and verified");
            *rig = Some(assembled.rig);
        }
        self.inner().rig_fault = None;
        self.herald.say(&Notice::Instruments);
        Ok(())
    }
}
