//! Connections to PostgreSQL: settings, TLS, password.

use std::path::PathBuf;
use std::time::Duration;

use tokio_postgres::config::{Host, SslMode};
use tokio_postgres::tls::MakeTlsConnect;
use tokio_postgres::{Client, Config, NoTls, Socket};
use tokio_postgres_rustls::MakeRustlsConnect;

use super::error::{CatalogueError, Endpoint};
use crate::credentials::{is_loopback, secret, trusting};

/// Timeout of a connection attempt.
const CONNECT: Duration = Duration::from_secs(10);
/// Name of the systemd credential with the password.
const CREDENTIAL: &str = "archive-password";

/// Where the catalogue is.
#[derive(Debug, Clone)]
pub struct Access {
    /// `archive.dsn`.
    pub dsn: String,
    /// `archive.ca`.
    pub ca: Option<PathBuf>,
    /// `archive.password_file`.
    pub password_file: Option<PathBuf>,
}

/// A connection, and the names used in messages about it.
pub(super) async fn connect(access: &Access) -> Result<(Client, Endpoint), CatalogueError> {
    let (mut config, endpoint) = parsed(access)?;
    let file = access.password_file.as_deref();
    let credentials = std::env::var_os("CREDENTIALS_DIRECTORY");
    if let Some(password) =
        secret(file, CREDENTIAL, credentials).map_err(CatalogueError::Password)?
    {
        config.password(password);
    }
    config
        .connect_timeout(CONNECT)
        .tcp_user_timeout(3 * CONNECT)
        .application_name("tactus-archive");
    let client = match &access.ca {
        Some(ca) if endpoint.ca.is_some() => {
            let tls = trusting(ca).map_err(CatalogueError::Ca)?;
            open(&config, MakeRustlsConnect::new(tls), &endpoint).await?
        }
        _ => open(&config, NoTls, &endpoint).await?,
    };
    Ok((client, endpoint))
}

async fn open<T>(config: &Config, tls: T, endpoint: &Endpoint) -> Result<Client, CatalogueError>
where
    T: MakeTlsConnect<Socket> + Send,
    T::Stream: Send + 'static,
{
    // the timeout of the library applies to each address
    let opened = tokio::time::timeout(2 * CONNECT, config.connect(tls)).await;
    let (client, connection) = opened
        .map_err(|_| CatalogueError::Late {
            place: endpoint.place.clone(),
            seconds: 2 * CONNECT.as_secs(),
        })?
        .map_err(|error| endpoint.not_connected(error))?;
    // ends with the client; its errors are results of the statement in progress
    tokio::spawn(async move { drop(connection.await) });
    Ok(client)
}

/// The configuration of the library, and the names used in messages.
fn parsed(access: &Access) -> Result<(Config, Endpoint), CatalogueError> {
    let wrong = |why: String| CatalogueError::Dsn(why);
    let mut config: Config = access.dsn.parse().map_err(|error: tokio_postgres::Error| {
        wrong(format!(
            "{}; write `host=HOST dbname=DATABASE user=ROLE`, with `port=` if it is not 5432",
            survey::error_chain(&error)
        ))
    })?;
    if config.get_password().is_some() {
        return Err(wrong("has a password, which everybody who can read the configuration would see: put it in archive.password_file".into()));
    }
    let role = config
        .get_user()
        .map(str::to_owned)
        .ok_or_else(|| wrong("names no user: add `user=ROLE`".into()))?;
    let database = config
        .get_dbname()
        .map(str::to_owned)
        .ok_or_else(|| wrong("names no database: add `dbname=DATABASE`".into()))?;
    if config.get_hosts().is_empty() {
        return Err(wrong("names no host: add `host=NAME`, or `host=/run/postgresql` for a socket of this machine".into()));
    }
    let hosts: Vec<String> = config
        .get_hosts()
        .iter()
        .map(|host| match host {
            Host::Tcp(name) => name.clone(),
            Host::Unix(folder) => folder.display().to_string(),
        })
        .collect();
    let remote: Vec<&str> = config
        .get_hosts()
        .iter()
        .filter_map(|host| match host {
            Host::Tcp(name) if !is_loopback(name) => Some(name.as_str()),
            _ => None,
        })
        .collect();
    let by_network = config
        .get_hosts()
        .iter()
        .any(|host| matches!(host, Host::Tcp(_)));
    let ca = access.ca.as_ref().filter(|_| by_network);
    if let (Some(name), None) = (remote.first(), ca) {
        return Err(wrong(format!(
            "{name} is another machine: give archive.ca, the certificates of its authority"
        )));
    }
    config.ssl_mode(match ca {
        Some(_) => SslMode::Require,
        None => SslMode::Disable,
    });
    let ports = config.get_ports();
    let place = match ports {
        [] => hosts.join(","),
        [port] => format!("{}:{port}", hosts.join(",")),
        several => format!("{} (ports {several:?})", hosts.join(",")),
    };
    let endpoint = Endpoint {
        place,
        role,
        database,
        ca: ca.map(|path| path.display().to_string()),
    };
    Ok((config, endpoint))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(dsn: &str) -> String {
        let access = Access {
            dsn: dsn.to_owned(),
            ca: None,
            password_file: None,
        };
        parsed(&access).map(|_| ()).unwrap_err().to_string()
    }

    #[test]
    fn wrong_dsn_is_named_with_what_is_missing() {
        for (dsn, words) in [
            (
                "host=localhost user=a password=b dbname=c",
                "archive.password_file",
            ),
            ("host=localhost dbname=c", "user=ROLE"),
            ("host=localhost user=a", "dbname=DATABASE"),
            ("user=a dbname=c", "host=NAME"),
            ("host=db.example.org user=a dbname=c", "archive.ca"),
            ("hots=localhost user=a dbname=c", "hots"),
            ("postgres://[", "host=HOST"),
        ] {
            let text = refusal(dsn);
            assert!(
                text.starts_with("archive.dsn: ") && text.contains(words),
                "{dsn}: {text}"
            );
        }
        for own in ["localhost", "127.0.0.1", "::1", "/run/postgresql"] {
            let access = Access {
                dsn: format!("host={own} user=a dbname=c"),
                ca: None,
                password_file: None,
            };
            assert!(parsed(&access).is_ok(), "{own}");
        }
    }
}
