//! Checks of a machine's files: users and groups, devices, installed files, directory and disk of the records.

use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};

use chrono::{DateTime, Datelike, Utc};

use super::{DoctorConfig, Finding};
use crate::failure::chain;

/// Network file systems; those in memory are in `IN_MEMORY`.
const NETWORK_FILE_SYSTEMS: [&str; 9] = [
    "nfs",
    "nfs4",
    "cifs",
    "smb3",
    "smbfs",
    "fuse.sshfs",
    "9p",
    "ceph",
    "afs",
];
const IN_MEMORY: [&str; 2] = ["tmpfs", "ramfs"];

/// Free space below this is a warning, bytes.
const LOW_SPACE: u64 = 2_000_000_000;
/// Free space below this is an error, bytes.
const CRITICAL_SPACE: u64 = 200_000_000;

/// A machine: the root of its files, the user, and the user's groups.
#[derive(Debug)]
pub(super) struct Machine {
    root: PathBuf,
    user: u32,
    /// Groups of this process.
    groups: Vec<u32>,
}

/// The part of a configuration that concerns the machine.
pub(super) fn wanted(file: &Path) -> Result<DoctorConfig, Finding> {
    let advice = "name the daemon's configuration with --config FILE";
    let text = std::fs::read_to_string(file).map_err(|cause| {
        let text = format!("{} cannot be read: {cause}", file.display());
        Finding::warn("configuration", text, advice)
    })?;
    let mut wanted: DoctorConfig = toml::from_str(&text).map_err(|error| {
        let text = format!(
            "{} is not a configuration: {}",
            file.display(),
            chain(&error)
        );
        Finding::bad(
            "configuration",
            text,
            "`tactusd --check` names every problem",
        )
    })?;
    // the checks resolve paths against the root
    let file = std::path::absolute(file).unwrap_or_else(|_| file.to_owned());
    let folder = file.parent().unwrap_or(Path::new("/"));
    for path in [&mut wanted.record.directory, &mut wanted.bus.peer_path]
        .into_iter()
        .flatten()
    {
        *path = folder.join(&*path);
    }
    Ok(wanted)
}

impl Machine {
    pub(super) fn this_machine() -> Self {
        let groups = rustix::process::getgroups().unwrap_or_default();
        let mut groups: Vec<u32> = groups.into_iter().map(|group| group.as_raw()).collect();
        groups.push(rustix::process::getegid().as_raw());
        Self {
            root: PathBuf::from("/"),
            user: rustix::process::geteuid().as_raw(),
            groups,
        }
    }

    fn path(&self, absolute: &str) -> PathBuf {
        self.root.join(absolute.trim_start_matches('/'))
    }

    fn text(&self, absolute: &str) -> String {
        std::fs::read_to_string(self.path(absolute)).unwrap_or_default()
    }

    /// The id of a name in `/etc/passwd` or `/etc/group`, and the last field of its line.
    fn named(&self, file: &str, name: &str) -> Option<(u32, String)> {
        let text = self.text(file);
        let line = text
            .lines()
            .find(|line| line.split(':').next() == Some(name))?;
        let id = line.split(':').nth(2)?.parse().ok()?;
        Some((id, line.rsplit(':').next()?.to_owned()))
    }

    /// The name of an id.
    fn name(&self, file: &str, id: u32) -> String {
        let text = self.text(file);
        let line = text
            .lines()
            .find(|line| line.split(':').nth(2).and_then(|field| field.parse().ok()) == Some(id));
        line.and_then(|line| line.split(':').next())
            .map_or_else(|| id.to_string(), str::to_owned)
    }

