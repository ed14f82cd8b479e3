//! Errors of the catalogue, with texts that name the remedy.

use std::error::Error;
use std::time::Duration;

use tokio_postgres::error::SqlState;

use crate::credentials::is_about_tls;

/// Timeout of one reply of the server.
const ANSWER: Duration = Duration::from_secs(60);

/// Errors of the catalogue.
#[derive(Debug, thiserror::Error)]
pub enum CatalogueError {
    /// The text of `dsn` is wrong.
    #[error("archive.dsn: {0}")]
    Dsn(String),
    /// The file of certificates is wrong.
    #[error("archive.ca: {0}")]
    Ca(String),
    /// The password cannot be read.
    #[error("archive.password_file: {0}")]
    Password(String),
    /// The server cannot be reached.
    #[error(
        "cannot reach PostgreSQL at {place}; it may be down, or archive.dsn has the wrong address"
    )]
    Unreachable {
        /// Hosts and port.
        place: String,
        /// The cause.
        #[source]
        source: Box<dyn Error + Send + Sync>,
    },
    /// The server's certificate is not trusted, or it has none.
    #[error(
        "no trusted connection to PostgreSQL at {place}: its certificate must be issued by {ca} for this host name"
    )]
    Untrusted {
        /// Hosts and port.
        place: String,
        /// The file of certificates.
        ca: String,
        /// The cause.
        #[source]
        source: Box<dyn Error + Send + Sync>,
    },
    /// Role or password are wrong.
    #[error(
        "PostgreSQL at {place} refuses the login of role '{role}': create the role there, or correct user and archive.password_file"
    )]
    Login {
        /// Hosts and port.
        place: String,
        /// The role.
        role: String,
        /// The cause.
        #[source]
        source: tokio_postgres::Error,
    },
    /// The database does not exist.
    #[error(
        "PostgreSQL at {place} has no database '{database}': create it (`createdb {database}`), or correct dbname in archive.dsn"
    )]
    NoDatabase {
        /// Hosts and port.
        place: String,
        /// The database.
        database: String,
    },
    /// The tables do not exist.
    #[error(
        "database '{database}' has no catalogue of this version: its owner runs `tactus-archive migrate`"
    )]
    NoCatalogue {
        /// The database.
        database: String,
    },
    /// The tables are of a later version of this program.
    #[error(
        "the catalogue has version {has}, this program knows {knows}: update tactus-archive on this machine"
    )]
    Newer {
        /// Version of the database.
        has: i32,
        /// Version of this program.
        knows: i32,
    },
    /// The role lacks rights.
    #[error(
        "role '{role}' may not do this: {why}; the owner of the catalogue runs `tactus-archive add-site SITE --role {role}`, or, for a role that only reads, `GRANT tactus_reader TO {role}`"
    )]
    NoRights {
        /// The role.
        role: String,
        /// The server's message.
        why: String,
    },
    /// The site belongs to another role.
    #[error(
        "site '{site}' belongs to another role than '{role}': choose another name in archive.site, or use the role of that site"
    )]
    SiteTaken {
        /// The site.
        site: String,
        /// The role.
        role: String,
    },
    /// The site does not exist.
    #[error(
        "the catalogue has no site '{site}': its owner runs `tactus-archive add-site {site} --role {role}`"
    )]
    NoSite {
        /// The site.
        site: String,
        /// The role.
        role: String,
    },
    /// A part of this name exists with another content.
    #[error(
        "{part} is in the archive with another content (SHA-256 {archived}, this file has {found}): one of them was altered, or two machines use the name {site}/{daq}; the archive keeps its copy"
    )]
    Conflict {
        /// The part.
        part: String,
        /// The site.
        site: String,
        /// The machine.
        daq: String,
        /// Hash in the catalogue.
        archived: String,
        /// Hash of this file.
        found: String,
    },
    /// No reply in time.
    #[error("PostgreSQL at {place} did not reply within {seconds} s")]
    Late {
        /// Hosts and port.
        place: String,
        /// The limit, s.
        seconds: u64,
    },
    /// Another error of the server or the connection.
    #[error("PostgreSQL at {place} refuses")]
    Refused {
        /// Hosts and port.
        place: String,
        /// The cause.
        #[source]
        source: tokio_postgres::Error,
    },
}

