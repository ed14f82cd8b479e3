//! Errors of a connection.

use std::time::Duration;

/// Longest text repeated in an error message, characters.
const LONGEST_EXCERPT: usize = 60;

/// An error of a connection.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// No connection to the address, or the port cannot be opened.
    #[error(
        "{address} cannot be reached; check the address, the cable and that the instrument is on"
    )]
    Unreachable {
        /// Host and port, or path of the serial port.
        address: String,
        /// Error of the operating system.
        #[source]
        cause: std::io::Error,
    },
    /// No complete reply before the timeout. The link is unsynchronised until its stream is replaced or it is
    /// resynchronised.
    #[error("{instrument} did not answer{} within {deadline:?}", quoted(.message))]
    Timeout {
        /// Name and address.
        instrument: String,
        /// The message that was sent, shortened.
        message: String,
        /// The timeout.
        deadline: Duration,
    },
    /// The peer closed, or the connection broke.
    #[error("the connection to {instrument} was lost{}", at(.message))]
    Lost {
        /// Name and address.
        instrument: String,
        /// The message being sent, or whose reply was awaited, shortened; empty without one.
        message: String,
        /// Error of the operating system, if any.
        #[source]
        cause: Option<std::io::Error>,
    },
    /// The link is unsynchronised after an earlier fault: a late reply could be taken for the next one.
    #[error(
        "the link to {instrument} is not synchronised after an earlier fault; reconnect before the next message"
    )]
    Unsynchronised {
        /// Name and address.
        instrument: String,
    },
    /// The peer sent data without a query.
    #[error("{instrument} sent '{text}' without a query")]
    Unsolicited {
        /// Name and address.
        instrument: String,
        /// The data received, shortened.
        text: String,
    },
    /// A reply longer than the limit.
    #[error("{instrument} answered '{message}' with more than {most} bytes")]
    TooLong {
        /// Name and address.
        instrument: String,
        /// The message that was sent, shortened.
        message: String,
        /// The bound.
        most: usize,
    },
    /// A reply that is not text.
    #[error("{instrument} answered '{message}' with bytes that are not text")]
    NotText {
        /// Name and address.
        instrument: String,
        /// The message that was sent, shortened.
        message: String,
    },
    /// A message that contains a line end would be two messages.
    #[error("the message '{message}' to {instrument} holds a line end; send one message at a time")]
    LineEnd {
        /// Name and address.
        instrument: String,
        /// The message to be sent, shortened.
        message: String,
    },
}

fn quoted(message: &str) -> String {
    match message {
        "" => String::new(),
        message => format!(" '{message}'"),
    }
}

fn at(message: &str) -> String {
    match message {
        "" => String::new(),
        message => format!(" at '{message}'"),
    }
}

/// The beginning of a text, with `...` where more follows.
pub(super) fn shorten(text: &str) -> String {
    let mut shortened: String = text.chars().take(LONGEST_EXCERPT).collect();
    if shortened.len() < text.len() {
        shortened.push_str("...");
    }
    shortened
}
