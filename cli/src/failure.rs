//! Failures of commands, with their exit codes.

use std::error::Error;
use std::process::ExitCode;

use imaging::GeometryError;
use outfile::OutFileError;

/// The kinds of failure, each with its exit code. The message includes advice.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Failure {
    /// An attempt failed.
    #[error("{0}")]
    Failed(String),
    /// The command line is invalid.
    #[error("{0}")]
    Usage(String),
    /// No daemon replies, or there is no such session.
    #[error("{0}")]
    Missing(String),
    /// The daemon refuses commands from this user.
    #[error("{0}")]
    NotAuthorised(String),
    /// An instrument failed, or the daemon stopped because of one.
    #[error("{0}")]
    Instrument(String),
    /// The timeout has expired.
    #[error("{0}")]
    Timeout(String),
    /// The daemon is busy, or a limit is reached: the same command may succeed later.
    #[error("{0}")]
    Busy(String),
    /// A file, model or recording that does not fit.
    #[error("{0}")]
    Configuration(String),
    /// The reader of the output has closed it (`tactus ... | head`): not a failure.
    #[error("the reader of the output has ended")]
    Closed,
    /// A signal requested the program's end: not a failure, and nothing is printed.
    #[error("ended by signal {0}")]
    Signal(u8),
}

impl Failure {
    /// The exit code: 0 done, 1 failed, 2 usage, 3 no daemon, no such session or baseline, 4 not authorised,
    /// 5 instrument fault, 6 timeout, 75 busy (try again later), 78 configuration, 128 and more a signal.
    pub(crate) fn code(&self) -> u8 {
        match self {
            Self::Closed => 0,
            Self::Failed(_) => 1,
            Self::Usage(_) => 2,
            Self::Missing(_) => 3,
            Self::NotAuthorised(_) => 4,
            Self::Instrument(_) => 5,
            Self::Timeout(_) => 6,
            // EX_TEMPFAIL
            Self::Busy(_) => 75,
            Self::Configuration(_) => 78,
            // as a shell reports it
            Self::Signal(number) => number.saturating_add(128),
        }
    }

    /// The kind in one word, as `--json` prints it.
    pub(crate) fn kind(&self) -> &'static str {
        match self {
            Self::Closed => "closed",
            Self::Failed(_) => "failed",
            Self::Usage(_) => "usage",
            Self::Missing(_) => "missing",
            Self::NotAuthorised(_) => "not-authorised",
            Self::Instrument(_) => "instrument",
            Self::Timeout(_) => "timeout",
            Self::Busy(_) => "busy",
            Self::Configuration(_) => "configuration",
            Self::Signal(_) => "signal",
        }
    }

    pub(crate) fn exit_code(&self) -> ExitCode {
        ExitCode::from(self.code())
    }

    /// A failed attempt, with the whole chain of causes in one line.
    pub(crate) fn failed(what: &str, cause: &dyn Error) -> Self {
        Self::Failed(format!("{what}: {}", chain(cause)))
    }

    /// A file or model that does not fit, with the whole chain of causes in one line.
    pub(crate) fn configuration(what: &str, cause: &dyn Error) -> Self {
        Self::Configuration(format!("{what}: {}", chain(cause)))
    }
}

impl From<GeometryError> for Failure {
    fn from(error: GeometryError) -> Self {
        match &error {
            GeometryError::Case { .. } => Self::Failed(chain(&error)),
            GeometryError::Preset(_) | GeometryError::Depth(_) | GeometryError::PresetAndCase => {
                Self::Configuration(chain(&error))
            }
        }
    }
}

impl From<OutFileError> for Failure {
    fn from(error: OutFileError) -> Self {
        Self::Failed(chain(&error))
    }
}

/// An error and its causes, on one line.
pub(crate) use survey::error_chain as chain;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_codes_of_the_design() {
        let text = String::new;
        assert_eq!(Failure::Closed.code(), 0);
        assert_eq!(Failure::Failed(text()).code(), 1);
        assert_eq!(Failure::Usage(text()).code(), 2);
        assert_eq!(Failure::Missing(text()).code(), 3);
        assert_eq!(Failure::NotAuthorised(text()).code(), 4);
        assert_eq!(Failure::Instrument(text()).code(), 5);
        assert_eq!(Failure::Timeout(text()).code(), 6);
        assert_eq!(Failure::Busy(text()).code(), 75);
        assert_eq!(Failure::Configuration(text()).code(), 78);
        assert_eq!(Failure::Signal(15).code(), 143);
    }

    #[test]
    fn a_chain_tells_each_cause_once() {
        #[derive(Debug, thiserror::Error)]
        #[error("inner")]
        struct Inner;
        #[derive(Debug, thiserror::Error)]
        #[error("outer")]
        struct Outer(#[source] Inner);
        #[derive(Debug, thiserror::Error)]
        #[error("outer of {0}")]
        struct Telling(#[source] Inner);
        assert_eq!(chain(&Outer(Inner)), "outer: inner");
        assert_eq!(chain(&Telling(Inner)), "outer of inner");
    }
}