impl CatalogueError {
    /// Whether a retry may succeed without a change of the configuration, the roles or the part.
    pub fn is_temporary(&self) -> bool {
        match self {
            Self::Unreachable { .. } | Self::Late { .. } => true,
            // connection lost, server shutting down, out of space or connections
            Self::Refused { source, .. } => source.code().is_none_or(|code| {
                matches!(code.code().get(..2), Some("08" | "40" | "53" | "57" | "58"))
            }),
            _ => false,
        }
    }
}

/// The names used in messages about a connection.
#[derive(Debug, Clone)]
pub(super) struct Endpoint {
    pub place: String,
    pub role: String,
    pub database: String,
    pub ca: Option<String>,
}

impl Endpoint {
    /// Applies the timeout to a reply.
    pub(super) async fn within<T>(
        &self,
        answer: impl Future<Output = Result<T, tokio_postgres::Error>>,
    ) -> Result<T, CatalogueError> {
        match tokio::time::timeout(ANSWER, answer).await {
            Ok(answer) => answer.map_err(|error| self.refused(error)),
            Err(_) => Err(CatalogueError::Late {
                place: self.place.clone(),
                seconds: ANSWER.as_secs(),
            }),
        }
    }

    /// The error of an attempt to connect.
    pub(super) fn not_connected(&self, source: tokio_postgres::Error) -> CatalogueError {
        let place = self.place.clone();
        match source.code() {
            Some(&SqlState::INVALID_PASSWORD | &SqlState::INVALID_AUTHORIZATION_SPECIFICATION) => {
                CatalogueError::Login {
                    place,
                    role: self.role.clone(),
                    source,
                }
            }
            Some(&SqlState::INVALID_CATALOG_NAME) => CatalogueError::NoDatabase {
                place,
                database: self.database.clone(),
            },
            Some(_) => self.refused(source),
            // the library has no error type for some of these causes
            None if is_about_tls(&source) || source.to_string().contains("TLS") => {
                CatalogueError::Untrusted {
                    place,
                    ca: self
                        .ca
                        .clone()
                        .unwrap_or_else(|| "archive.ca, which is not given,".into()),
                    source: source.into(),
                }
            }
            None if is_about_password(&source) => CatalogueError::Login {
                place,
                role: self.role.clone(),
                source,
            },
            None => CatalogueError::Unreachable {
                place,
                source: source.into(),
            },
        }
    }

    /// The error of a statement.
    pub(super) fn refused(&self, source: tokio_postgres::Error) -> CatalogueError {
        let place = self.place.clone();
        match source.code() {
            Some(&SqlState::INSUFFICIENT_PRIVILEGE) => CatalogueError::NoRights {
                role: self.role.clone(),
                why: source
                    .as_db_error()
                    .map_or_else(|| source.to_string(), |cause| cause.message().to_owned()),
            },
            Some(
                &SqlState::UNDEFINED_TABLE
                | &SqlState::INVALID_SCHEMA_NAME
                | &SqlState::UNDEFINED_FUNCTION
                | &SqlState::UNDEFINED_COLUMN,
            ) => CatalogueError::NoCatalogue {
                database: self.database.clone(),
            },
            _ => CatalogueError::Refused { place, source },
        }
    }
}

fn is_about_password(error: &tokio_postgres::Error) -> bool {
    // the library has no error type for these causes
    std::iter::successors(error.source(), |cause| (*cause).source())
        .any(|cause| cause.to_string().contains("password missing"))
}
