//! The D-Bus contract of Tactus: names, paths, interfaces, wire types, and the records of the full-rate stream.
//! Depends on no other crate of this workspace; daemon and clients convert their own types to the wire types.
//!
//! - **manager**: the daemon itself (`Manager1` on [`ROOT_PATH`]); **alarms**: its alarms (`Alarms1`, same object)
//! - **instrument**: one `Instrument1` object for each instrument
//! - **session**: a baseline being recorded or a measurement (`Session1`), running or recently ended
//! - **fault**: one error name for each kind ([`Fault`])
//! - **options**: the last `a{sv}` argument of a method ([`SessionOptions`], ...)
//! - **dictionaries**: the `a{sv}` that the daemon sends ([`Health`], [`PlanDetails`], ...)
//! - **json**: reports of the daemon as programs print and publish them ([`json::Status`], [`json::Alarm`])
//! - **record**: one frame, map or end in the full-rate stream ([`stream`])
//!
//! The proxies do not cache properties that may change: every read queries the daemon. The daemon emits
//! `PropertiesChanged`; to follow changes, subscribe through `zbus::fdo::PropertiesProxy`. Await a subscription
//! (`receive_...`) to its end: if its future is dropped, zbus (6.2) can lose that signal for the rest of the connection.
//!
//! The daemon has three kinds of address ([`Address`]): the system bus, the session bus, and a unix socket that needs
//! no broker.
//!
//! ```
//! assert_eq!(dbus::session_path("b20261207_1")?.as_str(), "/org/tactus/Tactus1/session/b20261207_1");
//! assert!(dbus::session_path("not-an-id").is_err(), "a minus is not allowed in an object path");
//! let address: dbus::Address = "unix:/run/tactus/peer".parse()?;
//! assert_eq!(address.to_string(), "unix:/run/tactus/peer");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod address;
mod alarms1;
mod dictionaries;
mod fault;
mod instrument1;
pub mod json;
mod manager1;
mod options;
mod session1;
mod simulation1;
pub mod stream;

use std::pin::Pin;

use zbus::proxy::{Builder, CacheProperties, Defaults};
use zbus::{Connection, ObjectPath, Proxy, export::futures_core::Stream};

pub use address::{Address, AddressError, BUSY, ConnectError, connect, search_order};
pub use alarms1::{AlarmReport, Alarms1Proxy};
pub use dictionaries::{
    BaselineDetails, EventDetails, FrameQuality, FrameSummary, GeometryDetails, Health, MapDetails,
    NotifyResult, PlanDetails, Recovery, SessionDetails, SessionStatus, SettingCost, Status,
    TestDetails,
};
pub use fault::Fault;
pub use instrument1::Instrument1Proxy;
pub use manager1::{
    BaselineReport, Discovery, Geometry, Happened, HappenedStream, Manager1Proxy, PlanReport,
    RelayWear, SeenInstrument, SessionSummary, TestLine, TestProgress, TestProgressStream,
    TestReport,
};
pub use options::{
    ABOUT_OPTIONS, DiscoverOptions, InvalidOption, ListOptions, MEASURING_OPTIONS, Options,
    SESSION_OPTIONS, SessionOptions, ShelveOptions, StreamOptions, TranscriptOptions,
};
pub use session1::{
    FrameDone, FrameDoneStream, LatestFrame, LatestMap, LatestPressure, LatestQuantities,
    Session1Proxy,
};
pub use simulation1::Simulation1Proxy;

/// The well-known name, which contains the version.
pub const BUS_NAME: &str = "org.tactus.Tactus1";
/// Path of the ObjectManager, Manager1, Alarms1 and (on a simulated rig) Simulation1.
pub const ROOT_PATH: &str = "/org/tactus/Tactus1";
/// Name of the manager's interface.
pub const MANAGER_INTERFACE: &str = "org.tactus.Tactus1.Manager1";
/// Name of the alarms' interface.
pub const ALARMS_INTERFACE: &str = "org.tactus.Tactus1.Alarms1";
/// Name of an instrument's interface.
pub const INSTRUMENT_INTERFACE: &str = "org.tactus.Tactus1.Instrument1";
/// Name of a session's interface.
pub const SESSION_INTERFACE: &str = "org.tactus.Tactus1.Session1";
/// Name of the interface for loads on a simulated sheet.
pub const SIMULATION_INTERFACE: &str = "org.tactus.Tactus1.Simulation1";
/// Introspection data of the five interfaces as the daemon must return it: interface name and XML.
pub const INTERFACE_XML: [(&str, &str); 5] = [
    (
        MANAGER_INTERFACE,
        include_str!("../xml/org.tactus.Tactus1.Manager1.xml"),
    ),
    (
        ALARMS_INTERFACE,
        include_str!("../xml/org.tactus.Tactus1.Alarms1.xml"),
    ),
    (
        INSTRUMENT_INTERFACE,
        include_str!("../xml/org.tactus.Tactus1.Instrument1.xml"),
    ),
    (
        SESSION_INTERFACE,
        include_str!("../xml/org.tactus.Tactus1.Session1.xml"),
    ),
    (
        SIMULATION_INTERFACE,
        include_str!("../xml/org.tactus.Tactus1.Simulation1.xml"),
    ),
];

/// An id that cannot be part of an object path.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "'{0}' is not an id of Tactus: only a to z, 0 to 9 and _ are allowed, and at least one of them"
)]
pub struct BadId(pub String);

/// The object path of a session.
///
/// # Errors
/// An id outside `[a-z0-9_]+`.
pub fn session_path(id: &str) -> Result<ObjectPath<'static>, BadId> {
    path("session", id)
}

/// The object path of an instrument.
///
/// # Errors
/// An id outside `[a-z0-9_]+`.
pub fn instrument_path(id: &str) -> Result<ObjectPath<'static>, BadId> {
    path("instrument", id)
}

/// The id at the end of a session's or instrument's object path; `None` for another path.
pub fn id_of(path: &str) -> Option<&str> {
    let rest = path.strip_prefix(ROOT_PATH)?;
    rest.strip_prefix("/session/")
        .or_else(|| rest.strip_prefix("/instrument/"))
        .filter(|id| is_id(id))
}

fn path(kind: &str, id: &str) -> Result<ObjectPath<'static>, BadId> {
    if !is_id(id) {
        return Err(BadId(id.to_owned()));
    }
    ObjectPath::try_from(format!("{ROOT_PATH}/{kind}/{id}")).map_err(|_| BadId(id.to_owned()))
}

fn is_id(id: &str) -> bool {
    !id.is_empty()
        && id
            .bytes()
            .all(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'_')
}

/// A proxy of the object at this path, which queries the daemon for each property.
///
/// # Errors
/// An invalid path, or a connection that has ended.
pub async fn proxy<P, O>(connection: &Connection, path: O) -> zbus::Result<P>
where
    P: Defaults + From<Proxy<'static>>,
    O: TryInto<ObjectPath<'static>>,
    O::Error: Into<zbus::Error>,
{
    Builder::new(connection)
        .path(path)
        .cache_properties(CacheProperties::No)
        .build()
        .await
}

/// The next item of a signal or property stream; `None` when the connection is closed.
pub async fn next<S: Stream + Unpin>(stream: &mut S) -> Option<S::Item> {
    std::future::poll_fn(|context| Pin::new(&mut *stream).poll_next(context)).await
}
