//! Keywords of headers and their short forms.

/// The short form of a keyword: a keyword of up to four letters is its own short form; a longer one keeps four, or
/// three if the fourth is a vowel.
///
/// ```
/// assert_eq!(scpi::short_form("current"), "CURR");
/// assert_eq!(scpi::short_form("output"), "OUTP");
/// assert_eq!(scpi::short_form("function"), "FUNC");
/// assert_eq!(scpi::short_form("clear"), "CLE");
/// ```
pub fn short_form(keyword: &str) -> String {
    let upper = keyword.to_ascii_uppercase();
    if upper.chars().count() <= 4 {
        return upper;
    }
    let vowel = upper.chars().nth(3).is_some_and(|c| "AEIOU".contains(c));
    upper.chars().take(if vowel { 3 } else { 4 }).collect()
}
