//! Checks of programs and buses: the configuration's own check, systemd, the system bus, the daemon.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use zbus::Connection;
use zbus::fdo::DBusProxy;

use super::{DoctorConfig, Finding};
use crate::args::Global;

/// Timeout; a program that does not reply within it counts as absent.
const TIMEOUT: Duration = Duration::from_secs(3);

/// Results of the checks of running programs.
#[derive(Debug, Default)]
pub(super) struct Running {
    pub findings: Vec<Finding>,
    /// The directory in which the running daemon records.
    pub record_directory: Option<PathBuf>,
}

/// Runs `tactusd --check`, if the program is installed.
pub(super) fn configuration(file: &Path) -> Finding {
    let beside = std::env::current_exe()
        .ok()
        .map(|own| own.with_file_name("tactusd"))
        .filter(|program| program.exists());
    let program = beside.unwrap_or_else(|| PathBuf::from("tactusd"));
    judged(
        file,
        Command::new(&program)
            .arg("--config")
            .arg(file)
            .arg("--check")
            .output(),
    )
}

fn judged(file: &Path, ran: std::io::Result<std::process::Output>) -> Finding {
    let file = file.display();
    match ran {
        Err(cause) => Finding::warn(
            "configuration",
            format!("tactusd cannot be run: {cause}"),
            "install it next to tactus or in PATH",
        ),
        Ok(ran) if ran.status.success() => {
            let printed = String::from_utf8_lossy(&ran.stdout);
            let warnings: Vec<&str> = printed
                .lines()
                .filter(|line| line.contains(": warning: "))
                .collect();
            match warnings.is_empty() {
                true => Finding::ok("configuration", format!("{file}: no problem found")),
                false => Finding::warn(
                    "configuration",
                    warnings.join("\n"),
                    format!("`tactusd --config {file} --check` as the daemon's user"),
                ),
            }
        }
        Ok(ran) => {
            let message = String::from_utf8_lossy(&ran.stderr);
            Finding::bad(
                "configuration",
                message.trim_end().to_owned(),
                format!("correct it, then `tactusd --config {file} --check`"),
            )
        }
    }
}

/// Checks the unit, the buses and the daemon.
pub(super) async fn check(global: &Global, wanted: &DoctorConfig) -> Running {
    let mut running = Running::default();
    running.findings.push(unit());
    running.findings.extend(system_bus(wanted).await);
    let hurried = Global {
        timeout: global.timeout.min(TIMEOUT),
        ..global.clone()
    };
    let answer = async {
        let daemon = crate::connection::open(&hurried).await?;
        let health = daemon.ask("its health", daemon.manager.health()).await?;
        let directory = daemon
            .ask("the record", daemon.manager.record_directory())
            .await?;
        Ok::<_, crate::failure::Failure>((daemon.address.to_string(), health, directory))
    };
    match answer.await {
        Ok((address, health, directory)) => {
            running.record_directory = Some(PathBuf::from(directory));
            running.findings.push(daemon(&address, &health));
        }
        Err(failure) => {
            let text = failure.to_string();
            let first = text.lines().next().unwrap_or_default().to_owned();
            running.findings.push(match failure.code() {
                4 => Finding::bad("daemon", first, "ask the administrator to add you to the group tactus, or run as root"),
                _ => Finding::warn(
                    "daemon",
                    "no daemon answers",
                    "`sudo systemctl start tactusd`, or `tactusd --config FILE` by hand; `tactus status` lists the addresses tried",
                ),
            });
        }
    }
    running.findings.extend(peer_socket(wanted));
    running
}

/// The finding about a daemon from its own report on its health.
fn daemon(address: &str, health: &dbus::Health) -> Finding {
    let troubles = health.troubles.as_deref().unwrap_or_default();
    let why = match (health.well, troubles) {
        (Some(true), []) => {
            return Finding::ok("daemon", format!("replies at {address}, and is well"));
        }
        (Some(false), []) => "it is not well, and gives no reason".to_owned(),
        (None, []) => "it does not report whether it is well".to_owned(),
        (_, troubles) => troubles.join("; "),
    };
    Finding::warn(
        "daemon",
        format!("replies at {address}: {why}"),
        "`tactus status`",
    )
}

