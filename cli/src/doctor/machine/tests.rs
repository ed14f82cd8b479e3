use std::os::unix::fs::{PermissionsExt, symlink};

use super::super::CheckResult;
use super::*;

/// A simulated machine with an ordinary user 1000 (ada) and the daemon's own user.
fn machine(root: &Path, groups: &[u32]) -> Machine {
    let write = |name: &str, text: &str| {
        let path = root.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    };
    write(
        "etc/passwd",
        "root:x:0:0::/r:/bin/sh\ntactusd:x:990:990::/var/lib/tactus:/usr/sbin/nologin\nada:x:1000:1000::/a:/bin/sh\n",
    );
    write(
        "etc/group",
        "root:x:0:\ntactus:x:991:tactusd,bob\ndialout:x:20:bob\nada:x:1000:\n",
    );
    write(
        "proc/mounts",
        "/dev/a / ext4 rw 0 0\ntmpfs /run tmpfs rw 0 0\nlab:/x /srv/lab\\040one nfs4 rw 0 0\n/dev/b /srv ext4 rw 0 0\n",
    );
    Machine {
        root: root.to_owned(),
        user: 1000,
        groups: groups.to_vec(),
    }
}

fn wanting(toml: &str) -> DoctorConfig {
    toml::from_str(toml).unwrap()
}

fn verdicts(findings: &[Finding]) -> Vec<(&'static str, CheckResult)> {
    findings
        .iter()
        .map(|finding| (finding.check, finding.verdict))
        .collect()
}

#[test]
fn permitted_users_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let of = |groups: &[u32]| machine(folder.path(), groups).users(&DoctorConfig::default());
    assert_eq!(
        verdicts(&of(&[1000, 991])),
        [
            ("user", CheckResult::Ok),
            ("daemon's user", CheckResult::Ok)
        ]
    );
    let outside = of(&[1000]);
    assert_eq!(outside[0].verdict, CheckResult::Bad);
    assert!(
        outside[0]
            .advice
            .as_ref()
            .unwrap()
            .contains("usermod -aG tactus ada")
    );
    let root = Machine {
        user: 0,
        ..machine(folder.path(), &[])
    };
    assert_eq!(
        root.users(&DoctorConfig::default())[0].verdict,
        CheckResult::Ok
    );
    let mut bob = machine(folder.path(), &[1001]);
    bob.user = 1001;
    let passwd = std::fs::read_to_string(folder.path().join("etc/passwd")).unwrap();
    let passwd = passwd + "bob:x:1001:1001::/b:/bin/sh\n";
    std::fs::write(folder.path().join("etc/passwd"), passwd).unwrap();
    let findings = bob.users(&DoctorConfig::default());
    assert_eq!(findings[0].verdict, CheckResult::Warn, "{findings:?}");
    assert!(findings[0].advice.as_ref().unwrap().contains("log out"));
    // for a serial port the daemon must be in the group dialout
    let serial = wanting("[switch]\naddress = \"serial:/dev/ttyUSB0@9600\"\n");
    let findings = bob.users(&serial);
    assert_eq!(findings[1].verdict, CheckResult::Bad, "{findings:?}");
}

#[test]
fn devices_of_the_configuration_are_looked_at() {
    let folder = tempfile::tempdir().unwrap();
    let machine = machine(folder.path(), &[1000, 20]);
    let by_id = folder.path().join("dev/serial/by-id");
    std::fs::create_dir_all(&by_id).unwrap();
    let wanted = wanting(
        "[source]\naddress = \"serial:/dev/ttyUSB0@9600\"\n[switch]\naddress = \"gpiochip:/dev/gpiochip0\"\n\
         [voltmeter]\naddress = \"tcp:h:5025\"\n",
    );
    let found = machine.devices(&wanted);
    assert_eq!(verdicts(&found), [("device", CheckResult::Bad); 2]);
    assert!(found[0].text.contains("/dev/ttyUSB0 is not there"));
    std::fs::write(folder.path().join("dev/ttyUSB0"), "").unwrap();
    symlink("../../ttyUSB0", by_id.join("usb-Tactus_mux_1234")).unwrap();
    let found = machine.devices(&wanted);
    assert!(
        found[0].text.contains("not a character device"),
        "{found:?}"
    );
    assert!(
        found[1]
            .advice
            .as_ref()
            .unwrap()
            .contains("/dev/serial/by-id/usb-Tactus_mux_1234"),
        "{found:?}"
    );
    // a device node that exists on every machine
    let here = Machine {
        root: PathBuf::from("/"),
        ..machine
    };
    assert_eq!(here.device("serial", "/dev/null").verdict, CheckResult::Ok);
}

