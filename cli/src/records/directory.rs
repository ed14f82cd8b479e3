//! Session files on disk, found and read without a daemon.

use std::path::{Path, PathBuf};
use std::time::Duration;

use eit::DiscTank;
use imaging::{Geometry, GeometrySettings, ReconstructionSettings, short_hash};
use logbook::{LogbookError, SessionHeader, SessionReader};
use serde::de::value::MapDeserializer;
use serde::de::{Deserializer, Visitor};

use crate::args::Global;
use crate::failure::Failure;

/// A running daemon that has not said within this where it records is passed over.
const DAEMON_SAYS_WITHIN: Duration = Duration::from_secs(2);

/// Where session files are looked for: `--state` or `TACTUS_STATE` alone where one is given; else the directory of the
/// running daemon, `$XDG_STATE_HOME/tactus`, `~/.local/state/tactus`, `/var/lib/tactus`.
///
/// # Errors
/// A `--bus` that is no address.
pub(crate) fn directories(global: &Global) -> Result<Vec<PathBuf>, Failure> {
    if let Some(directory) = &global.state {
        return Ok(vec![directory.clone()]);
    }
    let set = |name: &str| {
        std::env::var_os(name)
            .filter(|value| !value.is_empty())
            .map(PathBuf::from)
    };
    if let Some(directory) = set("TACTUS_STATE") {
        return Ok(vec![directory]);
    }
    let usual = [
        set("XDG_STATE_HOME").map(|state| state.join("tactus")),
        set("HOME").map(|home| home.join(".local/state/tactus")),
        Some(PathBuf::from("/var/lib/tactus")),
    ];
    let mut places: Vec<PathBuf> = Vec::new();
    for place in [daemon_directory(global)?].into_iter().chain(usual) {
        places.extend(place.filter(|place| !places.contains(place)));
    }
    Ok(places)
}

/// Where a running daemon records; `None` where none answers.
fn daemon_directory(global: &Global) -> Result<Option<PathBuf>, Failure> {
    let Ok(runtime) = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
    else {
        return Ok(None);
    };
    let hurried = Global {
        timeout: global.timeout.min(DAEMON_SAYS_WITHIN),
        ..global.clone()
    };
    let said = runtime.block_on(async {
        let daemon = crate::control::connection::open(&hurried).await?;
        daemon
            .ask("the record", daemon.manager.record_directory())
            .await
    });
    match said {
        Ok(directory) => Ok(Some(PathBuf::from(directory))),
        Err(Failure::Usage(wrong)) => Err(Failure::Usage(wrong)),
        Err(_) => Ok(None),
    }
}

/// Places as a person reads them.
pub(crate) fn listed(places: &[PathBuf]) -> String {
    let places: Vec<String> = places
        .iter()
        .map(|place| place.display().to_string())
        .collect();
    places.join(", ")
}

/// The file of a session: a path as it is, else the id (or its beginning) in the first of [`directories`] that has it.
pub(crate) fn session_file(global: &Global, named: &str) -> Result<PathBuf, Failure> {
    let path = Path::new(named);
    if path.is_file() {
        return Ok(path.to_owned());
    }
    if named.contains('/') || named.ends_with(".tactus") {
        return Err(Failure::Failed(format!(
            "there is no file or folder {named}; `tactus sessions` lists what is recorded"
        )));
    }
    let places = directories(global)?;
    let mut unreadable = Vec::new();
    for place in &places {
        match logbook::find(place, named) {
            Ok(file) => return Ok(file),
            Err(LogbookError::NoSuchSession { .. }) => {}
            Err(error @ (LogbookError::Ambiguous { .. } | LogbookError::BadId { .. })) => {
                return Err(refused(&error));
            }
            Err(_) if !place.exists() => {}
            Err(error) => unreadable.push(crate::failure::chain(&error)),
        }
    }
    let mut text = format!(
        "no session '{named}' in {}; --state DIR names another directory of session files",
        listed(&places)
    );
    for why in unreadable {
        text.push_str("\n  ");
        text.push_str(&why);
    }
    Err(Failure::Missing(text))
}

/// Opens a session file.
pub(crate) fn open(path: &Path) -> Result<SessionReader, Failure> {
    SessionReader::open(path).map_err(|error| refused(&error))
}

