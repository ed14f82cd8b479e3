//! `tactus instruments discover`: finds instruments and proposes lines of configuration. Without a daemon,
//! `tactusd --discover` prints the same.

use std::io::Write;

use dbus::json::DiscoverLine;
use dbus::{DiscoverOptions, Discovery};
use survey::printable;

use crate::args::Discover;
use crate::connection::{Daemon, fault};
use crate::failure::Failure;
use crate::options::duration::display_span;
use crate::output::Printer;
use crate::output::table::columns;

pub(crate) async fn run(
    daemon: &Daemon,
    requested: &Discover,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let options = DiscoverOptions {
        within_s: Some(requested.within.as_secs_f64()),
        mdns: Some(!requested.no_mdns),
        broadcast: Some(!requested.no_broadcast),
    };
    let addresses: Vec<&str> = requested.addresses.iter().map(String::as_str).collect();
    // added to the listening time: the daemon's own timeout for each instrument
    let patience = daemon.patience + requested.within;
    let found = tokio::time::timeout(patience, daemon.manager.discover(&addresses, &options))
        .await
        .map_err(|_| {
            let patience = display_span(patience);
            Failure::Timeout(format!("the search: no reply within {patience}"))
        })?
        .map_err(|error| fault("the search", &error))?;
    show(found, printer)
}

fn show(found: Discovery, printer: &mut Printer<impl Write>) -> Result<(), Failure> {
    if printer.is_json() {
        for seen in found.seen {
            printer.record(&DiscoverLine::from(seen), |_| String::new())?;
        }
        for text in found.notes {
            printer.record(&DiscoverLine::Note { text }, |_| String::new())?;
        }
        return Ok(());
    }
    for note in &found.notes {
        printer.text(&format!("note: {}", printable(note)))?;
    }
    if found.seen.is_empty() {
        return printer.text(
            "no instrument was found; a 6221 does not announce itself: give its address (tcp:HOST:1394) to query it",
        );
    }
    let rows: Vec<[String; 4]> = found
        .seen
        .iter()
        .map(|seen| {
            let used = if seen.in_use { " (in use)" } else { "" };
            let shown = match seen.identity.as_str() {
                "" => seen.remark.clone(),
                identity => identity.to_owned(),
            };
            let address = format!("{}{used}", seen.address);
            [address, seen.found_by.clone(), seen.name.clone(), shown]
        })
        .collect();
    printer.text(&columns(
        ["address", "found by", "announced as", "*IDN?"],
        &rows,
    ))?;
    let proposals = found
        .seen
        .iter()
        .filter(|seen| !seen.in_use && !seen.proposal.is_empty());
    let mut proposals = proposals.peekable();
    if proposals.peek().is_some() {
        printer.text(
            "\nLines for a configuration (an instrument is used only if a configuration names it):",
        )?;
    }
    for seen in proposals {
        printer.text(&format!(
            "# {}\n{}",
            printable(&seen.identity),
            seen.proposal
        ))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use dbus::SeenInstrument;

    use crate::instruments::discover::*;

    #[test]
    fn what_is_found_is_proposed_and_what_is_used_is_not() {
        let seen = |address: &str, in_use| SeenInstrument {
            address: address.into(),
            identity: "KEITHLEY INSTRUMENTS INC.,MODEL 6221,1,D04".into(),
            found_by: "mdns".into(),
            name: String::new(),
            in_use,
            proposal: format!("[source]\naddress = \"{address}\""),
            remark: String::new(),
        };
        let found = || Discovery {
            seen: vec![seen("tcp:a:1394", true), seen("tcp:b:1394", false)],
            notes: vec!["there is no multicast".into()],
        };
        let mut text = Printer::into(false, Vec::new());
        show(found(), &mut text).unwrap();
        let text = String::from_utf8(text.sink()).unwrap();
        assert!(
            text.contains("note: there is no multicast") && text.contains("(in use)"),
            "{text}"
        );
        assert_eq!(text.matches("[source]").count(), 1, "{text}");
        assert!(text.contains("address = \"tcp:b:1394\""), "{text}");
        let mut json = Printer::into(true, Vec::new());
        show(found(), &mut json).unwrap();
        let json = String::from_utf8(json.sink()).unwrap();
        let lines: Vec<serde_json::Value> = json
            .lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect();
        assert_eq!(lines.len(), 3);
        assert_eq!(
            (&lines[1]["name"], &lines[2]["event"]),
            (&serde_json::Value::Null, &"note".into())
        );
    }
}
