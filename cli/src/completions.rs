//! Completion scripts: those of clap, extended by the ids of sessions and baselines, which the shell requests from this
//! program. (clap's dynamic completion could do this, but is marked unstable.)

use std::fmt::Write;

use clap::{Arg, Command};
use clap_complete::Shell;

/// An argument that takes an id.
struct IdArgument {
    /// The commands before the argument, e.g. `sessions show`.
    words: String,
    /// Name of the option; `None` for a positional argument.
    long: Option<String>,
    /// The command that lists the ids.
    list: &'static str,
}

/// The completion script of a shell.
pub(crate) fn script(shell: Shell) -> Vec<u8> {
    let mut command = crate::command();
    let mut found = Vec::new();
    find(&command, "", &mut found);
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut command, "tactus", &mut script);
    match shell {
        Shell::Bash => script.extend(bash(&found).into_bytes()),
        Shell::Fish => script.extend(fish(&found).into_bytes()),
        Shell::Zsh => script = zsh(&String::from_utf8_lossy(&script)).into_bytes(),
        _ => {}
    }
    script
}

/// The command that lists the ids that an argument takes.
fn list_of(argument: &Arg) -> Option<&'static str> {
    let takes_an_id = || {
        let names = argument.get_value_names().unwrap_or_default();
        names.iter().any(|name| name.as_str() == "ID")
    };
    match argument.get_id().as_str() {
        "session" | "sessions" => Some("sessions"),
        "id" | "baseline" if takes_an_id() => Some("baseline list"),
        _ => None,
    }
}

fn find(command: &Command, words: &str, found: &mut Vec<IdArgument>) {
    for argument in command.get_arguments() {
        found.extend(list_of(argument).map(|list| IdArgument {
            words: words.to_owned(),
            long: argument.get_long().map(str::to_owned),
            list,
        }));
    }
    for below in command.get_subcommands() {
        let words = format!("{words} {}", below.get_name());
        find(below, words.trim_start(), found);
    }
}

/// Shell text that extracts the ids from lines of JSON.
const IDS: &str = r#"--json 2>/dev/null | sed -n 's/.*"id":"\([^"]*\)".*/\1/p' | sort -u"#;

fn bash(found: &[IdArgument]) -> String {
    let mut cases = String::new();
    for IdArgument { words, long, list } in found {
        // clap's script offers file names, but such an option takes no file
        let (before, only) = match long {
            Some(long) => (format!("\"--{long} \""), "COMPREPLY=() "),
            None => ("[!-]".to_owned(), ""),
        };
        let _ = writeln!(
            cases,
            "        {before}*\" {words} \"*) {only}list=\"{list}\" ;;"
        );
    }
    format!(
        r#"
_tactus_and_ids() {{
    _tactus "$@"
    local word words="" list="" cur="${{COMP_WORDS[COMP_CWORD]}}" prev="${{COMP_WORDS[COMP_CWORD-1]}}"
    [[ "${{cur}}" == -* ]] && return 0
    for word in "${{COMP_WORDS[@]:1:COMP_CWORD-1}}"; do
        [[ "${{word}}" == -* ]] || words="${{words}} ${{word}}"
    done
    case "${{prev}} ${{words}} " in
{cases}    esac
    [[ -z "${{list}}" ]] || COMPREPLY+=( $(compgen -W "last $(tactus ${{list}} {IDS})" -- "${{cur}}") )
}}

complete -F _tactus_and_ids -o bashdefault -o default tactus
"#
    )
}

fn fish(found: &[IdArgument]) -> String {
    let mut lines =
        format!("\nfunction __fish_tactus_ids\n    echo last\n    tactus $argv {IDS}\nend\n");
    for IdArgument { words, long, list } in found {
        let condition = match words.split_once(' ') {
            Some((command, below)) => format!(
                "__fish_tactus_using_subcommand {command}; and __fish_seen_subcommand_from {below}"
            ),
            None => format!("__fish_tactus_using_subcommand {words}"),
        };
        let option = match long {
            Some(long) => format!(" -l {long} -r -f"),
            None => String::new(),
        };
        let ids = format!("-k -a \"(__fish_tactus_ids {list})\"");
        let _ = writeln!(lines, "complete -c tactus -n \"{condition}\"{option} {ids}");
    }
    lines
}

/// clap's script, in which the arguments that take an id get the action that lists the ids.
fn zsh(script: &str) -> String {
    let action = |line: &str| {
        let option = |name| line.starts_with(name) && line.contains(":ID:_default'");
        let argument = |name| line.contains(name);
        if argument(":session -- ") || argument(":sessions -- ") || option("'--session=") {
            Some("sessions")
        } else if argument(":id -- ") || option("'--baseline=") {
            Some("baseline list")
        } else {
            None
        }
    };
    let mut lines = String::new();
    for line in script.lines() {
        match action(line) {
            Some(list) => {
                let action = format!(": _tactus_ids {list}' ");
                lines.push_str(&line.replace(":_default' ", &action));
            }
            None => lines.push_str(line),
        }
        lines.push('\n');
        if line == "autoload -U is-at-least" {
            let _ = write!(
                lines,
                "\n_tactus_ids() {{\n    local -a ids\n    ids=(last ${{(f)\"$(tactus \"$@\" {IDS})\"}})\n    \
                 compadd -a ids\n    [[ \"$*\" != sessions ]] || _files -g '*.tactus'\n}}\n"
            );
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bash_offers_baselines_only_for_a_baseline() {
        if !needs::program("SHELLS", "bash") {
            return;
        }
        let script = String::from_utf8(script(Shell::Bash)).unwrap();
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("m1.tactus"), "").unwrap();
        let lists = "tactus() { [[ \"$1\" == baseline ]] && echo '{\"id\":\"b1\"}' || echo '{\"id\":\"m1\"}'; }";
        let offered = |words: &str| {
            let test = format!(
                "{script}\n{lists}\nCOMP_WORDS=({words} '')\nCOMP_CWORD={}\n_tactus_and_ids tactus '' {}\necho ${{COMPREPLY[@]}}",
                words.split(' ').count(),
                words.split(' ').next_back().unwrap_or_default()
            );
            let file = folder.path().join("test.bash");
            std::fs::write(&file, test).unwrap();
            let mut bash = std::process::Command::new("bash");
            let ran = bash.arg(&file).current_dir(folder.path()).output();
            String::from_utf8(ran.unwrap().stdout).unwrap()
        };
        assert_eq!(offered("tactus start --baseline"), "last b1\n");
        assert_eq!(offered("tactus log --session"), "last m1\n");
        assert!(offered("tactus sessions show").contains("m1"));
    }

    #[test]
    fn every_argument_for_an_id_is_completed_in_each_shell() {
        let mut found = Vec::new();
        find(&crate::command(), "", &mut found);
        assert!(found.len() >= 12, "{}", found.len());
        for (shell, call) in [
            (Shell::Bash, "list=\"sessions\" ;;"),
            (Shell::Fish, "(__fish_tactus_ids sessions)"),
            (Shell::Zsh, ": _tactus_ids sessions'"),
        ] {
            let script = String::from_utf8(script(shell)).unwrap();
            let sessions = found.iter().filter(|place| place.list == "sessions");
            assert_eq!(script.matches(call).count(), sessions.count(), "{shell}");
            let baselines = call.replace("sessions", "baseline list");
            assert_eq!(script.matches(&baselines).count(), 2, "{shell}");
        }
    }
}
