//! A multiplexer board on a gpiochip of this machine.

use std::path::Path;
use std::time::Duration;

use config::EnableName;
use gpio_mux::{CharacterDevice, EnableLevel, GpioBoard};
use rig::RigError;

use crate::instruments::kinds::AnySwitch;

/// Settling time after lines have changed (fact sheet gpio-mux, section 3).
const SETTLING: Duration = Duration::from_millis(1);

/// Requests the lines of a gpiochip for a board: by their names, or 24 consecutive lines from `first` on.
pub(super) fn board_on(
    path: &str,
    first: Option<u32>,
    enable: EnableName,
    electrodes: usize,
) -> Result<AnySwitch, RigError> {
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
    Ok(AnySwitch::Lines(board, identity))
}
