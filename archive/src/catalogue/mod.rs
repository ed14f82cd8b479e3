//! The catalogue of the archive in PostgreSQL: the parts, their events, the quantities of each minute.

mod connection;
mod error;
mod listing;
mod machines;
mod migrations;
mod rows;
mod sessions;

use std::collections::BTreeMap;

use logbook::QuantityLine;
use tokio_postgres::{Client, Transaction};

pub use connection::Access;
pub use error::CatalogueError;
pub use listing::ArchivedPart;
pub use machines::Machine;
pub use migrations::Migration;
pub(crate) use sessions::Unfound;
pub use sessions::{ArchivedName, ArchivedSession, SessionFilter, SessionName};

use crate::part::Part;
use error::Endpoint;

/// A connection to the catalogue.
#[derive(Debug)]
pub struct Catalogue {
    client: Client,
    endpoint: Endpoint,
}

impl Catalogue {
    /// Connects. Everything but [`Catalogue::migrate`] requires the tables.
    ///
    /// # Errors
    /// The settings are wrong, or the server cannot be reached or refuses.
    pub async fn connect(access: &Access) -> Result<Self, CatalogueError> {
        let (client, endpoint) = connection::connect(access).await?;
        Ok(Self { client, endpoint })
    }

    /// Name of the server, for messages.
    pub fn place(&self) -> &str {
        &self.endpoint.place
    }

    /// Creates the tables, or updates them to the version of this program. Quantities become a hypertable if
    /// TimescaleDB is installed in the database.
    ///
    /// # Errors
    /// Missing rights, or tables of a later version.
    pub async fn migrate(&mut self) -> Result<Migration, CatalogueError> {
        migrations::apply(&mut self.client, &self.endpoint).await
    }

    /// Assigns a site to a role, which may then add and read its rows.
    ///
    /// # Errors
    /// Missing rights, or the site belongs to another role.
    pub async fn add_site(&mut self, site: &str, role: &str) -> Result<(), CatalogueError> {
        self.check_version().await?;
        // a site that is entered stays: it is entered together with the rights of its role, or not at all
        let (transaction, server) = self.begin().await?;
        let insert = "INSERT INTO tactus.site (name, role) VALUES ($1, $2::text::name) ON CONFLICT DO NOTHING";
        server
            .within(transaction.execute(insert, &[&site, &role]))
            .await?;
        let of = "SELECT role::text FROM tactus.site WHERE name = $1";
        let row = server.within(transaction.query_one(of, &[&site])).await?;
        if row.get::<_, &str>(0) != role {
            return Err(CatalogueError::SiteTaken {
                site: site.to_owned(),
                role: role.to_owned(),
            });
        }
        // an identifier cannot be a parameter
        let quoted = "SELECT format('GRANT tactus_uploader TO %I', $1::text)";
        let row = server
            .within(transaction.query_one(quoted, &[&role]))
            .await?;
        server.within(transaction.batch_execute(row.get(0))).await?;
        server.within(transaction.commit()).await
    }

    /// Checks that the tables have the version of this program, and that the site belongs to the role of this
    /// connection.
    ///
    /// # Errors
    /// No tables, tables of another version, no such site, or a site of another role.
    pub async fn check(&self, site: &str) -> Result<(), CatalogueError> {
        self.check_version().await?;
        let state = "SELECT tactus.site_state($1)";
        let row = self.within(self.client.query_one(state, &[&site])).await?;
        let (site, role) = (site.to_owned(), self.endpoint.role.clone());
        match row.get(0) {
            "own" => Ok(()),
            "other" => Err(CatalogueError::SiteTaken { site, role }),
            _ => Err(CatalogueError::NoSite { site, role }),
        }
    }

    /// Checks that the tables have the version of this program.
    ///
    /// # Errors
    /// No tables, or tables of another version.
    pub async fn check_version(&self) -> Result<(), CatalogueError> {
        let has = migrations::version(&self.client, &self.endpoint).await?;
        match has.cmp(&migrations::VERSION) {
            std::cmp::Ordering::Equal => Ok(()),
            std::cmp::Ordering::Less => Err(CatalogueError::NoCatalogue {
                database: self.endpoint.database.clone(),
            }),
            std::cmp::Ordering::Greater => Err(CatalogueError::Newer {
                has,
                knows: migrations::VERSION,
            }),
        }
    }

