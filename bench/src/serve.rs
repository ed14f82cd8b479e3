//! The simulated rig on TCP and a pseudo-terminal, for any client that speaks SCPI.

use std::net::SocketAddr;

use serde::Serialize;
use tokio::net::TcpListener;
use tokio::task::JoinSet;

use crate::announce::Announcement;
use crate::pty::Pty;
use crate::{Instrument, SimulatedRig};

/// Where to serve. Port 0 takes a free one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServeOptions {
    /// Address to listen on.
    pub bind: String,
    /// Port of the 6221; its raw socket is 1394.
    pub port_6221: u16,
    /// Port of the 34980A; its raw socket is 5025.
    pub port_34980a: u16,
    /// Whether to announce the instruments by mDNS.
    pub announce: bool,
}

impl Default for ServeOptions {
    fn default() -> Self {
        Self {
            bind: "127.0.0.1".to_owned(),
            port_6221: 1394,
            port_34980a: 5025,
            announce: false,
        }
    }
}

/// What is printed, as one line of JSON, once clients can connect.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Ready {
    /// Always true.
    pub ready: bool,
    /// `host:port` of the current source.
    #[serde(rename = "6221")]
    pub source: String,
    /// `host:port` of switch and voltmeter.
    #[serde(rename = "34980a")]
    pub mainframe: String,
    /// Path of the board's serial port; null without a board.
    pub serial: Option<String>,
}

/// Why the rig is not served.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// A port that cannot be had.
    #[error(
        "{address} cannot be listened on for the {instrument}; choose another port, or 0 for a free one"
    )]
    Listen {
        /// Address and port.
        address: String,
        /// Which instrument.
        instrument: Instrument,
        /// What the operating system says.
        #[source]
        cause: std::io::Error,
    },
    /// No pseudo-terminal for the board.
    #[error("no pseudo-terminal can be opened for the multiplexer board")]
    Pty(#[source] std::io::Error),
}

/// A rig being served, until [`Server::stop`] or until it is dropped.
pub struct Server {
    ready: Ready,
    tasks: JoinSet<()>,
    announcement: Option<Announcement>,
}

/// Serves the rig. Connections are accepted when this returns.
///
/// # Errors
/// A port or a pseudo-terminal that cannot be had.
pub async fn serve(rig: SimulatedRig, options: &ServeOptions) -> Result<Server, ServeError> {
    let mut tasks = JoinSet::new();
    let (source, source_at) = listen(Instrument::Source, &options.bind, options.port_6221).await?;
    let (mainframe, mainframe_at) =
        listen(Instrument::Mainframe, &options.bind, options.port_34980a).await?;
    let mut serial = None;
    if rig.has_board() {
        let pty = Pty::open().map_err(ServeError::Pty)?;
        serial = Some(pty.path().to_owned());
        tasks.spawn(rig.clone().converse(Instrument::Board, pty));
    }
    let identities = [
        (rig.hear(Instrument::Source, "*IDN?").0, source_at),
        (rig.hear(Instrument::Mainframe, "*IDN?").0, mainframe_at),
    ];
    tasks.spawn(accept(rig.clone(), Instrument::Source, source));
    tasks.spawn(accept(rig, Instrument::Mainframe, mainframe));
    let announcement = options.announce.then(|| {
        let named: Vec<(String, SocketAddr)> = identities
            .into_iter()
            .filter_map(|(identity, address)| Some((identity?, address)))
            .collect();
        Announcement::make(&named)
    });
    Ok(Server {
        ready: Ready {
            ready: true,
            source: source_at.to_string(),
            mainframe: mainframe_at.to_string(),
            serial,
        },
        tasks,
        announcement: announcement.flatten(),
    })
}

impl Server {
    /// Where the instruments are.
    pub fn ready(&self) -> &Ready {
        &self.ready
    }

    /// Says goodbye by mDNS and closes every connection.
    pub async fn stop(mut self) {
        if let Some(announcement) = self.announcement.take() {
            announcement.withdraw().await;
        }
        self.tasks.shutdown().await;
    }
}

async fn listen(
    instrument: Instrument,
    bind: &str,
    port: u16,
) -> Result<(TcpListener, SocketAddr), ServeError> {
    let fault = |cause| ServeError::Listen {
        address: format!("{bind}:{port}"),
        instrument,
        cause,
    };
    let listener = TcpListener::bind((bind, port)).await.map_err(fault)?;
    let address = listener.local_addr().map_err(fault)?;
    Ok((listener, address))
}

/// Takes clients: the source one at a time (the next waits until the last has left), the mainframe several at once.
async fn accept(rig: SimulatedRig, instrument: Instrument, listener: TcpListener) {
    let mut clients = JoinSet::new();
    loop {
        let stream = match listener.accept().await {
            Ok((stream, _)) => stream,
            Err(fault) => {
                tracing::warn!("a client of the {instrument} could not be accepted: {fault}");
                tokio::task::yield_now().await;
                continue;
            }
        };
        stream.set_nodelay(true).ok();
        let conversation = rig.clone().converse(instrument, stream);
        if instrument == Instrument::Source {
            conversation.await;
        } else {
            clients.spawn(conversation);
            while clients.try_join_next().is_some() {}
        }
    }
}
