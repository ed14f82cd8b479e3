//! The commands in the example files for cluster schedulers are valid for the current programs.

use super::commands::programs;
use super::pages::root;

/// Text with each variable of a shell, of GNU parallel and of Snakemake replaced by a value of its kind.
fn with_values(line: &str) -> String {
    let known = [
        ("\"$SHARDS\"", "40"),
        ("$SHARDS", "40"),
        ("{wildcards.n}", "40"),
        ("{METHODS}", "--method one-step"),
        ("{threads}", "2"),
    ];
    let mut text = line.to_owned();
    for (variable, value) in known {
        text = text.replace(variable, value);
    }
    let mut result = String::new();
    let mut letters = text.chars().peekable();
    while let Some(letter) = letters.next() {
        match letter {
            '{' => {
                for inner in letters.by_ref() {
                    if inner == '}' {
                        break;
                    }
                }
                result.push('1');
            }
            '$' => {
                while letters
                    .next_if(|next| next.is_alphanumeric() || *next == '_')
                    .is_some()
                {}
                result.push('1');
            }
            other => result.push(other),
        }
    }
    result
}

/// The command lines of `tactus-lab` in a file, without redirections and what follows.
fn commands(text: &str) -> Vec<Vec<String>> {
    text.lines()
        .filter(|line| !line.trim_start().starts_with('#'))
        .filter_map(|line| Some(&line[line.find("tactus-lab ")?..]))
        .map(|line| {
            let line = with_values(line.trim_end_matches('"'));
            let words = shlex::split(&line).unwrap_or_else(|| panic!("no shell words: {line}"));
            let ends = |word: &String| ["&", "||", ">"].contains(&word.as_str());
            words.into_iter().take_while(|word| !ends(word)).collect()
        })
        .collect()
}

#[test]
fn commands_of_cluster_files_parse() {
    let lab = programs()
        .into_iter()
        .find(|program| program.get_name() == "tactus-lab")
        .unwrap();
    for (file, count) in [
        ("slurm-array.sh", 1),
        ("gnu-parallel.sh", 1),
        ("kubernetes-job.yaml", 1),
        ("Snakefile", 4),
    ] {
        let path = root().join("docs/how-to/cluster").join(file);
        let found = commands(&std::fs::read_to_string(&path).unwrap());
        assert_eq!(found.len(), count, "{file}: {found:?}");
        for words in found {
            if let Err(refusal) = lab.clone().try_get_matches_from(&words) {
                panic!("{file}: {words:?}: {refusal}");
            }
        }
    }
}

#[test]
fn cluster_files_treat_exit_codes_as_the_table() {
    let read = |file: &str| std::fs::read_to_string(root().join("docs").join(file)).unwrap();
    let (page, job) = (
        read("reference/exit-codes.md"),
        read("how-to/cluster/kubernetes-job.yaml"),
    );
    let (slurm, parallel) = (
        read("how-to/cluster/slurm-array.sh"),
        read("how-to/cluster/gnu-parallel.sh"),
    );
    let mut never = Vec::new();
    for row in &studies::EXIT_TABLE {
        let line = format!("| {} | {} | {} |", row.code, row.kind, row.scheduler);
        assert!(page.contains(&line), "the page lacks `{line}`");
        match row.scheduler {
            "never run again" => never.push(row.code.to_string()),
            "run again" => {
                let test = format!("-eq {} ]", row.code);
                assert!(slurm.contains(&test) && parallel.contains(&test), "{test}");
            }
            _ => {}
        }
    }
    let listed = format!("values: [{}]", never.join(", "));
    assert!(job.contains(&listed), "the job lacks `{listed}`");
}
