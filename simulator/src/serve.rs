//! The simulated rig on TCP, VXI-11, pseudo-terminals and web pages, for any client that speaks SCPI.

use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use serde::Serialize;
use tempfile::TempDir;
use tokio::net::TcpListener;
use tokio::task::JoinSet;

use crate::control;
use crate::instrument::{Port, SecondClient};
use crate::transport::announce::{Announcement, HTTP, LXI, SCPI_RAW, SCPI_TELNET, VXI_11};
use crate::transport::pty::Pty;
use crate::transport::vxi11::Mainframe;
use crate::transport::{socket, telnet, web};
use crate::{Instrument, SimulatedRig};

/// Addresses and ports. Port 0 selects a free one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServeOptions {
    /// Address to listen on.
    pub bind: String,
    /// Port of the 6221; its raw socket is 1394.
    pub port_6221: u16,
    /// Port of the 34980A; its raw socket is 5025.
    pub port_34980a: u16,
    /// Port of the 34980A's VXI-11 core channel; `None` to disable it.
    pub port_vxi11: Option<u16>,
    /// Port of the 34980A's telnet server; `None` to disable it.
    pub port_telnet: Option<u16>,
    /// Port of the 34980A's web pages. Default: a free port if the instruments are announced, otherwise none.
    pub port_http: Option<u16>,
    /// Whether to add the 6221's serial port.
    pub serial_6221: bool,
    /// Path of the control socket; by default in a folder of its own.
    pub control: Option<PathBuf>,
    /// Whether to announce the instruments by mDNS.
    pub announce: bool,
}

impl Default for ServeOptions {
    fn default() -> Self {
        Self {
            bind: "127.0.0.1".to_owned(),
            port_6221: 1394,
            port_34980a: 5025,
            port_vxi11: None,
            port_telnet: None,
            port_http: None,
            serial_6221: false,
            control: None,
            announce: false,
        }
    }
}

impl ServeOptions {
    /// The port of an instrument's raw socket; a free one for an instrument without an option of its own.
    fn port(&self, instrument: Instrument) -> u16 {
        match instrument {
            Instrument::Source => self.port_6221,
            Instrument::Mainframe => self.port_34980a,
            _ => 0,
        }
    }
}

/// The line of JSON that is printed once clients can connect.
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
    /// Treatment of a second client of the current source: `held`, `refused` or `served`.
    #[serde(rename = "6221-second-client")]
    pub second_client: SecondClient,
    /// Path of the board's serial port; null without a board.
    pub serial: Option<String>,
    /// Path of the 6221's serial port; null unless requested.
    #[serde(rename = "6221-serial")]
    pub source_serial: Option<String>,
    /// `host:port` of the VXI-11 core channel; null unless requested.
    pub vxi11: Option<String>,
    /// `host:port` of the telnet server; null unless requested.
    pub telnet: Option<String>,
    /// `host:port` of the web pages; null unless requested or announced.
    pub http: Option<String>,
    /// Path of the control socket.
    pub control: String,
    /// `host:port` or path of the serial port of each other instrument, by its name in faults.
    #[serde(flatten)]
    pub others: BTreeMap<&'static str, String>,
}

/// Errors of serving.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// A port that cannot be opened.
    #[error(
        "cannot listen on {address} for the {instrument}; choose another port, or 0 for a free one"
    )]
    Listen {
        /// Address and port.
        address: String,
        /// Which instrument.
        instrument: Instrument,
        /// The operating system's error.
        #[source]
        cause: std::io::Error,
    },
    /// An address that this machine does not have.
    #[error(
        "{bind} is not an address of this machine: give one of its own by --bind, 127.0.0.1 for this machine alone or 0.0.0.0 for all"
    )]
    Address {
        /// Address or name.
        bind: String,
        /// The operating system's error.
        #[source]
        cause: std::io::Error,
    },
    /// A pseudo-terminal cannot be created.
    #[error("no pseudo-terminal can be opened for the {instrument}")]
    Pty {
        /// Which instrument.
        instrument: Instrument,
        /// The operating system's error.
        #[source]
        cause: std::io::Error,
    },
    /// The control socket cannot be created.
    #[error("the control socket {path} cannot be created; name another path")]
    Control {
        /// Its path.
        path: String,
        /// The operating system's error.
        #[source]
        cause: std::io::Error,
    },
}