#[test]
fn folder_and_disk_of_the_record_are_judged() {
    let folder = tempfile::tempdir().unwrap();
    let machine = machine(folder.path(), &[1000]);
    assert!(machine.record(None).is_empty());
    let state = folder.path().join("var/lib/tactus");
    let look = || machine.record(Some(Path::new("/var/lib/tactus")));
    assert_eq!(verdicts(&look()), [("record", CheckResult::Warn)]);
    std::fs::create_dir_all(&state).unwrap();
    for (mode, verdict) in [
        (0o750, CheckResult::Ok),
        (0o777, CheckResult::Bad),
        (0o550, CheckResult::Bad),
    ] {
        std::fs::set_permissions(&state, std::fs::Permissions::from_mode(mode)).unwrap();
        assert_eq!(look()[0].verdict, verdict, "{mode:o}");
    }
    assert_eq!(look()[1].text, "/var/lib/tactus is on ext4");
    for (place, kind) in [
        ("/", Some("ext4")),
        ("/run/tactus", Some("tmpfs")),
        ("/runner", Some("ext4")),
        ("/srv/lab one/sessions", Some("nfs4")),
    ] {
        assert_eq!(
            machine.file_system(Path::new(place)).as_deref(),
            kind,
            "{place}"
        );
    }
    for (place, verdict) in [
        ("/run/tactus", CheckResult::Warn),
        ("/srv/lab one/x", CheckResult::Bad),
    ] {
        std::fs::create_dir_all(folder.path().join(place.trim_start_matches('/'))).unwrap();
        let found = machine.record(Some(Path::new(place)));
        assert_eq!(found[1].verdict, verdict, "{found:?}");
    }
    for (free, verdict) in [
        (CRITICAL_SPACE - 1, CheckResult::Bad),
        (CRITICAL_SPACE, CheckResult::Warn),
        (LOW_SPACE, CheckResult::Ok),
    ] {
        assert_eq!(free_space(free).verdict, verdict);
    }
}

#[test]
fn missing_parts_of_an_installation_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let machine = machine(folder.path(), &[1000]);
    let wanted = wanting("[bus]\nsystem = true\n[notify]\ncommand = [\"/usr/lib/tactus/mail\"]\n");
    let found = machine.installed(&wanted);
    assert_eq!(
        verdicts(&found),
        [
            ("bus policy", CheckResult::Bad),
            ("polkit", CheckResult::Warn),
            ("notify", CheckResult::Bad)
        ]
    );
    for file in [
        "usr/share/dbus-1/system.d/org.tactus.Tactus1.conf",
        "usr/share/polkit-1/actions/org.tactus.Tactus1.policy",
        "usr/lib/tactus/mail",
    ] {
        let path = folder.path().join(file);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, "").unwrap();
    }
    let found = machine.installed(&wanted);
    assert!(
        found[2].text.contains("is not an executable file"),
        "{found:?}"
    );
    let mail = folder.path().join("usr/lib/tactus/mail");
    std::fs::set_permissions(mail, std::fs::Permissions::from_mode(0o755)).unwrap();
    let found = machine.installed(&wanted);
    assert!(
        found.iter().all(|one| one.verdict == CheckResult::Ok),
        "{found:?}"
    );
    let found = machine.installed(&DoctorConfig::default());
    assert_eq!(verdicts(&found), [("notify", CheckResult::Warn)]);
    assert!(found[0].text.contains("nobody is notified"), "{found:?}");
}

#[test]
fn a_clock_that_cannot_be_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let machine = machine(folder.path(), &[]);
    let at = |text: &str| text.parse::<DateTime<Utc>>().unwrap();
    assert!(machine.clock(at("2026-11-22T12:00:00Z")).is_empty());
    assert_eq!(
        machine.clock(at("1970-01-01T00:10:00Z"))[0].verdict,
        CheckResult::Bad
    );
    let now = at("2026-11-22T12:00:00Z");
    let booted = now.timestamp() - 1000;
    std::fs::write(
        folder.path().join("proc/stat"),
        format!("cpu 1\nbtime {booted}\n"),
    )
    .unwrap();
    std::fs::write(folder.path().join("proc/uptime"), "1000.50 1.0\n").unwrap();
    assert!(machine.clock(now).is_empty());
    let later = now + std::time::Duration::from_secs(600);
    assert_eq!(machine.clock(later)[0].verdict, CheckResult::Warn);
}

#[test]
fn a_configuration_is_read_for_what_concerns_the_machine() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("config.toml");
    assert_eq!(wanted(&file).unwrap_err().verdict, CheckResult::Warn);
    std::fs::write(&file, "[record\n").unwrap();
    assert_eq!(wanted(&file).unwrap_err().verdict, CheckResult::Bad);
    std::fs::write(
        &file,
        "[survey]\nnplc = 1.0\n[record]\ndirectory = \"state\"\n",
    )
    .unwrap();
    let read = wanted(&file).unwrap();
    assert_eq!(read.record.directory, Some(folder.path().join("state")));
    // with a path relative to the current folder, as on a command line
    let here = std::env::current_dir().unwrap();
    let up: PathBuf = here.components().skip(1).map(|_| "..").collect();
    let read = wanted(&up.join(file.strip_prefix("/").unwrap())).unwrap();
    assert!(read.record.directory.unwrap().is_absolute());
}
