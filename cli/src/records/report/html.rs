//! Text and tables as HTML.

/// A table; cells are text.
pub(super) fn table<const N: usize>(heading: &[&str; N], rows: &[[String; N]]) -> String {
    let mut html = String::from("<table>\n");
    if heading.iter().any(|cell| !cell.is_empty()) {
        let cells: String = heading
            .iter()
            .map(|cell| format!("<th>{}</th>", escape(cell)))
            .collect();
        html += &format!("<tr>{cells}</tr>\n");
    }
    for row in rows {
        let cells: String = row
            .iter()
            .map(|cell| format!("<td>{}</td>", escape(cell)))
            .collect();
        html += &format!("<tr>{cells}</tr>\n");
    }
    html + "</table>\n"
}

/// Text as HTML; control characters are spelled out.
pub(super) fn escape(text: &str) -> String {
    survey::printable_lines(text)
        .replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_of_a_record_are_no_markup() {
        let text = "<script>\"a\" & b\u{1b}[2J\nend";
        let html = escape(text);
        assert!(
            html.starts_with("&lt;script&gt;&quot;a&quot; &amp; b"),
            "{html}"
        );
        assert!(
            !html.contains('\u{1b}') && html.ends_with("\nend"),
            "{html}"
        );
        let row = table(&["a", "b"], &[["<b>".to_owned(), "1".to_owned()]]);
        assert!(row.contains("<th>a</th>") && row.contains("<td>&lt;b&gt;</td>"));
    }
}
