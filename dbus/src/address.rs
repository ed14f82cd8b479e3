//! Three kinds of address of the daemon, and the order in which they are tried.

use std::{fmt, path::PathBuf, str::FromStr};

use zbus::{Connection, connection::Builder, fdo::DBusProxy};

use crate::BUS_NAME;

/// Address of a daemon.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Address {
    /// The system bus.
    System,
    /// The session bus.
    Session,
    /// D-Bus over a unix socket, without a broker.
    Unix(PathBuf),
}

/// A text that is not a valid address.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("'{0}' is not an address of the daemon; write system, session or unix:PATH")]
pub struct AddressError(String);

impl FromStr for Address {
    type Err = AddressError;
    fn from_str(text: &str) -> Result<Self, AddressError> {
        match (text, text.strip_prefix("unix:")) {
            ("system", _) => Ok(Self::System),
            ("session", _) => Ok(Self::Session),
            (_, Some(path)) if !path.is_empty() => Ok(Self::Unix(path.into())),
            _ => Err(AddressError(text.to_owned())),
        }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::System => f.write_str("system"),
            Self::Session => f.write_str("session"),
            Self::Unix(path) => write!(f, "unix:{}", path.display()),
        }
    }
}

/// Prefix of the daemon's `ERROR` line if it accepts no further connection (D-Bus specification, authentication
/// protocol).
pub const BUSY: &str = "busy: ";

/// Why no daemon could be reached.
#[derive(Debug, thiserror::Error)]
pub enum ConnectError {
    /// No daemon listens at the address.
    #[error("no daemon at {address}: {cause}")]
    NoDaemon {
        /// The address tried.
        address: Address,
        /// The error of the system or the bus.
        cause: String,
    },
    /// The socket exists, but this user may not use it.
    #[error(
        "no permission to connect to the daemon at {address}: {cause}; only its user, root and members of the group tactus may connect"
    )]
    NotAuthorized {
        /// The address.
        address: Address,
        /// The error of the system.
        cause: String,
    },
    /// The daemon has its maximum number of connections, of this user or in total.
    #[error("the daemon at {address} is busy: {cause}")]
    Busy {
        /// The address.
        address: Address,
        /// The daemon's message.
        cause: String,
    },
    /// None of the default addresses has a daemon.
    #[error("no daemon found; tried {}", .tried.join("; "))]
    Nowhere {
        /// Each address with the reason.
        tried: Vec<String>,
    },
}

/// The addresses tried by default: the peer socket (`$XDG_RUNTIME_DIR/tactus/peer`, then `/run/tactus/peer`), the
/// session bus, the system bus.
pub fn search_order(runtime_directory: Option<PathBuf>) -> Vec<Address> {
    runtime_directory
        .map(|directory| Address::Unix(directory.join("tactus/peer")))
        .into_iter()
        .chain([
            Address::Unix("/run/tactus/peer".into()),
            Address::Session,
            Address::System,
        ])
        .collect()
}

/// Connects to the given address, or to the first address of [`search_order`] with a daemon that admits this user: a
/// user who may not use the peer socket may still read on the system bus.
///
/// # Errors
/// No daemon, or not allowed; the message names every address tried.
pub async fn connect(address: Option<&Address>) -> Result<(Connection, Address), ConnectError> {
    if let Some(address) = address {
        return Ok((reach(address).await?, address.clone()));
    }
    let (mut tried, mut refused) = (Vec::new(), None);
    // an empty variable would make the path relative to the present folder
    let runtime_directory =
        std::env::var_os("XDG_RUNTIME_DIR").filter(|directory| !directory.is_empty());
    for address in search_order(runtime_directory.map(PathBuf::from)) {
        match reach(&address).await {
            Ok(connection) => return Ok((connection, address)),
            Err(busy @ ConnectError::Busy { .. }) => return Err(busy),
            Err(ConnectError::NotAuthorized { address, cause }) => {
                refused.get_or_insert((address, cause));
            }
            Err(ConnectError::NoDaemon { address, cause }) => {
                tried.push(format!("{address} ({cause})"));
            }
            Err(other) => tried.push(other.to_string()),
        }
    }
    Err(match refused {
        Some((address, cause)) => {
            let cause = format!("{cause} (also tried {})", tried.join("; "));
            ConnectError::NotAuthorized { address, cause }
        }
        None => ConnectError::Nowhere { tried },
    })
}

async fn reach(address: &Address) -> Result<Connection, ConnectError> {
    let no_daemon = |cause: String| ConnectError::NoDaemon {
        address: address.clone(),
        cause,
    };
    let bus = match address {
        Address::System => Builder::system(),
        Address::Session => Builder::session(),
        Address::Unix(path) => {
            let stream = std::os::unix::net::UnixStream::connect(path).map_err(|cause| {
                if cause.kind() == std::io::ErrorKind::PermissionDenied {
                    ConnectError::NotAuthorized {
                        address: address.clone(),
                        cause: cause.to_string(),
                    }
                } else {
                    no_daemon(cause.to_string())
                }
            })?;
            // A daemon that rejects the caller's credentials closes the socket before the handshake.
            return Builder::unix_stream(stream)
                .p2p()
                .build()
                .await
                .map_err(|cause| turned_away(address, &cause.to_string()));
        }
    };
    let connection = bus
        .build()
        .await
        .map_err(|cause| no_daemon(cause.to_string()))?;
    let broker = DBusProxy::new(&connection)
        .await
        .map_err(|cause| no_daemon(cause.to_string()))?;
    let name = zbus::names::BusName::from_static_str(BUS_NAME)
        .map_err(|cause| no_daemon(cause.to_string()))?;
    match broker.name_has_owner(name).await {
        Ok(true) => Ok(connection),
        Ok(false) => Err(no_daemon(format!("no program owns {BUS_NAME}"))),
        Err(cause) => Err(no_daemon(cause.to_string())),
    }
}

/// Why the daemon closed a connection during the handshake: a busy daemon sends a message, a daemon that rejects the
/// user sends nothing.
fn turned_away(address: &Address, cause: &str) -> ConnectError {
    let address = address.clone();
    match cause.split_once(BUSY) {
        Some((_, message)) => ConnectError::Busy {
            address,
            cause: message.trim().to_owned(),
        },
        None => ConnectError::NotAuthorized {
            address,
            cause: cause.to_owned(),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_read_as_they_are_written() {
        for text in ["system", "session", "unix:/run/tactus/peer"] {
            assert_eq!(text.parse::<Address>().unwrap().to_string(), text);
        }
        for text in ["", "unix:", "tcp:host", "System"] {
            assert!(text.parse::<Address>().is_err(), "{text}");
        }
    }

    #[test]
    fn the_peer_socket_comes_first() {
        let order = search_order(Some("/run/user/7".into()));
        let order: Vec<String> = order.iter().map(Address::to_string).collect();
        assert_eq!(
            order,
            [
                "unix:/run/user/7/tactus/peer",
                "unix:/run/tactus/peer",
                "session",
                "system"
            ]
        );
        assert_eq!(search_order(None).len(), 3);
    }
}