/// Checks that the configured socket of the daemon exists and is accessible.
fn peer_socket(wanted: &DoctorConfig) -> Option<Finding> {
    if wanted.bus.peer == Some(false) {
        return None;
    }
    let path = wanted.bus.peer_path.as_ref()?;
    let shown = path.display();
    Some(match std::os::unix::net::UnixStream::connect(path) {
        Ok(_) => Finding::ok("peer socket", format!("{shown} can be reached")),
        Err(cause) if cause.kind() == std::io::ErrorKind::PermissionDenied => Finding::bad(
            "peer socket",
            format!("{shown}: {cause}"),
            "ask the administrator to add you to the group tactus, or run as root",
        ),
        Err(cause) => Finding::warn(
            "peer socket",
            format!("{shown}: {cause}"),
            "start the daemon",
        ),
    })
}

/// The state of the service according to systemd.
fn unit() -> Finding {
    let output = Command::new("systemctl")
        .args(["show", "tactusd.service", "--property"])
        .arg("LoadState,ActiveState,SubState,NRestarts,Result")
        .output();
    match output {
        Ok(ran) if ran.status.success() => service(&String::from_utf8_lossy(&ran.stdout)),
        _ => Finding::ok("service", "no systemd here; run tactusd by hand"),
    }
}

/// Interprets the output of `systemctl show`.
fn service(shown: &str) -> Finding {
    let of = |name: &str| {
        let line = shown.lines().find_map(|line| line.strip_prefix(name));
        line.and_then(|rest| rest.strip_prefix('='))
            .unwrap_or_default()
            .to_owned()
    };
    let (active, restarts) = (of("ActiveState"), of("NRestarts"));
    let text = format!("tactusd.service is {active} ({})", of("SubState"));
    let journal = "`journalctl -u tactusd -e` shows why";
    match (of("LoadState").as_str(), active.as_str()) {
        ("not-found" | "", _) => Finding::warn(
            "service",
            "tactusd.service is not installed",
            "install the package, or run tactusd by hand",
        ),
        ("masked", _) => Finding::bad("service", "it is masked", "`sudo systemctl unmask tactusd`"),
        (_, "failed") => Finding::bad("service", format!("{text}: {}", of("Result")), journal),
        (_, "active" | "reloading") if restarts.parse::<u64>().is_ok_and(|times| times > 0) => {
            Finding::warn(
                "service",
                format!("{text}, restarted {restarts} times"),
                journal,
            )
        }
        (_, "active" | "reloading") => Finding::ok("service", text),
        _ => Finding::warn("service", text, "`sudo systemctl enable --now tactusd`"),
    }
}

/// Checks names on the system bus (the daemon's and polkit's), and whether the clock is synchronised.
async fn system_bus(wanted: &DoctorConfig) -> Vec<Finding> {
    let reached = async {
        let connection = Connection::system().await.ok()?;
        let bus = DBusProxy::new(&connection).await.ok()?;
        Some((connection, bus))
    };
    let reached = tokio::time::timeout(TIMEOUT, reached).await.ok().flatten();
    let Some((connection, bus)) = reached else {
        let text = "there is no system bus";
        return match wanted.bus.system {
            true => vec![Finding::bad(
                "system bus",
                text,
                "start dbus, or set [bus] system = false",
            )],
            false => vec![Finding::ok(
                "system bus",
                format!("{text}, and none is configured"),
            )],
        };
    };
    let mut findings = Vec::new();
    let owned = |name: &'static str| {
        let bus = bus.clone();
        async move {
            let name = zbus::names::BusName::try_from(name).ok()?;
            let answer = tokio::time::timeout(TIMEOUT, bus.name_has_owner(name)).await;
            answer.ok()?.ok()
        }
    };
    if wanted.bus.system {
        findings.push(match owned(dbus::BUS_NAME).await {
            Some(true) => Finding::ok("system bus", format!("{} is owned", dbus::BUS_NAME)),
            _ => Finding::warn(
                "system bus",
                format!("no process owns {}", dbus::BUS_NAME),
                "`sudo systemctl start tactusd`",
            ),
        });
        if owned("org.freedesktop.PolicyKit1").await != Some(true) {
            findings.push(Finding::warn(
                "polkit",
                "polkit does not run: on the system bus only root and the group tactus have control; others can only read",
                "`sudo apt install polkitd`, unless this is intended",
            ));
        }
    }
    let synchronised = async {
        let clock = zbus::Proxy::new(
            &connection,
            "org.freedesktop.timedate1",
            "/org/freedesktop/timedate1",
            "org.freedesktop.timedate1",
        )
        .await
        .ok()?;
        clock.get_property::<bool>("NTPSynchronized").await.ok()
    };
    let synchronised = tokio::time::timeout(TIMEOUT, synchronised).await;
    findings.push(match synchronised.ok().flatten() {
        Some(true) => Finding::ok("clock", "synchronised by NTP"),
        Some(false) => Finding::warn(
            "clock",
            "not synchronised: wall times in the record drift (schedules do not)",
            "`sudo timedatectl set-ntp true`",
        ),
        None => Finding::warn(
            "clock",
            "it is unknown whether it is synchronised",
            "`timedatectl` or `chronyc tracking`",
        ),
    });
    findings
}