    /// Checks the current user and the daemon's own user.
    pub(super) fn users(&self, wanted: &DoctorConfig) -> Vec<Finding> {
        let me = self.name("etc/passwd", self.user);
        let mut findings = Vec::new();
        let member = |group: &str, user: &str| {
            self.named("etc/group", group)
                .is_some_and(|(_, members)| members.split(',').any(|one| one == user))
        };
        findings.push(match self.named("etc/group", "tactus") {
            _ if self.user == 0 => Finding::ok("user", "root may do everything"),
            None => Finding::warn(
                "user",
                "there is no group tactus",
                "install the package, or the sysusers file: `sudo systemd-sysusers`; a daemon run by hand needs none",
            ),
            Some((group, _)) if self.groups.contains(&group) => {
                Finding::ok("user", format!("{me} is in the group tactus"))
            }
            Some(_) if member("tactus", &me) => Finding::warn(
                "user",
                format!("{me} is in the group tactus, but not in this login"),
                "log out and in again",
            ),
            Some(_) => Finding::bad(
                "user",
                format!("{me} is not in the group tactus"),
                format!("`sudo usermod -aG tactus {me}`, then log in again"),
            ),
        });
        let devices = devices(wanted);
        let serial = devices.iter().any(|(kind, _)| *kind == "serial");
        if let Some((_, _)) = self.named("etc/passwd", "tactusd") {
            findings.push(match member("dialout", "tactusd") {
                _ if !serial => Finding::ok("daemon's user", "tactusd is there"),
                true => Finding::ok("daemon's user", "tactusd is in the group dialout"),
                false => Finding::bad(
                    "daemon's user",
                    "tactusd is not in the group dialout, and a serial port is configured",
                    "`sudo usermod -aG dialout tactusd`, then `sudo systemctl restart tactusd`",
                ),
            });
        }
        findings
    }

    /// Checks every device in the configuration.
    pub(super) fn devices(&self, wanted: &DoctorConfig) -> Vec<Finding> {
        let each = devices(wanted);
        each.iter()
            .map(|(kind, path)| self.device(kind, path))
            .collect()
    }

    fn device(&self, kind: &str, named: &str) -> Finding {
        let path = self.path(named);
        let Ok(found) = std::fs::metadata(&path) else {
            let there = self.by_id();
            let advice = match there.is_empty() {
                true => "is it plugged in and switched on? `dmesg` shows what the kernel detected"
                    .to_owned(),
                false => format!("plugged in are: {}", there.join(", ")),
            };
            return Finding::bad("device", format!("{named} is not there"), advice);
        };
        if !found.file_type().is_char_device() {
            let advice = "name the device node itself";
            return Finding::bad(
                "device",
                format!("{named} is not a character device"),
                advice,
            );
        }
        let open = self.user == 0
            || (found.uid() == self.user && found.mode() & 0o600 == 0o600)
            || (self.groups.contains(&found.gid()) && found.mode() & 0o060 == 0o060)
            || found.mode() & 0o006 == 0o006;
        let group = self.name("etc/group", found.gid());
        let daemon = self
            .named("etc/group", &group)
            .is_some_and(|(_, members)| members.split(',').any(|one| one == "tactusd"));
        if !open && !daemon {
            return Finding::bad(
                "device",
                format!(
                    "{named} belongs to the group {group}, in which neither you nor tactusd are"
                ),
                format!(
                    "`sudo usermod -aG {group} tactusd`, then `sudo systemctl restart tactusd`"
                ),
            );
        }
        let wanders = ["/dev/ttyUSB", "/dev/ttyACM"];
        if kind == "serial" && wanders.iter().any(|name| named.starts_with(name)) {
            let same = self.by_id().into_iter().find(|link| {
                std::fs::canonicalize(self.path(link)).ok() == std::fs::canonicalize(&path).ok()
            });
            let advice = match same {
                Some(link) => format!("write serial:{link}"),
                None => "name it by /dev/serial/by-id/...".to_owned(),
            };
            let text = format!("{named} may be another instrument after the next boot");
            return Finding::warn("device", text, advice);
        }
        Finding::ok("device", format!("{named} can be opened"))
    }

