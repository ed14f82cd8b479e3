//! The section EXAMPLES of every command's help and manual page, from one text of command lines for each program; and
//! the parsing of a program's command line.
//!
//! A line of the text is `program command words # what it does`. It belongs to the command that its words name; a
//! command that has only subcommands shows their examples.

use std::ffi::OsString;
use std::process::ExitCode;

use clap::{ArgMatches, Command, FromArgMatches};
use clap_mangen::Man;
use clap_mangen::roff::{Roff, roman};

/// The heading in a command's help.
pub const HEADING: &str = "EXAMPLES:";

/// Number of examples of subcommands that a command without examples of its own shows.
const FROM_BELOW: usize = 5;

/// Adds a section of examples to the help of a command and of all commands below it.
///
/// ```
/// use clap::Command;
/// let text = "light on  # switches it on\n";
/// let program = Command::new("light").subcommand(Command::new("on").about("On"));
/// let program = help_examples::with_examples(program, text);
/// let help = program.find_subcommand("on").unwrap().get_after_help().unwrap().to_string();
/// assert_eq!(help, "EXAMPLES:\n  light on\n      switches it on");
/// ```
pub fn with_examples(program: Command, text: &str) -> Command {
    let lines = lines(text);
    let path = vec![program.get_name().to_owned()];
    add(program, &path, &lines)
}

/// Parses a command line whose first word is the program's name; returns clap's matches and the arguments.
///
/// # Errors
/// The program's exit code, for a refused command line and for `--help` and `--version`, which are printed. With `json`
/// a refusal is not printed but passed to `report`.
pub fn parsed<A: FromArgMatches>(
    command: &Command,
    words: &[OsString],
    json: bool,
    report: impl FnOnce(String) -> ExitCode,
) -> Result<(ArgMatches, A), ExitCode> {
    let matches = command.clone().try_get_matches_from(words);
    let parsed = matches.and_then(|matches| {
        let arguments = A::from_arg_matches(&matches)?;
        Ok((matches, arguments))
    });
    parsed.map_err(|refusal| {
        if json && refusal.use_stderr() {
            return report(refusal.render().to_string());
        }
        // a terminal that is closed meanwhile is not an error
        let _ = refusal.print();
        ExitCode::from(if refusal.use_stderr() { 2 } else { 0 })
    })
}

/// The words of a command line, the whole line, and what it does.
type Example<'a> = (Vec<&'a str>, &'a str, &'a str);

fn lines(text: &str) -> Vec<Example<'_>> {
    let lines = text.lines().filter(|line| !line.trim().is_empty());
    lines
        .map(|line| {
            let (command, what) = line.split_once(" # ").unwrap_or((line, ""));
            (
                command.split_whitespace().collect(),
                command.trim(),
                what.trim(),
            )
        })
        .collect()
}

fn add(command: Command, path: &[String], lines: &[Example<'_>]) -> Command {
    let below: Vec<Example<'_>> = lines
        .iter()
        .filter(|(words, ..)| words.iter().copied().take(path.len()).eq(path.iter()))
        .cloned()
        .collect();
    let of_subcommand = |(words, ..): &&Example<'_>| {
        let next = words.get(path.len());
        next.is_some_and(|word| command.find_subcommand(word).is_some())
    };
    let own: Vec<&Example<'_>> = below.iter().filter(|line| !of_subcommand(line)).collect();
    let shown = match own.is_empty() {
        true => below.iter().take(FROM_BELOW).collect(),
        false => own,
    };
    let mut section = HEADING.to_owned();
    for (_, line, what) in &shown {
        section.push_str(&format!("\n  {line}\n      {what}"));
    }
    let after = match command.get_after_help() {
        None => section,
        Some(after) => format!("{after}\n\n{section}"),
    };
    let has_own_examples = !shown.is_empty();
    let command = command.mut_subcommands(|inner| {
        let mut path = path.to_vec();
        path.push(inner.get_name().to_owned());
        add(inner, &path, &below)
    });
    match has_own_examples {
        true => command.after_help(after),
        false => command,
    }
}

/// The manual page of a command that [`with_examples`] has made, with a section EXAMPLES.
///
/// # Errors
/// Those of writing to memory.
pub fn manual_page(command: &Command, section: &str) -> std::io::Result<Vec<u8>> {
    let help = command.get_after_help().map(ToString::to_string);
    let help = help.unwrap_or_default();
    let (before, examples) = help.split_once(HEADING).unwrap_or((&help, ""));
    let mut page = Vec::new();
    let command = match before.trim() {
        "" => command.clone().after_help(None::<&str>),
        before => command.clone().after_help(before.to_owned()),
    };
    Man::new(command).section(section).render(&mut page)?;
    if !examples.is_empty() {
        let mut roff = Roff::new();
        roff.control("SH", ["EXAMPLES"]).control("nf", []);
        for line in examples.lines().skip(1) {
            roff.text([roman(line)]);
        }
        roff.control("fi", []).to_writer(&mut page)?;
    }
    Ok(page)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn manual_page_has_its_examples_after_the_notes() {
        let program = Command::new("light")
            .after_help("Exit codes: 0 done")
            .subcommand(Command::new("on"));
        let program = with_examples(program, "light on # switch it on\nlight # show it");
        let page = String::from_utf8(manual_page(&program, "8").unwrap()).unwrap();
        let (before, examples) = page.split_once(".SH EXAMPLES\n").unwrap();
        assert!(before.contains("Exit codes: 0 done"), "{page}");
        assert!(examples.contains("  light\n      show it"), "{page}");
        assert!(!examples.contains("light on"), "{page}");
    }
}
