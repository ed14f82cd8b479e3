//! The D-Bus interface of one instrument of the rig.

use std::sync::Arc;

use dbus::ROOT_PATH;
use zbus::{ObjectPath, interface};

use crate::instruments::identities::Connected;
use crate::session::controller::Controller;

/// The object of one instrument.
pub(crate) struct Instrument1 {
    controller: Arc<Controller>,
    role: &'static str,
}

impl Instrument1 {
    pub(crate) fn new(controller: Arc<Controller>, role: &'static str) -> Self {
        Self { controller, role }
    }

    pub(crate) fn path(&self) -> ObjectPath<'static> {
        path(self.role)
    }

    /// The instrument with this role; `None` if a reload has removed it.
    fn found(&self) -> Option<Connected> {
        let identities = self.controller.identities();
        identities
            .instruments
            .into_iter()
            .find(|found| found.role == self.role)
    }
}

/// The object path of the instrument with this role, in which `+` is replaced by `_`.
pub(crate) fn path(role: &str) -> ObjectPath<'static> {
    dbus::instrument_path(&role.replace('+', "_"))
        .unwrap_or_else(|_| ObjectPath::from_static_str_unchecked(ROOT_PATH))
}

/// One instrument of the rig.
#[interface(name = "org.tactus.Tactus1.Instrument1")]
impl Instrument1 {
    /// `source`, `switch`, `voltmeter`, or two of them joined by `+`.
    #[zbus(property(emits_changed_signal = "const"))]
    fn role(&self) -> &str {
        self.role
    }

    /// The reply to `*IDN?` of the expected instrument: found at the start, or accepted by the operator since.
    #[zbus(property)]
    fn identity(&self) -> String {
        self.found().map(|found| found.identity).unwrap_or_default()
    }

    /// The address: `tcp:HOST:PORT`, `serial:PATH`, or `memory` for an instrument simulated inside the daemon.
    #[zbus(property)]
    fn address(&self) -> String {
        self.found().map(|found| found.address).unwrap_or_default()
    }

    /// Whether it is simulated.
    #[zbus(property)]
    fn simulated(&self) -> bool {
        self.found().is_some_and(|found| found.simulated)
    }

    /// `ready` or `fault: ...`.
    #[zbus(property)]
    fn state(&self) -> String {
        match self.controller.rig_fault() {
            None => "ready".to_owned(),
            Some(why) => format!("fault: {why}"),
        }
    }
}
