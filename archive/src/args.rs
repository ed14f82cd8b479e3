//! The command line of `tactus-archive`.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};

use crate::catalogue::ArchivedName;

const EXIT_CODES: &str = "Exit codes: 0 done, 1 failed or not everything is archived, 2 usage, 3 no such session, 75 store or \
                          catalogue cannot be reached now: try again later, 78 configuration";

/// Copies closed parts of sessions to the archive: files to a store, their catalogue to PostgreSQL.
#[derive(Debug, Parser)]
#[command(name = "tactus-archive", version, max_term_width = 100, after_long_help = EXIT_CODES)]
pub(crate) struct Arguments {
    /// The configuration of the daemon, with a section [archive]; relative paths in it are relative to its folder.
    #[arg(
        long,
        value_name = "FILE",
        default_value = "/etc/tactus/config.toml",
        global = true
    )]
    pub config: PathBuf,
    /// Print one JSON object per line.
    #[arg(long, global = true)]
    pub json: bool,
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    #[command(flatten)]
    Task(Task),
    /// Archive everything that is not archived yet, periodically; publish live topics if the configuration has [mqtt]
    Run,
    /// Create the tables of the catalogue, or update them to this version (as the owner of the database)
    Migrate,
    /// Assign a site to a role of PostgreSQL, so that the role can add and read its rows (as the owner of the database)
    AddSite(AddSite),
}

/// What `tactus archive` does too.
#[derive(Debug, Subcommand)]
pub enum Task {
    /// Archive everything that is not archived yet, once
    Push,
    /// Compare the record of this machine with the catalogue
    Status,
    /// Copy the parts of a session from the archive, each verified by its hash
    Pull(Pull),
    /// Read every part in the store and compare it with the catalogue
    Verify(Filter),
}

/// Of which machines.
#[derive(Debug, Args)]
pub struct Filter {
    /// Only of this site [default: all that the role may see]
    #[arg(long, value_name = "NAME")]
    pub site: Option<String>,
    /// Only of this machine [default: all]
    #[arg(long, value_name = "NAME")]
    pub daq: Option<String>,
}

/// Options of `pull`.
#[derive(Debug, Args)]
pub struct Pull {
    /// Session: SITE/DAQ/SESSION, its id, the beginning of one, or `last`
    pub session: ArchivedName,
    /// Existing folder for the files; a file that is there already is kept and verified
    #[arg(long, value_name = "FOLDER")]
    pub into: PathBuf,
    /// The machines that are searched.
    #[command(flatten)]
    pub of: Filter,
}

#[derive(Debug, Args)]
pub(crate) struct AddSite {
    /// The site: a to z, 0 to 9, _ and -
    pub site: String,
    /// An existing role that may log in
    #[arg(long, value_name = "ROLE")]
    pub role: String,
}
