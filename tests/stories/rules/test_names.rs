//! Test names state the behaviour in at most 60 characters.

use proc_macro2::{TokenStream, TokenTree};

use super::{crates, folder, from_root, metadata, only_exceptions, rust_files, text};

const LONGEST: usize = 60;

/// Longer names, by the file; the list may only shrink.
const LONGER: &[(&str, &str)] = &[
    (
        "daemon/src/instruments/identities.rs",
        "what_is_kept_is_recalled_and_compared_by_serial_number_and_module",
    ),
    (
        "daemon/src/monitoring/notification.rs",
        "the_command_reads_the_letter_and_its_words_and_code_come_back",
    ),
    (
        "daemon/src/recording/recorder/tests/events.rs",
        "an_event_that_meets_a_full_disk_waits_for_room_and_ends_no_session",
    ),
    (
        "daemon/src/recording/recorder/tests/mod.rs",
        "a_day_begins_the_next_part_no_sequence_is_missing_and_a_clock_that_was_set_is_said",
    ),
    (
        "daemon/src/recording/recorder/tests/mod.rs",
        "a_full_disk_is_announced_early_and_waited_for_and_nothing_is_lost",
    ),
    (
        "daemon/src/recording/recorder/tests/mod.rs",
        "a_map_that_is_late_comes_after_its_frame_and_the_next_frames_go_without",
    ),
    (
        "daemon/src/recording/stream.rs",
        "a_reader_that_goes_is_noticed_and_one_that_only_says_no_more_is_served",
    ),
    (
        "daemon/src/session/panics.rs",
        "where_the_daemons_head_fails_the_source_is_switched_off_over_fresh_connections",
    ),
    (
        "daemon/src/session/state.rs",
        "no_sequence_of_five_events_runs_two_sessions_or_loses_a_fault",
    ),
];

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
    only_exceptions(
        "a test's name states the behaviour in at most 60 characters",
        long,
        LONGER
            .iter()
            .map(|(file, name)| ((*file).to_owned(), (*name).to_owned())),
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
