//! The board as a [`Switch`]: relay numbers in, line protocol out.
//!
//! The board replies to every move with the electrodes now on its poles, and each reply is compared with the intended
//! state: the next command therefore detects that the watchdog has opened everything, or that the board was reset.

use std::time::Duration;

use rig::{Conversation, Link, Move, RigError, Stream, Switch};
use survey::{Electrode, Relay};
use tokio::io::{AsyncRead, AsyncReadExt};

use crate::MODEL;
use crate::command::{Command, MOST_ERRORS, Pair, Pole, State, error_in_reply};
use crate::moves::state_after;

/// Added to the longest time without a command that the rig expects: for the messages to other instruments meanwhile.
const WATCHDOG_MARGIN: Duration = Duration::from_secs(2);

/// Options of the driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Options {
    /// The board opens everything when no command arrives for this long; zero disables the watchdog. Extended by
    /// [`Switch::prepare_for_silence`] if settling and reading take longer, because no command is sent meanwhile. The
    /// rig knows the time of a reading only if [`rig::MeterSettings::deadline`] is set.
    pub watchdog: Duration,
    /// Wait after every move (section 3: 5 x (R_on + R_sample) x C_cable, at least 50 us).
    pub settling: Duration,
}

impl Default for Options {
    /// A watchdog of 10 s, settling 1 ms.
    fn default() -> Self {
        Self {
            watchdog: Duration::from_secs(10),
            settling: Duration::from_millis(1),
        }
    }
}

/// Reads the line that a board sends when its port is opened, if it arrives in time: opening the port may reset the
/// board (section 5). Must be called before the stream becomes a [`Link`].
pub async fn await_banner<S: AsyncRead + Unpin>(
    stream: &mut S,
    within: Duration,
) -> Option<String> {
    const LONGEST: usize = 200;
    let read = async {
        let mut line = Vec::new();
        while line.len() < LONGEST {
            match stream.read_u8().await {
                Ok(b'\n') | Err(_) => break,
                Ok(byte) => line.push(byte),
            }
        }
        String::from_utf8_lossy(&line).trim().to_owned()
    };
    tokio::time::timeout(within, read)
        .await
        .ok()
        .filter(|line| !line.is_empty())
}

/// A multiplexer board at the other end of a link.
#[derive(Debug)]
pub struct GpioMux<S> {
    conversation: Conversation<S>,
    identity: String,
    options: Options,
    /// The watchdog's present time.
    watchdog: Duration,
    /// The state last reported by the board; `None` after a fault.
    state: Option<State>,
}

impl<S: Stream> GpioMux<S> {
    /// Queries the identity, rejects another model, and sets the watchdog.
    ///
    /// # Errors
    /// Another instrument, or a broken connection.
    pub async fn connect(link: Link<S>) -> Result<Self, RigError> {
        Self::connect_with(link, Options::default()).await
    }

    /// As [`GpioMux::connect`], with other options.
    ///
    /// # Errors
    /// As [`GpioMux::connect`].
    pub async fn connect_with(link: Link<S>, options: Options) -> Result<Self, RigError> {
        let mut conversation = Conversation::new(link, Command::NextError, MOST_ERRORS);
        let is_board = |fields: &[&str]| fields.get(1) == Some(&MODEL);
        let mut board = Self {
            identity: conversation.identify(MODEL, is_board).await?,
            conversation,
            options,
            watchdog: options.watchdog,
            state: None,
        };
        board.set_watchdog(options.watchdog).await?;
        Ok(board)
    }

    async fn set_watchdog(&mut self, watchdog: Duration) -> Result<(), RigError> {
        let milliseconds = u32::try_from(watchdog.as_millis()).unwrap_or(u32::MAX);
        self.send(Command::Watchdog(milliseconds)).await?;
        self.watchdog = watchdog;
        Ok(())
    }

    /// The reply to `*IDN?`.
    pub fn identity(&self) -> &str {
        &self.identity
    }

    /// Reads back the electrodes on the poles.
    ///
    /// # Errors
    /// A broken connection, or a reply that is not a state.
    pub async fn state(&mut self) -> Result<State, RigError> {
        self.send(Command::AskState).await
    }

    /// Sends one command and returns the state in the reply.
    async fn send(&mut self, command: Command) -> Result<State, RigError> {
        self.state = None;
        let message = command.to_string();
        let answer = self.conversation.link_mut().ask(&message).await?;
        if let Some(error) = error_in_reply(&answer) {
            return Err(self.conversation.refused(message, error));
        }
        let state = answer.parse().map_err(|_| {
            let expected = "four electrodes such as 1,2,OFF,OFF";
            self.conversation.garbled(&message, &answer, expected)
        })?;
        self.state = Some(state);
        Ok(state)
    }

    /// Brings the poles to a state with the fewest commands; each reply is checked.
    async fn apply(&mut self, from: State, to: State) -> Result<(), RigError> {
        let commands = commands_between(from, to);
        for (command, meant) in &commands {
            let found = self.send(*command).await?;
            if found != *meant {
                self.state = None;
                let poles = "electrodes on I+,I-,V+,V-";
                return Err(self.conversation.mismatch(poles, meant, found));
            }
        }
        if !commands.is_empty() && !self.options.settling.is_zero() {
            tokio::time::sleep(self.options.settling).await;
        }
        Ok(())
    }

