//! Selecting a baseline, and remarks on it.

use std::sync::Arc;

use dbus::Fault;
use imaging::tracking::{KeptTracking, TrackingOrder, kept};
use survey::Baseline;

use crate::events::event::BusEvent;
use crate::panics::containment;
use crate::session::controller::Controller;

impl Controller {
    /// Makes an earlier baseline the current one; returns its id.
    ///
    /// # Errors
    /// There is no such baseline, it was measured with other settings than a session would use now, or the daemon plays
    /// a recording.
    pub(crate) fn use_baseline(&self, id: &str) -> Result<String, Fault> {
        if self.is_recording() {
            return Err(Fault::Unsupported(
                "a recording has its own baseline; [recording] names it".into(),
            ));
        }
        let chosen = self.chosen_baseline(Some(id))?;
        self.check_baseline(&chosen, self.runtime().settings.as_ref(), None)?;
        let id = chosen.id.clone();
        self.inner().baseline = Some(chosen);
        self.events.publish(&BusEvent::Daemon);
        Ok(id)
    }

    /// Remarks for the operator before the baseline is used, one sentence each: noise that contradicts the
    /// configuration, a load on the sheet. The search for a load is made once for each baseline.
    pub(crate) async fn baseline_remarks(
        self: &Arc<Self>,
        baseline: &Arc<Baseline>,
    ) -> Vec<String> {
        if self.is_recording() {
            return Vec::new();
        }
        let mut remarks: Vec<String> = self.noise_contradiction(baseline).into_iter().collect();
        let mut kept = Arc::clone(&self.remarked).lock_owned().await;
        if let Some(found) = kept.get(&baseline.id) {
            remarks.extend(found.iter().cloned());
            return remarks;
        }
        let (controller, baseline) = (Arc::clone(self), Arc::clone(baseline));
        // one search at a time; the result is kept even if its caller has disconnected
        let found = containment::blocking(move || {
            let found = controller.remarks_on(&baseline);
            kept.insert(baseline.id.clone(), found.clone());
            found
        });
        remarks.extend(found.await.into_iter().flatten());
        remarks
    }

    /// The remarks on the current baseline, without those on its noise. `None` if they are not known yet; then they are
    /// computed for a later call.
    pub(crate) fn known_remarks(self: &Arc<Self>) -> Option<Vec<String>> {
        let baseline = self.baseline().filter(|_| !self.is_recording())?;
        // locked while the remarks are computed
        let found = self.remarked.try_lock().ok()?.get(&baseline.id).cloned();
        if found.is_some() {
            return found;
        }
        let controller = Arc::clone(self);
        tokio::spawn(async move { controller.baseline_remarks(&baseline).await });
        None
    }

    /// Gives an order to the tracked baseline of the running session; returns the number of the first frame to which it
    /// applies.
    ///
    /// # Errors
    /// There is no running session, it does not track its baseline, or the order is unknown.
    pub(crate) async fn override_tracking(&self, order: &str, by: String) -> Result<u64, Fault> {
        let Some(order) = TrackingOrder::named(order) else {
            return Err(Fault::InvalidOption(format!(
                "order: '{}' is none of {}",
                survey::printable(order),
                TrackingOrder::ALL.map(TrackingOrder::name).join(", ")
            )));
        };
        let session = self.active().ok_or_else(|| {
            Fault::NoSession(
                "no session is running: there is no tracked baseline to overrule; `tactus start` starts a session".into(),
            )
        })?;
        session.order_tracking(order, by).await
    }

    /// The last stored summary of the tracking of a baseline, as JSON; `None` if there is none.
    pub(crate) async fn baseline_tracking(&self, baseline: &Baseline) -> Option<String> {
        let folder = self.runtime().setup.record_directory.clone();
        let id = baseline.id.clone();
        let read = move || {
            let kept: KeptTracking = kept(&folder, &id).ok().flatten()?;
            Some(serde_json::json!(kept.summary()?).to_string())
        };
        containment::blocking(read).await.ok().flatten()
    }

    fn remarks_on(&self, baseline: &Baseline) -> Vec<String> {
        let setup = &self.runtime().setup;
        if baseline.settings.protocol_hash != setup.model.reconstructor.protocol().hash() {
            return Vec::new();
        }
        let before = self
            .records
            .baseline_before(baseline)
            .unwrap_or_else(|error| {
                tracing::debug!("the previous baseline cannot be read: {error}");
                None
            });
        imaging::baseline_remarks(&setup.model, &setup.geometry, baseline, before.as_ref())
    }
}
