//! The settings of the archive, from the configuration of the daemon.

use std::path::{Path, PathBuf};
use std::time::Duration;

use config::problems::{Problem, Source};

use crate::catalogue::Access;
use crate::store::name_fault;
use crate::upload::Owner;

/// What `[archive]` and `[record]` say.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Site and machine.
    pub owner: Owner,
    /// Folder of the store.
    pub store: PathBuf,
    /// The catalogue.
    pub access: Access,
    /// Period of `run`.
    pub every: Duration,
    /// Folder of the record.
    pub record: PathBuf,
}

/// Why there are no settings.
#[derive(Debug, thiserror::Error)]
pub enum SettingsError {
    /// The file cannot be read.
    #[error("cannot read {}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Error of the system.
        #[source]
        source: std::io::Error,
    },
    /// Values are missing or wrong.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
    Problems(Vec<Problem>),
}

impl Settings {
    /// Reads the configuration.
    ///
    /// # Errors
    /// It cannot be read, or has problems, each with file, line and column.
    pub fn read(path: &Path) -> Result<Self, SettingsError> {
        let text = std::fs::read_to_string(path).map_err(|source| SettingsError::Unreadable {
            path: path.to_owned(),
            source,
        })?;
        let source = Source::new(path, text);
        let (config, problems) = source.read();
        let config = match config {
            Some(config) if problems.is_empty() => config,
            _ => return Err(SettingsError::Problems(problems)),
        };
        let folder = path.parent().unwrap_or(Path::new("."));
        let config = config.resolved(folder);
        let Some(archive) = config.archive else {
            let text = "is missing: without it nothing is archived";
            return Err(SettingsError::Problems(vec![
                source.problem("archive", text),
            ]));
        };
        let daq = archive.daq.clone().unwrap_or_else(host_name);
        let mut problems = Vec::new();
        for (key, name) in [("archive.site", &archive.site), ("archive.daq", &daq)] {
            if let Some(fault) = name_fault(name) {
                problems.push(source.problem(key, fault));
            }
        }
        if archive.store.as_os_str().is_empty() {
            problems
                .push(source.problem("archive.store", "is missing: name the folder of the store"));
        }
        if archive.dsn.is_empty() {
            let text = "is missing: write `host=HOST dbname=DATABASE user=ROLE`";
            problems.push(source.problem("archive.dsn", text));
        }
        match problems.is_empty() {
            false => Err(SettingsError::Problems(problems)),
            true => Ok(Self {
                owner: Owner {
                    site: archive.site,
                    daq,
                },
                store: archive.store,
                access: Access {
                    dsn: archive.dsn,
                    ca: archive.ca,
                    password_file: archive.password_file,
                },
                every: survey::duration(archive.every_s),
                record: config.record.directory.unwrap_or_default(),
            }),
        }
    }
}

/// The host's name in lower case, without its domain.
fn host_name() -> String {
    let name = rustix::system::uname()
        .nodename()
        .to_string_lossy()
        .to_lowercase();
    let (host, _) = name.split_once('.').unwrap_or((&name, ""));
    host.to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Settings, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.toml");
        std::fs::write(&path, text).unwrap();
        Settings::read(&path).map_err(|error| error.to_string())
    }

    #[test]
    fn each_wrong_setting_is_reported_with_its_line() {
        let text =
            read("[archive]\nsite = \"Berlin/1\"\ndaq = \"..\"\nevery_s = 60.0\n").unwrap_err();
        for words in [
            "config.toml:2:8: archive.site: 'Berlin/1' is no name",
            "config.toml:3:7: archive.daq: '..' is no name",
            "archive.store: is missing",
            "archive.dsn: is missing",
        ] {
            assert!(text.contains(words), "{text}");
        }
        let none = read("").unwrap_err();
        assert!(none.contains("archive: is missing"), "{none}");
        let fast = read("[archive]\nevery_s = 0.0\n").unwrap_err();
        assert!(fast.contains("archive.every_s"), "{fast}");
    }

    #[test]
    fn paths_are_relative_to_the_file_of_the_settings() {
        let text = "[archive]\nsite = \"berlin\"\nstore = \"store\"\ndsn = \"host=localhost dbname=a user=b\"\nca = \"ca.pem\"\n";
        let settings = read(text).unwrap();
        assert!(settings.store.is_absolute() && settings.store.ends_with("store"));
        assert!(settings.access.ca.is_some_and(|ca| ca.is_absolute()));
        assert_eq!(settings.every, Duration::from_secs(60));
        assert!(name_fault(&settings.owner.daq).is_none());
    }
}