    /// After a lost or late reply: opens everything and resynchronises the link.
    async fn recover(&mut self) -> Result<(), RigError> {
        self.state = None;
        let off = (Command::Off.to_string(), State::default().to_string());
        // the reply to this probe cannot be that of an earlier command: no frame connects V+ alone
        let alone = State::default().with(Pole::VPlus, Some(Electrode(0)));
        let probe = Command::Set(Pole::VPlus, Some(Electrode(0))).to_string();
        let probes = [
            (off.0.as_str(), off.1.as_str()),
            (&probe, &alone.to_string()),
            (&Command::Identify.to_string(), self.identity.trim()),
            (&off.0, &off.1),
        ];
        Ok(self
            .conversation
            .link_mut()
            .resynchronise_by(&probes)
            .await?)
    }

    fn pole_and_electrode(&self, relay: Relay) -> Result<(Pole, Electrode), RigError> {
        Pole::of(relay).ok_or_else(|| {
            self.conversation.unable(format!(
                "move relay {relay}: its relays are pole x 100 + electrode, poles 1 to 4"
            ))
        })
    }

    /// The state after the moves, or the error for moves that must not be made.
    fn target(&self, from: State, moves: &[Move]) -> Result<State, RigError> {
        let place = |relay| self.pole_and_electrode(relay);
        state_after(from, moves, place, |what| self.conversation.unable(what))
    }
}

/// The commands from one valid state to another, each with the state after it. No intermediate state has one electrode
/// on both current poles.
fn commands_between(from: State, to: State) -> Vec<(Command, State)> {
    if to == State::default() && from != to {
        return vec![(Command::Off, to)];
    }
    let mut commands = Vec::new();
    let mut state = from;
    let mut append = |command, next: State| {
        commands.push((command, next));
        next
    };
    for pair in [Pair::Current, Pair::Voltage] {
        let [plus, minus] = pair.poles();
        let (want_plus, want_minus) = (to.on(plus), to.on(minus));
        if (state.on(plus), state.on(minus)) == (want_plus, want_minus) {
            continue;
        }
        // The board computes the neighbour modulo its number of electrodes, which the driver does not have: the last
        // pair is set pole by pole.
        if let (Some(first), Some(second)) = (want_plus, want_minus)
            && second.0 == first.0 + 1
        {
            let next = state.with(plus, want_plus).with(minus, want_minus);
            state = append(Command::Pair(pair, first), next);
            continue;
        }
        if state.on(plus) != want_plus && want_plus == state.on(minus) && want_plus.is_some() {
            state = append(Command::Set(minus, None), state.with(minus, None));
        }
        for (pole, want) in [(plus, want_plus), (minus, want_minus)] {
            if state.on(pole) != want {
                state = append(Command::Set(pole, want), state.with(pole, want));
            }
        }
    }
    commands
}

impl<S: Stream> Switch for GpioMux<S> {
    /// Sets the watchdog to a longer time, or back to that of the options.
    async fn prepare_for_silence(&mut self, longest: Duration) -> Result<(), RigError> {
        let watchdog = self.options.watchdog.max(longest + WATCHDOG_MARGIN);
        if self.options.watchdog.is_zero() || watchdog == self.watchdog {
            return Ok(());
        }
        self.set_watchdog(watchdog).await
    }

    /// Moves every pole to the state after the moves. Opening and closing of one pole is one command; the board breaks
    /// before it makes. No move is deferred.
    async fn move_relays(&mut self, moves: &[Move]) -> Result<(), RigError> {
        let from = match self.state {
            Some(state) => state,
            None => self.state().await?,
        };
        let to = self.target(from, moves)?;
        self.apply(from, to).await
    }

    /// Does nothing: a move has settled when it returns.
    async fn settle(&mut self) -> Result<(), RigError> {
        Ok(())
    }

    async fn closed(&mut self, relays: &[Relay]) -> Result<Vec<bool>, RigError> {
        let places = relays
            .iter()
            .map(|relay| self.pole_and_electrode(*relay))
            .collect::<Result<Vec<_>, _>>()?;
        let state = self.state().await?;
        Ok(places
            .into_iter()
            .map(|(pole, electrode)| state.on(pole) == Some(electrode))
            .collect())
    }

    async fn open_verified(&mut self, relays: &[Relay]) -> Result<(), RigError> {
        if !self.conversation.link().is_synchronised() {
            self.recover().await?;
        }
        let from = self.state().await?;
        let to = self.target(from, &[Move::Open(relays.to_vec())])?;
        self.apply(from, to).await?;
        let closed = self.closed(relays).await?;
        self.conversation.check_open(relays, &closed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(text: &str) -> State {
        text.parse().unwrap()
    }

    #[test]
    fn no_command_sequence_shorts_the_source() {
        let all: Vec<Option<Electrode>> = [None, Some(0), Some(1), Some(2)]
            .map(|electrode| electrode.map(Electrode))
            .to_vec();
        let mut legal = Vec::new();
        for plus in &all {
            for minus in &all {
                let state = State([*plus, *minus, None, Some(Electrode(4))]);
                if state.shorted().is_none() {
                    legal.push(state);
                }
            }
        }
        for from in &legal {
            for to in &legal {
                let commands = commands_between(*from, *to);
                assert!(commands.iter().all(|(_, state)| state.shorted().is_none()));
                assert!(commands.len() <= 3, "{from} to {to}: {commands:?}");
                let end = commands.last().map_or(*from, |(_, state)| *state);
                assert_eq!(end, *to);
            }
        }
    }

    #[test]
    fn neighbours_go_by_one_command() {
        let commands = commands_between(state("1,2,3,4"), state("1,2,4,5"));
        assert_eq!(commands.len(), 1);
        assert_eq!(commands[0].0, Command::Pair(Pair::Voltage, Electrode(3)));
    }
}