/// A rig being served, until [`Server::stop`] or until it is dropped.
pub struct Server {
    ready: Ready,
    tasks: JoinSet<()>,
    announcement: Option<Announcement>,
    /// Folder of the socket and the names of serial ports, removed with the server.
    _folder: TempDir,
    control: PathBuf,
}

/// Serves the rig. Connections are accepted when the function returns.
///
/// # Errors
/// A port, a pseudo-terminal or a socket that cannot be opened.
pub async fn serve(rig: SimulatedRig, options: &ServeOptions) -> Result<Server, ServeError> {
    let mut tasks = JoinSet::new();
    let bind = options.bind.as_str();
    let here = Instrument::ALL.into_iter();
    let here: Vec<_> = here.filter(|instrument| rig.has(*instrument)).collect();
    let by = |port: Port| {
        let here = here.iter().copied();
        here.filter(move |instrument| instrument.kind().port == port)
    };
    let mut listeners = Vec::new();
    let mut sockets = BTreeMap::new();
    for instrument in by(Port::Network) {
        let (listener, at) = listen(instrument, bind, options.port(instrument)).await?;
        listeners.push((instrument, listener));
        sockets.insert(instrument, at);
    }
    let pages = options.port_http.or(options.announce.then_some(0));
    let http = match pages {
        Some(port) => Some(listen(Instrument::Mainframe, bind, port).await?),
        None => None,
    };
    let core = match options.port_vxi11 {
        Some(port) => Some(listen(Instrument::Mainframe, bind, port).await?),
        None => None,
    };
    let telnet = match options.port_telnet {
        Some(port) => Some(listen(Instrument::Mainframe, bind, port).await?),
        None => None,
    };
    let no_control = |path: &Path| {
        let path = path.display().to_string();
        move |cause| ServeError::Control { path, cause }
    };
    let folder = control::own_folder().map_err(no_control(Path::new("folder")))?;
    let control = match &options.control {
        Some(path) => path.clone(),
        None => folder.path().join(control::SOCKET),
    };
    let socket = control::listen(&control).map_err(no_control(&control))?;
    let mut serial = |instrument: Instrument, name: &str| -> Result<String, ServeError> {
        let path = folder.path().join(name);
        let fault = |cause| ServeError::Pty { instrument, cause };
        let pty = plug(&path).map_err(fault)?;
        let shown = path.display().to_string();
        tasks.spawn(serial_port(rig.clone(), instrument, path, pty));
        Ok(shown)
    };
    let mut addresses: BTreeMap<Instrument, String> = BTreeMap::new();
    addresses.extend(sockets.iter().map(|(of, at)| (*of, at.to_string())));
    for instrument in by(Port::Serial) {
        addresses.insert(instrument, serial(instrument, instrument.kind().word)?);
    }
    let source_serial = match options.serial_6221 {
        true => Some(serial(Instrument::Source, "6221")?),
        false => None,
    };
    let second_client = rig.source_profile().second_client;
    let vxi11_at = core.as_ref().map(|(_, at)| *at);
    let telnet_at = telnet.as_ref().map(|(_, at)| *at);
    let http_at = http.as_ref().map(|(_, at)| *at);
    for (instrument, listener) in listeners {
        tasks.spawn(socket::serve(rig.clone(), instrument, listener));
    }
    tasks.spawn(control::serve(rig.clone(), socket));
    tasks.spawn(time_line(rig.clone()));
    if let Some((core, _)) = core {
        tasks.spawn(vxi11::CoreChannel::serve(Mainframe(rig.clone()), core));
    }
    if let Some((port, _)) = telnet {
        tasks.spawn(telnet::serve(rig.clone(), port));
    }
    if let Some((http, _)) = http {
        let ports = web::Ports {
            mainframe: sockets[&Instrument::Mainframe],
            vxi11: vxi11_at,
        };
        tasks.spawn(web::serve(rig.clone(), http, ports));
    }
    let announcement = options.announce.then(|| {
        let of_mainframe = [
            (LXI, http_at),
            (HTTP, http_at),
            (VXI_11, vxi11_at),
            (SCPI_TELNET, telnet_at),
        ];
        let mainframe = rig.identity(Instrument::Mainframe);
        let mut services: Vec<_> = sockets
            .iter()
            .map(|(instrument, at)| (rig.identity(*instrument), SCPI_RAW, *at))
            .collect();
        services.extend(
            of_mainframe
                .into_iter()
                .filter_map(|(kind, at)| Some((mainframe.clone(), kind, at?))),
        );
        Announcement::make(&services)
    });
    let mut address = |instrument| addresses.remove(&instrument);
    Ok(Server {
        ready: Ready {
            ready: true,
            source: address(Instrument::Source).unwrap_or_default(),
            mainframe: address(Instrument::Mainframe).unwrap_or_default(),
            second_client,
            serial: address(Instrument::Board),
            source_serial,
            vxi11: vxi11_at.map(|at| at.to_string()),
            telnet: telnet_at.map(|at| at.to_string()),
            http: http_at.map(|at| at.to_string()),
            control: control.display().to_string(),
            others: addresses
                .into_iter()
                .map(|(instrument, address)| (instrument.kind().word, address))
                .collect(),
        },
        tasks,
        announcement: announcement.flatten(),
        _folder: folder,
        control,
    })
}

