//! Runs the notification command, with JSON on its standard input and a timeout. Only its own task waits for the
//! command.

use std::process::Stdio;
use std::time::{Duration, Instant};

use dbus::NotifyResult;
use rustix::process::{Pid, Signal, kill_process_group};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWriteExt};
use tokio::process::Command;

use crate::monitoring::health::Health;
use crate::monitoring::notices::Message;
use config::NotifySection;

/// Maximum number of bytes kept of the command's standard error.
const LONGEST_MESSAGE: u64 = 4096;
/// Time to read the remaining output of child processes after the command has ended.
const OUTPUT_DRAIN_TIME: Duration = Duration::from_secs(2);

/// The command's result as text for people.
pub(crate) fn text(result: &NotifyResult) -> String {
    let how = match (result.code, &result.trouble) {
        (Some(code), _) => format!("exit code {code}"),
        (None, Some(trouble)) => trouble.clone(),
        (None, None) => "ended by a signal".to_owned(),
    };
    match result.stderr.as_deref().unwrap_or_default().trim() {
        "" => how,
        reported => format!("{how}: {reported}"),
    }
}

/// The command's input: one JSON object on one line.
pub(crate) fn payload(message: &Message, health: &Health, limits: &NotifySection) -> String {
    let alarms: Vec<_> = health
        .alarms(limits)
        .into_iter()
        .map(|alarm| (alarm.kind.to_owned(), alarm.text))
        .chain(health.rules.iter().cloned())
        .map(|(kind, text)| serde_json::json!({"kind": kind, "text": text}))
        .collect();
    let session = health.session.as_ref();
    let payload = serde_json::json!({
        "kind": message.kind,
        "phase": message.phase.word(),
        "text": message.text,
        "at": health.at.to_rfc3339_opts(chrono::SecondsFormat::Millis, true),
        "state": health.state,
        "source_state": health.source,
        "simulated": health.simulated,
        "session": session.map(|session| &session.id),
        "frames_durable": session.map(|session| session.durable),
        "last_frame_age_s": health.age.map(|age| age.as_secs_f64()),
        "disk_days": health.space.days(),
        "troubles": alarms,
    });
    format!("{payload}\n")
}

/// The process group of a command; killed when this is dropped, also if the daemon ends while the command runs.
struct ProcessGroup(Option<Pid>);

impl ProcessGroup {
    /// Does not kill the group: the command has ended, and processes that it started may continue.
    fn leave(mut self) {
        self.0 = None;
    }
}

impl Drop for ProcessGroup {
    fn drop(&mut self) {
        if let Some(group) = self.0 {
            let _ = kill_process_group(group, Signal::KILL);
        }
    }
}

