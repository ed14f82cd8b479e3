//! The mainframe's web pages: its LXI identification document, and one page for people.
//!
//! Two fixed pages for GET, each connection one request: written out here in a hundred bounded lines, because a web
//! framework would be the largest dependency of this room for its smallest part.

use std::fmt::Write as _;
use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::time::Duration;

use rig::{BoxStream, Stream};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpListener;
use tokio::task::JoinSet;

use crate::{Instrument, SimulatedRig};

/// Most bytes of a request's head.
const LONGEST_HEAD: usize = 8 * 1024;
/// Longest time for a request and its answer.
const TIMEOUT: Duration = Duration::from_secs(5);
/// Most clients at once.
const CLIENTS: usize = 32;
/// Room of a connection in memory, bytes.
const PIPE: usize = 16 * 1024;

/// Ports that the pages name.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ports {
    pub(crate) mainframe: SocketAddr,
    pub(crate) vxi11: Option<SocketAddr>,
}

impl SimulatedRig {
    /// Connects to the mainframe's web server, in memory: one request, one answer. Inside a tokio runtime.
    pub fn connect_web(&self) -> BoxStream {
        let (here, there) = tokio::io::duplex(PIPE);
        let rig = self.clone();
        tokio::spawn(async move {
            // The addresses that the instrument itself would name.
            let at = |port| SocketAddr::from((Ipv4Addr::LOCALHOST, port));
            let ports = Ports {
                mainframe: at(5025),
                vxi11: None,
            };
            tokio::time::timeout(TIMEOUT, answer(&rig, there, at(80), ports)).await
        });
        Box::new(here)
    }
}

/// Serves the pages.
pub(crate) async fn serve(rig: SimulatedRig, listener: TcpListener, ports: Ports) {
    let mut clients = JoinSet::new();
    loop {
        if clients.len() >= CLIENTS {
            clients.join_next().await;
        }
        match listener.accept().await {
            Ok((stream, address)) => {
                let rig = rig.clone();
                clients.spawn(async move {
                    let Ok(here) = stream.local_addr() else {
                        return;
                    };
                    match tokio::time::timeout(TIMEOUT, answer(&rig, stream, here, ports)).await {
                        Ok(Ok(())) => {}
                        Ok(Err(fault)) => tracing::debug!("{address} asked for a page: {fault}"),
                        Err(_) => tracing::debug!("{address} took too long to ask for a page"),
                    }
                });
            }
            Err(fault) => {
                tracing::warn!("a page's reader could not be accepted: {fault}");
                tokio::task::yield_now().await;
            }
        }
        while clients.try_join_next().is_some() {}
    }
}

async fn answer(
    rig: &SimulatedRig,
    mut stream: impl Stream,
    here: SocketAddr,
    ports: Ports,
) -> io::Result<()> {
    let mut head = Vec::new();
    let mut chunk = [0; 1024];
    while !head.windows(4).any(|end| end == b"\r\n\r\n")
        && !head.windows(2).any(|end| end == b"\n\n")
    {
        let count = stream.read(&mut chunk).await?;
        if count == 0 || head.len() + count > LONGEST_HEAD {
            return respond(
                &mut stream,
                "400 Bad Request",
                "text/plain",
                "not a request\n",
            )
            .await;
        }
        head.extend_from_slice(&chunk[..count]);
    }
    let head = String::from_utf8_lossy(&head);
    let mut words = head.lines().next().unwrap_or_default().split(' ');
    let (method, target) = (
        words.next().unwrap_or_default(),
        words.next().unwrap_or_default(),
    );
    let path = target.split('?').next().unwrap_or_default();
    match (method, path) {
        ("GET", "/lxi/identification") => {
            let page = identification(rig, here, ports);
            respond(&mut stream, "200 OK", "text/xml; charset=utf-8", &page).await
        }
        ("GET", "/") => {
            let page = for_people(rig, ports);
            respond(&mut stream, "200 OK", "text/html; charset=utf-8", &page).await
        }
        ("GET", _) => {
            let body = "there is / and /lxi/identification\n";
            respond(&mut stream, "404 Not Found", "text/plain", body).await
        }
        (_, "/" | "/lxi/identification") => {
            respond(
                &mut stream,
                "405 Method Not Allowed",
                "text/plain",
                "only GET\n",
            )
            .await
        }
        _ => {
            respond(
                &mut stream,
                "400 Bad Request",
                "text/plain",
                "not a request\n",
            )
            .await
        }
    }
}

async fn respond(
    stream: &mut impl Stream,
    status: &str,
    media: &str,
    body: &str,
) -> io::Result<()> {
    let length = body.len();
    let allow = if status.starts_with("405") {
        "Allow: GET\r\n"
    } else {
        ""
    };
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {media}\r\nContent-Length: {length}\r\n{allow}Connection: close\r\n\r\n"
    );
    stream.write_all(head.as_bytes()).await?;
    stream.write_all(body.as_bytes()).await?;
    stream.shutdown().await
}

/// The identification document (fact sheet lxi-discovery, section 5).
fn identification(rig: &SimulatedRig, here: SocketAddr, ports: Ports) -> String {
    let identity = rig.identity(Instrument::Mainframe);
    let mut fields = identity.splitn(4, ',').map(escaped);
    let mut next = || fields.next().unwrap_or_default();
    let host = here.ip();
    let mut page = String::from(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<LXIDevice xmlns=\"http://lxistandard.org/schemas/InstrumentIdentification/2.0\">\n",
    );
    for name in ["Manufacturer", "Model", "SerialNumber", "FirmwareRevision"] {
        // Writing to a String cannot fail.
        writeln!(page, "  <{name}>{}</{name}>", next()).ok();
    }
    writeln!(
        page,
        "  <ManufacturerDescription>simulated by tactus-sim</ManufacturerDescription>\n  <HomepageURL>http://{here}/</HomepageURL>"
    )
    .ok();
    let mut addresses = vec![format!("TCPIP::{host}::{}::SOCKET", ports.mainframe.port())];
    if let Some(vxi11) = ports.vxi11 {
        addresses.push(format!("TCPIP::{host},{}::inst0::INSTR", vxi11.port()));
    }
    page.push_str("  <Interface InterfaceType=\"LXI\" InterfaceName=\"eth0\">\n");
    for address in addresses {
        writeln!(
            page,
            "    <InstrumentAddressString>{address}</InstrumentAddressString>"
        )
        .ok();
    }
    page.push_str("  </Interface>\n</LXIDevice>\n");
    page
}

fn for_people(rig: &SimulatedRig, ports: Ports) -> String {
    let identity = escaped(rig.identity(Instrument::Mainframe));
    let status = escaped(rig.status().to_string());
    let vxi11 = ports
        .vxi11
        .map_or_else(|| "not served".to_owned(), |address| address.to_string());
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>34980A, simulated</title></head>\n<body><h1>34980A, simulated</h1>\n<p>{identity}</p>\n<p>SCPI socket {}, VXI-11 {vxi11}, <a href=\"/lxi/identification\">LXI identification</a></p>\n<pre>{status}</pre></body></html>\n",
        ports.mainframe
    )
}

fn escaped(text: impl AsRef<str>) -> String {
    let escape = |character| match character {
        '&' => "&amp;".to_owned(),
        '<' => "&lt;".to_owned(),
        '>' => "&gt;".to_owned(),
        '"' => "&quot;".to_owned(),
        other => other.to_string(),
    };
    text.as_ref().chars().map(escape).collect()
}
