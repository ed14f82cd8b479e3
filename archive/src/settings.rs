//! The settings of the archive, from the configuration of the daemon.

use std::path::{Path, PathBuf};
use std::time::Duration;

use config::ArchiveSection;
use config::problems::{Problem, Source};

use crate::catalogue::Access;
use crate::credentials::{certificates, secret};
use crate::live::LiveSettings;
use crate::store::{BucketAccess, Directory, Objects, Store, name_fault};
use crate::upload::Owner;

/// Settings from `[archive]`, `[mqtt]` and `[record]`.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Site and machine.
    pub owner: Owner,
    /// The store.
    pub store: StorePlace,
    /// The catalogue.
    pub access: Access,
    /// Period of `run`.
    pub every: Duration,
    /// Largest size of the cache of fetched sessions, bytes.
    pub cache_bytes: u64,
    /// Folder of the record.
    pub record: PathBuf,
    /// The live topics, if there are any.
    pub live: Option<LiveSettings>,
}

/// Where the store is.
#[derive(Debug, Clone)]
pub enum StorePlace {
    /// A folder.
    Folder(PathBuf),
    /// A bucket of an S3-compatible server.
    Bucket(BucketAccess),
}

impl StorePlace {
    /// Creates the store; nothing is read or written yet.
    ///
    /// # Errors
    /// The address of a bucket cannot be used.
    pub fn open(&self) -> Result<Box<dyn Store>, SettingsError> {
        match self {
            Self::Folder(folder) => Ok(Box::new(Directory::new(folder))),
            Self::Bucket(access) => Objects::new(access)
                .map(|store| Box::new(store) as Box<dyn Store>)
                .map_err(SettingsError::Endpoint),
        }
    }
}

/// Errors of the settings.
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
    /// The address of a bucket is wrong.
    #[error("archive.store_endpoint: {0}")]
    Endpoint(String),
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
        Self::read_as(path, false)
    }

    /// Reads the configuration of a machine that only reads the archive and belongs to no site.
    ///
    /// # Errors
    /// As [`Settings::read`].
    pub fn read_for_reader(path: &Path) -> Result<Self, SettingsError> {
        Self::read_as(path, true)
    }

    fn read_as(path: &Path, reader: bool) -> Result<Self, SettingsError> {
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
        let config = config.resolved(logbook::folder_of(path));
        let Some(archive) = config.archive else {
            let text = match reader {
                true => "is missing: it locates the archive",
                false => "is missing: without it nothing is archived",
            };
            return Err(SettingsError::Problems(vec![
                source.problem("archive", text),
            ]));
        };
        let daq = archive.daq.clone().unwrap_or_else(host_name);
        let mut problems = Vec::new();
        let own = [("archive.site", &archive.site), ("archive.daq", &daq)];
        for (key, name) in own.into_iter().filter(|_| !reader) {
            if let Some(fault) = name_fault(name) {
                problems.push(source.problem(key, fault));
            }
        }
        let store = match archive.bucket() {
            Some(_) => bucket(&archive).map(StorePlace::Bucket),
            None if archive.store.is_empty() => Err((
                "store",
                "is missing: name the folder of the store, or s3://BUCKET".to_owned(),
            )),
            None => Ok(StorePlace::Folder(PathBuf::from(&archive.store))),
        };
        if let Err((key, fault)) = &store {
            problems.push(source.problem(&format!("archive.{key}"), fault.as_str()));
        }
        let of_bucket = [
            ("store_endpoint", archive.store_endpoint.is_some()),
            ("store_region", archive.store_region.is_some()),
            ("store_keys_file", archive.store_keys_file.is_some()),
            ("store_ca", archive.store_ca.is_some()),
        ];
        if matches!(store, Ok(StorePlace::Folder(_))) {
            for (key, _) in of_bucket.into_iter().filter(|(_, given)| *given) {
                let text = "belongs to a bucket, and archive.store is a folder";
                problems.push(source.problem(&format!("archive.{key}"), text));
            }
        }
        if archive.dsn.is_empty() {
            let text = "is missing: write `host=HOST dbname=DATABASE user=ROLE`";
            problems.push(source.problem("archive.dsn", text));
        }
        let owner = Owner {
            site: archive.site,
            daq,
        };
        let live = config
            .mqtt
            .map(|mqtt| LiveSettings::of(&mqtt, &config.bus, &owner))
            .transpose()
            .map_err(|(key, fault)| {
                problems.push(source.problem(&format!("mqtt.{key}"), fault));
            });
        match (store, live) {
            (Ok(store), Ok(live)) if problems.is_empty() => Ok(Self {
                owner,
                store,
                access: Access {
                    dsn: archive.dsn,
                    ca: archive.ca,
                    password_file: archive.password_file,
                },
                every: survey::duration(archive.every_s),
                cache_bytes: archive.cache_mb.saturating_mul(1_000_000),
                record: config.record.directory.unwrap_or_default(),
                live,
            }),
            _ => Err(SettingsError::Problems(problems)),
        }
    }
}

/// Region for a server without regions.
const REGION: &str = "us-east-1";
/// Name of the systemd credential with the keys of the bucket.
const CREDENTIAL: &str = "archive-store-keys";

