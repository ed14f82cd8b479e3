//! Opens the streams that links run over.

use std::time::Duration;

use tokio_serial::SerialPortBuilderExt;

use crate::link::half_open;
use crate::{BoxStream, LinkError};

/// Data unacknowledged for this long break a TCP connection: an unplugged cable is detected although neither end
/// closes.
const UNACKNOWLEDGED_TIMEOUT: Duration = Duration::from_secs(4);

/// Connects to `host:port`, without Nagle's delay (44 ms on every write followed by a query). After a lost connection
/// every other attempt uses the local port of that connection: an instrument that still holds the connection then
/// releases it.
///
/// # Errors
/// [`LinkError::Unreachable`] with the address, after `deadline` at the latest.
pub async fn connect_tcp(address: &str, deadline: Duration) -> Result<BoxStream, LinkError> {
    let unreachable = |cause| LinkError::Unreachable {
        address: address.to_owned(),
        cause,
    };
    let stream = tokio::time::timeout(deadline, half_open::connect(address))
        .await
        .map_err(|_| {
            unreachable(std::io::Error::new(
                std::io::ErrorKind::TimedOut,
                format!("no connection within {deadline:?}"),
            ))
        })?
        .map_err(unreachable)?;
    let tcp = &stream.stream;
    tcp.set_nodelay(true).map_err(unreachable)?;
    rustix::net::sockopt::set_tcp_user_timeout(tcp, UNACKNOWLEDGED_TIMEOUT.as_millis() as u32)
        .map_err(|errno| unreachable(errno.into()))?;
    Ok(Box::new(stream))
}

/// Opens a serial port, 8N1 without flow control.
///
/// # Errors
/// [`LinkError::Unreachable`] with the path.
pub fn open_serial(path: &str, baud: u32) -> Result<BoxStream, LinkError> {
    let stream = tokio_serial::new(path, baud)
        .open_native_async()
        .map_err(|cause| LinkError::Unreachable {
            address: path.to_owned(),
            cause: cause.into(),
        })?;
    Ok(Box::new(stream))
}
