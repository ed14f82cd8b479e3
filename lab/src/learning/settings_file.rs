//! A settings file (TOML) of `--settings`; its errors name the file and the line.

use std::path::Path;

use serde::de::DeserializeOwned;
use toml::de::DeTable;

/// A settings file that was read.
pub(super) struct SettingsFile<'a> {
    path: &'a Path,
    text: String,
}

impl<'a> SettingsFile<'a> {
    /// Reads the file.
    ///
    /// # Errors
    /// The system's.
    pub(super) fn read(path: &'a Path) -> Result<Self, std::io::Error> {
        let text = std::fs::read_to_string(path)?;
        Ok(Self { path, text })
    }

    /// The settings.
    ///
    /// # Errors
    /// Invalid TOML, an unknown key or a value of another type, as a text.
    pub(super) fn parsed<T: DeserializeOwned>(&self) -> Result<T, String> {
        toml::from_str(&self.text).map_err(|fault| {
            let at = fault.span().map(|span| span.start);
            self.at(at, fault.message())
        })
    }

    /// A text about a key, after the file and the line of the key. `keys`: the tables of the key, and the key.
    pub(super) fn about(&self, keys: &[&str], text: &str) -> String {
        let (table, _) = DeTable::parse_recoverable(&self.text);
        let (mut level, mut at) = (Some(table.get_ref()), None);
        for key in keys {
            let mut entries = level.into_iter().flatten();
            let found = entries.find(|(name, _)| name.get_ref() == key);
            at = found.map(|(name, _)| name.span().start).or(at);
            level = found.and_then(|(_, value)| value.get_ref().as_table());
        }
        self.at(at, text)
    }

    fn at(&self, byte: Option<usize>, text: &str) -> String {
        let line = byte.map_or(String::new(), |byte| {
            format!(":{}", survey::line_and_column(&self.text, byte).0)
        });
        format!("{}{line}: {text}", self.path.display())
    }
}
