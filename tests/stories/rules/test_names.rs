//! Test names state the behaviour in at most 60 characters.

use proc_macro2::{TokenStream, TokenTree};

use super::{crates, folder, from_root, metadata, rust_files, text};

const LONGEST: usize = 60;

/// Adds the names of the functions with an attribute `test` or `tokio::test`.
fn tests_in(tokens: TokenStream, found: &mut Vec<String>) {
    let mut is_test = false;
    let mut tokens = tokens.into_iter().peekable();
    while let Some(token) = tokens.next() {
        match token {
            TokenTree::Punct(punct) if punct.as_char() == '#' => {
                if let Some(TokenTree::Group(attribute)) = tokens.peek() {
                    let path: String = attribute
                        .stream()
                        .into_iter()
                        .take_while(|token| !matches!(token, TokenTree::Group(_)))
                        .map(|token| token.to_string())
                        .collect();
                    is_test |= path == "test" || path == "tokio::test";
                    tokens.next();
                }
            }
            TokenTree::Ident(word) if word == "fn" => {
                if let Some(TokenTree::Ident(name)) = tokens.peek()
                    && is_test
                {
                    found.push(name.to_string());
                }
                is_test = false;
            }
            TokenTree::Group(group) => tests_in(group.stream(), found),
            _ => {}
        }
    }
}

#[test]
fn test_names_have_at_most_sixty_characters() {
    let metadata = metadata();
    let mut long = Vec::new();
    let mut count = 0;
    for package in crates(&metadata).values() {
        for path in rust_files(folder(package)) {
            let tokens: TokenStream = text(&path)
                .parse()
                .unwrap_or_else(|error| panic!("{}: {error}", path.display()));
            let mut names = Vec::new();
            tests_in(tokens, &mut names);
            count += names.len();
            names.retain(|name| name.len() > LONGEST);
            long.extend(names.into_iter().map(|name| (from_root(&path), name)));
        }
    }
    assert!(count > 1000, "only {count} tests were found");
    assert!(
        long.is_empty(),
        "a test's name states the behaviour in at most {LONGEST} characters: {long:#?}"
    );
}

#[test]
fn tests_are_found_by_their_attribute() {
    let text = "#[test] fn one() {} #[tokio::test(start_paused = true)] #[cfg(unix)] async fn two() {} fn three() {}
        mod tests { #[test] fn four() { fn five() {} } } proptest! { #[test] fn six(x in 0..1) {} }";
    let mut found = Vec::new();
    tests_in(text.parse().expect("this is Rust"), &mut found);
    assert_eq!(found, ["one", "two", "four", "six"]);
}
