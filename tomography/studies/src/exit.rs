//! The exit codes of `tactus-lab`, and what the scheduler of a cluster does with each.

/// How a command ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Exit {
    /// Done.
    Done,
    /// Failed: a file, a full disk, a case that cannot be solved, a broken bound.
    Failed,
    /// A wrong command line, or settings that differ from those of existing shards.
    Usage,
    /// Another process makes this shard, or SIGTERM: the shard is incomplete and can be continued.
    TryAgain,
    /// A file with settings that cannot be used.
    Configuration,
}

/// One line of the table.
#[derive(Debug)]
pub struct ExitRow {
    /// How a command ends.
    pub exit: Exit,
    /// The exit code, of `sysexits.h` where it has one.
    pub code: u8,
    /// `kind` of the line of JSON on standard error.
    pub kind: &'static str,
    /// What a scheduler does with a shard that ends so.
    pub scheduler: &'static str,
}

/// Every way to end. A process that is ended by a signal (128 + its number in a shell) is also run again; SIGKILL and a
/// power cut leave a shard that can be continued.
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
    /// Its line of the table.
    pub fn row(self) -> &'static ExitRow {
        EXIT_TABLE
            .iter()
            .find(|row| row.exit == self)
            .expect("the table has every variant")
    }
}
