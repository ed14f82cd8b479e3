//! The one place that waits on a wire.

/// Bad news from a wire.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// No complete answer before the deadline. The link is out of step until it is reopened or resynchronised.
    #[error("{instrument} did not answer '{message}' within {deadline:?}")]
    Timeout {
        /// Name and address.
        instrument: String,
        /// What was sent, shortened.
        message: String,
        /// How long it was waited for.
        deadline: std::time::Duration,
    },
    /// The peer closed, or the connection broke.
    #[error("the connection to {instrument} was lost at '{message}'")]
    Lost {
        /// Name and address.
        instrument: String,
        /// What was being sent or awaited, shortened.
        message: String,
        /// What the operating system says, if anything.
        #[source]
        cause: Option<std::io::Error>,
    },
    /// The link is out of step after an earlier timeout: a late reply could be taken for the next answer.
    #[error(
        "the link to {instrument} is out of step after an earlier fault; reconnect before asking again"
    )]
    OutOfStep {
        /// Name and address.
        instrument: String,
    },
    /// The peer sent something nobody asked for.
    #[error("{instrument} sent '{text}' that was not asked for")]
    Unsolicited {
        /// Name and address.
        instrument: String,
        /// What came, shortened.
        text: String,
    },
    /// A reply longer than any that was asked for.
    #[error("{instrument} answered '{message}' with more than {most} bytes")]
    TooLong {
        /// Name and address.
        instrument: String,
        /// What was sent, shortened.
        message: String,
        /// The bound.
        most: usize,
    },
}
