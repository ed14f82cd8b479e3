//! The reference pages of commands, configuration, events and metrics agree with the programs.

use clap::Command;
use clap_markdown::MarkdownOptions;

use super::{commands, configuration, pages};

const WRITE: &str = "TACTUS_WRITE_REFERENCE";

#[test]
fn reference_pages_are_generated_from_the_programs() {
    let mut generated: Vec<(String, String)> = commands::programs()
        .iter()
        .map(|program| {
            let name = program.get_name();
            (format!("commands-{name}.md"), command_page(program))
        })
        .collect();
    let configuration = self::generated("config.toml") + &configuration::page();
    generated.push(("configuration.md".to_owned(), configuration));
    generated.push(("events.md".to_owned(), events_page()));
    generated.push(("metrics.md".to_owned(), metrics_page()));
    let folder = pages::root().join("docs/reference");
    let mut stale = Vec::new();
    for (name, text) in generated {
        let path = folder.join(&name);
        if std::env::var_os(WRITE).is_some() {
            std::fs::write(&path, &text).expect("the manual can be written");
        }
        let kept = std::fs::read_to_string(&path).unwrap_or_default();
        if kept != text {
            let line = kept
                .lines()
                .zip(text.lines())
                .position(|(kept, generated)| kept != generated)
                .map_or("its end".to_owned(), |line| format!("line {}", line + 1));
            stale.push(format!("docs/reference/{name} differs from {line} on"));
        }
    }
    assert!(
        stale.is_empty(),
        "{}\nwrite them anew: {WRITE}=1 cargo test -p tactus-tests --test stories manual::reference",
        stale.join("\n")
    );
}

/// The comment that marks a generated page.
fn generated(from: &str) -> String {
    format!(
        "<!-- Generated from {from}. Do not edit: \
         {WRITE}=1 cargo test -p tactus-tests --test stories manual::reference -->\n\n"
    )
}

fn command_page(program: &Command) -> String {
    let name = program.get_name();
    let options = MarkdownOptions::new()
        .title(format!("Commands of `{name}`"))
        .show_footer(false);
    let page = clap_markdown::help_markdown_command_custom(program, &options);
    let mut lines = Vec::new();
    let mut in_examples = false;
    for line in page.lines().map(str::trim_end) {
        if in_examples && line.is_empty() {
            lines.push("```");
            in_examples = false;
        }
        lines.push(line);
        if line == help_examples::HEADING {
            lines.extend(["", "```text"]);
            in_examples = true;
        }
    }
    let head = generated("the program's own definitions");
    format!("{head}{}\n", lines.join("\n").trim())
}

/// A row per kind of event.
fn events_page() -> String {
    let mut page = generated("the daemon's table of events")
        + "# Events\n\nWhat the daemon reports. Each event has `at` (time), `kind` (the name below), `text` (a sentence) and \
           `session` (empty for an event of the daemon): the columns of [`tactus events`](commands-tactus.md), the \
           [JSON](json.md) of that command, and the signal `Happened` of the [bus](interfaces.md). In the journal the fields \
           are `TACTUS_KIND` and `TACTUS_SESSION`, for a frame that failed also `TACTUS_FRAME` and `TACTUS_INSTRUMENT`; \
           the journal shows each kind at most once in ten minutes, with the number left out.\n\n\
           | name | level | kept in | meaning | what to do |\n|---|---|---|---|---|\n";
    for row in daemon::event_kinds() {
        page += &format!(
            "| `{}` | {} | {} | {} | {} |\n",
            row.name, row.level, row.kept, row.meaning, row.action
        );
    }
    page + "\nEvents that are kept nowhere are in the journal alone. Events without a level are written by the program that \
            writes the file, not reported.\n"
}

/// A row per metric.
fn metrics_page() -> String {
    let mut page = generated("the daemon's table of metrics")
        + "# Metrics\n\n`tactusd` serves OpenMetrics at `/metrics`, off by default ([metrics](configuration.md#metrics)). A \
           value that is not known is left out. Flags are 0 or 1.\n\n\
           | name | type | unit | label | meaning |\n|---|---|---|---|---|\n";
    for row in daemon::metrics() {
        page += &format!(
            "| `{}` | {} | {} | {} | {} |\n",
            row.name, row.kind, row.unit, row.label, row.meaning
        );
    }
    page
}
