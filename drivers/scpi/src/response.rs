//! What a simulated instrument returns for a message.

use std::time::Duration;

/// A simulated instrument's response to a message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Response {
    /// The replies of the message's queries joined by `;`, without line end; `None` without a reply.
    pub text: Option<String>,
    /// Time that the instrument needs for the message.
    pub busy: Duration,
}
