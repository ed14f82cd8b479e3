//! The live page: an HTTP server on this machine that shows a running daemon in a browser.
//!
//! It runs in a process of its own and is an ordinary client of the daemon's bus: the daemon opens no network socket
//! for it, and the page has the rights of the user who starts it. It only reads, unless its settings allow commands.
//!
//! [`Server::open`] listens, [`Server::run`] serves until it is stopped. [`follow`] keeps a [`Live`] up to date, which
//! the terminal's dashboard reads too.

mod answer;
mod beside;
mod control;
mod guard;
mod live;
mod page;
mod playback;
mod routes;
mod running;
mod sheets;
mod snapshot;
#[cfg(test)]
mod tests;
mod token;

use std::io::ErrorKind;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio::task::JoinSet;

use beside::Beside;

pub use control::acknowledge;
pub use guard::{HostName, HostNameError};
pub use live::follow;
pub use playback::{
    Course, History, MapKind, Overview, Place, Playback, PlayedMap, Recordings, SessionEntry,
    SessionList,
};
pub use running::{DEVIATION, ProvisionalMap, RunningModel};
pub use sheets::Sheets;
pub use snapshot::{DaemonState, EventState, FrameState, Live, SessionState, Snapshot, State};
pub use token::{Token, TokenError};

/// Time for open connections to end after a request to stop.
const DRAIN: Duration = Duration::from_secs(2);

/// Where the page is served, and to whom.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Addresses to listen on; with port 0 the system chooses one for the first, and the others take the same.
    pub listen: Vec<SocketAddr>,
    /// Further values of the header `Host` that are accepted, for a tunnel or a reverse proxy.
    pub names: Vec<HostName>,
    /// The token that every request needs, except for the page's files, which contain no data.
    pub token: Token,
    /// Whether the page may command the daemon, and the daemon's address; `None` for a page that only reads.
    pub control: Option<Control>,
}

/// The daemon that a page may command.
#[derive(Debug, Clone)]
pub struct Control {
    /// Address of its bus; `None` for the usual ones.
    pub address: Option<dbus::Address>,
}

/// A server that listens and does not serve yet.
#[derive(Debug)]
pub struct Server {
    listeners: Vec<TcpListener>,
    address: SocketAddr,
    settings: Settings,
}

impl Server {
    /// Listens on each address. After the first, an IPv6 address that this machine does not have is left out.
    ///
    /// # Errors
    /// An address cannot be used.
    pub async fn open(settings: Settings) -> std::io::Result<Self> {
        let mut listeners: Vec<TcpListener> = Vec::new();
        let mut first: Option<SocketAddr> = None;
        for wanted in &settings.listen {
            let port = match (wanted.port(), first) {
                (0, Some(first)) => first.port(),
                (port, _) => port,
            };
            match TcpListener::bind(SocketAddr::new(wanted.ip(), port)).await {
                Ok(listener) => {
                    first.get_or_insert(listener.local_addr()?);
                    listeners.push(listener);
                }
                // a port that the system chose for the first address may be in use at the second one
                Err(error)
                    if first.is_some()
                        && wanted.is_ipv6()
                        && (wanted.port() == 0 || error.kind() != ErrorKind::AddrInUse) => {}
                Err(error) => return Err(error),
            }
        }
        let address = first.ok_or_else(|| std::io::Error::other("no address to listen on"))?;
        Ok(Self {
            listeners,
            address,
            settings,
        })
    }

    /// The address of the first listener.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The address of the page with its token, for a browser on this machine. The token is after `#`: a browser does
    /// not send that part.
    pub fn url(&self) -> String {
        let host = match self.address.ip() {
            ip if ip.is_unspecified() => "127.0.0.1".to_owned(),
            std::net::IpAddr::V6(ip) => format!("[{ip}]"),
            std::net::IpAddr::V4(ip) => ip.to_string(),
        };
        let port = self.address.port();
        format!("http://{host}:{port}/#token={}", self.settings.token.text())
    }

    /// Serves the live state and these recorded sessions until `stop` is true. Then open streams are ended, and a
    /// connection that does not end within two seconds is closed.
    ///
    /// # Errors
    /// A listener failed.
    pub async fn run(
        self,
        live: Live,
        recordings: Arc<dyn Recordings>,
        stop: watch::Receiver<bool>,
    ) -> std::io::Result<()> {
        let control = self.settings.control.is_some();
        live.set_control(control);
        let port = self.address.port();
        let beside = Arc::new(Beside::new(Arc::clone(&recordings)));
        let router = routes::router(
            &self.settings,
            port,
            live.clone(),
            recordings,
            Arc::clone(&beside),
            stop.clone(),
        );
        let mut serving = JoinSet::new();
        for listener in self.listeners {
            let (router, mut stop) = (router.clone(), stop.clone());
            serving.spawn(async move {
                let ended = async move {
                    // an error means that the sender is gone: serving ends too
                    let _ = stop.wait_for(|stop| *stop).await;
                };
                axum::serve(listener, router)
                    .with_graceful_shutdown(ended)
                    .await
            });
        }
        let mut stop = stop;
        let drained = async {
            let _ = stop.wait_for(|stop| *stop).await;
            tokio::time::sleep(DRAIN).await;
        };
        tokio::pin!(drained);
        let provisional = beside::show_provisional(beside, live);
        tokio::pin!(provisional);
        loop {
            tokio::select! {
                () = &mut provisional => {}
                ended = serving.join_next() => match ended {
                    None => return Ok(()),
                    Some(Ok(served)) => served?,
                    Some(Err(panicked)) => return Err(std::io::Error::other(panicked)),
                },
                () = &mut drained => return Ok(()),
            }
        }
    }
}
