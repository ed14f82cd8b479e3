//! No socket listens for other hosts unless it is configured. Checked with the kernel's list of a daemon's sockets.

use std::collections::BTreeSet;
use std::path::Path;

use crate::stage::{SMALL, Stage};

/// Inodes of the sockets of a process.
fn sockets(process: &Path) -> BTreeSet<String> {
    let mut inodes = BTreeSet::new();
    for entry in std::fs::read_dir(process.join("fd")).unwrap().flatten() {
        let Ok(target) = std::fs::read_link(entry.path()) else {
            continue;
        };
        let target = target.to_string_lossy().into_owned();
        if let Some(inode) = target.strip_prefix("socket:[") {
            inodes.insert(inode.trim_end_matches(']').to_owned());
        }
    }
    inodes
}

/// Lines of `/proc/PID/net/tcp` and similar files for these sockets, in any state.
fn bound(process: &Path, inodes: &BTreeSet<String>) -> Vec<String> {
    let tables = ["tcp", "tcp6", "udp", "udp6", "raw", "raw6"];
    let mut lines = Vec::new();
    for table in tables {
        let text = std::fs::read_to_string(process.join("net").join(table)).unwrap_or_default();
        for line in text.lines().skip(1) {
            let inode = line.split_whitespace().nth(9).unwrap_or_default();
            if inodes.contains(inode) {
                lines.push(format!("{table}: {line}"));
            }
        }
    }
    lines
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_with_default_settings_has_no_network_socket() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let process = Path::new("/proc").join(daemon.id().to_string());
    let inodes = sockets(&process);
    assert!(!inodes.is_empty(), "the peer socket at least");
    assert_eq!(bound(&process, &inodes), Vec::<String>::new());
    daemon.terminate().await;
}

#[test]
fn a_socket_that_listens_is_seen() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let process = Path::new("/proc/self");
    let port = format!("{:04X}", listener.local_addr().unwrap().port());
    let lines = bound(process, &sockets(process));
    assert!(lines.iter().any(|line| line.contains(&port)), "{lines:?}");
}
