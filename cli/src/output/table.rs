//! Text tables: columns as wide as their widest entry, separated by two spaces.

use std::borrow::Cow;

use survey::printable;

/// Aligns rows under a heading; the last column is not padded.
pub(crate) fn columns<const N: usize>(heading: [&str; N], rows: &[[String; N]]) -> String {
    // escaped, so that text from outside cannot leave its cell
    let rows: Vec<[Cow<'_, str>; N]> = rows
        .iter()
        .map(|row| row.each_ref().map(|cell| printable(cell)))
        .collect();
    let mut widths = heading.map(|title| title.chars().count());
    for row in &rows {
        for (width, cell) in widths.iter_mut().zip(row) {
            *width = (*width).max(cell.chars().count());
        }
    }
    let mut text = String::new();
    let mut push = |cells: [&str; N]| {
        let mut line = String::new();
        for (cell, width) in cells.iter().zip(widths) {
            line.push_str(cell);
            line.extend(std::iter::repeat_n(' ', width - cell.chars().count() + 2));
        }
        text.push_str(line.trim_end());
        text.push('\n');
    };
    push(heading);
    for row in &rows {
        push(row.each_ref().map(|cell| &**cell));
    }
    text
}

#[cfg(test)]
mod tests {
    #[test]
    fn columns_are_as_wide_as_their_widest_entry() {
        let rows = [
            ["a".to_owned(), "long entry".to_owned()],
            ["bcd".to_owned(), String::new()],
        ];
        assert_eq!(
            crate::output::table::columns(["id", "what"], &rows),
            "id   what\na    long entry\nbcd\n"
        );
    }
}
