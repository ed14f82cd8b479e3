//! Makes a rig safe, and reports what could not be made safe.

use std::fmt;
use std::time::Duration;

use survey::{Dipole, Relay, Wiring};
use tokio::time::Instant;

use crate::found_relay::{FoundRelay, name_relays};
use crate::traits::Instruments;
use crate::{CurrentSource, Rig, RigError, Switch};

/// Time allowed for verifying the source off before the relays are opened; after it they are opened concurrently.
const OFF_BEFORE_RELAYS: Duration = Duration::from_millis(100);

/// What could not be made safe. `source` and `relays` are `None` where the step was done and verified.
#[derive(Debug)]
pub struct CleanupError {
    /// Why the source could not be verified off; its state is unknown.
    pub source: Option<RigError>,
    /// Why the relays could not be verified open.
    pub relays: Option<RigError>,
    /// Time until the source was verified off; `None` if it was not.
    pub off_after: Option<Duration>,
}

impl CleanupError {
    /// Whether the source may still drive a current.
    pub fn source_state_unknown(&self) -> bool {
        self.source.is_some()
    }

    /// No cleanup was possible: the runtime was shut down during a plan.
    pub(crate) fn runtime_ended() -> Self {
        let unable = |what: &str| RigError::Unable {
            instrument: "the rig".to_owned(),
            what: format!("{what}: the runtime has ended"),
        };
        Self {
            source: Some(unable("switch the source off")),
            relays: Some(unable("open the relays")),
            off_after: None,
        }
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
    /// The injecting relays could not be read back.
    #[error("the injecting relays could not be read back")]
    Unreadable(#[from] RigError),
    /// Relays are closed before any command: latching relays survive a power cycle.
    #[error(
        "injecting relays were closed before any command: {}; find the cause, then open them with `tactus instruments \
         open-all` (or tactusd --safe-off)",
        name_relays(.0)
    )]
    Closed(Vec<FoundRelay>),
}

/// Checks that every injecting relay reads back open, before any relay is moved.
///
/// # Errors
/// [`StartError::Closed`] with each closed relay and its pairs; [`StartError::Unreadable`] if the switch does not
/// reply.
pub async fn check_at_start<C, W: Switch, V>(
    rig: &Rig<C, W, V>,
    wiring: &Wiring,
) -> Result<(), StartError> {
    let closed = find_closed(&mut rig.lock().await.switch, wiring).await?;
    if closed.is_empty() {
        Ok(())
    } else {
        Err(StartError::Closed(closed))
    }
}

/// The injecting relays that read back closed, with their electrodes.
///
/// # Errors
/// A failed connection, or an invalid reply.
pub async fn find_closed<W: Switch>(
    switch: &mut W,
    wiring: &Wiring,
) -> Result<Vec<FoundRelay>, RigError> {
    let relays = wiring.injecting_relays();
    let states = switch.closed(&relays).await?;
    Ok(relays
        .into_iter()
        .zip(states)
        .filter(|(_, closed)| *closed)
        .map(|(relay, _)| found(relay, wiring))
        .collect())
}

/// Switches the source off and opens the wiring's relays, each verified; opens the relays even if the source fails.
///
/// # Errors
/// Why the source could not be switched off, why relays could not be opened, or both.
pub async fn safe_off<C, W, V>(rig: &Rig<C, W, V>, wiring: &Wiring) -> Result<(), CleanupError>
where
    C: CurrentSource,
    W: Switch,
{
    make_safe(&mut *rig.lock().await, wiring).await.map(drop)
}

/// Switches the source off and opens the wiring's relays, each verified. Returns the time until the source was verified
/// off.
pub(crate) async fn make_safe<C, W, V>(
    instruments: &mut Instruments<C, W, V>,
    wiring: &Wiring,
) -> Result<Duration, CleanupError>
where
    C: CurrentSource,
    W: Switch,
{
    let detected = Instant::now();
    let relays = wiring.relays();
    let mut off = std::pin::pin!(async {
        let off = instruments.source.off().await;
        (off, detected.elapsed())
    });
    // Relays last longest when they open without current. If the source does not reply in time, they are opened
    // nevertheless: no current reaches the sheet through open relays.
    let ((off, after), opened) = match tokio::time::timeout(OFF_BEFORE_RELAYS, &mut off).await {
        Ok(off) => (off, instruments.switch.open_verified(&relays).await),
        Err(_) => tokio::join!(off, instruments.switch.open_verified(&relays)),
    };
    match (off.err(), opened.err()) {
        (None, None) => Ok(after),
        (source, relays) => Err(CleanupError {
            off_after: source.is_none().then_some(after),
            source,
            relays,
        }),
    }
}

/// Reads back every injecting relay, and opens all relays. Only the relays in `driven` are expected to be closed.
///
/// # Errors
/// [`RigError::RelayMismatch`] with the relays in an unexpected state and their electrodes; an error of the switch.
pub(crate) async fn open_checked<W: Switch>(
    switch: &mut W,
    wiring: &Wiring,
    driven: &[Relay],
) -> Result<(), RigError> {
    let relays = wiring.injecting_relays();
    let states = switch
        .closed_before_opening(&relays, &wiring.relays())
        .await?;
    let (mut open, mut closed) = (Vec::new(), Vec::new());
    for (relay, is_closed) in relays.into_iter().zip(states) {
        match (driven.contains(&relay), is_closed) {
            (true, false) => open.push(found(relay, wiring)),
            (false, true) => closed.push(found(relay, wiring)),
            _ => {}
        }
    }
    if open.is_empty() && closed.is_empty() {
        Ok(())
    } else {
        Err(RigError::RelayMismatch { open, closed })
    }
}

fn found(relay: Relay, wiring: &Wiring) -> FoundRelay {
    let of = |pairs: &[(Dipole, Vec<Relay>)]| -> Vec<Dipole> {
        let with = pairs.iter().filter(|(_, relays)| relays.contains(&relay));
        with.map(|(pair, _)| *pair).collect()
    };
    let pairs = match of(&wiring.inject) {
        used if used.is_empty() => of(&wiring.unused_inject),
        used => used,
    };
    FoundRelay { relay, pairs }
}
