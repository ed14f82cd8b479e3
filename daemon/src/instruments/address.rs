//! Instrument addresses, as written in the configuration.

use std::fmt;
use std::str::FromStr;

/// An instrument's address.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum InstrumentAddress {
    /// Simulated, inside the daemon.
    Simulated,
    /// `tcp:HOST:PORT`.
    Tcp(String),
    /// `serial:PATH` or `serial:PATH@BAUD`.
    Serial { path: String, baud: Option<u32> },
    /// `gpiochip:PATH` (lines found by name) or `gpiochip:PATH@OFFSET` (24 consecutive lines).
    Gpiochip { path: String, first: Option<u32> },
}

/// An invalid address.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "'{0}' is no address; write tcp:HOST:PORT, serial:PATH, serial:PATH@BAUD, gpiochip:PATH, gpiochip:PATH@OFFSET or \
     simulated"
)]
pub(crate) struct BadAddress(String);

impl FromStr for InstrumentAddress {
    type Err = BadAddress;
    fn from_str(text: &str) -> Result<Self, BadAddress> {
        let refused = || BadAddress(text.to_owned());
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
        let (kind, address) = text.split_once(':').ok_or_else(refused)?;
        let (path, number) = match address.rsplit_once('@') {
            None => (address, None),
            Some((path, number)) => (path, Some(number.parse().map_err(|_| refused())?)),
        };
        if path.is_empty() {
            return Err(refused());
        }
        let path = path.to_owned();
        match (kind, number) {
            ("serial", Some(0)) => Err(refused()),
            ("serial", baud) => Ok(Self::Serial { path, baud }),
            ("gpiochip", first) => Ok(Self::Gpiochip { path, first }),
            _ => Err(refused()),
        }
    }
}

impl fmt::Display for InstrumentAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Simulated => f.write_str("memory"),
            Self::Tcp(address) => write!(f, "tcp:{address}"),
            Self::Serial { path, .. } => write!(f, "serial:{path}"),
            Self::Gpiochip { path, .. } => write!(f, "gpiochip:{path}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::instruments::address::*;

    #[test]
    fn addresses_are_read_and_others_refused() {
        assert_eq!(
            "tcp:10.0.0.7:1394".parse(),
            Ok(InstrumentAddress::Tcp("10.0.0.7:1394".into()))
        );
        assert_eq!(
            "serial:/dev/ttyUSB0@9600".parse(),
            Ok(InstrumentAddress::Serial {
                path: "/dev/ttyUSB0".into(),
                baud: Some(9600)
            })
        );
        assert_eq!(
            "gpiochip:/dev/gpiochip0@8".parse(),
            Ok(InstrumentAddress::Gpiochip {
                path: "/dev/gpiochip0".into(),
                first: Some(8)
            })
        );
        assert_eq!("simulated".parse(), Ok(InstrumentAddress::Simulated));
        for text in [
            "",
            "10.0.0.7:1394",
            "tcp:host",
            "tcp::5",
            "tcp:h:99999",
            "serial:",
            "serial:/dev/x@fast",
            "serial:/dev/x@0",
            "gpiochip:",
            "gpiochip:/dev/gpiochip0@-1",
            "usb:/dev/x",
        ] {
            assert!(text.parse::<InstrumentAddress>().is_err(), "{text}");
        }
    }
}
