//! Checks a valid configuration against this machine: the notification program, the folder of the record, and the
//! duration of a frame. `tactusd --check` prints errors and warnings; nothing is changed.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use config::problems::Problem;
use rustix::fs::{Access, access};
use rustix::io::Errno;

use super::{FramesFrom, Prepared};
use crate::monitoring::disk::free_bytes;

impl Prepared {
    /// Why no user could record in the configured folder, with the position in the file.
    pub(crate) fn unusable_record(&self) -> Option<Problem> {
        no_folder(&self.setup.record_directory).map(|text| self.record_problem(text))
    }

    /// Why this user lacks the permission to record in the configured folder, with the position in the file. This is
    /// not an error of the configuration: the disk may be mounted later.
    pub(crate) fn closed_record(&self) -> Option<Problem> {
        let (cause, text) = not_writable(&self.setup.record_directory)?;
        (cause == Errno::ACCESS).then(|| self.record_problem(text))
    }

    fn record_problem(&self, text: String) -> Problem {
        self.source.problem("record.directory", text)
    }

    /// Settings that will not work on this machine for this user, one sentence each.
    pub(crate) fn machine_warnings(&self) -> Vec<String> {
        let config = &self.setup.config;
        let notify = config.notify.command.first().map(Path::new);
        let mut found: Vec<String> = notify.and_then(program).into_iter().collect();
        found.extend(record(
            &self.setup.record_directory,
            config.record.warn_below_mb.max(config.record.reserve_mb),
        ));
        let frame_s = match &self.frames {
            FramesFrom::Rig(rig) => Some(rig.mean_duration().as_secs_f64()),
            FramesFrom::Recording { .. } => None,
        };
        if let (Some(every_s), Some(frame_s)) = (config.schedule.every_s, frame_s)
            && every_s < frame_s
        {
            found.push(format!(
                "schedule.every_s is {every_s}, but a frame takes {frame_s:.2} s: frames will come back to back; lengthen it, or \
                 shorten the frame (`tactusd --plan` shows its parts)"
            ));
        }
        found
    }
}

/// Why the program of `[notify]` cannot run.
fn program(path: &Path) -> Option<String> {
    let shown = path.display();
    match std::fs::metadata(path) {
        Err(cause) => Some(format!(
            "notify.command: {shown}: {cause}; nobody would be notified"
        )),
        Ok(found) if !found.is_file() || found.permissions().mode() & 0o111 == 0 => Some(format!(
            "notify.command: {shown} is not an executable file; nobody would be notified (`sudo chmod 755 {shown}`)"
        )),
        Ok(_) => None,
    }
}

/// The folder, or its nearest parent that exists. The daemon creates a missing folder.
fn existing(folder: &Path) -> Option<&Path> {
    folder.ancestors().find(|folder| folder.exists())
}

/// Why the folder can neither be used nor created.
fn no_folder(folder: &Path) -> Option<String> {
    let there = existing(folder)?;
    (!there.is_dir()).then(|| {
        format!(
            "{} is not a folder, so nothing can be recorded in {}; name another folder",
            there.display(),
            folder.display()
        )
    })
}

/// Why this user cannot write in the folder.
fn not_writable(folder: &Path) -> Option<(Errno, String)> {
    let there = existing(folder)?;
    let cause = access(there, Access::WRITE_OK | Access::EXEC_OK).err()?;
    let text = format!(
        "this user cannot write in {}: {cause}; run tactusd as the user who owns it (`sudo -u tactusd tactusd --check` checks \
         as the daemon's user), or name another folder",
        there.display()
    );
    Some((cause, text))
}

/// Why this user cannot record in the folder, or only for a short time.
fn record(folder: &Path, wanted_mb: u64) -> Option<String> {
    if let Some((_, text)) = not_writable(folder) {
        return Some(format!("record.directory: {text}"));
    }
    let shown = folder.display();
    match free_bytes(existing(folder)?) {
        Err(cause) => Some(format!("record.directory: {shown}: {cause}")),
        Ok(free) if free / 1_000_000 < wanted_mb => Some(format!(
            "record.directory: {} MB are free in {shown}, {wanted_mb} MB are wanted (record.warn_below_mb, record.reserve_mb)",
            free / 1_000_000
        )),
        Ok(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_that_cannot_run_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mail");
        assert!(program(&path).unwrap().contains("nobody would be notified"));
        std::fs::write(&path, "").unwrap();
        assert!(program(&path).unwrap().contains("chmod 755"));
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
        assert_eq!(program(&path), None);
    }

    #[test]
    fn a_record_without_space_or_folder_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let not_yet = folder.path().join("a/b");
        assert_eq!(record(&not_yet, 0), None);
        let text = record(&not_yet, u64::MAX).unwrap();
        assert!(text.contains("MB are free"), "{text}");
        std::fs::write(folder.path().join("a"), "").unwrap();
        let text = no_folder(&not_yet).unwrap();
        assert!(text.contains("is not a folder"), "{text}");
    }

    #[test]
    fn a_period_too_short_for_zero_current_frames_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.toml");
        let prepared = |every_s: f64| {
            let text = format!(
                "[geometry]\npreset = \"disc-tank\"\n[geometry.disc-tank]\nelectrodes = 16\n[survey]\nzero_every = 1\n\
                 [record]\ndirectory = \"state\"\nwarn_below_mb = 0\nreserve_mb = 0\n[schedule]\nevery_s = {every_s:?}\n"
            );
            std::fs::write(&path, text).unwrap();
            crate::preparation::prepare(&path).unwrap_or_else(|problems| panic!("{problems:?}"))
        };
        let FramesFrom::Rig(rig) = prepared(1000.0).frames else {
            panic!("it is a rig");
        };
        // each frame has a zero-current frame before it, of the same duration
        let frame_s = rig.plan.duration(&rig.timing).as_secs_f64();
        let short = prepared(1.5 * frame_s).machine_warnings().join("\n");
        assert!(short.contains("schedule.every_s"), "{short}");
        let enough = prepared(2.1 * frame_s).machine_warnings().join("\n");
        assert!(!enough.contains("schedule.every_s"), "{enough}");
    }
}