/// Runs the command with `payload` on its standard input; after `deadline` kills it and all its child processes.
pub(crate) async fn run_hook(
    command: &[String],
    payload: &str,
    deadline: Duration,
) -> NotifyResult {
    let begun = Instant::now();
    let result = |code: Option<i32>, trouble: Option<String>, stderr| NotifyResult {
        done: Some(code == Some(0)),
        code: code.map(i64::from),
        trouble,
        stderr: Some(stderr),
        took_s: Some(begun.elapsed().as_secs_f64()),
    };
    let failed = |trouble| result(None, Some(trouble), String::new());
    let Some((program, arguments)) = command.split_first() else {
        return failed("no command is configured: [notify] command".to_owned());
    };
    let started = Command::new(program)
        .args(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .process_group(0)
        .kill_on_drop(true)
        .spawn();
    let mut child = match started {
        Ok(child) => child,
        Err(cause) => return failed(format!("{program} cannot be run: {cause}")),
    };
    let group = ProcessGroup(child.id().and_then(|id| Pid::from_raw(id.cast_signed())));
    let (stdin, stderr) = (child.stdin.take(), child.stderr.take());
    let mut received = tokio::spawn(beginning(stderr));
    let run = async {
        if let Some(mut stdin) = stdin {
            // a command may end without reading everything
            let _ = stdin.write_all(payload.as_bytes()).await;
        }
        child.wait().await
    };
    let ended = tokio::time::timeout(deadline, run).await;
    let (code, trouble) = match ended {
        Ok(Ok(status)) => (status.code(), None),
        Ok(Err(cause)) => (None, Some(cause.to_string())),
        Err(_) => {
            let text = format!("killed after {:.1} s", deadline.as_secs_f64());
            (None, Some(text))
        }
    };
    if trouble.is_some() {
        drop(group);
        let _ = child.wait().await;
    } else {
        group.leave();
    }
    let stderr = match tokio::time::timeout(OUTPUT_DRAIN_TIME, &mut received).await {
        Ok(text) => text.unwrap_or_default(),
        Err(_) => {
            received.abort();
            String::new()
        }
    };
    result(code, trouble, stderr)
}

/// The beginning of the output; the rest is read and dropped, so that the writer does not block.
async fn beginning(stream: Option<impl AsyncRead + Unpin>) -> String {
    let Some(mut stream) = stream else {
        return String::new();
    };
    let mut kept = Vec::new();
    let _ = (&mut stream)
        .take(LONGEST_MESSAGE)
        .read_to_end(&mut kept)
        .await;
    let mut rest = [0; 4096];
    while matches!(stream.read(&mut rest).await, Ok(read) if read > 0) {}
    String::from_utf8_lossy(&kept).into_owned()
}

#[cfg(test)]
mod tests {
    use crate::monitoring::notification::*;

    const LONG: Duration = Duration::from_secs(120);

    fn shell(script: &str) -> Vec<String> {
        ["sh", "-c", script].map(str::to_owned).to_vec()
    }

    #[tokio::test]
    async fn hook_gets_the_payload_and_its_stderr_and_code_come_back() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("letter");
        let script = format!("cat > {}; echo no route >&2; exit 3", file.display());
        let done = run_hook(&shell(&script), "{\"kind\":\"test\"}\n", LONG).await;
        assert_eq!((done.code, done.done), (Some(3), Some(false)));
        assert_eq!(text(&done), "exit code 3: no route");
        let read = std::fs::read_to_string(file).unwrap();
        assert_eq!(read, "{\"kind\":\"test\"}\n");
        let done = run_hook(&shell("cat > /dev/null"), "x", LONG).await;
        assert_eq!(done.done, Some(true));
    }

    #[tokio::test]
    async fn a_command_that_does_not_end_is_killed_with_all_it_began() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("pid");
        // its child would sleep for an hour
        let script = format!(
            "sleep 3600 & echo $! > {}.new; mv {0}.new {0}; wait",
            file.display()
        );
        let done = run_hook(&shell(&script), "x", Duration::from_secs(2)).await;
        assert_eq!(done.trouble.as_deref(), Some("killed after 2.0 s"));
        if let Ok(pid) = std::fs::read_to_string(&file) {
            let stat = format!("/proc/{}/stat", pid.trim());
            let gone = async {
                // it is killed immediately; its new parent reaps it
                while std::fs::read_to_string(&stat).is_ok_and(|text| !text.contains(") Z")) {
                    tokio::task::yield_now().await;
                }
            };
            tokio::time::timeout(LONG, gone).await.unwrap();
        }
    }

    #[tokio::test]
    async fn floods_and_deaf_commands_end_all_the_same() {
        // far more than a pipe holds, in both directions
        let script = "head -c 1000000 /dev/zero | tr '\\0' x >&2; exec 0<&-; exit 0";
        let payload = "y".repeat(1_000_000);
        let done = run_hook(&shell(script), &payload, LONG).await;
        assert_eq!(done.code, Some(0), "{}", text(&done));
        assert_eq!(done.stderr.unwrap().len() as u64, LONGEST_MESSAGE);
        let absent = run_hook(&["/nonexistent/mail".to_owned()], "x", LONG).await;
        let absent = text(&absent);
        assert!(absent.contains("cannot be run"), "{absent}");
        let none = run_hook(&[], "x", LONG).await;
        assert!(text(&none).contains("[notify] command"));
    }
}
