//! `tactus instruments`: the instruments of the rig, and whether they reply.

pub(crate) mod discover;
pub(crate) mod recovery;
pub(crate) mod self_test;

use std::io::Write;

use serde::Serialize;

use crate::connection::Daemon;
use crate::failure::Failure;
use crate::output::Printer;

/// A line of `instruments --json`; see `docs/reference/json.md`.
#[derive(Debug, Serialize)]
struct Instrument {
    id: String,
    role: String,
    state: String,
    identity: String,
    address: String,
    simulated: bool,
}

pub(crate) async fn run(daemon: &Daemon, printer: &mut Printer<impl Write>) -> Result<(), Failure> {
    let mut found = Vec::new();
    for path in daemon
        .ask("the instruments", daemon.manager.instruments())
        .await?
    {
        let id = dbus::id_of(path.as_str())
            .unwrap_or(path.as_str())
            .to_owned();
        let proxy = daemon.instrument(path.into()).await?;
        found.push(Instrument {
            role: daemon.ask(&id, proxy.role()).await?,
            state: daemon.ask(&id, proxy.state()).await?,
            identity: daemon.ask(&id, proxy.identity()).await?,
            address: daemon.ask(&id, proxy.address()).await?,
            simulated: daemon.ask(&id, proxy.simulated()).await?,
            id,
        });
    }
    show(&found, printer)
}

fn show(found: &[Instrument], printer: &mut Printer<impl Write>) -> Result<(), Failure> {
    if found.is_empty() {
        return printer.text("the daemon plays a recording; there is no instrument");
    }
    let heading = ["id", "role", "state", "address", "identity"];
    printer.table(heading, found, |instrument| {
        [
            instrument.id.clone(),
            instrument.role.clone(),
            brief(&instrument.state),
            if instrument.simulated {
                format!("{} (SIMULATED)", instrument.address)
            } else {
                instrument.address.clone()
            },
            instrument.identity.clone(),
        ]
    })
}

/// A state's first sentence, shortened for its column; `--json` has the full text.
fn brief(state: &str) -> String {
    const LONG: usize = 48;
    if state.chars().count() <= LONG {
        return state.to_owned();
    }
    let end = ["\n", ". ", "; "]
        .iter()
        .filter_map(|mark| state.find(mark))
        .min()
        .unwrap_or(state.len());
    let sentence = &state[..end];
    if sentence.chars().count() <= 2 * LONG {
        return sentence.to_owned();
    }
    let mut text: String = sentence.chars().take(2 * LONG - 3).collect();
    text.truncate(text.trim_end().len());
    text + "..."
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_fault_is_its_first_sentence() {
        let long = "faulted: the meter at 10.0.0.1:5025 does not answer within 5 s; look at its cable, then `tactus start`";
        assert_eq!(
            brief(long),
            "faulted: the meter at 10.0.0.1:5025 does not answer within 5 s"
        );
        assert_eq!(brief("ready; warm"), "ready; warm");
        assert_eq!(brief(&"\u{b5}".repeat(200)).chars().count(), 96);
    }

    #[test]
    fn one_line_an_instrument() {
        let source = Instrument {
            id: "source".into(),
            role: "source".into(),
            state: "ready".into(),
            identity: "KEITHLEY,6221".into(),
            address: "memory".into(),
            simulated: true,
        };
        let mut json = Printer::into(true, Vec::new());
        show(std::slice::from_ref(&source), &mut json).unwrap();
        assert_eq!(
            String::from_utf8(json.sink()).unwrap(),
            "{\"id\":\"source\",\"role\":\"source\",\"state\":\"ready\",\"identity\":\"KEITHLEY,6221\",\
             \"address\":\"memory\",\"simulated\":true}\n"
        );
        let mut text = Printer::into(false, Vec::new());
        show(&[source], &mut text).unwrap();
        let text = String::from_utf8(text.sink()).unwrap();
        assert!(text.contains("memory (SIMULATED)"), "{text}");
    }
}
