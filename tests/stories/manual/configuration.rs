//! The reference page of the configuration: the complete example, and a table of the numbers of each section.

use super::pages;

/// The complete example, with a heading per table.
pub(super) fn page() -> String {
    let example = std::fs::read_to_string(pages::root().join("config.toml"))
        .expect("the complete example ships with the project");
    let mut page = "# Configuration\n\nEvery key of `config.toml`, with its default or its form. This is the complete example \
           `config.toml` of the repository, a heading for each table. `tactusd --check` reports every problem as \
           file:line:column; `tactusd --print-config` prints a configuration with all defaults in it. Below each table stand \
           the unit, the range and the default of its numbers; `-` is no unit, or no default: the number is then \
           chosen or needed as the comment states.\n\n"
        .to_owned();
    let defaults = defaults();
    let mut open: Option<&str> = None;
    let mut pending: Vec<&str> = Vec::new();
    for line in example.lines() {
        if let Some(table) = table_name(line) {
            // comments between the last blank line and a table belong to the table
            let above = pending
                .iter()
                .rposition(|line| line.is_empty())
                .map_or(pending.len(), |blank| blank + 1);
            let comments = match open {
                Some(_) => pending.split_off(above),
                None => Vec::new(),
            };
            close(&mut page, &mut pending, open, &defaults);
            page += &format!("## {table}\n\n");
            pending = comments;
            open = Some(table);
        }
        pending.push(line);
    }
    close(&mut page, &mut pending, open, &defaults);
    page.trim_end().to_owned() + "\n"
}

/// The name of a table, including one that is commented out.
fn table_name(line: &str) -> Option<&str> {
    let line = line.strip_prefix("# ").unwrap_or(line);
    let (name, _) = line.strip_prefix('[')?.split_once(']')?;
    let is_name = |letter: char| letter.is_ascii_lowercase() || ".-_".contains(letter);
    name.chars().all(is_name).then_some(name)
}

fn close(page: &mut String, pending: &mut Vec<&str>, open: Option<&str>, defaults: &toml::Table) {
    let text = pending.join("\n");
    let text = text.trim();
    if open.is_some() || !text.is_empty() {
        *page += &format!("```toml\n{text}\n```\n\n");
    }
    if let Some(table) = open {
        *page += &numbers(table, defaults);
        // in the example, the alarm rules follow this table
        if table == "quantities" {
            *page += &numbers("alarm", defaults);
        }
    }
    pending.clear();
}

/// A row per numeric key of a table; nothing for a table without numbers.
fn numbers(table: &str, defaults: &toml::Table) -> String {
    let mut rows = String::new();
    for (key, bounds) in config::numbers::keys() {
        let (section, name) = key.rsplit_once('.').expect("every key belongs to a table");
        if section == table {
            let default = default_of(key, defaults).unwrap_or_else(|| "-".to_owned());
            rows += &format!("| `{name}` | {} | {bounds} | {default} |\n", unit(name));
        }
    }
    if rows.is_empty() {
        return rows;
    }
    format!("| number in `[{table}]` | unit | range | default |\n|---|---|---|---|\n{rows}\n")
}

/// The configuration that an empty file gives, with the optional tables.
fn defaults() -> toml::Table {
    let optional = "[source]\n[recording]\n[geometry.paper-sheet]\n[geometry.disc-tank]\n";
    let read = config::problems::Source::new("defaults.toml".as_ref(), optional.to_owned()).read();
    let config = read.0.expect("a file without keys is valid");
    toml::Table::try_from(config).expect("every configuration can be written")
}

fn default_of(key: &str, defaults: &toml::Table) -> Option<String> {
    let (section, name) = key.rsplit_once('.')?;
    let mut table = defaults;
    for part in section.split('.') {
        table = table.get(part)?.as_table()?;
    }
    table.get(name).map(ToString::to_string)
}

/// The unit that the end of a key's name states.
fn unit(name: &str) -> &'static str {
    let units = [
        ("per_s", "1/s"),
        ("per_hour", "1/h"),
        ("_ua", "uA"),
        ("_uv", "uV"),
        ("_v", "V"),
        ("_hz", "Hz"),
        ("_ohm", "ohm"),
        ("_kpa", "kPa"),
        ("_percent", "%"),
        ("_cm2", "cm2"),
        ("_mm", "mm"),
        ("_deg", "degrees"),
        ("_mb", "MB"),
        ("_days", "days"),
        ("_cycles", "cycles"),
        ("nplc", "power-line cycles"),
        ("_periods", "periods of the schedule"),
        ("_ms", "ms"),
        ("_h", "h"),
        ("_s", "s"),
    ];
    let known = units.iter().find(|(end, _)| name.ends_with(end));
    known.map_or("-", |(_, unit)| unit)
}
