//! The name that was probably meant by one that does not exist.

/// The known name most similar to an unknown one: one name contains the other (if the unknown one has three letters or more), or
/// their edit distance is at most a third of the unknown name's length, and at least 1 is allowed. `None` if there is none. Case, and `_`
/// instead of `-`, do not count.
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
