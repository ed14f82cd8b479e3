//! The trait of a gpiochip.

use crate::lines::Levels;

/// Why lines could not be set or read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the lines of {chip} cannot be {attempt}: {reason}")]
pub struct GpioFault {
    /// Name of the chip.
    pub chip: String,
    /// `taken`, `set` or `read`.
    pub attempt: &'static str,
    /// The reason.
    pub reason: String,
}

/// The 24 lines of a board on a chip: all requested at once as outputs, low at first (fact sheet section 4).
pub trait GpioChip: Send {
    /// The chip's name for messages.
    fn name(&self) -> &str;

    /// Sets the lines in `mask` to their levels in `bits` in one call; the other lines keep their levels.
    ///
    /// # Errors
    /// The chip is gone or rejects the request, for example one without lines.
    fn set(&mut self, mask: u32, bits: u32) -> Result<(), GpioFault>;

    /// Reads all lines back.
    ///
    /// # Errors
    /// The chip is gone or rejects the request.
    fn read(&mut self) -> Result<Levels, GpioFault>;
}
