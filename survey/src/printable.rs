//! Escapes text from outside before it is displayed.
//!
//! Instruments, network announcements, session files, models and configurations contain text from others. Printed as it
//! is, it could move the cursor, clear a terminal, reverse the direction of writing, or imitate a line of the program.
//! All such text passes one of these functions before it is printed, logged or recorded as part of a sentence.

use std::borrow::Cow;
use std::fmt::Write as _;

/// The text on one line: every character that is not plainly visible (controls, line ends, direction marks, zero width)
/// is escaped, as `\n` or `\u{202e}`.
///
/// ```
/// assert_eq!(survey::printable("10 µV"), "10 µV");
/// assert_eq!(survey::printable("a\n[notify]\x1b[2J\0"), "a\\n[notify]\\u{1b}[2J\\0");
/// ```
pub fn printable(text: &str) -> Cow<'_, str> {
    escaped(text, is_seen)
}

/// Like [`printable`], but keeps line ends: for multi-line text of the program whose foreign parts have been escaped
/// already.
pub fn printable_lines(text: &str) -> Cow<'_, str> {
    escaped(text, |letter| letter == '\n' || is_seen(letter))
}

/// Like [`printable`], at most `most` characters long; a longer text is cut and ends in `...`.
pub fn printable_within(text: &str, most: usize) -> Cow<'_, str> {
    match text.char_indices().nth(most) {
        None => printable(text),
        Some((end, _)) => Cow::Owned(format!("{}...", printable(&text[..end]))),
    }
}

/// An error and its causes on one line, joined by colons; a cause that its parent's message contains is not repeated.
///
/// ```
/// #[derive(Debug, thiserror::Error)]
/// #[error("cannot read the scene")]
/// struct Unread(#[source] std::num::ParseIntError);
///
/// let error = Unread("x".parse::<i32>().unwrap_err());
/// assert_eq!(survey::error_chain(&error), "cannot read the scene: invalid digit found in string");
/// ```
pub fn error_chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    for cause in std::iter::successors(error.source(), |cause| cause.source()) {
        let cause = cause.to_string();
        if !text.contains(&cause) {
            let _infallible = write!(text, ": {cause}");
        }
    }
    printable(&text).into_owned()
}

/// JSON with the same characters escaped as `\uXXXX`: the same values, safe to display. The text must be valid JSON,
/// where such characters occur in strings only.
///
/// ```
/// assert_eq!(survey::printable_json("{\"note\":\"\u{202e}\"}".to_owned()), r#"{"note":"\u202e"}"#);
/// ```
pub fn printable_json(json: String) -> String {
    if json.chars().all(is_seen) {
        return json;
    }
    let mut shown = String::with_capacity(json.len() + 16);
    for letter in json.chars() {
        if is_seen(letter) || letter == '\n' {
            shown.push(letter);
            continue;
        }
        for unit in letter.encode_utf16(&mut [0; 2]) {
            let _infallible = write!(shown, "\\u{unit:04x}");
        }
    }
    shown
}

/// The line of JSON that every program prints on standard error when it fails with `--json`; the fields are described
/// in `docs/reference/json.md`.
///
/// ```
/// assert_eq!(
///     survey::error_line("failed", 1, "no \"a\"\nand no b"),
///     r#"{"event":"error","kind":"failed","code":1,"text":"no \"a\"\nand no b"}"#
/// );
/// ```
pub fn error_line(kind: &str, code: u8, text: &str) -> String {
    #[derive(serde::Serialize)]
    struct Line<'a> {
        event: &'static str,
        kind: &'a str,
        code: u8,
        text: &'a str,
    }
    let line = Line {
        event: "error",
        kind,
        code,
        text: text.trim_end(),
    };
    // serialisation of texts and numbers cannot fail
    printable_json(serde_json::to_string(&line).unwrap_or_default())
}

/// Whether a command line that may be invalid has the option `--json`; for errors of the command line itself.
///
/// ```
/// assert!(survey::asks_for_json(&["tactus".into(), "--json".into()]));
/// assert!(!survey::asks_for_json(&["tactus".into(), "--".into(), "--json".into()]));
/// ```
pub fn asks_for_json(words: &[std::ffi::OsString]) -> bool {
    let mut options = words.iter().take_while(|word| *word != "--");
    options.any(|word| word == "--json")
}

fn escaped(text: &str, stays: impl Fn(char) -> bool) -> Cow<'_, str> {
    if text.chars().all(&stays) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for letter in text.chars() {
        if stays(letter) {
            shown.push(letter);
        } else {
            shown.extend(letter.escape_debug());
        }
    }
    Cow::Owned(shown)
}

/// Whether a character is plainly visible: a letter, a sign, a combining mark or a space.
fn is_seen(letter: char) -> bool {
    match letter {
        ' '..='~' => true,
        // the line and the paragraph separator
        '\u{2028}' | '\u{2029}' => false,
        _ if letter.is_control() => false,
        _ if letter.is_whitespace() => true,
        // tested after another character, because a leading combining mark would be escaped
        _ => {
            let mut pair = String::from("x");
            pair.push(letter);
            pair.escape_debug().count() == 2
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_text_of_any_language_is_not_touched() {
        for text in [
            "KEITHLEY INSTRUMENTS INC.,MODEL 6221,1234567,D04",
            "said \"why\" in C:\\folder, 10\u{a0}µV, 2\u{2009}Ω",
            "Zürich cafe\u{301} 日本語 नमस्ते שלום ✓",
        ] {
            assert!(matches!(printable(text), Cow::Borrowed(same) if same == text));
            assert_eq!(printable_json(text.to_owned()), text);
        }
    }

    #[test]
    fn what_acts_on_a_terminal_is_escaped() {
        for (text, shown) in [
            ("a\r\nb", "a\\r\\nb"),
            ("\x1b[2J", "\\u{1b}[2J"),
            ("\u{9b}2J\u{7f}", "\\u{9b}2J\\u{7f}"),
            ("\u{202e}txt\u{2066}", "\\u{202e}txt\\u{2066}"),
            ("\u{200b}\u{feff}\u{e0041}", "\\u{200b}\\u{feff}\\u{e0041}"),
            ("\u{2028}\u{2029}\0", "\\u{2028}\\u{2029}\\0"),
        ] {
            assert_eq!(printable(text), shown);
            assert!(printable_json(text.to_owned()).is_ascii());
        }
        assert_eq!(printable_lines("a\n\x1bb"), "a\n\\u{1b}b");
        assert_eq!(printable_within("\u{1b}abc", 2), "\\u{1b}a...");
        assert_eq!(printable_within("abc", 3), "abc");
    }
}