/// What the logbook's refusal means here.
pub(crate) fn refused(error: &LogbookError) -> Failure {
    let text = crate::failure::chain(error);
    match error {
        LogbookError::NoSuchSession { .. } => Failure::Missing(format!(
            "{text}; --state DIR names another directory of session files"
        )),
        LogbookError::Ambiguous { .. } => Failure::Usage(text),
        LogbookError::BadId { .. } => Failure::Usage(text),
        LogbookError::NotASession { .. } | LogbookError::OtherSchema { .. } => {
            Failure::Failed(text)
        }
        _ => Failure::Failed(text),
    }
}

/// The part of a daemon's configuration that says how maps are made.
#[derive(Debug, Default)]
pub(crate) struct Kept {
    geometry: GeometrySettings,
    pub(crate) model: ReconstructionSettings,
}

/// The effective configuration kept in a session. The daemon has checked it, so keys that this program does not know are
/// passed over.
///
/// # Errors
/// Text that is no configuration of a daemon.
pub(crate) fn kept(header: &SessionHeader) -> Result<Kept, Failure> {
    let read = || -> Result<Kept, toml::de::Error> {
        let mut tables: toml::Table = toml::from_str(&header.config_toml)?;
        Ok(Kept {
            geometry: known_keys(tables.remove("geometry"))?,
            model: known_keys(tables.remove("model"))?,
        })
    };
    read().map_err(|error| {
        Failure::configuration(
            &format!(
                "the configuration kept in session {} cannot be read; {NAME_IT}",
                header.id
            ),
            &error,
        )
    })
}

/// A section without the keys that its type does not have.
fn known_keys<T: serde::de::DeserializeOwned + Default>(
    section: Option<toml::Value>,
) -> Result<T, toml::de::Error> {
    match section {
        None => Ok(T::default()),
        Some(toml::Value::Table(table)) => T::deserialize(KnownKeys(table)),
        Some(other) => other.try_into(),
    }
}

/// A table that gives a struct the keys that the struct has.
struct KnownKeys(toml::Table);

impl<'de> Deserializer<'de> for KnownKeys {
    type Error = toml::de::Error;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Self::Error> {
        visitor.visit_map(MapDeserializer::new(self.0.into_iter()))
    }

    fn deserialize_struct<V: Visitor<'de>>(
        mut self,
        _name: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Self::Error> {
        self.0.retain(|key, _| fields.contains(&key));
        self.deserialize_any(visitor)
    }

    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option unit unit_struct
        newtype_struct seq tuple tuple_struct map enum identifier ignored_any
    }
}

const NAME_IT: &str =
    "say --preset paper-sheet or disc-tank, --case DIR with a mesh, or --model FILE";

/// The geometry of a session, from the configuration kept in it, verified by the hash kept beside it.
///
/// # Errors
/// The geometry that is named is not the one that was used.
pub(crate) fn geometry(header: &SessionHeader) -> Result<Geometry, Failure> {
    let mut named = kept(header)?.geometry;
    if named.case.is_some() {
        named.preset = None;
    }
    named.disc_tank.get_or_insert_with(|| DiscTank {
        electrodes: header.protocol.electrodes(),
        ..DiscTank::default()
    });
    let mut geometry = named.geometry(None)?;
    // the daemon takes it as it is where a case folder does not say it
    geometry.sigma0_known = true;
    match &header.geometry_hash {
        Some(hash) if hash != geometry.mesh.hash() => Err(Failure::Configuration(format!(
            "session {} was recorded on geometry {}, its configuration gives {} here; {NAME_IT}",
            header.id,
            short_hash(hash),
            short_hash(geometry.mesh.hash()),
        ))),
        _ => Ok(geometry),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_keys_of_a_kept_section_are_passed_over() {
        let section = |text: &str| Some(toml::Value::Table(toml::from_str(text).unwrap()));
        let read: ReconstructionSettings = known_keys(section(
            "method = \"tv\"\ngap = 1e-4\nof_a_later_version = 3\nloss_only = true",
        ))
        .unwrap();
        let asked = ReconstructionSettings {
            method: Some(imaging::Method::Tv),
            gap: Some(1e-4),
            loss_only: Some(true),
            ..ReconstructionSettings::default()
        };
        assert_eq!(read, asked);
        let tank: GeometrySettings = known_keys(section(
            "preset = \"disc-tank\"\nlater = 1\n[disc-tank]\nradius_mm = 50.0",
        ))
        .unwrap();
        assert_eq!(tank.disc_tank.unwrap().radius_mm, 50.0);
        let wrong: Result<ReconstructionSettings, _> = known_keys(section("gap = \"small\""));
        assert!(wrong.is_err());
    }
}
