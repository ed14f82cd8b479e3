//! Reconstruction settings of a recorded session, from the stored configuration.

use eit::DiscTank;
use imaging::quantities::{QuantitySettings, RegionSettings};
use imaging::recorded::Origin;
use imaging::{Geometry, GeometrySettings, ReconstructionSettings, short_hash};
use logbook::SessionHeader;
use serde::de::value::MapDeserializer;
use serde::de::{Deserializer, Visitor};

use crate::failure::Failure;

/// The part of a daemon's configuration that concerns maps.
#[derive(Debug, Default)]
pub(crate) struct StoredConfig {
    geometry: GeometrySettings,
    pub(crate) model: ReconstructionSettings,
    quantities: QuantitySettings,
    regions: Vec<RegionSettings>,
}

/// The effective configuration stored in a session. The daemon has validated it, so keys unknown to this program are
/// ignored.
///
/// # Errors
/// Text that is not a configuration of the daemon.
pub(crate) fn stored_config(header: &SessionHeader) -> Result<StoredConfig, Failure> {
    read_config(header).map_err(|error| {
        Failure::configuration(
            &format!(
                "the configuration kept in session {} cannot be read; {SETTINGS_HINT}",
                header.id
            ),
            &error,
        )
    })
}

/// As [`stored_config`], with only the cause in the error.
pub(crate) fn read_config(header: &SessionHeader) -> Result<StoredConfig, toml::de::Error> {
    let mut tables: toml::Table = toml::from_str(&header.config_toml)?;
    Ok(StoredConfig {
        geometry: known_keys(tables.remove("geometry"))?,
        model: known_keys(tables.remove("model"))?,
        quantities: known_keys(tables.remove("quantities"))?,
        regions: match tables.remove("region") {
            None => Vec::new(),
            Some(regions) => regions.try_into()?,
        },
    })
}

/// Thresholds and regions of a session; the defaults for a case folder.
///
/// # Errors
/// As [`stored_config`].
pub(crate) fn of_quantities(
    origin: &Origin,
) -> Result<(QuantitySettings, Vec<RegionSettings>), Failure> {
    match origin {
        Origin::Folder(_) => Ok((QuantitySettings::default(), Vec::new())),
        Origin::Session(header) => {
            let stored = stored_config(header)?;
            Ok((stored.quantities, stored.regions))
        }
    }
}

/// Parses a section and ignores keys that are unknown to its type.
fn known_keys<T: serde::de::DeserializeOwned + Default>(
    section: Option<toml::Value>,
) -> Result<T, toml::de::Error> {
    match section {
        None => Ok(T::default()),
        Some(toml::Value::Table(table)) => T::deserialize(KnownKeys(table)),
        Some(other) => other.try_into(),
    }
}

/// A table that presents only the known keys of a struct to its deserialisation.
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

const SETTINGS_HINT: &str =
    "give --preset paper-sheet or disc-tank, --case DIR with a mesh, or --model FILE";

/// The geometry of a session from its stored configuration, verified with the stored hash.
///
/// # Errors
/// The named geometry is not the one that was used.
pub(crate) fn geometry(header: &SessionHeader) -> Result<Geometry, Failure> {
    let mut named = stored_config(header)?.geometry;
    if named.case.is_some() {
        named.preset = None;
    }
    named.disc_tank.get_or_insert_with(|| DiscTank {
        electrodes: header.protocol.electrodes(),
        ..DiscTank::default()
    });
    let mut geometry = named.geometry(None)?;
    // the daemon uses the conductance unchanged unless a case folder lacks it
    geometry.sigma0_known = true;
    match &header.geometry_hash {
        Some(hash) if hash != geometry.mesh.hash() => Err(Failure::Configuration(format!(
            "session {} was recorded on geometry {}, its configuration gives {} here; {SETTINGS_HINT}",
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
