//! The state of the poles after moves of relays.

use rig::{Move, RigError};
use survey::{Electrode, Relay};

use crate::command::{Pole, State};

/// The state after the moves, or the error for moves that must not be made. `place` returns pole and electrode of a
/// relay; `unable` makes the error from its text.
pub(crate) fn state_after(
    from: State,
    moves: &[Move],
    place: impl Fn(Relay) -> Result<(Pole, Electrode), RigError>,
    unable: impl Fn(String) -> RigError,
) -> Result<State, RigError> {
    let mut state = from;
    for one in moves {
        let (Move::Close(relays) | Move::Open(relays)) = one;
        for relay in relays {
            let (pole, electrode) = place(*relay)?;
            match one {
                Move::Open(_) if state.on(pole) == Some(electrode) => {
                    state = state.with(pole, None);
                }
                Move::Open(_) => {}
                Move::Close(_) => {
                    if let Some(other) = state.on(pole).filter(|other| *other != electrode) {
                        return Err(unable(format!(
                            "close relay {relay} while electrode {other} is on {pole}: a pole carries one electrode"
                        )));
                    }
                    state = state.with(pole, Some(electrode));
                }
            }
        }
    }
    match state.shorted() {
        Some(electrode) => Err(unable(format!(
            "put electrode {electrode} on I+ and on I-: it would short the source"
        ))),
        None => Ok(state),
    }
}
