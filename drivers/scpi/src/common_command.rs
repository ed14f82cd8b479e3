//! Common commands of IEEE 488.2 as values, shared by the SCPI instruments of this workspace.

use std::fmt;

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

impl Common {
    /// Parses a call as a common command; `None` if its header is not one of these.
    pub fn of(call: &Call) -> Option<Result<Self, ParseError>> {
        if !call.common {
            return None;
        }
        let keyword = call.header.first()?.to_ascii_uppercase();
        let plain = |command: Common| Some(call.exactly::<0>().map(|_| command));
        let byte = |command: fn(u8) -> Common| {
            let value = call
                .exactly::<1>()
                .and_then(|[value]| value.integer(0, 255));
            // `integer` checks the limits of u8.
            Some(value.map(|value| command(value as u8)))
        };
        match (keyword.as_str(), call.query) {
            ("IDN", true) => plain(Common::Identify),
            ("RST", false) => plain(Common::Reset),
            ("CLS", false) => plain(Common::ClearStatus),
            ("ESE", false) => byte(Common::SetEventEnable),
            ("ESE", true) => plain(Common::EventEnable),
            ("ESR", true) => plain(Common::Events),
            ("SRE", false) => byte(Common::SetServiceEnable),
            ("SRE", true) => plain(Common::ServiceEnable),
            ("STB", true) => plain(Common::StatusByte),
            ("OPC", false) => plain(Common::OperationComplete),
            ("OPC", true) => plain(Common::WhenComplete),
            ("WAI", false) => plain(Common::Wait),
            ("TST", true) => plain(Common::SelfTest),
            ("TRG", false) => plain(Common::Trigger),
            _ => None,
        }
    }

    /// Whether the command has a reply.
    pub fn is_query(self) -> bool {
        matches!(
            self,
            Common::Identify
                | Common::EventEnable
                | Common::Events
                | Common::ServiceEnable
                | Common::StatusByte
                | Common::WhenComplete
                | Common::SelfTest
        )
    }
}

impl fmt::Display for Common {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Common::Identify => f.write_str("*IDN?"),
            Common::Reset => f.write_str("*RST"),
            Common::ClearStatus => f.write_str("*CLS"),
            Common::SetEventEnable(mask) => write!(f, "*ESE {mask}"),
            Common::EventEnable => f.write_str("*ESE?"),
            Common::Events => f.write_str("*ESR?"),
            Common::SetServiceEnable(mask) => write!(f, "*SRE {mask}"),
            Common::ServiceEnable => f.write_str("*SRE?"),
            Common::StatusByte => f.write_str("*STB?"),
            Common::OperationComplete => f.write_str("*OPC"),
            Common::WhenComplete => f.write_str("*OPC?"),
            Common::Wait => f.write_str("*WAI"),
            Common::SelfTest => f.write_str("*TST?"),
            Common::Trigger => f.write_str("*TRG"),
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
