//! `tactus notify test`: tests the notification command.

use std::io::Write;

use serde::Serialize;

use crate::connection::Daemon;
use crate::failure::Failure;
use crate::output::Printer;

/// The line of `notify test --json`; see `docs/reference/json.md`.
#[derive(Debug, Serialize)]
struct NotifyOutcome {
    event: &'static str,
    done: bool,
    code: Option<i64>,
    trouble: Option<String>,
    stderr: String,
    took_s: f64,
}

impl NotifyOutcome {
    fn for_a_person(&self) -> String {
        let how = match (self.code, &self.trouble) {
            (Some(0), _) => format!("the command succeeded in {:.2} s", self.took_s),
            (Some(code), _) => format!("the command ended with exit code {code}"),
            (None, Some(trouble)) => trouble.clone(),
            (None, None) => "the command was ended by a signal".to_owned(),
        };
        match self.stderr.trim() {
            "" => how,
            message => format!("{how}; its output:\n{message}"),
        }
    }
}

/// Runs the daemon's notification command (`[notify]`) once.
///
/// # Errors
/// The command failed.
pub(crate) async fn test(
    daemon: &Daemon,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let result = daemon
        .ask("the command", daemon.manager.notify_test())
        .await?;
    let fared = NotifyOutcome {
        event: "notified",
        done: result.done.unwrap_or(false),
        code: result.code,
        trouble: result.trouble,
        stderr: result.stderr.unwrap_or_default(),
        took_s: result.took_s.unwrap_or(0.0),
    };
    printer.record(&fared, NotifyOutcome::for_a_person)?;
    if fared.done {
        return Ok(());
    }
    Err(Failure::Failed(
        "nobody would be notified; correct [notify] command in the daemon's configuration"
            .to_owned(),
    ))
}

#[cfg(test)]
mod tests {
    use crate::control::notify::*;

    #[test]
    fn hook_output_is_shown() {
        let fared = NotifyOutcome {
            event: "notified",
            done: false,
            code: Some(75),
            trouble: None,
            stderr: "no route to host\n".into(),
            took_s: 0.5,
        };
        assert_eq!(
            fared.for_a_person(),
            "the command ended with exit code 75; its output:\nno route to host"
        );
        let killed = NotifyOutcome {
            code: None,
            trouble: Some("killed after 10.0 s".into()),
            stderr: String::new(),
            ..fared
        };
        assert_eq!(killed.for_a_person(), "killed after 10.0 s");
    }
}
