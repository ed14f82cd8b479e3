//! One unit of a message: its header and its arguments.

use crate::{Argument, ParseError};

/// One unit of a message.
#[derive(Debug, Clone, PartialEq)]
pub struct Call {
    /// The keywords of the full header from the root, as written; for a common command the one keyword without `*`.
    pub header: Vec<String>,
    /// Whether this is a common command (`*...`).
    pub common: bool,
    /// Whether the header ends with `?`.
    pub query: bool,
    /// The arguments in order.
    pub arguments: Vec<Argument>,
}

impl Call {
    /// The arguments, if there are exactly `N`.
    ///
    /// # Errors
    /// -109 for fewer, -108 for more.
    pub fn exactly<const N: usize>(&self) -> Result<&[Argument; N], ParseError> {
        if self.arguments.len() > N {
            return Err(ParseError::ParameterNotAllowed);
        }
        self.arguments
            .as_slice()
            .try_into()
            .map_err(|_| ParseError::MissingParameter)
    }

    /// The only argument, or `None` if there are no arguments.
    ///
    /// # Errors
    /// -108 for more than one.
    pub fn at_most_one(&self) -> Result<Option<&Argument>, ParseError> {
        match self.arguments.as_slice() {
            [] => Ok(None),
            [only] => Ok(Some(only)),
            _ => Err(ParseError::ParameterNotAllowed),
        }
    }
}
