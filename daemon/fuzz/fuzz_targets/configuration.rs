//! Arbitrary configurations through `tactusd --check`: arbitrary text, and the shipped `config.toml` with the fuzzer's
//! edits, in which commented-out keys are sometimes activated. Each is accepted or rejected with exit code 78, never a
//! panic.

#![no_main]

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::OnceLock;

use libfuzzer_sys::fuzz_target;

const SHIPPED: &str = include_str!("../../../config.toml");
/// `EX_CONFIG`, which the systemd unit recognises.
const REFUSED: u8 = 78;

static FILE: OnceLock<PathBuf> = OnceLock::new();

fuzz_target!(|bytes: &[u8]| {
    let Some((kind, bytes)) = bytes.split_first() else {
        return;
    };
    let file = FILE.get_or_init(begin);
    let text = match kind % 4 {
        0 => bytes.to_vec(),
        _ => edited(bytes),
    };
    std::fs::write(file, &text).expect("a temporary file");
    let code = quietly(|| {
        let args = ["tactusd", "--check", "--config"].map(std::ffi::OsString::from);
        daemon::run(args.into_iter().chain([file.clone().into_os_string()]))
    });
    // `ExitCode` does not implement `PartialEq`.
    let is = |wanted: ExitCode| format!("{code:?}") == format!("{wanted:?}");
    assert!(
        is(ExitCode::SUCCESS) || is(ExitCode::from(REFUSED)),
        "{code:?}"
    );
});

/// Applies the fuzzer's edits to the shipped file. Each edit names a line and an operation. Sections keep their order,
/// so that most results are valid.
fn edited(mut orders: &[u8]) -> Vec<u8> {
    // Accepted configurations are prepared, which takes a thousandth of the time for a small tank, compared with a
    // sheet.
    let small = SHIPPED
        .replace("preset = \"paper-sheet\"", "preset = \"disc-tank\"")
        .replace("# [geometry.disc-tank]", "[geometry.disc-tank]")
        .replace("# electrodes = 16", "electrodes = 26\nfineness = 0.25");
    let mut lines: Vec<Vec<u8>> = small.lines().map(|line| line.as_bytes().to_vec()).collect();
    while let Some((&[order, line, at, length], rest)) = orders.split_first_chunk() {
        let (new, rest) = rest.split_at(usize::from(length % 24).min(rest.len()));
        orders = rest;
        let count = lines.len().max(1);
        let Some(line) = lines.get_mut(usize::from(line) % count) else {
            continue;
        };
        let value = line
            .iter()
            .position(|byte| *byte == b'=')
            .map_or(0, |at| at + 1);
        match order % 8 {
            // Replaces the value.
            0..3 => {
                line.truncate(value);
                line.extend(new);
            }
            // Replaces the first number of the line.
            3 => {
                let from = line
                    .iter()
                    .position(u8::is_ascii_digit)
                    .unwrap_or(line.len());
                let to = line[from..]
                    .iter()
                    .take_while(|byte| byte.is_ascii_digit())
                    .count();
                let number = new
                    .iter()
                    .map(|byte| b"0123456789.-e_"[usize::from(*byte) % 14]);
                line.splice(from..from + to, number);
            }
            // Activates an example in a comment.
            4 | 5 if line.starts_with(b"# ") => drop(line.drain(..2)),
            4 | 5 => line.clear(),
            6 => {
                let at = usize::from(at) * line.len() / 256;
                let end = (at + usize::from(length / 24)).min(line.len());
                line.splice(at..end, new.iter().copied());
            }
            _ => {
                let copy = line.clone();
                lines.push(copy);
            }
        }
    }
    lines.join(&b'\n')
}

/// Runs `work` with standard output and standard error redirected to `/dev/null`.
fn quietly<T>(work: impl FnOnce() -> T) -> T {
    let null = File::options()
        .write(true)
        .open("/dev/null")
        .expect("nowhere");
    let kept = [
        rustix::io::dup(std::io::stdout()).expect("standard output"),
        rustix::io::dup(std::io::stderr()).expect("standard error"),
    ];
    rustix::stdio::dup2_stdout(&null).expect("standard output");
    rustix::stdio::dup2_stderr(&null).expect("standard error");
    let done = work();
    let [stdout, stderr] = kept;
    rustix::stdio::dup2_stdout(stdout).expect("standard output");
    rustix::stdio::dup2_stderr(stderr).expect("standard error");
    done
}

fn begin() -> PathBuf {
    // The panic hook restores this copy of standard error, which may be redirected.
    let stderr = rustix::io::dup(std::io::stderr()).expect("standard error");
    let tell = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let _ = rustix::stdio::dup2_stderr(&stderr);
        tell(panic);
    }));
    let memory = Path::new("/dev/shm");
    let base = if memory.is_dir() {
        memory.to_owned()
    } else {
        std::env::temp_dir()
    };
    let folder = tempfile::Builder::new()
        .prefix("fuzz")
        .tempdir_in(base)
        .expect("a temporary folder")
        .keep();
    folder.join("config.toml")
}
