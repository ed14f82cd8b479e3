//! A listener for a few read-only pages over HTTP/1.1: one request a connection, with limits on every length, time and
//! number of clients.
//!
//! Used for the daemon's metrics and the simulated mainframe's pages. Request bodies, persistent connections and
//! encryption are left to web frameworks.
//!
//! ```
//! # #[tokio::main(flavor = "current_thread")] async fn main() -> std::io::Result<()> {
//! use http_listener::{Hosts, HttpListener, NoPage, Page};
//! use tokio::io::{AsyncReadExt, AsyncWriteExt};
//!
//! let pages = |path: String, _| async move {
//!     match path.as_str() {
//!         "/hello" => Ok(Page { content: "text/plain", body: "good day\n".to_owned() }),
//!         _ => Err(NoPage::NotFound),
//!     }
//! };
//! let listener = HttpListener::open(([127, 0, 0, 1], 0).into(), Hosts::Any, pages).await?;
//! let mut client = tokio::net::TcpStream::connect(listener.address()).await?;
//! client.write_all(b"GET /hello HTTP/1.1\r\nHost: here\r\n\r\n").await?;
//! let mut answer = String::new();
//! client.read_to_string(&mut answer).await?;
//! assert!(answer.starts_with("HTTP/1.1 200 OK") && answer.ends_with("good day\n"));
//! # Ok(()) }
//! ```

#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::TcpListener;
use tokio::task::AbortHandle;

/// Most bytes of a request with all its headers.
const LONGEST: usize = 8192;
/// Most concurrent clients. A further one closes the oldest connection: a normal client is done in a moment, so that
/// slow clients are closed first and the page stays available.
const CLIENTS: usize = 8;
/// Timeout of a connection.
const DEADLINE: Duration = Duration::from_secs(5);

/// A page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Page {
    /// Its media type.
    pub content: &'static str,
    /// Its text.
    pub body: String,
}

/// Why there is no page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoPage {
    /// No such page: 404.
    NotFound,
    /// The page could not be generated: 500.
    Failed,
}

/// Accepted values of the `Host` header.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Hosts {
    /// Any, or none.
    Any,
    /// `localhost`, a loopback address, the local address of the connection, and these names; HTTP/1.1 must send one.
    /// Prevents DNS rebinding: a foreign web page whose name resolves to this machine reads nothing.
    Own(Vec<String>),
}

/// A listener that is open until it is dropped.
#[derive(Debug)]
pub struct HttpListener {
    address: SocketAddr,
    task: tokio::task::JoinHandle<()>,
}

impl Drop for HttpListener {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl HttpListener {
    /// Listens on an address. `pages` generates the page of a path; it also receives the local address of the
    /// connection.
    ///
    /// # Errors
    /// The address cannot be bound.
    pub async fn open<F>(
        address: SocketAddr,
        hosts: Hosts,
        pages: impl Fn(String, SocketAddr) -> F + Send + Sync + 'static,
    ) -> std::io::Result<Self>
    where
        F: Future<Output = Result<Page, NoPage>> + Send + 'static,
    {
        let listener = TcpListener::bind(address).await?;
        Ok(Self {
            address: listener.local_addr()?,
            task: tokio::spawn(serve(listener, hosts, pages)),
        })
    }

    /// The address with the actual port.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

/// Serves pages on a listener, as [`HttpListener::open`] does; never returns.
pub async fn serve<F>(
    listener: TcpListener,
    hosts: Hosts,
    pages: impl Fn(String, SocketAddr) -> F + Send + Sync + 'static,
) where
    F: Future<Output = Result<Page, NoPage>> + Send + 'static,
{
    let mut clients = Clients::default();
    let (hosts, pages) = (Arc::new(hosts), Arc::new(pages));
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            // out of descriptors: retry after a moment
            tokio::time::sleep(Duration::from_millis(100)).await;
            continue;
        };
        clients.make_space();
        let (hosts, pages) = (Arc::clone(&hosts), Arc::clone(&pages));
        let client = tokio::spawn(async move {
            if let Ok(here) = stream.local_addr() {
                answer_once(stream, here, &hosts, pages.as_ref()).await.ok();
            }
        });
        clients.0.push_back(client.abort_handle());
    }
}

/// Connections, oldest first; closed when dropped.
#[derive(Debug, Default)]
struct Clients(VecDeque<AbortHandle>);

impl Clients {
    fn make_space(&mut self) {
        self.0.retain(|client| !client.is_finished());
        while self.0.len() >= CLIENTS
            && let Some(longest) = self.0.pop_front()
        {
            longest.abort();
        }
    }
}

impl Drop for Clients {
    fn drop(&mut self) {
        self.0.iter().for_each(AbortHandle::abort);
    }
}