/// Access to the bucket of a section; the error names the key that is wrong.
fn bucket(archive: &ArchiveSection) -> Result<BucketAccess, (&'static str, String)> {
    let name = archive.bucket().unwrap_or_default();
    let good = |byte: u8| byte.is_ascii_alphanumeric() || b".-_".contains(&byte);
    if name.is_empty() || !name.bytes().all(good) {
        return Err((
            "store",
            format!("'{name}' is not a bucket: write s3://BUCKET"),
        ));
    }
    let Some(endpoint) = archive.store_endpoint.clone() else {
        let text = "is missing: the address of the bucket's server, https://HOST";
        return Err(("store_endpoint", text.to_owned()));
    };
    let folder = std::env::var_os("CREDENTIALS_DIRECTORY");
    let keys = secret(archive.store_keys_file.as_deref(), CREDENTIAL, folder);
    let keys = keys.map_err(|fault| ("store_keys_file", fault))?;
    let lines = keys.as_deref().and_then(|text| text.split_once('\n'));
    let Some((key, secret)) = lines else {
        let text = "is missing, or does not have two lines: the name of the key, and the key";
        return Err(("store_keys_file", text.to_owned()));
    };
    let authorities = match &archive.store_ca {
        Some(path) => certificates(path).map_err(|fault| ("store_ca", fault))?,
        None => Vec::new(),
    };
    Ok(BucketAccess {
        endpoint,
        region: archive
            .store_region
            .clone()
            .unwrap_or_else(|| REGION.to_owned()),
        bucket: name.to_owned(),
        authorities: authorities.iter().map(|der| der.to_vec()).collect(),
        key: key.trim().to_owned(),
        secret: secret.trim().to_owned(),
    })
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
            "config.toml:2:8: archive.site: 'Berlin/1' is not a name",
            "config.toml:3:7: archive.daq: '..' is not a name",
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
    fn settings_of_a_bucket_are_refused_with_a_folder() {
        let archive = "[archive]\nsite = \"berlin\"\nstore = \"store\"\ndsn = \"host=localhost dbname=a user=b\"\n";
        for key in [
            "store_endpoint",
            "store_region",
            "store_keys_file",
            "store_ca",
        ] {
            let text = read(&format!("{archive}{key} = \"x\"\n")).unwrap_err();
            let words =
                format!("archive.{key}: belongs to a bucket, and archive.store is a folder");
            assert!(text.contains(&words), "{text}");
        }
        assert!(read(archive).is_ok());
    }

    #[test]
    fn each_wrong_setting_of_live_topics_is_reported() {
        let archive = "[archive]\nsite = \"berlin\"\nstore = \"store\"\ndsn = \"host=localhost dbname=a user=b\"\n[mqtt]\n";
        for (mqtt, words) in [
            ("every_s = 10.0\n", "config.toml:5:2: mqtt.host: is missing"),
            (
                "host = \"broker.example.org\"\n",
                "config.toml:6:8: mqtt.host: broker.example.org is another machine: give mqtt.ca",
            ),
            (
                "host = \"localhost\"\npassword_file = \"p\"\n",
                "config.toml:7:17: mqtt.password_file: needs mqtt.user",
            ),
            (
                "host = \"localhost\"\nhome_assistant = \"a/#\"\n",
                "config.toml:7:18: mqtt.home_assistant: is not a topic",
            ),
            (
                "host = \"localhost\"\nport = 65536\n",
                "config.toml:7:8: mqtt.port: ",
            ),
            (
                "host = \"localhost\"\nport = 0\n",
                "config.toml:7:8: mqtt.port: ",
            ),
            (
                "host = \"localhost\"\nevery_s = 0.1\n",
                "config.toml:7:11: mqtt.every_s: ",
            ),
            ("hots = \"localhost\"\n", "config.toml:6:1"),
            (
                "host = \"localhost\"\n[bus]\npeer = false\n",
                "config.toml:6:8: mqtt.host: needs a bus of the daemon",
            ),
        ] {
            let text = read(&format!("{archive}{mqtt}")).unwrap_err();
            assert!(text.contains(words), "{mqtt}: {text}");
        }
        let live = |mqtt: &str| read(&format!("{archive}{mqtt}")).unwrap().live.unwrap();
        assert_eq!(live("host = \"127.0.0.1\"\n").port, 1883);
        let remote = live("host = \"broker.example.org\"\nca = \"ca.pem\"\n");
        assert_eq!(remote.port, 8883);
        assert!(remote.ca.is_some_and(|ca| ca.is_absolute()));
        assert!(
            read(archive.trim_end_matches("[mqtt]\n"))
                .unwrap()
                .live
                .is_none()
        );
    }

    #[test]
    fn paths_are_relative_to_the_file_of_the_settings() {
        let text = "[archive]\nsite = \"berlin\"\nstore = \"store\"\ndsn = \"host=localhost dbname=a user=b\"\nca = \"ca.pem\"\n";
        let settings = read(text).unwrap();
        assert!(
            matches!(&settings.store, StorePlace::Folder(folder) if folder.is_absolute() && folder.ends_with("store"))
        );
        assert!(settings.access.ca.is_some_and(|ca| ca.is_absolute()));
        assert_eq!(settings.every, Duration::from_secs(60));
        assert!(name_fault(&settings.owner.daq).is_none());
    }
}
