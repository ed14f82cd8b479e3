//! Every command line and every flag in a page exists in the programs.

use clap::error::ErrorKind;
use clap::{Arg, Command};

use super::pages;

/// The programs' own definitions.
pub fn programs() -> [Command; 5] {
    [
        cli::command(),
        daemon::command(),
        simulator::command(),
        lab::command(),
        archive::command(),
    ]
}

fn program(name: &str) -> Option<Command> {
    programs()
        .into_iter()
        .find(|program| program.get_name() == name)
}

#[test]
fn every_command_has_examples_that_parse() {
    fn wrong(command: &Command, path: &str, program: &Command, found: &mut Vec<String>) {
        let help = command.get_after_help().map(ToString::to_string);
        let help = help.unwrap_or_default();
        let examples = help.split_once("EXAMPLES:\n").map_or("", |(_, text)| text);
        let lines = examples.lines().map(str::trim);
        let lines: Vec<&str> = lines.filter(|line| line.starts_with(path)).collect();
        if lines.is_empty() {
            found.push(format!("`{path}` has no example"));
        }
        for (number, line) in lines.iter().enumerate() {
            if lines[..number].contains(line) {
                found.push(format!("`{line}` stands twice in the help of `{path}`"));
            }
            let words = shlex::split(line).expect("an example is a line of a shell");
            if let Err(refusal) = program.clone().try_get_matches_from(words) {
                found.push(format!("`{line}`: {refusal}"));
            }
        }
        let visible = command
            .get_subcommands()
            .filter(|inner| !inner.is_hide_set());
        for inner in visible {
            wrong(
                inner,
                &format!("{path} {}", inner.get_name()),
                program,
                found,
            );
        }
    }
    let mut found = Vec::new();
    for program in programs() {
        wrong(&program, program.get_name(), &program, &mut found);
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

/// Words that state a unit, or that a number is a count (`N`) or has no unit.
const UNITS: &str =
    "N SPAN PLC mm V A mA uA uV Hz s ms degrees bytes number seed share frames times multiple";

#[test]
fn every_number_option_states_unit_and_default() {
    use std::any::TypeId;
    let numbers = [
        TypeId::of::<f64>(),
        TypeId::of::<f32>(),
        TypeId::of::<u8>(),
        TypeId::of::<u16>(),
        TypeId::of::<u32>(),
        TypeId::of::<u64>(),
        TypeId::of::<usize>(),
        TypeId::of::<i64>(),
        TypeId::of::<std::num::NonZero<usize>>(),
        TypeId::of::<std::time::Duration>(),
    ];
    let mut commands: Vec<(String, Command)> = programs()
        .into_iter()
        .map(|program| (program.get_name().to_owned(), program))
        .collect();
    let (mut wrong, mut seen) = (Vec::new(), 0);
    while let Some((path, command)) = commands.pop() {
        for arg in command.get_arguments().filter(|arg| !arg.is_hide_set()) {
            let kind = arg.get_value_parser().type_id();
            if !arg.get_action().takes_values() || !numbers.iter().any(|number| kind == *number) {
                continue;
            }
            seen += 1;
            let help = arg
                .get_long_help()
                .or(arg.get_help())
                .map(ToString::to_string);
            let names = arg.get_value_names().unwrap_or_default().join(" ");
            let text = format!("{names} {}", help.unwrap_or_default());
            let words: Vec<&str> = text
                .split(|letter: char| !letter.is_alphanumeric() && letter != '-' && letter != '%')
                .map(|word| word.trim_start_matches(|letter: char| letter.is_ascii_digit()))
                .collect();
            let has = |known: &str| known.split(' ').any(|word| words.contains(&word));
            let lacks_default = !arg.is_required_set()
                && arg.get_default_values().is_empty()
                && !has("default without Without");
            for (lacks, what) in [(!has(UNITS), "no unit"), (lacks_default, "no default")] {
                if lacks {
                    wrong.push(format!("{path} {}: {what}: {text}", arg.get_id()));
                }
            }
        }
        for inner in command.get_subcommands() {
            commands.push((format!("{path} {}", inner.get_name()), inner.clone()));
        }
    }
    assert!(seen > 60, "only {seen} options with a number were found");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn command_lines_of_all_pages_parse() {
    let mut wrong = Vec::new();
    let mut parsed = 0;
    for page in pages::all() {
        for block in page.blocks() {
            if !block.is_shell() {
                for line in block.text.lines().map(str::trim) {
                    let first = line.split(' ').next().unwrap_or_default();
                    if block.info == [""] && program(first).is_some() {
                        wrong.push(format!(
                            "{}: `{line}` stands in no console block",
                            page.path
                        ));
                    }
                }
                continue;
            }
            for line in block.commands(&page) {
                let Some(program) = program(&line.words[0]) else {
                    continue;
                };
                parsed += 1;
                match program.try_get_matches_from(&line.words) {
                    Ok(_) => {}
                    Err(refusal)
                        if matches!(
                            refusal.kind(),
                            ErrorKind::DisplayHelp | ErrorKind::DisplayVersion
                        ) => {}
                    Err(refusal) => wrong.push(format!("{}: {refusal}", line.place)),
                }
            }
        }
    }
    println!("{parsed} command lines parsed");
    assert!(parsed > 50, "only {parsed} command lines were found");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn commands_and_flags_named_in_the_text_exist() {
    let programs = programs();
    let mut wrong = Vec::new();
    let mut named = 0;
    for page in pages::manual() {
        for (code, line) in page.code() {
            let words: Vec<&str> = code.split_whitespace().collect();
            let Some(first) = words.first() else { continue };
            let place = format!("{}:{line}", page.path);
            if let Some(program) = program(first) {
                named += 1;
                if let Err(unknown) = walk(&program, &words[1..]) {
                    wrong.push(format!("{place}: `{code}`: {unknown}"));
                }
            } else if let Some(flag) = first.strip_prefix("--") {
                named += 1;
                if !programs.iter().any(|program| has_flag(program, flag, true)) {
                    wrong.push(format!("{place}: no program has `--{flag}`"));
                }
            }
        }
    }
    println!("{named} commands and flags named in the text");
    assert!(named > 50, "only {named} were found");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Follows subcommands as far as they exist; every flag on the way must exist.
fn walk(program: &Command, words: &[&str]) -> Result<(), String> {
    let mut path = vec![program];
    let mut positional = false;
    for word in words {
        let command = path[path.len() - 1];
        if let Some(flag) = word.strip_prefix("--") {
            // those of the command, and the global ones of its parents
            if !path.iter().any(|command| has_flag(command, flag, false)) {
                return Err(format!("`{}` has no `--{flag}`", command.get_name()));
            }
            positional = true;
        } else if word.starts_with(['<', '[']) {
            // a usage line
            positional = true;
        } else if let Some(below) = command.find_subcommand(word) {
            path.push(below);
        } else if command.has_subcommands() && !positional {
            return Err(format!("`{}` has no `{word}`", command.get_name()));
        }
    }
    Ok(())
}

fn has_flag(command: &Command, flag: &str, below: bool) -> bool {
    let flag = flag.split('=').next().unwrap_or(flag);
    let named = |arg: &Arg| arg.get_long() == Some(flag);
    flag == "help"
        || flag == "version"
        || command.get_arguments().any(named)
        || below
            && command
                .get_subcommands()
                .any(|command| has_flag(command, flag, true))
}