    /// SHA-256 of each of these parts that the catalogue has, by its name.
    ///
    /// # Errors
    /// The server refuses.
    pub async fn known_parts(
        &self,
        site: &str,
        daq: &str,
        parts: &[&str],
    ) -> Result<BTreeMap<String, String>, CatalogueError> {
        let query = "SELECT part, encode(sha256, 'hex') FROM tactus.part WHERE site = $1 AND daq = $2 AND part = ANY ($3)";
        let rows = self
            .within(self.client.query(query, &[&site, &daq, &parts]))
            .await?;
        Ok(rows.iter().map(|row| (row.get(0), row.get(1))).collect())
    }

    /// Number of the last line of quantities of each of these sessions; sessions without lines are left out.
    ///
    /// # Errors
    /// The server refuses.
    pub async fn known_lines(
        &self,
        site: &str,
        daq: &str,
        sessions: &[&str],
    ) -> Result<BTreeMap<String, u64>, CatalogueError> {
        // one index lookup for each session
        let query = "SELECT wanted, (SELECT max(line) FROM tactus.quantity WHERE site = $1 AND daq = $2 AND session = wanted)
                     FROM unnest($3::text[]) AS wanted";
        let rows = self
            .within(self.client.query(query, &[&site, &daq, &sessions]))
            .await?;
        let lines = rows.iter().filter_map(|row| {
            let last: i32 = row.get::<_, Option<i32>>(1)?;
            Some((row.get(0), u64::try_from(last).unwrap_or_default()))
        });
        Ok(lines.collect())
    }

    /// Enters a stored part with its events and the new lines of quantities of its session, in one transaction. A
    /// part that is already entered with the same content changes nothing.
    ///
    /// # Errors
    /// The part is entered with another content, or the server refuses.
    pub async fn enter(
        &mut self,
        part: &Part,
        lines: &[QuantityLine],
    ) -> Result<(), CatalogueError> {
        let (transaction, server) = self.begin().await?;
        rows::part(&transaction, server, part).await?;
        rows::events(&transaction, server, part).await?;
        let name = &part.name;
        rows::quantities(
            &transaction,
            server,
            (&name.site, &name.daq, &name.session),
            lines,
        )
        .await?;
        server.within(transaction.commit()).await
    }

    /// Enters lines of quantities of a session, in one transaction.
    ///
    /// # Errors
    /// The server refuses.
    pub async fn enter_lines(
        &mut self,
        site: &str,
        daq: &str,
        session: &str,
        lines: &[QuantityLine],
    ) -> Result<(), CatalogueError> {
        let (transaction, server) = self.begin().await?;
        rows::quantities(&transaction, server, (site, daq, session), lines).await?;
        server.within(transaction.commit()).await
    }

    /// Begins a transaction.
    async fn begin(&mut self) -> Result<(Transaction<'_>, &Endpoint), CatalogueError> {
        let server = &self.endpoint;
        let transaction = server.within(self.client.transaction()).await?;
        // a receipt follows: the commit must be on the server's disk, whatever its configuration
        server
            .within(transaction.batch_execute("SET LOCAL synchronous_commit = on"))
            .await?;
        Ok((transaction, server))
    }

    async fn within<T>(
        &self,
        answer: impl Future<Output = Result<T, tokio_postgres::Error>>,
    ) -> Result<T, CatalogueError> {
        self.endpoint.within(answer).await
    }
}

#[cfg(test)]
mod tests {
    use tokio::io::{AsyncReadExt, AsyncWriteExt, duplex};
    use tokio_postgres::{Config, NoTls};

    use super::*;

    #[tokio::test(start_paused = true)]
    async fn version_of_a_silent_server_is_not_awaited_for_ever() {
        let (near, mut far) = duplex(4096);
        // accepts the login, and then sends nothing
        let login = async {
            let mut request = [0; 512];
            assert!(far.read(&mut request).await.unwrap() > 0);
            let accepted = b"R\0\0\0\x08\0\0\0\0Z\0\0\0\x05I";
            far.write_all(accepted).await.unwrap();
        };
        let mut config = Config::new();
        config.user("berlin");
        let (opened, ()) = tokio::join!(config.connect_raw(near, NoTls), login);
        let (client, connection) = opened.unwrap();
        tokio::spawn(async move { drop(connection.await) });
        let endpoint = Endpoint {
            place: "silent".to_owned(),
            role: "berlin".to_owned(),
            database: "tactus".to_owned(),
            ca: None,
        };
        let error = Catalogue { client, endpoint }.check_version().await;
        let error = error.unwrap_err();
        assert!(matches!(error, CatalogueError::Late { .. }), "{error}");
    }
}
