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
    let perhaps = survey::nearest(name, names.iter().copied())
        .map_or(".".to_owned(), |near| format!(", perhaps `{near}`?"));
    let all = names.join(", ");
    Some((
        key.span(),
        format!("there is no effect `{name}`{perhaps} There are {all}"),
    ))
}

/// An addition to a message about an unknown key: the valid key that differs only by its unit; empty if there is none.
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
        let (at, why) = unknown_effect("[effects.noise]\n[effects.sprai]\nstd = 1").unwrap();
        assert_eq!(at, 9..14);
        assert!(why.contains("`noise`"), "{why}");
        let (_, why) = unknown_effect("[effects.thermal_emf]\n").unwrap();
        assert!(why.contains("perhaps `thermal-emf`?"), "{why}");
    }
}
