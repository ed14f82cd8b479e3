//! `tactus web`: serves the live page until a signal ends it.

use std::io::Write;
use std::net::SocketAddr;
use std::process::{Command, Stdio};
use std::sync::Arc;

use serde::Serialize;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::watch;
use web::{Control, Live, Server, Settings, Token};

use crate::args::{Global, Web};
use crate::connection;
use crate::failure::Failure;
use crate::maps::playback::RecordedSessions;
use crate::output::Printer;

/// The line of `web --json`; see `docs/reference/json.md`.
#[derive(Debug, Serialize)]
struct Serving {
    url: String,
}

/// Serves until SIGINT or SIGTERM.
pub(crate) fn run(
    global: &Global,
    requested: &Web,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let address = connection::wanted(global)?;
    let mut settings = settings(requested)?;
    settings.control = requested.control.then(|| Control {
        address: address.clone(),
    });
    let recordings = Arc::new(RecordedSessions::new(global, requested)?);
    crate::runtime::current_thread()?.block_on(async {
        let listen = settings.listen.clone();
        let server = Server::open(settings).await.map_err(|error| {
            let listen: Vec<String> = listen.iter().map(ToString::to_string).collect();
            Failure::failed(&format!("cannot listen on {}", listen.join(", ")), &error)
        })?;
        let serving = Serving { url: server.url() };
        printer.record(&serving, |serving| {
            format!(
                "{}\nCtrl-C ends it. Whoever has this address can read the page.",
                serving.url
            )
        })?;
        if printer.is_terminal() && !requested.no_browser {
            open_browser(&serving.url);
        }
        let live = Live::default();
        let (stop, stopped) = watch::channel(false);
        let ended = async {
            let failed =
                |error: std::io::Error| Failure::failed("signals cannot be received", &error);
            let mut interrupt = signal(SignalKind::interrupt()).map_err(failed)?;
            let mut terminate = signal(SignalKind::terminate()).map_err(failed)?;
            tokio::select! {
                _ = interrupt.recv() => {}
                _ = terminate.recv() => {}
            }
            stop.send_replace(true);
            // the server ends now: its result is awaited in the other branch
            std::future::pending::<Result<(), Failure>>().await
        };
        tokio::select! {
            served = server.run(live.clone(), recordings, stopped) => {
                served.map_err(|error| Failure::failed("the page can no longer be served", &error))
            }
            ended = ended => ended,
            () = web::follow(address, live) => Ok(()),
        }
    })
}

/// Converts the options to addresses, names and a token.
fn settings(requested: &Web) -> Result<Settings, Failure> {
    for address in &requested.listen {
        if !address.ip().is_loopback() && !requested.beyond_localhost {
            return Err(Failure::Usage(format!(
                "--listen {address}: other machines can reach this address, without encryption; use a tunnel (`ssh -L`) or a \
                 reverse proxy to 127.0.0.1, or add --beyond-localhost"
            )));
        }
    }
    let token = match &requested.token_file {
        Some(file) => Token::from_file(file),
        None => Token::random(),
    };
    let token = token.map_err(|error| Failure::Configuration(survey::error_chain(&error)))?;
    let default = [
        SocketAddr::from(([127, 0, 0, 1], 0)),
        SocketAddr::from((std::net::Ipv6Addr::LOCALHOST, 0)),
    ];
    Ok(Settings {
        listen: match requested.listen.is_empty() {
            true => default.to_vec(),
            false => requested.listen.clone(),
        },
        names: requested.names.clone(),
        token,
        control: None,
    })
}

/// Opens the page in a browser if there is a desktop. A failure is ignored, because the address was printed.
fn open_browser(url: &str) {
    let desktop = ["DISPLAY", "WAYLAND_DISPLAY"];
    if desktop.iter().any(|name| std::env::var_os(name).is_some()) {
        let _ = Command::new("xdg-open")
            .arg(url)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn();
    }
}
