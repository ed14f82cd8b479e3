//! Parsers of arguments that several chapters share.

use scpi::{Argument, Call, ChannelList, Numeric, ParseError, Unit};

use super::{Channels, Command};

/// Headers with their commands.
pub(super) type Table = scpi::Table<Command>;

/// Reads a channel list as the only argument.
pub(super) fn list(call: &Call) -> Result<ChannelList, ParseError> {
    let [channels] = call.exactly()?;
    channels.channels()
}

/// Reads a channel list or no arguments.
pub(super) fn only_channels(call: &Call) -> Result<Channels, ParseError> {
    call.at_most_one()?.map(Argument::channels).transpose()
}

/// Splits the arguments into those before the channel list and the list, which can only be the last argument.
pub(super) fn before_channels(call: &Call) -> Result<(&[Argument], Channels), ParseError> {
    match call.arguments.split_last() {
        Some((last @ Argument::Expression(_), values)) => Ok((values, Some(last.channels()?))),
        _ => Ok((&call.arguments, None)),
    }
}

/// Reads exactly one value before an optional channel list.
pub(super) fn value_and_channels(call: &Call) -> Result<(&Argument, Channels), ParseError> {
    match before_channels(call)? {
        ([], _) => Err(ParseError::MissingParameter),
        ([value], channels) => Ok((value, channels)),
        _ => Err(ParseError::ParameterNotAllowed),
    }
}

/// Reads MIN, MAX or DEF, if a query has this argument; other arguments are errors.
pub(super) fn limit(argument: Option<&Argument>) -> Result<Option<Numeric>, ParseError> {
    let Some(argument) = argument else {
        return Ok(None);
    };
    match argument.number(Unit::None)? {
        limit @ (Numeric::Min | Numeric::Max | Numeric::Def) => Ok(Some(limit)),
        _ => Err(ParseError::IllegalParameter),
    }
}

/// Reads a number from 1 to `most`, also with the prefix of the manuals (`SLOT3`, `ABUS2`); `None` for the word `all`
/// and for a missing argument.
pub(super) fn one_or(
    argument: Option<&Argument>,
    prefix: &str,
    all: &str,
    most: i64,
) -> Result<Option<u32>, ParseError> {
    match argument {
        None => Ok(None),
        Some(Argument::Word(word)) if word.eq_ignore_ascii_case(all) => Ok(None),
        Some(argument) => numbered(argument, prefix, most).map(Some),
    }
}

/// Reads a number from 1 to `most`, also with a prefix.
pub(super) fn numbered(argument: &Argument, prefix: &str, most: i64) -> Result<u32, ParseError> {
    let number = match argument {
        Argument::Word(word) => {
            let upper = word.to_ascii_uppercase();
            let digits = upper.strip_prefix(prefix);
            let number: i64 = digits
                .and_then(|digits| digits.parse().ok())
                .ok_or(ParseError::IllegalParameter)?;
            (1..=most)
                .contains(&number)
                .then_some(number)
                .ok_or(ParseError::OutOfRange)?
        }
        number => number.integer(1, most)?,
    };
    // `most` is 8 at the most.
    Ok(number as u32)
}