#[cfg(test)]
mod tests {
    use super::super::CheckResult;
    use super::*;

    #[test]
    fn systemds_words_are_judged() {
        let of = |load, active, sub, restarts, result| {
            service(&format!(
                "LoadState={load}\nActiveState={active}\nSubState={sub}\nNRestarts={restarts}\nResult={result}\n"
            ))
        };
        for (finding, verdict, word) in [
            (
                of("loaded", "active", "running", "0", "success"),
                CheckResult::Ok,
                "running",
            ),
            (
                of("loaded", "active", "running", "3", "success"),
                CheckResult::Warn,
                "restarted 3 times",
            ),
            (
                of("loaded", "failed", "failed", "0", "exit-code"),
                CheckResult::Bad,
                "exit-code",
            ),
            (
                of("loaded", "inactive", "dead", "0", "success"),
                CheckResult::Warn,
                "inactive",
            ),
            (
                of("not-found", "inactive", "dead", "0", "success"),
                CheckResult::Warn,
                "not installed",
            ),
            (
                of("masked", "inactive", "dead", "0", "success"),
                CheckResult::Bad,
                "masked",
            ),
        ] {
            assert_eq!(finding.verdict, verdict, "{finding:?}");
            assert!(finding.text.contains(word), "{finding:?}");
        }
    }

    #[test]
    fn the_check_of_the_configuration_is_passed_on() {
        let ran = |script: &str| Command::new("sh").args(["-c", script]).output();
        let file = Path::new("c.toml");
        assert_eq!(judged(file, ran("exit 0")).verdict, CheckResult::Ok);
        let warned = judged(
            file,
            ran("echo c.toml: warning: no disk; echo no error found"),
        );
        assert_eq!(
            (warned.verdict, warned.text.as_str()),
            (CheckResult::Warn, "c.toml: warning: no disk")
        );
        let bad = judged(file, ran("echo c.toml:2:8: unknown variant >&2; exit 78"));
        assert_eq!(
            (bad.verdict, bad.text.as_str()),
            (CheckResult::Bad, "c.toml:2:8: unknown variant")
        );
        let absent = Command::new("/nonexistent/tactusd").output();
        assert_eq!(judged(file, absent).verdict, CheckResult::Warn);
    }

    #[test]
    fn a_daemon_is_well_only_if_it_reports_so() {
        let of = |well, troubles: Option<&[&str]>| {
            let troubles = troubles.map(|texts| texts.iter().map(ToString::to_string).collect());
            let health = dbus::Health {
                well,
                troubles,
                ..dbus::Health::default()
            };
            let found = daemon("unix:path=/run/x", &health);
            (found.verdict, found.text)
        };
        let (verdict, text) = of(Some(true), Some(&[]));
        assert_eq!(verdict, CheckResult::Ok);
        assert!(text.ends_with("and is well"), "{text}");
        assert_eq!(of(Some(true), None).0, CheckResult::Ok);
        for (well, troubles, words) in [
            (Some(false), None, "not well"),
            (None, None, "does not report whether it is well"),
            (None, Some(&[][..]), "does not report whether it is well"),
            (Some(false), Some(&["lost: 6221"][..]), "lost: 6221"),
            (None, Some(&["lost: 6221"][..]), "lost: 6221"),
        ] {
            let (verdict, text) = of(well, troubles);
            assert_eq!(verdict, CheckResult::Warn, "{text}");
            assert!(text.contains(words), "{text}");
        }
    }

    #[test]
    fn unserved_socket_is_reported() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("peer");
        let mut wanted = DoctorConfig::default();
        assert_eq!(peer_socket(&wanted), None);
        wanted.bus.peer_path = Some(path.clone());
        assert_eq!(peer_socket(&wanted).unwrap().verdict, CheckResult::Warn);
        let _listener = std::os::unix::net::UnixListener::bind(&path).unwrap();
        assert_eq!(peer_socket(&wanted).unwrap().verdict, CheckResult::Ok);
        wanted.bus.peer = Some(false);
        assert_eq!(peer_socket(&wanted), None);
    }
}
