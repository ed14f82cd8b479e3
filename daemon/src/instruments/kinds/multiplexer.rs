//! The multiplexer board, on a serial line or on a gpiochip of this machine.

use std::path::Path;
use std::time::Duration;

use gpio_mux::{CharacterDevice, EnableLevel, GpioBoard, GpioMux};
use rig::{BoxStream, Move, RigError, Switch};
use survey::Relay;

use config::EnableName;

/// Settling time after lines have changed (fact sheet gpio-mux, section 3).
const SETTLING: Duration = Duration::from_millis(1);

/// A board on a serial line or on a gpiochip.
pub(crate) enum Multiplexer {
    Serial(GpioMux<BoxStream>),
    Lines(GpioBoard<CharacterDevice>, String),
}

impl Multiplexer {
    /// Requests the lines of a gpiochip: by their names, or 24 consecutive lines from `first` on.
    pub(crate) fn on_gpiochip(
        path: &str,
        first: Option<u32>,
        enable: EnableName,
        electrodes: usize,
    ) -> Result<Self, RigError> {
        let enable = match enable {
            EnableName::Low => EnableLevel::Low,
            EnableName::High => EnableLevel::High,
        };
        let path = Path::new(path);
        let chip = match first {
            None => CharacterDevice::by_names(path, enable),
            Some(first) => CharacterDevice::by_offset(path, first, enable),
        }
        .map_err(|fault| RigError::Unable {
            instrument: format!("GPIO board on {}", path.display()),
            what: format!("start: {fault}"),
        })?;
        let identity = format!("lines of {}", path.display());
        let board = GpioBoard::new(chip, electrodes, SETTLING)?;
        Ok(Self::Lines(board, identity))
    }

    /// The reply to `*IDN?`; for a gpiochip, which has no identity, the path of the chip.
    pub(crate) fn identity(&self) -> &str {
        match self {
            Self::Serial(board) => board.identity(),
            Self::Lines(_, identity) => identity,
        }
    }
}

impl Switch for Multiplexer {
    async fn move_relays(&mut self, moves: &[Move]) -> Result<(), RigError> {
        match self {
            Self::Serial(board) => board.move_relays(moves).await,
            Self::Lines(board, _) => board.move_relays(moves).await,
        }
    }

    async fn settle(&mut self) -> Result<(), RigError> {
        match self {
            Self::Serial(board) => board.settle().await,
            Self::Lines(board, _) => board.settle().await,
        }
    }

    async fn closed(&mut self, relays: &[Relay]) -> Result<Vec<bool>, RigError> {
        match self {
            Self::Serial(board) => board.closed(relays).await,
            Self::Lines(board, _) => board.closed(relays).await,
        }
    }

    async fn open_verified(&mut self, relays: &[Relay]) -> Result<(), RigError> {
        match self {
            Self::Serial(board) => board.open_verified(relays).await,
            Self::Lines(board, _) => board.open_verified(relays).await,
        }
    }
}
