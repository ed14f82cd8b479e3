//! The interface of one instrument.

use crate::Fault;

/// `org.tactus.Tactus1.Instrument1`, below `/org/tactus/Tactus1/instrument/`.
#[zbus::proxy(
    interface = "org.tactus.Tactus1.Instrument1",
    default_service = "org.tactus.Tactus1"
)]
pub trait Instrument1 {
    /// `source`, `switch`, `voltmeter`, or two of them joined by `+`.
    #[zbus(property(emits_changed_signal = "const"))]
    fn role(&self) -> Result<String, Fault>;

    /// The reply to `*IDN?`.
    #[zbus(property(emits_changed_signal = "false"))]
    fn identity(&self) -> Result<String, Fault>;

    /// The address: `tcp:HOST:PORT`, `serial:PATH`, or `memory` for an instrument simulated inside the daemon.
    #[zbus(property(emits_changed_signal = "false"))]
    fn address(&self) -> Result<String, Fault>;

    /// Whether it is simulated.
    #[zbus(property(emits_changed_signal = "false"))]
    fn simulated(&self) -> Result<bool, Fault>;

    /// `ready` or `fault: ...`.
    #[zbus(property(emits_changed_signal = "false"))]
    fn state(&self) -> Result<String, Fault>;
}
