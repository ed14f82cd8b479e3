//! File systems mounted in a private namespace of a test. The daemon's tests include this file.

pub mod loop_disk;

use std::path::Path;
use std::process::Command;

/// Set in the run that has the right to mount.
const INSIDE: &str = "TACTUS_TEST_INSIDE";

/// Whether this process has the right to mount. If not, runs the test again in a process that has it; the caller
/// returns.
pub fn has_own_mounts(test: &str) -> bool {
    if std::env::var_os(INSIDE).is_some() {
        return true;
    }
    let rights: &[&str] = match rustix::process::geteuid().is_root() {
        true => &["--mount"],
        false => &["--user", "--map-root-user", "--mount"],
    };
    let tried = Command::new("unshare")
        .args(rights)
        .args(["sh", "-c", "mount -t tmpfs none /mnt"])
        .output();
    let refusal = match tried {
        Ok(output) if output.status.success() => None,
        Ok(output) => Some(String::from_utf8_lossy(&output.stderr).into_owned()),
        Err(error) => Some(format!("unshare: {error}")),
    };
    if let Some(refusal) = refusal {
        let why = format!("no file system can be mounted here: {refusal}");
        // root may always mount
        let kind = if needs::required("ROOT") {
            "ROOT"
        } else {
            "NETNS"
        };
        needs::lacking(kind, &why);
        return false;
    }
    let output = Command::new("unshare")
        .args(rights)
        .arg(std::env::current_exe().unwrap())
        .args(["--exact", test, "--nocapture"])
        .env(INSIDE, "1")
        .output()
        .unwrap();
    let printed = String::from_utf8_lossy(&output.stdout);
    println!("{printed}{}", String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success() && printed.contains("1 passed"));
    false
}

/// Runs `mount` with these arguments and a folder.
pub fn mount(arguments: &[&str], folder: &Path) {
    let output = Command::new("mount")
        .args(arguments)
        .arg(folder)
        .output()
        .unwrap();
    assert!(output.status.success(), "mount {arguments:?}: {output:?}");
}