    /// Stable names of the serial ports that exist.
    fn by_id(&self) -> Vec<String> {
        let folder = "/dev/serial/by-id";
        let entries = std::fs::read_dir(self.path(folder)).into_iter().flatten();
        let mut names: Vec<String> = entries
            .flatten()
            .map(|entry| format!("{folder}/{}", entry.file_name().to_string_lossy()))
            .collect();
        names.sort();
        names
    }

    /// Checks the installed files other than the programs.
    pub(super) fn installed(&self, wanted: &DoctorConfig) -> Vec<Finding> {
        let mut findings = Vec::new();
        if wanted.bus.system {
            let places = [
                "/usr/share/dbus-1/system.d/org.tactus.Tactus1.conf",
                "/etc/dbus-1/system.d/org.tactus.Tactus1.conf",
            ];
            findings.push(match places.iter().find(|place| self.path(place).exists()) {
                Some(place) => Finding::ok("bus policy", *place),
                None => Finding::bad(
                    "bus policy",
                    "no user is permitted to own org.tactus.Tactus1 on the system bus",
                    "copy systemd/org.tactus.Tactus1.conf to /usr/share/dbus-1/system.d/, then `sudo systemctl reload dbus`",
                ),
            });
            let actions = "/usr/share/polkit-1/actions/org.tactus.Tactus1.policy";
            findings.push(match self.path(actions).exists() {
                true => Finding::ok("polkit", actions),
                false => Finding::warn(
                    "polkit",
                    "the actions of tactusd are not declared: on the system bus only root and the group tactus have control; others can only read",
                    "copy systemd/org.tactus.Tactus1.policy to /usr/share/polkit-1/actions/",
                ),
            });
        }
        if wanted.notify.command.is_empty() {
            findings.push(Finding::warn(
                "notify",
                "nobody is notified of alarms: [notify] has no command",
                "set [notify] command to a program that reaches people, then `tactus notify test`",
            ));
        }
        if let Some(program) = wanted.notify.command.first() {
            let mode = std::fs::metadata(self.path(program)).map(|found| found.mode());
            findings.push(match mode {
                Ok(mode) if mode & 0o111 != 0 => {
                    Finding::ok("notify", format!("{program}; `tactus notify test` runs it"))
                }
                Ok(_) => Finding::bad(
                    "notify",
                    format!("{program} is not an executable file"),
                    format!("`sudo chmod 755 {program}`"),
                ),
                Err(cause) => Finding::bad(
                    "notify",
                    format!("{program}: {cause}"),
                    "nobody is notified of alarms; correct [notify] command",
                ),
            });
        }
        findings
    }

    /// Checks whether the wall clock is good enough for time stamps.
    pub(super) fn clock(&self, now: DateTime<Utc>) -> Vec<Finding> {
        let mut findings = Vec::new();
        if !(2025..2100).contains(&now.year()) {
            let text = format!("the date of this machine is {}", now.date_naive());
            findings.push(Finding::bad(
                "clock",
                text,
                "set the clock: `sudo timedatectl set-ntp true`",
            ));
        }
        let booted = self.text("proc/uptime");
        let up = booted
            .split(' ')
            .next()
            .and_then(|seconds| seconds.parse::<f64>().ok());
        let since = self.text("proc/stat");
        let since = since
            .lines()
            .find_map(|line| line.strip_prefix("btime "))
            .and_then(|seconds| seconds.trim().parse::<f64>().ok());
        if let (Some(up), Some(since)) = (up, since) {
            let off = now.timestamp() as f64 - (since + up);
            // a tolerance of 60 s, because both are in whole seconds and queried one after the other
            if off.abs() > 60.0 {
                let text = format!("wall clock and time since the boot disagree by {off:.0} s");
                let advice = "the clock was set after the boot, or a container has another clock; frames have both times";
                findings.push(Finding::warn("clock", text, advice));
            }
        }
        findings
    }

