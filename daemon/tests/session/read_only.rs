//! A record's disk that becomes read-only during a session, as ext4 does after an error of its device.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::endings::{assert_stays_ended, durable, recorded, resuming};
use crate::mounts::has_own_mounts;
use crate::stage::{Stage, within};
use dbus::Options;

/// A separate filesystem in an image, on a loop device.
struct Disk {
    image: PathBuf,
    folder: PathBuf,
}

fn run(program: &str, arguments: &[&str]) -> String {
    let output = Command::new(program).args(arguments).output().unwrap();
    assert!(
        output.status.success(),
        "{program} {arguments:?}: {output:?}"
    );
    String::from_utf8(output.stdout).unwrap()
}

impl Disk {
    fn mounted(image: PathBuf, folder: PathBuf) -> Self {
        std::fs::create_dir(&folder).unwrap();
        let file = std::fs::File::create(&image).unwrap();
        file.set_len(24 << 20).unwrap();
        let disk = Self { image, folder };
        run("mkfs.ext4", &["-q", disk.image()]);
        disk.mount();
        disk
    }

    fn image(&self) -> &str {
        self.image.to_str().unwrap()
    }

    fn folder(&self) -> &str {
        self.folder.to_str().unwrap()
    }

    fn mount(&self) {
        let options = "loop,errors=remount-ro";
        run("mount", &["-o", options, self.image(), self.folder()]);
    }

    /// Reports a filesystem error to the kernel, which makes it read-only.
    fn turn_read_only(&self) {
        let device = run("findmnt", &["-n", "-o", "SOURCE", self.folder()]);
        let device = Path::new(device.trim()).file_name().unwrap();
        let trigger = Path::new("/sys/fs/ext4").join(device);
        std::fs::write(trigger.join("trigger_fs_error"), "1").unwrap();
    }

    /// Checks the filesystem and mounts it again, as an administrator does.
    fn repair(&self) {
        run("umount", &[self.folder()]);
        // 1: errors were corrected
        let checked = Command::new("e2fsck").args(["-fy", self.image()]).status();
        assert!(matches!(checked.unwrap().code(), Some(0 | 1)));
        self.mount();
    }
}

/// Whether a filesystem can be created and mounted here.
fn has_disks(folder: &Path) -> bool {
    let image = folder.join("trial");
    let script = "truncate -s 1M $0 && mkfs.ext4 -q $0 && mount -o loop $0 /mnt && umount /mnt";
    let tried = Command::new("sh")
        .arg("-c")
        .arg(script)
        .arg(&image)
        .output();
    let refusal = match tried {
        Ok(output) if output.status.success() => return true,
        Ok(output) => String::from_utf8_lossy(&output.stderr).into_owned(),
        Err(error) => error.to_string(),
    };
    let why = format!("no file system can be mounted from an image here: {refusal}");
    needs::lacking("LOOP", &why);
    false
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_whose_disk_turns_read_only_stays_ended() {
    if !has_own_mounts("read_only::a_session_whose_disk_turns_read_only_stays_ended") {
        return;
    }
    let stage = Stage::new(&resuming());
    if !has_disks(stage.path()) {
        return;
    }
    let state = stage.path().join("state");
    let disk = Disk::mounted(stage.path().join("image"), state.clone());
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let mut happened = daemon.manager.receive_happened().await.unwrap();
    let session = daemon.start(Options::new().with("every_s", 0.02)).await;
    durable(&session, 3).await;
    disk.turn_read_only();
    let text = loop {
        let signal = within(dbus::next(&mut happened)).await.unwrap();
        let text = signal.args().unwrap().text.to_string();
        if text.contains("could not be closed") {
            break text;
        }
    };
    assert!(text.contains("only until this machine restarts"), "{text}");
    let ended = within(session.wait()).await;
    assert!(ended.is_err(), "the record failed: {ended:?}");
    assert_eq!(session.state().await.unwrap(), "faulted");
    let frames = session.frames_durable().await.unwrap();
    daemon.kill().await;
    disk.repair();
    let daemon = assert_stays_ended(&stage).await;
    // a frame whose sync failed may have reached the disk; no acknowledged frame is lost
    let kept = recorded(&state);
    assert!(kept.iter().copied().eq(1..=kept.len() as u64), "{kept:?}");
    assert!(
        kept.len() as u64 >= frames,
        "{kept:?}, acknowledged {frames}"
    );
    daemon.terminate().await;
}
