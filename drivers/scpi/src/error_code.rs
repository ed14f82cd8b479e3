//! Error numbers that SCPI-99 defines for messages that an instrument cannot carry out.

macro_rules! parse_errors {
    ($($(#[$doc:meta])* $name:ident = $code:literal, $text:literal;)*) => {
        /// Why an instrument rejects a message, with the number and text of SCPI-99 volume 2, section 21.8.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, thiserror::Error)]
        #[error("{},\"{}\"", self.code(), self.text())]
        pub enum ParseError {
            $($(#[$doc])* $name,)*
        }

        impl ParseError {
            /// All errors, in the order of the magnitude of their numbers.
            pub const ALL: &'static [ParseError] = &[$(ParseError::$name,)*];

            /// The error number of the standard; always negative.
            pub fn code(self) -> i32 {
                match self { $(ParseError::$name => $code,)* }
            }

            /// The error text of the standard.
            pub fn text(self) -> &'static str {
                match self { $(ParseError::$name => $text,)* }
            }
        }
    };
}

parse_errors! {
    /// A byte that cannot start any syntax element.
    InvalidCharacter = -101, "Invalid character";
    /// A unit that does not follow the grammar.
    Syntax = -102, "Syntax error";
    /// Another character where a comma, blank or semicolon was expected.
    InvalidSeparator = -103, "Invalid separator";
    /// An argument of the wrong type.
    DataType = -104, "Data type error";
    /// More arguments than the command takes.
    ParameterNotAllowed = -108, "Parameter not allowed";
    /// Fewer arguments than the command needs.
    MissingParameter = -109, "Missing parameter";
    /// A keyword longer than twelve characters.
    MnemonicTooLong = -112, "Program mnemonic too long";
    /// A header this instrument does not have.
    UndefinedHeader = -113, "Undefined header";
    /// A numeric suffix of a keyword that this instrument does not have.
    HeaderSuffixOutOfRange = -114, "Header suffix out of range";
    /// A number that does not follow the grammar.
    InvalidNumber = -121, "Invalid character in number";
    /// A number too large to represent.
    ExponentTooLarge = -123, "Exponent too large";
    /// A number where none is allowed.
    NumericNotAllowed = -128, "Numeric data not allowed";
    /// A unit that is unknown or belongs to another quantity.
    InvalidSuffix = -131, "Invalid suffix";
    /// A unit where none is allowed.
    SuffixNotAllowed = -138, "Suffix not allowed";
    /// A word that is not one of the allowed words.
    InvalidCharacterData = -141, "Invalid character data";
    /// A word where none is allowed.
    CharacterNotAllowed = -148, "Character data not allowed";
    /// A string without closing quote.
    InvalidString = -151, "Invalid string data";
    /// A string where none is allowed.
    StringNotAllowed = -158, "String data not allowed";
    /// A block whose length and content disagree.
    InvalidBlock = -161, "Invalid block data";
    /// A block where none is allowed.
    BlockNotAllowed = -168, "Block data not allowed";
    /// An expression without closing parenthesis, or an invalid channel list.
    InvalidExpression = -171, "Invalid expression";
    /// An expression where none is allowed.
    ExpressionNotAllowed = -178, "Expression data not allowed";
    /// A trigger arrived while none was awaited.
    TriggerIgnored = -211, "Trigger ignored";
    /// A measurement is already running.
    InitIgnored = -213, "Init ignored";
    /// A valid value that conflicts with the present settings.
    SettingsConflict = -221, "Settings conflict";
    /// A number outside its limits.
    OutOfRange = -222, "Data out of range";
    /// More data than fits.
    TooMuchData = -223, "Too much data";
    /// A value that is not one of those allowed.
    IllegalParameter = -224, "Illegal parameter value";
    /// Data that are old or damaged.
    DataStale = -230, "Data corrupt or stale";
    /// An option that is not installed.
    HardwareMissing = -241, "Hardware missing";
    /// The error queue was full.
    QueueOverflow = -350, "Queue overflow";
    /// A message longer than the input buffer.
    InputOverrun = -363, "Input buffer overrun";
    /// A new message came before the reply was read.
    QueryInterrupted = -410, "Query INTERRUPTED";
    /// A reply was read although no query had been received.
    QueryUnterminated = -420, "Query UNTERMINATED";
    /// Both buffers full.
    QueryDeadlocked = -430, "Query DEADLOCKED";
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_descend_and_are_unique() {
        for pair in ParseError::ALL.windows(2) {
            assert!(pair[0].code() > pair[1].code(), "{pair:?}");
        }
    }

    #[test]
    fn a_parse_error_prints_as_the_error_queue_does() {
        assert_eq!(
            ParseError::UndefinedHeader.to_string(),
            "-113,\"Undefined header\""
        );
    }
}
