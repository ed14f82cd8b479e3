//! The control socket of a served rig: commands for faults and presses, as lines of text; every reply is a line of
//! JSON.

use std::io::{self, BufRead, BufReader, Write};
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{UnixListener, UnixStream};
use tokio::task::JoinSet;

use crate::{Fault, Load, SimulatedRig};

/// Longest command line, bytes.
const LONGEST_LINE: usize = 4096;
/// Timeout of a command.
const TIMEOUT: Duration = Duration::from_secs(30);

/// Creates the socket; only the owner may connect.
///
/// # Errors
/// A socket that cannot be created.
pub(crate) fn listen(path: &Path) -> io::Result<UnixListener> {
    let socket = std::fs::symlink_metadata(path).is_ok_and(|found| found.file_type().is_socket());
    if socket && std::os::unix::net::UnixStream::connect(path).is_err() {
        // Remove a socket left by a killed process, but never another kind of file.
        std::fs::remove_file(path).ok();
    }
    let listener = UnixListener::bind(path)?;
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o600))?;
    Ok(listener)
}

/// Serves the socket.
pub(crate) async fn serve(rig: SimulatedRig, listener: UnixListener) {
    let mut clients = JoinSet::new();
    loop {
        match listener.accept().await {
            Ok((stream, _)) => {
                clients.spawn(converse(rig.clone(), stream));
            }
            Err(fault) => {
                tracing::warn!("the control socket cannot accept: {fault}");
                // out of descriptors: retry after a moment
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        }
        while clients.try_join_next().is_some() {}
    }
}

async fn converse(rig: SimulatedRig, mut stream: UnixStream) {
    let mut framer = scpi::Framer::new(LONGEST_LINE);
    let mut chunk = [0; 1024];
    while let Ok(count @ 1..) = stream.read(&mut chunk).await {
        framer.push(&chunk[..count]);
        for line in framer.by_ref() {
            let answer = match line {
                Ok(line) => {
                    let rig = rig.clone();
                    let line = String::from_utf8_lossy(&line).into_owned();
                    // A fault or a press may need a solution of the sheet.
                    let obeyed = tokio::task::spawn_blocking(move || execute(&rig, &line)).await;
                    obeyed.unwrap_or_else(|fault| json!({ "error": fault.to_string() }))
                }
                Err(fault) => json!({ "error": fault.to_string() }),
            };
            if stream
                .write_all(format!("{answer}\n").as_bytes())
                .await
                .is_err()
            {
                return;
            }
        }
    }
}

/// Executes a command line.
fn execute(rig: &SimulatedRig, line: &str) -> Value {
    let done = match line.split_whitespace().collect::<Vec<_>>().as_slice() {
        ["status"] => return serde_json::to_value(rig.status()).unwrap_or_default(),
        ["release"] => match rig.release() {
            true => Ok(()),
            false => Err("no load was added with press, so there is none to release".to_owned()),
        },
        ["press", numbers @ ..] => press(rig, numbers),
        _ => line
            .parse::<Fault>()
            .and_then(|fault| rig.fault(&fault))
            .map_err(|refusal| refusal.to_string()),
    };
    match done {
        Ok(()) => json!({ "ok": true }),
        Err(message) => json!({ "error": message }),
    }
}

fn press(rig: &SimulatedRig, numbers: &[&str]) -> Result<(), String> {
    let parsed: Result<Vec<f64>, _> = numbers.iter().map(|word| word.parse()).collect();
    let Ok(&[x_mm, y_mm, diameter_mm, loss_percent]) = parsed.as_deref() else {
        return Err("a press is written press X_MM Y_MM DIAMETER_MM LOSS_PERCENT".to_owned());
    };
    let load = Load::disc([x_mm, y_mm], diameter_mm, loss_percent / 100.0);
    rig.press(load)
        .map_err(|refusal| survey::error_chain(&refusal).to_string())
}

/// Folder of the sockets of served rigs.
fn folder() -> PathBuf {
    std::env::var_os("XDG_RUNTIME_DIR")
        .filter(|directory| !directory.is_empty())
        .map_or_else(std::env::temp_dir, PathBuf::from)
}

/// Prefix of the name of a served rig's own folder.
const PREFIX: &str = "tactus-sim-";
/// Name of the socket in it.
pub(crate) const SOCKET: &str = "control";

/// Creates a served rig's own folder, removed with it.
pub(crate) fn own_folder() -> io::Result<tempfile::TempDir> {
    tempfile::Builder::new()
        .prefix(PREFIX)
        .permissions(std::fs::Permissions::from_mode(0o700))
        .tempdir_in(folder())
}

/// Sends a command line to a running rig and returns its reply. Without a path exactly one rig must be running.
///
/// # Errors
/// No rig, several rigs, or a command that is refused; in words.
pub(crate) fn ask(path: Option<&Path>, line: &str) -> Result<Value, String> {
    let path = match path {
        Some(path) => path.to_owned(),
        None => only_socket()?,
    };
    let with_path = |fault: io::Error| {
        format!(
            "{}: {fault}; is `tactus-sim serve` running there?",
            path.display()
        )
    };
    let mut stream = std::os::unix::net::UnixStream::connect(&path).map_err(with_path)?;
    stream.set_read_timeout(Some(TIMEOUT)).map_err(with_path)?;
    stream
        .write_all(format!("{line}\n").as_bytes())
        .map_err(with_path)?;
    let mut answer = String::new();
    BufReader::new(stream)
        .read_line(&mut answer)
        .map_err(with_path)?;
    let answer: Value = serde_json::from_str(&answer)
        .map_err(|_| format!("{} does not reply as a simulated rig", path.display()))?;
    match answer.get("error").and_then(Value::as_str) {
        Some(refusal) => Err(refusal.to_owned()),
        None => Ok(answer),
    }
}

fn only_socket() -> Result<PathBuf, String> {
    let entries = std::fs::read_dir(folder()).into_iter().flatten().flatten();
    let running: Vec<PathBuf> = entries
        .filter(|entry| entry.file_name().to_string_lossy().starts_with(PREFIX))
        .map(|entry| entry.path().join(SOCKET))
        .filter(|path| std::os::unix::net::UnixStream::connect(path).is_ok())
        .collect();
    match running.as_slice() {
        [only] => Ok(only.clone()),
        [] => Err(
            "no `tactus-sim serve` is running; if one is, name its socket by --control".to_owned(),
        ),
        several => {
            let paths: Vec<String> = several
                .iter()
                .map(|path| path.display().to_string())
                .collect();
            Err(format!(
                "several rigs are served; choose one by --control: {}",
                paths.join(", ")
            ))
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::control::*;

    #[tokio::test]
    async fn a_socket_replaces_only_an_unused_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("control");
        std::fs::write(&path, "precious").unwrap();
        assert!(listen(&path).is_err());
        assert_eq!(std::fs::read(&path).unwrap(), b"precious");
        std::fs::remove_file(&path).unwrap();
        drop(listen(&path).unwrap());
        // its name still exists, but no process listens
        assert!(path.exists());
        listen(&path).unwrap();
    }
}
