//! An uploader's machine: record, store and configuration.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use logbook::{SessionHeader, SessionWriter, append_quantities};
use survey::{Protocol, Reading, Volts};
use tempfile::TempDir;

use crate::frames::{at, taken};
use crate::server::{DATABASE, OWNER, PASSWORD, Server, wait_until};

pub struct Site {
    pub folder: TempDir,
    pub name: String,
}

impl Site {
    /// A site registered in the catalogue, with its role.
    pub fn added(server: &Server, name: &str) -> Self {
        let site = Self::new(server, name);
        server.add_role(name);
        let done = site.owner(server, &["add-site", name, "--role", name]);
        assert!(done.status.success(), "{done:?}");
        site
    }

    /// A site that is not registered in the catalogue.
    pub fn new(server: &Server, name: &str) -> Self {
        let site = Self {
            folder: tempfile::tempdir().unwrap(),
            name: name.to_owned(),
        };
        std::fs::create_dir(site.record()).unwrap();
        std::fs::create_dir(site.store()).unwrap();
        site.write_private("password", PASSWORD);
        site.configure(
            &format!(
                "host={} port={} dbname={DATABASE} user={name}",
                server.socket().display(),
                server.port()
            ),
            "",
        );
        site
    }

    pub fn record(&self) -> PathBuf {
        self.folder.path().join("record")
    }

    pub fn store(&self) -> PathBuf {
        self.folder.path().join("store")
    }

    pub fn write_private(&self, name: &str, text: &str) {
        use std::os::unix::fs::PermissionsExt;
        let path = self.folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        std::fs::set_permissions(path, PermissionsExt::from_mode(0o600)).unwrap();
    }

    /// Writes the configuration.
    pub fn configure(&self, dsn: &str, more: &str) {
        let text = format!(
            "[record]\ndirectory = \"record\"\n[archive]\nsite = \"{}\"\ndaq = \"bed3\"\nstore = \"store\"\ndsn = \"{dsn}\"\n\
             password_file = \"password\"\nevery_s = 1.0\n{more}",
            self.name
        );
        std::fs::write(self.folder.path().join("config.toml"), text).unwrap();
    }

    pub fn command(&self, words: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_tactus-archive"));
        command
            .args(words)
            .arg("--config")
            .arg(self.folder.path().join("config.toml"));
        command
    }

    pub fn run(&self, words: &[&str]) -> Output {
        self.command(words).output().expect("the program runs")
    }

    /// Runs the program, which must succeed, and returns its output.
    pub fn done(&self, words: &[&str]) -> String {
        let output = self.run(words);
        let error = String::from_utf8_lossy(&output.stderr);
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{words:?}: {text}{error}");
        text
    }

    /// Runs the program, which must fail with this exit code, and returns standard error.
    pub fn refused(&self, words: &[&str], code: i32) -> String {
        let output = self.run(words);
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{words:?}: {error}");
        error
    }

    /// Runs as the owner of the catalogue.
    pub fn owner(&self, server: &Server, words: &[&str]) -> Output {
        let text = format!(
            "[archive]\nsite = \"{}\"\nstore = \"store\"\ndsn = \"host={} port={} dbname={DATABASE} user={OWNER}\"\n",
            self.name,
            server.socket().display(),
            server.port()
        );
        let path = self.folder.path().join("owner.toml");
        std::fs::write(&path, text).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_tactus-archive"));
        command.args(words).arg("--config").arg(path);
        command.output().expect("the program runs")
    }

    /// All files in the store.
    pub fn stored(&self) -> Vec<PathBuf> {
        let mut files = Vec::new();
        let mut open = vec![self.store()];
        while let Some(folder) = open.pop() {
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                match path.is_dir() {
                    true => open.push(path),
                    false => files.push(path),
                }
            }
        }
        files.sort();
        files
    }

    /// Records a closed session; each part has three frames, four events and three minutes of quantities.
    pub fn record_session(&self, id: &str, parts: u64) {
        let mut writer = begun(&self.record(), id, 1);
        for part in 2..=parts {
            writer.roll(at(10 * part as i64)).unwrap();
            more_frames(&mut writer, part);
        }
        for minute in 1..=3 * parts {
            add_minute(&self.record(), id, minute);
        }
        writer.close(at(3600), "asked to stop").unwrap();
        self.merge_journals();
    }

    /// Merges the journals of closed parts into their files, as the daemon does every minute: if a part is read while
    /// it is closed, its last rows stay in its journal.
    pub fn merge_journals(&self) {
        let is_merged = || {
            logbook::merge_closed(self.record()).unwrap();
            let mut files = std::fs::read_dir(self.record()).unwrap();
            !files.any(|file| file.unwrap().path().to_string_lossy().ends_with("-wal"))
        };
        wait_until(is_merged, || "a journal stays".to_owned());
    }
}

/// Appends a line of quantities.
pub fn add_minute(record: &Path, id: &str, minute: u64) {
    let begin = 1_800_000_000 + 60 * minute;
    let json = format!(
        "{{\"begin_s\":{begin},\"of\":\"kpa\",\"regions\":[{{\"name\":\"sheet\",\"values\":{{\"peak\":[1.0,2.0,{minute}.5,60,59],\"area\":[3.0,4.0,5.0,60,60],\"known\":[0.0,0.75,1.0,60,60]}}}}]}}"
    );
    append_quantities(record, id, &json).unwrap();
}

/// A session in progress, with the frames of this part.
pub fn begun(record: &Path, id: &str, part: u64) -> SessionWriter {
    let header = SessionHeader::new(id, at(0), Protocol::sheffield(8).unwrap());
    let mut writer = SessionWriter::create(record, &header).unwrap();
    more_frames(&mut writer, part);
    writer
}

/// Appends the three frames and four events of a part.
pub fn more_frames(writer: &mut SessionWriter, part: u64) {
    let protocol = Protocol::sheffield(8).unwrap();
    for number in 3 * part - 2..=3 * part {
        let readings = (0..protocol.len())
            .map(|k| Reading::Ok(Volts(1e-3 * (number as f64 + k as f64).sin())));
        let frame = taken(&protocol, number, number as i64, readings.collect());
        writer.append(&frame, None).unwrap();
        writer
            .event(at(number as i64), "note", "zero \0 byte")
            .unwrap();
    }
    writer
        .event(at(3 * part as i64), "alarm-active", "heel: ppi is 9 kPa")
        .unwrap();
}
