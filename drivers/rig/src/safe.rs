//! A rig made safe, and what is said when it is not.

use std::fmt;

use survey::{Dipole, Relay, Wiring};

use crate::seams::Instruments;
use crate::{CurrentSource, Rig, RigError, Switch};

/// What could not be made safe; the halves that are `None` were done and verified.
#[derive(Debug)]
pub struct CleanupError {
    /// Why the source is not verified off: its state is unknown.
    pub source: Option<RigError>,
    /// Why the relays are not verified open.
    pub relays: Option<RigError>,
}

impl CleanupError {
    /// Whether nobody knows if the source still drives.
    pub fn source_state_unknown(&self) -> bool {
        self.source.is_some()
    }
}

impl fmt::Display for CleanupError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.source, &self.relays) {
            (Some(source), None) => write!(
                f,
                "source state unknown ({source}); the injecting relays are open, so the sheet carries no current"
            ),
            (None, Some(relays)) => write!(
                f,
                "the source is off and verified, but relays are not verified open ({relays})"
            ),
            (Some(source), Some(relays)) => write!(
                f,
                "source state unknown ({source}) and relays not verified open ({relays}); treat the sheet as live"
            ),
            (None, None) => f.write_str("nothing"),
        }
    }
}

impl std::error::Error for CleanupError {}

/// Why a rig must not be started.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The switch does not answer.
    #[error("the injecting relays could not be read back")]
    Unreadable(#[from] RigError),
    /// Relays are closed before anything was asked: latching relays survive a power cycle.
    #[error("injecting relays closed at the start: {}; open them with --safe-off before measuring", name(.0))]
    Closed(Vec<ClosedRelay>),
}

/// A relay found closed, and the pairs that it serves.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ClosedRelay {
    /// The relay.
    pub relay: Relay,
    /// The pairs it joins to the source.
    pub pairs: Vec<Dipole>,
}

fn name(closed: &[ClosedRelay]) -> String {
    let each = |found: &ClosedRelay| {
        let pairs: Vec<String> = found.pairs.iter().map(Dipole::to_string).collect();
        format!("{} (pair {})", found.relay, pairs.join(", "))
    };
    closed.iter().map(each).collect::<Vec<_>>().join(", ")
}

/// Reads back every injecting relay before anything is moved.
///
/// # Errors
/// [`StartError::Closed`] names each closed relay with its pairs.
pub async fn check_at_start<C, W: Switch, V>(
    rig: &Rig<C, W, V>,
    wiring: &Wiring,
) -> Result<(), StartError> {
    let relays = wiring.injecting_relays();
    let states = rig.lock().await.switch.closed(&relays).await?;
    let closed: Vec<ClosedRelay> = relays
        .into_iter()
        .zip(states)
        .filter(|(_, closed)| *closed)
        .map(|(relay, _)| ClosedRelay {
            relay,
            pairs: wiring
                .inject
                .iter()
                .filter(|(_, relays)| relays.contains(&relay))
                .map(|(pair, _)| *pair)
                .collect(),
        })
        .collect();
    if closed.is_empty() {
        Ok(())
    } else {
        Err(StartError::Closed(closed))
    }
}

/// Switches the source off and opens the wiring's relays, each verified; tries the second also when the first fails.
///
/// # Errors
/// Which half failed, or both.
pub async fn safe_off<C, W, V>(rig: &Rig<C, W, V>, wiring: &Wiring) -> Result<(), CleanupError>
where
    C: CurrentSource,
    W: Switch,
{
    make_safe(&mut *rig.lock().await, wiring).await
}

pub(crate) async fn make_safe<C, W, V>(
    instruments: &mut Instruments<C, W, V>,
    wiring: &Wiring,
) -> Result<(), CleanupError>
where
    C: CurrentSource,
    W: Switch,
{
    let source = instruments.source.off().await.err();
    let relays = instruments
        .switch
        .open_verified(&every_relay(wiring))
        .await
        .err();
    if source.is_none() && relays.is_none() {
        return Ok(());
    }
    Err(CleanupError { source, relays })
}

/// Injecting relays first: those matter most.
pub(crate) fn every_relay(wiring: &Wiring) -> Vec<Relay> {
    let mut relays = wiring.injecting_relays();
    relays.extend(wiring.measuring_relays());
    relays.extend(&wiring.bus);
    relays
}
