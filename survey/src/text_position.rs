//! Positions in a text file, for error messages.

/// Line and column, from 1, of a byte offset in a text. The column counts characters. An offset that is not in the
/// text or not between two characters is taken as the end of the text.
///
/// ```
/// assert_eq!(survey::line_and_column("[wiring]\nkínd = 1", 15), (2, 6));
/// ```
pub fn line_and_column(text: &str, offset: usize) -> (usize, usize) {
    let before = text.get(..offset).unwrap_or(text);
    let line_start = before.rfind('\n').map_or(0, |end| end + 1);
    let line = before.matches('\n').count() + 1;
    (line, before[line_start..].chars().count() + 1)
}

#[cfg(test)]
mod tests {
    use super::line_and_column;

    #[test]
    fn columns_count_characters_from_the_line_start() {
        let text = "ab\nµ=1\n";
        for (offset, position) in [
            (0, (1, 1)),
            (2, (1, 3)),
            (3, (2, 1)),
            (5, (2, 2)),
            (8, (3, 1)),
        ] {
            assert_eq!(line_and_column(text, offset), position, "{offset}");
        }
        // behind the text, and within a character
        assert_eq!(line_and_column(text, 99), (3, 1));
        assert_eq!(line_and_column(text, 4), (3, 1));
    }
}
