//! One instrument of the rig.

use std::sync::Arc;

use bus::ROOT_PATH;
use zbus::{ObjectPath, interface};

use crate::keeper::Keeper;

/// The object of one instrument.
pub(super) struct Instrument1 {
    keeper: Arc<Keeper>,
    index: usize,
}

impl Instrument1 {
    pub(super) fn new(keeper: Arc<Keeper>, index: usize) -> Self {
        Self { keeper, index }
    }

    pub(super) fn path(&self) -> ObjectPath<'static> {
        path(self.keeper.house.instruments[self.index].role)
    }
}

/// Where the instrument with this role is; `switch+voltmeter` is `switch_voltmeter` there.
pub(super) fn path(role: &str) -> ObjectPath<'static> {
    bus::instrument_path(&role.replace('+', "_"))
        .unwrap_or_else(|_| ObjectPath::from_static_str_unchecked(ROOT_PATH))
}

/// One instrument of the rig.
#[interface(name = "org.tactus.Tactus1.Instrument1")]
impl Instrument1 {
    /// `source`, `switch`, `voltmeter`, or two of them joined by `+`.
    #[zbus(property(emits_changed_signal = "const"))]
    fn role(&self) -> &str {
        self.keeper.house.instruments[self.index].role
    }

    /// The reply to `*IDN?`.
    #[zbus(property(emits_changed_signal = "const"))]
    fn identity(&self) -> &str {
        &self.keeper.house.instruments[self.index].identity
    }

    /// Where it is: `tcp:HOST:PORT`, `serial:PATH`, or `memory` for one simulated inside the daemon.
    #[zbus(property(emits_changed_signal = "const"))]
    fn address(&self) -> &str {
        &self.keeper.house.instruments[self.index].address
    }

    /// Whether it is simulated.
    #[zbus(property(emits_changed_signal = "const"))]
    fn simulated(&self) -> bool {
        self.keeper.house.instruments[self.index].simulated
    }

    /// `ready` or `fault: ...`.
    #[zbus(property)]
    fn state(&self) -> String {
        match self.keeper.rig_fault() {
            None => "ready".to_owned(),
            Some(why) => format!("fault: {why}"),
        }
    }
}
