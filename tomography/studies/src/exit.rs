//! The exit codes of `tactus-lab`, and the reaction of a cluster's scheduler to each.

/// Result of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Exit {
    /// Done.
    Done,
    /// Failed: a file, a full disk, a case that cannot be solved, a broken bound.
    Failed,
    /// An invalid command line, or settings that differ from those of existing shards.
    Usage,
    /// Another process is making this shard, or SIGTERM was received: the shard is incomplete and can be continued.
    TryAgain,
    /// A file with settings that cannot be used.
    Configuration,
}

/// One row of the table.
#[derive(Debug)]
pub struct ExitRow {
    /// Result of a command.
    pub exit: Exit,
    /// The exit code, from `sysexits.h` if that defines one.
    pub code: u8,
    /// `kind` of the line of JSON on standard error.
    pub kind: &'static str,
    /// What a scheduler does with a shard that ends with this code.
    pub scheduler: &'static str,
}

/// All exit codes. A process that was terminated by a signal (exit code 128 + its number in a shell) is also run again;
/// after SIGKILL or a power cut the shard can be continued.
pub const EXIT_TABLE: [ExitRow; 5] = [
    row(Exit::Done, 0, "done", "complete"),
    row(Exit::Failed, 1, "failed", "run again a few times at most"),
    row(Exit::Usage, 2, "usage", "never run again"),
    row(Exit::TryAgain, 75, "busy", "run again"),
    row(Exit::Configuration, 78, "configuration", "never run again"),
];

const fn row(exit: Exit, code: u8, kind: &'static str, scheduler: &'static str) -> ExitRow {
    ExitRow {
        exit,
        code,
        kind,
        scheduler,
    }
}

impl Exit {
    /// Its row of the table.
    pub fn row(self) -> &'static ExitRow {
        EXIT_TABLE
            .iter()
            .find(|row| row.exit == self)
            .expect("the table has every variant")
    }
}