    /// Checks the directory of sessions and its disk.
    pub(super) fn record(&self, directory: Option<&Path>) -> Vec<Finding> {
        let Some(directory) = directory else {
            return Vec::new();
        };
        let shown = directory.display();
        let path = self.path(&directory.to_string_lossy());
        let found = match std::fs::metadata(&path) {
            Ok(found) if found.is_dir() => found,
            Ok(_) => {
                let text = format!("{shown} is not a folder");
                return vec![Finding::bad("record", text, "correct [record] directory")];
            }
            Err(cause) => {
                let text = format!("{shown}: {cause}");
                let advice =
                    "the daemon creates it when it starts, as does systemd's StateDirectory=";
                return vec![Finding::warn("record", text, advice)];
            }
        };
        let owner = self.name("etc/passwd", found.uid());
        let mode = found.mode() & 0o777;
        let mut findings = vec![match () {
            () if mode & 0o002 != 0 => Finding::bad(
                "record",
                format!("everybody may write to {shown} (mode {mode:o})"),
                format!("`sudo chmod 750 {shown}`"),
            ),
            () if mode & 0o200 == 0 => Finding::bad(
                "record",
                format!("its owner {owner} may not write to {shown} (mode {mode:o})"),
                format!("`sudo chmod 750 {shown}`"),
            ),
            () => Finding::ok("record", format!("{shown} of {owner}, mode {mode:o}")),
        }];
        let mounted = self.file_system(directory);
        findings.push(match mounted.as_deref() {
            Some(kind) if NETWORK_FILE_SYSTEMS.contains(&kind) => Finding::bad(
                "disk",
                format!("{shown} is on another machine ({kind})"),
                "a frame that is acknowledged must be on a disk of this machine; export or copy closed sessions instead",
            ),
            Some(kind) if IN_MEMORY.contains(&kind) => Finding::warn(
                "disk",
                format!("{shown} is in memory ({kind}) and gone after a reboot"),
                "choose a folder on a disk",
            ),
            Some(kind) => Finding::ok("disk", format!("{shown} is on {kind}")),
            None => Finding::warn("disk", "its file system is not known", "is /proc mounted?"),
        });
        if let Ok(found) = rustix::fs::statvfs(&path) {
            findings.push(free_space(found.f_bavail.saturating_mul(found.f_frsize)));
        }
        findings
    }

    /// The type of the file system on which a path is.
    fn file_system(&self, path: &Path) -> Option<String> {
        let path = std::path::absolute(path).ok()?;
        let text = self.text("proc/mounts");
        let mounts = text.lines().filter_map(|line| {
            let mut fields = line.split(' ').skip(1);
            // /proc/mounts writes spaces in a path as \040
            Some((fields.next()?.replace("\\040", " "), fields.next()?))
        });
        // of several mounts at the same path the last one is visible
        mounts
            .filter(|(at, _)| path.starts_with(at))
            .max_by_key(|(at, _)| at.len())
            .map(|(_, kind)| kind.to_owned())
    }
}

fn free_space(free: u64) -> Finding {
    let text = format!("{:.1} GB are free", free as f64 / 1e9);
    let advice = "free some, or name another folder in [record] directory; `tactus status` shows how long the space lasts";
    match free {
        free if free < CRITICAL_SPACE => Finding::bad("disk", text, advice),
        free if free < LOW_SPACE => Finding::warn("disk", text, advice),
        _ => Finding::ok("disk", text),
    }
}

/// Serial ports and GPIO chips in the configuration, without repetition.
fn devices(wanted: &DoctorConfig) -> Vec<(&'static str, String)> {
    let mut devices = Vec::new();
    for place in [&wanted.source, &wanted.switch, &wanted.voltmeter] {
        for kind in ["serial", "gpiochip"] {
            let Some(rest) = place.address.strip_prefix(kind) else {
                continue;
            };
            let path = rest.trim_start_matches(':').split('@').next();
            let device = (kind, path.unwrap_or_default().to_owned());
            if !devices.contains(&device) {
                devices.push(device);
            }
        }
    }
    devices
}

#[cfg(test)]
mod tests;
