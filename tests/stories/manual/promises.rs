//! The tests named in the page of promises exist.

use super::pages;

#[test]
fn tests_named_as_proofs_exist() {
    let page = pages::all()
        .into_iter()
        .find(|page| page.path == "docs/reference/promises.md")
        .expect("the manual has a page of promises");
    let sources = pages::files("rs");
    let mut missing = Vec::new();
    let mut named = 0;
    let lines: Vec<&str> = page.text.lines().collect();
    for (code, line) in page.code() {
        let name = code.trim_end_matches("...");
        let is_name =
            |letter: char| letter.is_ascii_lowercase() || letter == '_' || letter.is_ascii_digit();
        if !lines[line - 1].starts_with('|') || !name.chars().all(is_name) {
            continue;
        }
        named += 1;
        let whole = format!("fn {name}(");
        let begun = format!("fn {name}");
        let file = format!("/{name}.rs");
        let exists = sources.iter().any(|source| {
            // a shortened name, a test, or a file of tests
            (code.ends_with("...") || !name.contains('_')) && source.text.contains(&begun)
                || source.text.contains(&whole)
                || source.path.ends_with(&file)
                || source.path.contains(&format!("/{name}_"))
                || source.path.contains(&format!("/tests/{name}/"))
        });
        if !exists {
            missing.push(format!("{}:{line}: no test `{code}`", page.path));
        }
    }
    assert!(named > 40, "only {named} tests are named");
    assert!(missing.is_empty(), "{}", missing.join("\n"));
}
