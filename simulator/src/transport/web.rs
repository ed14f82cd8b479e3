//! The mainframe's web pages: its LXI identification document, and one page for people.

use std::fmt::Write as _;
use std::net::{Ipv4Addr, SocketAddr};

use http_listener::{Hosts, NoPage, Page, answer_once};
use rig::BoxStream;
use tokio::net::TcpListener;

use crate::{Instrument, SimulatedRig};

/// Capacity of a connection in memory, bytes.
const PIPE: usize = 16 * 1024;

/// Ports listed on the pages.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ports {
    pub(crate) mainframe: SocketAddr,
    pub(crate) vxi11: Option<SocketAddr>,
}

impl SimulatedRig {
    /// Connects to the mainframe's web server, in memory: one request, one reply. Requires a tokio runtime.
    pub fn connect_web(&self) -> BoxStream {
        let (here, there) = tokio::io::duplex(PIPE);
        let rig = self.clone();
        tokio::spawn(async move {
            // The addresses that the instrument would list.
            let at = |port| SocketAddr::from((Ipv4Addr::LOCALHOST, port));
            let ports = Ports {
                mainframe: at(5025),
                vxi11: None,
            };
            let pages = |path: String, here| std::future::ready(page(&rig, &path, here, ports));
            answer_once(there, at(80), &Hosts::Any, &pages).await.ok();
        });
        Box::new(here)
    }
}

/// Serves the pages.
pub(crate) async fn serve(rig: SimulatedRig, listener: TcpListener, ports: Ports) {
    let pages = move |path: String, here| std::future::ready(page(&rig, &path, here, ports));
    http_listener::serve(listener, Hosts::Any, pages).await;
}

fn page(rig: &SimulatedRig, path: &str, here: SocketAddr, ports: Ports) -> Result<Page, NoPage> {
    let (content, body) = match path {
        "/lxi/identification" => ("text/xml; charset=utf-8", identification(rig, here, ports)),
        "/" => ("text/html; charset=utf-8", for_people(rig, ports)),
        _ => return Err(NoPage::NotFound),
    };
    Ok(Page { content, body })
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
