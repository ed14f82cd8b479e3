//! The table from every method to its action, and how the call is served.

use dbus::{
    ALARMS_INTERFACE as ALARMS, MANAGER_INTERFACE as MANAGER, SESSION_INTERFACE as SESSION,
    SIMULATION_INTERFACE as SIMULATION,
};
use zbus::names::InterfaceName;

use crate::service::limit::{COMMANDS, Limit, QUERIES, SAFETY_CALLS, WAITING_CALLS};
use CallClass::{Command, LargeQuery, Query, Safety, Wait};

/// Groups of operations for which permission is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::service) enum Action {
    /// Reading status, events and the record.
    Observe,
    /// Starting, suspending and ending a session.
    Control,
    /// Recording a baseline, which replaces the current one, and overruling the tracked baseline.
    Baseline,
    /// Access to the instruments or the simulated sheet outside of a session.
    Instruments,
    /// Acknowledging, shelving and resetting alarms.
    Alarms,
    /// Reading the configuration again.
    Reload,
}

impl Action {
    /// Its polkit action; `None` if no permission is needed.
    pub(super) fn id(self) -> Option<&'static str> {
        match self {
            Self::Observe => None,
            Self::Control => Some("org.tactus.Tactus1.control"),
            Self::Baseline => Some("org.tactus.Tactus1.baseline"),
            Self::Instruments => Some("org.tactus.Tactus1.instruments"),
            Self::Alarms => Some("org.tactus.Tactus1.alarms"),
            Self::Reload => Some("org.tactus.Tactus1.reload"),
        }
    }
}

/// How a call is served, and what happens to it when its caller disconnects.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::service) enum CallClass {
    /// Replied immediately; cancelled when its caller disconnects.
    Query,
    /// Like a query, with a reply of some 100 kB: a connection sends one such reply at a time.
    LargeQuery,
    /// Waits for a frame or for the end of a session; cancelled when its caller disconnects.
    Wait,
    /// Changes something; runs to its end even if its caller disconnects.
    Command,
    /// Makes the rig safe, with separate limits; runs to its end even if its caller disconnects.
    Safety,
}

impl CallClass {
    pub(super) fn limit(self) -> &'static Limit {
        match self {
            Self::Query | Self::LargeQuery => &QUERIES,
            Self::Wait => &WAITING_CALLS,
            Self::Command => &COMMANDS,
            Self::Safety => &SAFETY_CALLS,
        }
    }

    /// Whether a reply is cancelled when its caller disconnects.
    pub(super) fn ends_with_its_caller(self) -> bool {
        matches!(self, Self::Query | Self::LargeQuery | Self::Wait)
    }
}

/// Every method, its action, and how it is served.
pub(super) const METHODS: &[(&str, &str, Action, CallClass)] = &[
    (MANAGER, "StartSession", Action::Control, Command),
    (MANAGER, "RecordBaseline", Action::Baseline, Command),
    (MANAGER, "UseBaseline", Action::Baseline, Command),
    (MANAGER, "OverrideTracking", Action::Baseline, Command),
    (MANAGER, "ListSessions", Action::Observe, Query),
    (MANAGER, "Plan", Action::Observe, Query),
    (MANAGER, "PlanWith", Action::Observe, Query),
    (MANAGER, "Geometry", Action::Observe, LargeQuery),
    (MANAGER, "Baseline", Action::Observe, Query),
    (MANAGER, "BaselineRemarks", Action::Observe, Query),
    (MANAGER, "Health", Action::Observe, Query),
    (MANAGER, "Status", Action::Observe, Query),
    // runs a program that only the configuration names
    (MANAGER, "NotifyTest", Action::Control, Command),
    // injects current and moves every relay
    (MANAGER, "TestInstruments", Action::Instruments, Command),
    // queries the instruments
    (MANAGER, "Relays", Action::Instruments, Command),
    // connects to addresses that the caller names
    (MANAGER, "Discover", Action::Instruments, Command),
    (MANAGER, "OpenAll", Action::Instruments, Safety),
    (MANAGER, "AcceptInstruments", Action::Instruments, Command),
    (MANAGER, "Transcript", Action::Instruments, Command),
    (MANAGER, "Reload", Action::Reload, Command),
    (ALARMS, "List", Action::Observe, Query),
    (ALARMS, "Acknowledge", Action::Alarms, Command),
    (ALARMS, "Shelve", Action::Alarms, Command),
    (ALARMS, "Unshelve", Action::Alarms, Command),
    (ALARMS, "Reset", Action::Alarms, Command),
    (ALARMS, "SetInService", Action::Alarms, Command),
    (SESSION, "Stop", Action::Control, Safety),
    (SESSION, "Suspend", Action::Control, Safety),
    (SESSION, "Resume", Action::Control, Command),
    (SESSION, "Step", Action::Control, Wait),
    (SESSION, "Wait", Action::Observe, Wait),
    (SESSION, "LatestFrame", Action::Observe, Query),
    (SESSION, "LatestMap", Action::Observe, LargeQuery),
    (SESSION, "LatestPressure", Action::Observe, Query),
    (SESSION, "Quantities", Action::Observe, Query),
    (SESSION, "OpenStream", Action::Observe, Query),
    (SIMULATION, "Press", Action::Instruments, Command),
    (SIMULATION, "Release", Action::Instruments, Command),
];

pub(super) fn method(interface: &InterfaceName<'_>, member: &str) -> Option<(Action, CallClass)> {
    METHODS
        .iter()
        .find(|(of, named, ..)| *of == interface.as_str() && *named == member)
        .map(|(_, _, action, class)| (*action, *class))
}

/// Whether a method does more than read.
pub(in crate::service) fn changes_something(interface: &str, member: &str) -> bool {
    METHODS.iter().any(|(of, named, action, _)| {
        *of == interface && *named == member && *action != Action::Observe
    })
}
