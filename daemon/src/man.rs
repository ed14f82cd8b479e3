//! Generates the daemon's manual pages from its command line and the complete example configuration.

use std::io;
use std::path::Path;

use clap_mangen::roff::{Roff, bold, roman};
use outfile::{Existing, OutFileError};

/// The complete example configuration, which has every key.
const EXAMPLE: &str = include_str!("../../config.toml");

/// Writes `tactusd.8` and `tactus.toml.5`.
pub(crate) fn write(folder: &Path) -> io::Result<()> {
    let daemon = help_examples::manual_page(&crate::command(), "8")?;
    put(&folder.join("tactusd.8"), &daemon)?;
    let mut file = Vec::new();
    configuration().to_writer(&mut file)?;
    put(&folder.join("tactus.toml.5"), &file)
}

fn put(path: &Path, page: &[u8]) -> io::Result<()> {
    outfile::write(path, Existing::Refuse, page).map_err(OutFileError::into_io)
}

fn configuration() -> Roff {
    let mut page = Roff::new();
    page.control("TH", ["tactus.toml", "5"])
        .control("SH", ["NAME"])
        .text([roman("/etc/tactus/config.toml - configuration of tactusd")])
        .control("SH", ["DESCRIPTION"])
        .text([
            roman("Relative paths are relative to the folder of the file. "),
            bold("tactusd --check"),
            roman(" reports every problem as file:line:column; "),
            bold("systemctl reload tactusd"),
            roman(" loads a changed file; if it is invalid, nothing changes. This is a complete example:"),
        ])
        .control("nf", []);
    for line in EXAMPLE.lines() {
        page.text([roman(line)]);
    }
    page.control("fi", []).control("SH", ["SEE ALSO"]).text([
        bold("tactusd"),
        roman("(8), "),
        bold("tactus"),
        roman("(1)"),
    ]);
    page
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pages_have_every_option_and_every_key() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path()).unwrap();
        let page = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
        assert!(page("tactusd.8").contains("safe\\-off"));
        let keys = page("tactus.toml.5");
        for line in EXAMPLE.lines().filter(|line| line.contains(" = ")) {
            let key = line.trim_start_matches("# ").split(' ').next().unwrap();
            assert!(keys.contains(key), "no {key}");
        }
    }
}
