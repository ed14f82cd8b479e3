//! A full disk: a session that it stopped is not resumed.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use tactus_tests::DEADLINE;

use crate::files::assert_does_not_go_on;
use crate::site::Site;

const KILOBYTES: u32 = 32 * 1024;

/// A small disk mounted over a folder, in its own mount namespace; unmounted when dropped.
struct SmallDisk {
    holder: Child,
    folder: PathBuf,
}

impl SmallDisk {
    /// `None`, with the reason printed, if no disk can be mounted in a namespace.
    fn mount(folder: &Path) -> Option<Self> {
        std::fs::create_dir_all(folder).unwrap();
        let mut holder = Command::new("unshare")
            .args(["--mount", "sh", "-c"])
            .arg(format!(
                "mount --make-rprivate / && mount -t tmpfs -o size={KILOBYTES}k tmpfs \"$0\" && echo mounted && exec cat"
            ))
            .arg(folder)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        let stdout = holder.stdout.take().unwrap();
        BufReader::new(stdout).read_line(&mut line).unwrap();
        let disk = Self {
            holder,
            folder: folder.to_owned(),
        };
        if line == "mounted\n" {
            return Some(disk);
        }
        needs::lacking("NETNS", "no small disk can be mounted here");
        None
    }

    /// A command that runs another one in the namespace of this disk.
    fn launcher(&self) -> Vec<String> {
        let namespace = format!("--mount=/proc/{}/ns/mnt", self.holder.id());
        vec!["nsenter".to_owned(), namespace]
    }

    /// A path on the disk, as accessible from outside the namespace.
    fn outside(&self, name: &str) -> PathBuf {
        let root = PathBuf::from(format!("/proc/{}/root", self.holder.id()));
        root.join(self.folder.strip_prefix("/").unwrap()).join(name)
    }

    /// Fills the disk completely.
    fn fill(&self) {
        let mut filler = std::fs::File::create(self.outside("filler")).unwrap();
        for size in [64 * 1024, 4096] {
            while filler.write_all(&vec![0; size]).is_ok() {}
        }
    }

    fn free(&self) {
        std::fs::remove_file(self.outside("filler")).unwrap();
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = self.holder.kill();
        let _ = self.holder.wait();
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_session_stopped_on_a_full_disk_stays_stopped() {
    let Some(mut site) = Site::prepare().await else {
        return;
    };
    let Some(disk) = SmallDisk::mount(&site.stage.state_path()) else {
        return;
    };
    site.stage.launch_by(disk.launcher());
    let daemon = site.start().await;
    daemon.baseline().await;
    let session = daemon.measure().await;
    let id = session.id().await.unwrap();
    disk.fill();
    let begun = Instant::now();
    while !session
        .last_error()
        .await
        .unwrap()
        .contains("acquisition pauses")
    {
        assert!(
            begun.elapsed() < DEADLINE,
            "the session does not pause: {}",
            daemon.daemon.log()
        );
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    let begun = Instant::now();
    let stopped = site.tactus("system", &["stop", "--json"]);
    println!(
        "on a full disk `tactus stop` took {:.2?}: {stopped:?}",
        begun.elapsed()
    );
    assert_eq!(daemon.manager.source_state().await.unwrap(), "off");
    // like a power cut, with the disk still full
    daemon.daemon.kill();
    disk.free();
    assert_does_not_go_on(&site, &id).await;
}
