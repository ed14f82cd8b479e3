//! Suggests a known name for an unknown one.

/// The known name most similar to an unknown one; `None` if none is similar. Names are similar if one contains the
/// other (and the unknown one has three letters or more), or if their edit distance is at most a third of the unknown
/// name's length, at least 1. Upper and lower case, and `_` and `-`, count as equal.
///
/// ```
/// let known = ["temperature", "thermal-emf", "creep"];
/// assert_eq!(survey::nearest("temprature", known), Some("temperature"));
/// assert_eq!(survey::nearest("Thermal_EMF", known), Some("thermal-emf"));
/// assert_eq!(survey::nearest("zzzzzz", known), None);
/// ```
pub fn nearest<'a>(unknown: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let plain = |name: &str| name.to_lowercase().replace('_', "-");
    let wanted = plain(unknown);
    let length = wanted.chars().count();
    let away = |name: &str| {
        let name = plain(name);
        let letters = strsim::osa_distance(&wanted, &name);
        match name.contains(&wanted) || wanted.contains(&name) {
            true if length > 2 => (letters.min(1), letters),
            _ => (letters, letters),
        }
    };
    let ((away, _), name) = known
        .into_iter()
        .map(|name| (away(name), name))
        .min_by_key(|(away, _)| *away)?;
    (away <= (length / 3).max(1)).then_some(name)
}
