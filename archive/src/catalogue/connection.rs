//! Connecting to PostgreSQL: the settings, TLS, the password.

use std::net::IpAddr;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject;
use rustls::{ClientConfig, RootCertStore};
use tokio_postgres::config::{Host, SslMode};
use tokio_postgres::tls::MakeTlsConnect;
use tokio_postgres::{Client, Config, NoTls, Socket};
use tokio_postgres_rustls::MakeRustlsConnect;

use super::error::{CatalogueError, Endpoint};

/// Time for a connection.
const CONNECT: Duration = Duration::from_secs(10);
/// Name of the systemd credential with the password.
const CREDENTIAL: &str = "archive-password";
/// Bytes of a password file; a longer one is another file.
const LONGEST_PASSWORD: u64 = 4096;

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

/// A connection, and what messages about it name.
pub(super) async fn connect(access: &Access) -> Result<(Client, Endpoint), CatalogueError> {
    let (mut config, endpoint) = parsed(access)?;
    if let Some(password) = password(access.password_file.as_deref())? {
        config.password(password);
    }
    config
        .connect_timeout(CONNECT)
        .tcp_user_timeout(3 * CONNECT)
        .application_name("tactus-archive");
    let client = match &access.ca {
        Some(ca) if endpoint.ca.is_some() => {
            open(&config, MakeRustlsConnect::new(trusting(ca)?), &endpoint).await?
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
    // the library's limit is one for each address
    let opened = tokio::time::timeout(2 * CONNECT, config.connect(tls)).await;
    let (client, connection) = opened
        .map_err(|_| CatalogueError::Late {
            place: endpoint.place.clone(),
            seconds: 2 * CONNECT.as_secs(),
        })?
        .map_err(|error| endpoint.not_connected(error))?;
    // ends with the client; what goes wrong is the result of the statement that runs
    tokio::spawn(async move { drop(connection.await) });
    Ok(client)
}

/// The configuration of the library, and the names for messages.
fn parsed(access: &Access) -> Result<(Config, Endpoint), CatalogueError> {
    let wrong = |why: String| CatalogueError::Dsn(why);
    let mut config: Config = access.dsn.parse().map_err(|error: tokio_postgres::Error| {
        wrong(format!(
            "{}; write `host=HOST dbname=DATABASE user=ROLE`, with `port=` where it is not 5432",
            survey::error_chain(&error)
        ))
    })?;
    if config.get_password().is_some() {
        return Err(wrong("has a password, which everybody who reads the configuration would know: put it in archive.password_file".into()));
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

fn is_loopback(name: &str) -> bool {
    name == "localhost"
        || name
            .parse::<IpAddr>()
            .is_ok_and(|address| address.is_loopback())
}

/// TLS that trusts the certificates of a file and nothing else.
fn trusting(ca: &Path) -> Result<ClientConfig, CatalogueError> {
    let wrong = |why: String| CatalogueError::Ca(format!("{}: {why}", ca.display()));
    let mut roots = RootCertStore::empty();
    let certificates =
        CertificateDer::pem_file_iter(ca).map_err(|error| wrong(survey::error_chain(&error)))?;
    for certificate in certificates {
        let certificate = certificate.map_err(|error| wrong(survey::error_chain(&error)))?;
        roots
            .add(certificate)
            .map_err(|error| wrong(error.to_string()))?;
    }
    if roots.is_empty() {
        return Err(wrong(
            "holds no certificate in PEM form (`-----BEGIN CERTIFICATE-----`)".into(),
        ));
    }
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let versions = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .map_err(|error| wrong(error.to_string()))?;
    Ok(versions.with_root_certificates(roots).with_no_client_auth())
}

/// The password: of the file, else of the systemd credential, if there is one.
fn password(file: Option<&Path>) -> Result<Option<String>, CatalogueError> {
    let wrong =
        |path: &Path, why: &str| CatalogueError::Password(format!("{}: {why}", path.display()));
    let path = match (file, std::env::var_os("CREDENTIALS_DIRECTORY")) {
        (Some(file), _) => {
            let found = std::fs::metadata(file).map_err(|error| wrong(file, &error.to_string()))?;
            if !found.is_file() || found.len() > LONGEST_PASSWORD {
                return Err(wrong(file, "is no file of one password"));
            }
            let mode = found.mode() & 0o777;
            if mode & 0o077 != 0 {
                return Err(wrong(
                    file,
                    &format!("others may read it (mode {mode:04o}): chmod 0600"),
                ));
            }
            file.to_owned()
        }
        (None, Some(folder)) => {
            let path = Path::new(&folder).join(CREDENTIAL);
            if !path.exists() {
                return Ok(None);
            }
            path
        }
        (None, None) => return Ok(None),
    };
    let text = std::fs::read_to_string(&path).map_err(|error| wrong(&path, &error.to_string()))?;
    let password = text.trim_end_matches(['\n', '\r']);
    match password.is_empty() {
        true => Err(wrong(&path, "is empty")),
        false => Ok(Some(password.to_owned())),
    }
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

    #[test]
    fn password_that_others_may_read_is_refused() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("password");
        std::fs::write(&file, "secret\n").unwrap();
        let allow = |mode| {
            std::fs::set_permissions(&file, std::fs::Permissions::from_mode(mode)).unwrap();
            password(Some(&file))
        };
        assert_eq!(allow(0o600).unwrap().as_deref(), Some("secret"));
        for mode in [0o640, 0o604, 0o644] {
            let text = allow(mode).unwrap_err().to_string();
            assert!(text.contains("chmod 0600"), "{text}");
        }
        let missing = password(Some(&folder.path().join("none"))).unwrap_err();
        assert!(missing.to_string().contains("none"), "{missing}");
    }

    #[test]
    fn file_without_certificates_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("ca.pem");
        std::fs::write(&file, "no certificate").unwrap();
        let text = trusting(&file).unwrap_err().to_string();
        assert!(text.contains("ca.pem") && text.contains("PEM"), "{text}");
    }
}