/// Serves one request on any stream; `here` is the local address of the connection.
///
/// # Errors
/// A lost connection, or the timeout.
pub async fn answer_once<S, F>(
    stream: S,
    here: SocketAddr,
    hosts: &Hosts,
    pages: &(impl Fn(String, SocketAddr) -> F + Sync),
) -> std::io::Result<()>
where
    S: AsyncRead + AsyncWrite + Unpin,
    F: Future<Output = Result<Page, NoPage>>,
{
    tokio::time::timeout(DEADLINE, exchange(stream, here, hosts, pages)).await?
}

async fn exchange<S, F>(
    mut stream: S,
    here: SocketAddr,
    hosts: &Hosts,
    pages: &(impl Fn(String, SocketAddr) -> F + Sync),
) -> std::io::Result<()>
where
    S: AsyncRead + AsyncWrite + Unpin,
    F: Future<Output = Result<Page, NoPage>>,
{
    let head = head(&mut stream).await?;
    let request = match head.as_deref() {
        None => Err("431 Request Header Fields Too Large"),
        Some(head) => request(head, here.ip(), hosts),
    };
    let (status, page, with_body) = match request {
        Err(status) => (status, None, true),
        Ok((method, path)) => match pages(path, here).await {
            Ok(page) => ("200 OK", Some(page), method == Method::Get),
            Err(NoPage::NotFound) => ("404 Not Found", None, true),
            Err(NoPage::Failed) => ("500 Internal Server Error", None, true),
        },
    };
    let Page { content, body } = page.unwrap_or_else(|| Page {
        content: "text/plain; charset=utf-8",
        body: format!("{status}\n"),
    });
    let allow = match status.starts_with("405") {
        true => "Allow: GET, HEAD\r\n",
        false => "",
    };
    let mut text = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {content}\r\nContent-Length: {}\r\n{allow}Connection: close\r\n\r\n",
        body.len()
    );
    if with_body {
        text.push_str(&body);
    }
    stream.write_all(text.as_bytes()).await?;
    stream.shutdown().await
}

/// Everything up to the empty line; `None` if that is too long.
async fn head(stream: &mut (impl AsyncRead + Unpin)) -> std::io::Result<Option<Vec<u8>>> {
    let mut head = Vec::with_capacity(512);
    let mut piece = [0; 1024];
    loop {
        if let Some(end) = head.windows(4).position(|four| four == b"\r\n\r\n") {
            head.truncate(end);
            return Ok(Some(head));
        }
        if head.len() >= LONGEST {
            return Ok(None);
        }
        let most = piece.len().min(LONGEST - head.len());
        let read = stream.read(&mut piece[..most]).await?;
        if read == 0 {
            return Err(std::io::ErrorKind::UnexpectedEof.into());
        }
        head.extend_from_slice(&piece[..read]);
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Method {
    Get,
    Head,
}

/// Method and path, without the query string; of the headers only `Host` is used.
fn request(head: &[u8], own: IpAddr, hosts: &Hosts) -> Result<(Method, String), &'static str> {
    const BAD: &str = "400 Bad Request";
    let head = std::str::from_utf8(head).map_err(|_| BAD)?;
    let mut lines = head.split("\r\n");
    let line = lines.next().unwrap_or_default();
    let words: Vec<&str> = line.split(' ').collect();
    let [method, target, "HTTP/1.1" | "HTTP/1.0"] = words[..] else {
        return Err(BAD);
    };
    let mut named = lines
        .filter_map(|line| line.split_once(':'))
        .filter(|(name, _)| name.eq_ignore_ascii_case("host"))
        .map(|(_, value)| value.trim());
    let host = named.next();
    if named.next().is_some() {
        return Err(BAD);
    }
    if let Hosts::Own(names) = hosts {
        match host {
            Some(host) if OwnNames { own, names }.is(host) => {}
            Some(_) => return Err("421 Misdirected Request"),
            None if words[2] == "HTTP/1.0" => {}
            None => return Err(BAD),
        }
    }
    let method = match method {
        "GET" => Method::Get,
        "HEAD" => Method::Head,
        _ => return Err("405 Method Not Allowed"),
    };
    let path = target.split('?').next().unwrap_or_default();
    Ok((method, path.to_owned()))
}

/// Accepted host names.
#[derive(Debug)]
struct OwnNames<'a> {
    /// The local address of the connection.
    own: IpAddr,
    /// As configured.
    names: &'a [String],
}

impl OwnNames<'_> {
    /// Whether a host, with or without a port, is this machine: `localhost`, a loopback address, the local address of
    /// the connection, or a configured name.
    fn is(&self, host: &str) -> bool {
        let name = match host.strip_prefix('[') {
            Some(rest) => rest.split(']').next().unwrap_or_default(),
            None => host.split(':').next().unwrap_or_default(),
        };
        if let Ok(address) = name.parse::<IpAddr>() {
            let address = address.to_canonical();
            return address.is_loopback() || address == self.own.to_canonical();
        }
        let name = name.strip_suffix('.').unwrap_or(name);
        let configured = self.names.iter().map(String::as_str);
        configured
            .chain(["localhost"])
            .any(|known| known.eq_ignore_ascii_case(name))
    }
}
