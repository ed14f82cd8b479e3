//! A number at the limit of its range is either accepted or rejected.

use config::numbers::keys;
use survey::Bounds;

/// Prepares a configuration with each number at both limits of its range. Meshes have separate tests.
#[test]
fn what_is_within_bounds_never_panics() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("config.toml");
    let small = "[rig]\nkind = \"simulated\"\nscene = \"scene.toml\"\n[record]\ndirectory = \"state\"\n\
                 [geometry]\npreset = \"disc-tank\"\n[geometry.disc-tank]\nelectrodes = 8\n";
    let scene = "[disc-tank]\nelectrodes = 8\n";
    std::fs::write(folder.path().join("scene.toml"), scene).unwrap();
    for (key, bounds) in keys().filter(|(key, _)| !key.starts_with("geometry")) {
        let ends = match bounds {
            Bounds::Within(low, high) => vec![low, high],
            Bounds::Above(low, high) => vec![low.next_up(), high],
            Bounds::Between(low, high) => vec![low.next_up(), high.next_down()],
            Bounds::OneOf(each) => each.to_vec(),
        };
        for value in ends {
            let mut table: toml::Table = toml::from_str(small).unwrap();
            let (section, name) = key.rsplit_once('.').unwrap();
            let section = table.entry(section);
            let section = section.or_insert_with(|| toml::Table::new().into());
            let whole = value.fract() == 0.0 && value.abs() < 9e18;
            let number = match whole {
                true => toml::Value::Integer(value as i64),
                false => toml::Value::Float(value),
            };
            section
                .as_table_mut()
                .unwrap()
                .insert(name.to_owned(), number);
            let text = toml::to_string(&table).unwrap();
            std::fs::write(&path, &text).unwrap();
            // either result is valid
            if let Err(problems) = crate::preparation::prepare(&path) {
                assert!(!problems.is_empty(), "{text}");
            }
        }
    }
}
