//! Errors for unknown effects and keys, with a suggestion and the list of valid names.

use std::ops::Range;

use crate::effects::EffectSettings;

/// The first unknown effect in a scene's text: its position, and the message.
pub(super) fn unknown_effect(text: &str) -> Option<(Range<usize>, String)> {
    let whole = toml::de::DeTable::parse(text).ok()?;
    let effects = whole.get_ref().get("effects")?.get_ref().as_table()?;
    let names: Vec<&str> = EffectSettings::ALL.iter().map(|(name, _)| *name).collect();
    let (key, name) = effects
        .keys()
        .map(|key| (key, key.get_ref().as_ref()))
        .filter(|(_, name)| !names.contains(name))
        .min_by_key(|(key, _)| key.span().start)?;
    let perhaps = near(name, &names).map_or(".".to_owned(), |near| format!(", perhaps `{near}`?"));
    let all = names.join(", ");
    Some((
        key.span(),
        format!("there is no effect `{name}`{perhaps} There are {all}"),
    ))
}

/// The name with the smallest edit distance, or one that contains the other.
fn near<'a>(requested: &str, names: &[&'a str]) -> Option<&'a str> {
    let requested = requested.to_lowercase().replace('_', "-");
    let away = |name: &str| match name.contains(&requested) || requested.contains(name) {
        true if requested.len() > 2 => 1,
        _ => letters_apart(&requested, name),
    };
    let nearest = names.iter().min_by_key(|name| away(name))?;
    (away(nearest) <= (requested.len() / 3).max(1)).then_some(*nearest)
}

/// Edit distance (Levenshtein).
fn letters_apart(one: &str, other: &str) -> usize {
    let other: Vec<char> = other.chars().collect();
    let mut row: Vec<usize> = (0..=other.len()).collect();
    for (i, a) in one.chars().enumerate() {
        let mut corner = row[0];
        row[0] = i + 1;
        for (j, b) in other.iter().enumerate() {
            let changed = corner + usize::from(a != *b);
            corner = row[j + 1];
            row[j + 1] = changed.min(corner + 1).min(row[j] + 1);
        }
    }
    row[other.len()]
}

/// Adds to a message about an unknown key the valid key that differs only by its unit.
pub(super) fn with_unit(message: &str) -> String {
    let Some((_, rest)) = message.split_once("unknown field `") else {
        return String::new();
    };
    let Some((given, allowed)) = rest.split_once('`') else {
        return String::new();
    };
    let stem = |key: &str| key.split('_').next().unwrap_or(key).to_owned();
    let named = allowed.split('`').skip(1).step_by(2);
    let close: Vec<&str> = named
        .filter(|key| key.contains('_') && stem(key) == stem(given))
        .collect();
    match close[..] {
        [] => String::new(),
        _ => format!("; a key ends in its unit: `{}`", close.join("` or `")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_meant_is_found() {
        let names: Vec<&str> = EffectSettings::ALL.iter().map(|(name, _)| *name).collect();
        assert_eq!(letters_apart("kitten", "sitting"), 3);
        assert_eq!(near("temprature", &names), Some("temperature"));
        assert_eq!(near("thermal_emf", &names), Some("thermal-emf"));
        assert_eq!(
            near("drift", &names).map(|name| name.contains("drift")),
            Some(true)
        );
        assert_eq!(near("zzzzzz", &names), None);
        let (at, why) = unknown_effect("[effects.noise]\n[effects.sprai]\nstd = 1").unwrap();
        assert_eq!(at, 9..14);
        assert!(why.contains("`noise`"), "{why}");
    }
}
