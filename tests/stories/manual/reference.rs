//! The reference pages of commands, configuration, events and metrics agree with the programs.

use clap::Command;
use clap_markdown::MarkdownOptions;

use super::{commands, pages};

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
    generated.push(("configuration.md".to_owned(), configuration_page()));
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

/// The complete example, with a heading per table.
fn configuration_page() -> String {
    let example = std::fs::read_to_string(pages::root().join("config.toml"))
        .expect("the complete example ships with the project");
    let mut page = generated("config.toml")
        + "# Configuration\n\nEvery key of `config.toml`, with its default or its form. This is the complete example \
           `config.toml` of the repository, a heading for each table. `tactusd --check` reports every problem as \
           file:line:column; `tactusd --print-config` prints a configuration with all defaults in it.\n\n";
    let mut open = false;
    let mut pending: Vec<&str> = Vec::new();
    for line in example.lines() {
        if let Some(table) = table_name(line) {
            // comments between the last blank line and a table belong to the table
            let above = pending
                .iter()
                .rposition(|line| line.is_empty())
                .map_or(pending.len(), |blank| blank + 1);
            let comments = match open {
                true => pending.split_off(above),
                false => Vec::new(),
            };
            close(&mut page, &mut pending, open);
            page += &format!("## {table}\n\n");
            pending = comments;
            open = true;
        }
        pending.push(line);
    }
    close(&mut page, &mut pending, open);
    page.trim_end().to_owned() + "\n"
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

/// The name of a table, including one that is commented out.
fn table_name(line: &str) -> Option<&str> {
    let line = line.strip_prefix("# ").unwrap_or(line);
    let (name, _) = line.strip_prefix('[')?.split_once(']')?;
    let is_name = |letter: char| letter.is_ascii_lowercase() || ".-_".contains(letter);
    name.chars().all(is_name).then_some(name)
}

fn close(page: &mut String, pending: &mut Vec<&str>, open: bool) {
    let text = pending.join("\n");
    let text = text.trim();
    if open || !text.is_empty() {
        *page += &format!("```toml\n{text}\n```\n\n");
    }
    pending.clear();
}
