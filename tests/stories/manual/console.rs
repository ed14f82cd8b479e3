//! Runs the console blocks of README and manual, page by page, on a simulated rig.
//!
//! Each page has its own temporary rig, with the rig of the stories as `config.toml`, and its blocks run in order. The
//! daemon is started by the page's `tactusd --config config.toml`, or before its first `tactus`. `SESSION` stands for
//! the last measured session; if a page has measured none, a session of three frames is measured for it.
//! A block with `norun` in its info string needs real instruments, hours, or another program; it is counted.

use tactus_tests::{DaemonProcess, Spoken, Stage};

use super::pages::{self, CommandLine, Page};
use crate::test_rig::{self, Needs, ask};

#[test]
fn readme_session_runs() {
    play_all(|path| path == "README.md", 8);
}

#[test]
fn tutorials_run() {
    play_all(|path| path.starts_with("docs/tutorials/"), 12);
}

#[test]
fn how_to_pages_run() {
    play_all(|path| path.starts_with("docs/how-to/"), 15);
}

#[test]
fn other_pages_run() {
    let elsewhere = |path: &str| {
        path != "README.md"
            && !path.starts_with("docs/tutorials/")
            && !path.starts_with("docs/how-to/")
    };
    play_all(elsewhere, 0);
}

fn play_all(chosen: impl Fn(&str) -> bool, at_least: usize) {
    let mut run = 0;
    for page in pages::manual() {
        if chosen(&page.path) {
            let Some(count) = play(&page) else { return };
            run += count;
        }
    }
    assert!(run >= at_least, "only {run} command lines were run");
}

/// Runs a page's blocks and returns the number of command lines; `None` if the rig is not the simulated one.
fn play(page: &Page) -> Option<usize> {
    let blocks = page.blocks();
    let (left, run): (Vec<_>, Vec<_>) = blocks
        .iter()
        .filter(|block| block.is("console"))
        .partition(|block| block.is("norun"));
    let lines: Vec<CommandLine> = run.iter().flat_map(|block| block.commands(page)).collect();
    let left: usize = left.iter().map(|block| block.commands(page).len()).sum();
    if lines.len() + left > 0 {
        println!(
            "{}: {} command lines run, {left} marked norun",
            page.path,
            lines.len()
        );
    }
    if lines.is_empty() {
        return Some(0);
    }
    let mut player = Player {
        stage: test_rig::set(Needs::SIMULATED, test_rig::NOISY)?,
        daemon: None,
    };
    for line in &lines {
        player.play(line);
    }
    Some(lines.len())
}

struct Player {
    stage: Stage,
    daemon: Option<DaemonProcess>,
}

impl Player {
    fn play(&mut self, line: &CommandLine) {
        let place = &line.place;
        let program = line.words[0].as_str();
        assert!(
            [
                "tactus",
                "tactusd",
                "tactus-sim",
                "tactus-lab",
                "tactus-archive"
            ]
            .contains(&program),
            "{place}: `{program}` cannot be run here: mark the block `console,norun`"
        );
        if program == "tactusd" && line.words[1..] == ["--config", "config.toml"] {
            assert!(self.daemon.is_none(), "{place}: the daemon runs already");
            self.start_daemon();
            return;
        }
        if program == "tactus" {
            self.start_daemon();
        }
        let words: Vec<String> = line
            .words
            .iter()
            .map(|word| match word.as_str() {
                "SESSION" => self.session(),
                _ => word.clone(),
            })
            .collect();
        let ended = self.run(&words);
        assert_eq!(
            ended.code,
            Some(0),
            "{place}: `{}` ended so:\n{}{}",
            words.join(" "),
            ended.stdout,
            ended.stderr
        );
        if let Some(out) = words.iter().position(|word| word == "--out") {
            let path = self.stage.path().join(&words[out + 1]);
            assert!(path.exists(), "{place}: it wrote no {}", words[out + 1]);
        }
    }

    fn start_daemon(&mut self) {
        if self.daemon.is_none() {
            self.daemon = Some(test_rig::start(&self.stage));
        }
    }

    /// The last measured session; measures one if there is none.
    fn session(&mut self) -> String {
        let measured = |stage: &Stage| {
            let sessions = ask(stage, &["sessions"]);
            let last = sessions
                .iter()
                .rfind(|session| session["kind"] == "measurement");
            last.and_then(|session| session["id"].as_str().map(str::to_owned))
        };
        if let Some(id) = measured(&self.stage) {
            return id;
        }
        self.start_daemon();
        test_rig::baseline(&self.stage, 2);
        test_rig::measure(&self.stage, 3)
    }

    fn run(&self, words: &[String]) -> Spoken {
        let mut command = self.stage.command(&words[0]);
        command
            .args(&words[1..])
            .current_dir(self.stage.path())
            .env(
                "TACTUS_BUS",
                format!("unix:{}", self.stage.peer_path().display()),
            )
            .env("TACTUS_STATE", self.stage.state_path());
        self.stage
            .run_command(command)
            .unwrap_or_else(|fault| panic!("{fault}"))
    }
}