impl Server {
    /// Addresses of the instruments.
    pub fn ready(&self) -> &Ready {
        &self.ready
    }

    /// Withdraws the mDNS announcement and closes every connection.
    pub async fn stop(mut self) {
        if let Some(announcement) = self.announcement.take() {
            announcement.withdraw().await;
        }
        self.tasks.shutdown().await;
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // A socket at a path chosen by the user is outside the folder that is removed.
        std::fs::remove_file(&self.control).ok();
    }
}

async fn listen(
    instrument: Instrument,
    bind: &str,
    port: u16,
) -> Result<(TcpListener, SocketAddr), ServeError> {
    let fault = |cause: std::io::Error| match cause.kind() {
        ErrorKind::AddrInUse | ErrorKind::PermissionDenied => ServeError::Listen {
            address: format!("{bind}:{port}"),
            instrument,
            cause,
        },
        _ => ServeError::Address {
            bind: bind.to_owned(),
            cause,
        },
    };
    let listener = TcpListener::bind((bind, port)).await.map_err(fault)?;
    let address = listener.local_addr().map_err(fault)?;
    Ok((listener, address))
}

/// Opens a pseudo-terminal under a fixed name.
fn plug(path: &Path) -> std::io::Result<Pty> {
    let pty = Pty::open()?;
    std::fs::remove_file(path).ok();
    std::os::unix::fs::symlink(pty.path(), path)?;
    Ok(pty)
}

/// Serves a serial port, and recreates it after a fault that removes it.
async fn serial_port(rig: SimulatedRig, instrument: Instrument, path: PathBuf, first: Pty) {
    let mut pty = first;
    loop {
        let address = path.display().to_string();
        let served = rig.clone().converse_by_serial(instrument, address, pty);
        served.await;
        std::fs::remove_file(&path).ok();
        rig.until_connected(instrument).await;
        match plug(&path) {
            Ok(next) => pty = next,
            Err(fault) => {
                tracing::warn!(
                    "the serial port of the {instrument} cannot be opened again: {fault}"
                );
                return;
            }
        }
    }
}

/// Applies the faults of the time line at their times, also without messages from clients.
async fn time_line(rig: SimulatedRig) {
    while let Some(left) = rig.next_fault_in() {
        tokio::time::sleep(left).await;
        rig.apply_due_faults();
    }
}
