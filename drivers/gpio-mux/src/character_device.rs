//! A board's lines on a real gpiochip, through the kernel's character device.

use std::path::{Path, PathBuf};

use gpiocdev::Request;
use gpiocdev::line::{Offset, Value, Values};

use crate::chip::{GpioChip, GpioFault};
use crate::lines::{LINES, Levels, Line};

/// The name that the kernel shows as the owner of the lines.
const CONSUMER: &str = "tactus";

/// The level at which a chip's enable is on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum EnableLevel {
    /// Low, as on a 74HC4067 (its E), with pull-up resistors.
    #[default]
    Low,
    /// High, as on an ADG1606 (its EN), with pull-down resistors.
    High,
}

/// The 24 lines on a gpiochip, all requested at once as outputs, with the enables off (fact sheet section 4).
///
/// Dropping it releases the lines. Whether they keep their levels depends on the chip's driver; only the board's pull
/// resistors open everything reliably.
#[derive(Debug)]
pub struct CharacterDevice {
    name: String,
    request: Request,
    /// The offset of each line, by line number.
    offsets: [Offset; LINES as usize],
}

impl CharacterDevice {
    /// Takes the lines by their names, which are the text of [`Line`]: `I+.S0` to `V-.EN_B`.
    ///
    /// # Errors
    /// A chip that does not exist, a name that no line of the chip has, a line that another process has taken.
    pub fn by_names(path: &Path, enable: EnableLevel) -> Result<Self, GpioFault> {
        let fault = |reason: String| taken(path, reason);
        let chip = gpiocdev::Chip::from_path(path).map_err(|cause| fault(cause.to_string()))?;
        let lines = chip
            .line_info_iter()
            .map_err(|cause| fault(cause.to_string()))?;
        let mut known = Vec::new();
        for line in lines {
            known.push(line.map_err(|cause| fault(cause.to_string()))?);
        }
        let mut offsets = [0; LINES as usize];
        for (line, offset) in Line::all().zip(&mut offsets) {
            let name = line.to_string();
            let found = known
                .iter()
                .find(|found| found.name == name)
                .ok_or_else(|| {
                    fault(format!(
                        "no line is named {name}; name the lines in the device tree, or give the first line's offset: \
                         gpiochip:{}@OFFSET",
                        path.display()
                    ))
                })?;
            if found.used {
                return Err(fault(format!(
                    "line {name} (offset {}) is held by '{}'",
                    found.offset, found.consumer
                )));
            }
            *offset = found.offset;
        }
        Self::request(path, offsets, enable)
    }

    /// Takes 24 consecutive lines, in the order of their numbers.
    ///
    /// # Errors
    /// As [`CharacterDevice::by_names`].
    pub fn by_offset(path: &Path, first: u32, enable: EnableLevel) -> Result<Self, GpioFault> {
        if first > u32::MAX - LINES {
            let reason = format!("there are no {LINES} lines from offset {first} on");
            return Err(taken(path, reason));
        }
        let mut offsets = [0; LINES as usize];
        for (offset, number) in offsets.iter_mut().zip(first..) {
            *offset = number;
        }
        Self::request(path, offsets, enable)
    }

    fn request(
        path: &Path,
        offsets: [Offset; LINES as usize],
        enable: EnableLevel,
    ) -> Result<Self, GpioFault> {
        let mut builder = Request::builder();
        builder.on_chip(PathBuf::from(path)).with_consumer(CONSUMER);
        for (line, offset) in Line::all().zip(&offsets) {
            builder.with_line(*offset).as_output(Value::Inactive);
            // the kernel inverts active-low lines: an enable that is set is always on
            match (line, enable) {
                (Line::Enable(..), EnableLevel::Low) => builder.as_active_low(),
                _ => builder.as_active_high(),
            };
        }
        let request = builder
            .request()
            .map_err(|cause| taken(path, cause.to_string()))?;
        Ok(Self {
            name: path.display().to_string(),
            request,
            offsets,
        })
    }

    fn fault(&self, attempt: &'static str, cause: gpiocdev::Error) -> GpioFault {
        GpioFault {
            chip: self.name.clone(),
            attempt,
            reason: cause.to_string(),
        }
    }
}

fn taken(path: &Path, reason: String) -> GpioFault {
    GpioFault {
        chip: path.display().to_string(),
        attempt: "taken",
        reason,
    }
}

impl GpioChip for CharacterDevice {
    fn name(&self) -> &str {
        &self.name
    }

    fn set(&mut self, mask: u32, bits: u32) -> Result<(), GpioFault> {
        let mut values = Values::default();
        for (line, offset) in Line::all().zip(self.offsets) {
            if mask & line.mask() != 0 {
                values.set(offset, Value::from(bits & line.mask() != 0));
            }
        }
        let set = self.request.set_values(&values);
        set.map_err(|cause| self.fault("set", cause))
    }

    fn read(&mut self) -> Result<Levels, GpioFault> {
        let mut values = Values::from_offsets(&self.offsets);
        let read = self.request.values(&mut values);
        read.map_err(|cause| self.fault("read", cause))?;
        let bits = Line::all()
            .zip(self.offsets)
            .filter(|(_, offset)| values.get(*offset) == Some(Value::Active))
            .map(|(line, _)| line.mask())
            .sum();
        Ok(Levels(bits))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_chip_is_reported_with_its_path() {
        let path = Path::new("/dev/gpiochip-none");
        for refused in [
            CharacterDevice::by_names(path, EnableLevel::Low),
            CharacterDevice::by_offset(path, 0, EnableLevel::High),
            CharacterDevice::by_offset(path, u32::MAX, EnableLevel::High),
        ] {
            let text = refused.unwrap_err().to_string();
            assert!(
                text.starts_with("the lines of /dev/gpiochip-none cannot be taken: "),
                "{text}"
            );
        }
    }
}
