//! Where an instrument is, as written in the configuration.

use std::fmt;
use std::str::FromStr;

const BAUD: u32 = 115_200;

/// An instrument's address.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Place {
    /// Simulated, inside the daemon.
    Simulated,
    /// `tcp:HOST:PORT`.
    Tcp(String),
    /// `serial:PATH` or `serial:PATH@BAUD`.
    Serial { path: String, baud: u32 },
}

/// A text that is no address.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("'{0}' is no address; write tcp:HOST:PORT, serial:PATH, serial:PATH@BAUD or simulated")]
pub(crate) struct NoPlace(String);

impl FromStr for Place {
    type Err = NoPlace;
    fn from_str(text: &str) -> Result<Self, NoPlace> {
        let refused = || NoPlace(text.to_owned());
        if text == "simulated" {
            return Ok(Self::Simulated);
        }
        if let Some(address) = text.strip_prefix("tcp:") {
            let (host, port) = address.rsplit_once(':').ok_or_else(refused)?;
            let port: u16 = port.parse().map_err(|_| refused())?;
            if host.is_empty() || port == 0 {
                return Err(refused());
            }
            return Ok(Self::Tcp(address.to_owned()));
        }
        let address = text.strip_prefix("serial:").ok_or_else(refused)?;
        let (path, baud) = match address.rsplit_once('@') {
            None => (address, BAUD),
            Some((path, baud)) => (path, baud.parse().map_err(|_| refused())?),
        };
        if path.is_empty() || baud == 0 {
            return Err(refused());
        }
        Ok(Self::Serial {
            path: path.to_owned(),
            baud,
        })
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Simulated => f.write_str("memory"),
            Self::Tcp(address) => write!(f, "tcp:{address}"),
            Self::Serial { path, .. } => write!(f, "serial:{path}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_and_others_refused() {
        assert_eq!(
            "tcp:10.0.0.7:1394".parse(),
            Ok(Place::Tcp("10.0.0.7:1394".into()))
        );
        assert_eq!(
            "serial:/dev/ttyUSB0@9600".parse(),
            Ok(Place::Serial {
                path: "/dev/ttyUSB0".into(),
                baud: 9600
            })
        );
        assert_eq!("simulated".parse(), Ok(Place::Simulated));
        for text in [
            "",
            "10.0.0.7:1394",
            "tcp:host",
            "tcp::5",
            "tcp:h:99999",
            "serial:",
            "serial:/dev/x@fast",
        ] {
            assert!(text.parse::<Place>().is_err(), "{text}");
        }
    }
}
