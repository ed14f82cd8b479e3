//! Common commands of IEEE 488.2 as values, shared by the SCPI instruments of this workspace.

use std::fmt;
use std::mem::discriminant;

use crate::{Call, ParseError};

/// A common command.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Common {
    /// `*IDN?`: maker, model, serial number, firmware.
    Identify,
    /// `*RST`: reset the settings to their values after power on.
    Reset,
    /// `*CLS`: clear the event registers and the error queue.
    ClearStatus,
    /// `*ESE`: enable mask of the standard event register.
    SetEventEnable(u8),
    /// `*ESE?`
    EventEnable,
    /// `*ESR?`: the standard events, cleared by reading.
    Events,
    /// `*SRE`: enable mask of the service request.
    SetServiceEnable(u8),
    /// `*SRE?`
    ServiceEnable,
    /// `*STB?`: the status byte.
    StatusByte,
    /// `*OPC`: set bit 0 of the standard events when all pending operations are complete.
    OperationComplete,
    /// `*OPC?`: reply 1 when all pending operations are complete.
    WhenComplete,
    /// `*WAI`: execute no further command before all pending operations are complete.
    Wait,
    /// `*TST?`: 0 when the self-test passes.
    SelfTest,
    /// `*TRG`: a trigger from the bus.
    Trigger,
}

/// The header of each command, here with an argument of 0 if it has one.
const HEADERS: [(&str, Common); 14] = [
    ("*IDN?", Common::Identify),
    ("*RST", Common::Reset),
    ("*CLS", Common::ClearStatus),
    ("*ESE", Common::SetEventEnable(0)),
    ("*ESE?", Common::EventEnable),
    ("*ESR?", Common::Events),
    ("*SRE", Common::SetServiceEnable(0)),
    ("*SRE?", Common::ServiceEnable),
    ("*STB?", Common::StatusByte),
    ("*OPC", Common::OperationComplete),
    ("*OPC?", Common::WhenComplete),
    ("*WAI", Common::Wait),
    ("*TST?", Common::SelfTest),
    ("*TRG", Common::Trigger),
];

impl Common {
    /// Parses a call as a common command; `None` if its header is not one of these.
    pub fn of(call: &Call) -> Option<Result<Self, ParseError>> {
        if !call.common {
            return None;
        }
        let mark = if call.query { "?" } else { "" };
        let header = format!("*{}{mark}", call.header.first()?.to_ascii_uppercase());
        let mut rows = HEADERS.iter();
        let (_, command) = rows.find(|(known, _)| *known == header)?;
        let mask = || {
            let [mask] = call.exactly()?;
            // The limits are those of u8.
            mask.integer(0, 255).map(|mask| mask as u8)
        };
        Some(match command {
            Common::SetEventEnable(_) => mask().map(Common::SetEventEnable),
            Common::SetServiceEnable(_) => mask().map(Common::SetServiceEnable),
            plain => call.exactly::<0>().map(|_| *plain),
        })
    }

    fn header(self) -> &'static str {
        let same = |row: &&(&str, Common)| discriminant(&row.1) == discriminant(&self);
        HEADERS.iter().find(same).map_or("", |(header, _)| *header)
    }

    /// Whether the command has a reply.
    pub fn is_query(self) -> bool {
        self.header().ends_with('?')
    }
}

impl fmt::Display for Common {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.header())?;
        match self {
            Common::SetEventEnable(mask) | Common::SetServiceEnable(mask) => write!(f, " {mask}"),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parse_message;

    fn parsed(message: &str) -> Option<Result<Common, ParseError>> {
        Common::of(parse_message(message)[0].as_ref().unwrap())
    }

    #[test]
    fn formatted_commands_parse_again() {
        for text in [
            Common::Identify,
            Common::Reset,
            Common::ClearStatus,
            Common::SetEventEnable(60),
            Common::EventEnable,
            Common::Events,
            Common::SetServiceEnable(255),
            Common::ServiceEnable,
            Common::StatusByte,
            Common::OperationComplete,
            Common::WhenComplete,
            Common::Wait,
            Common::SelfTest,
            Common::Trigger,
        ] {
            assert_eq!(parsed(&text.to_string()), Some(Ok(text)), "{text}");
            assert_eq!(text.is_query(), text.to_string().ends_with('?'));
        }
    }

    #[test]
    fn unknown_and_forbidden_common_commands_differ() {
        assert_eq!(parsed("ESE 1"), None);
        assert_eq!(parsed("*XYZ?"), None);
        assert_eq!(parsed("*RST?"), None);
        assert_eq!(parsed("*ESE"), Some(Err(ParseError::MissingParameter)));
        assert_eq!(parsed("*ESE 256"), Some(Err(ParseError::OutOfRange)));
        assert_eq!(
            parsed("*ESE ON"),
            Some(Err(ParseError::CharacterNotAllowed))
        );
        assert_eq!(parsed("*RST 1"), Some(Err(ParseError::ParameterNotAllowed)));
    }
}
