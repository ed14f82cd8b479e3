//! Checks a valid configuration against this machine: the notification program, the folder of the record, and the
//! duration of a frame. `tactusd --check` prints the warnings; nothing is changed.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use rustix::fs::{Access, access};

use super::{FramesFrom, Prepared};
use crate::monitoring::disk::free_bytes;

impl Prepared {
    /// Settings that will not work on this machine for this user, a sentence each.
    pub(crate) fn machine_warnings(&self) -> Vec<String> {
        let config = &self.setup.config;
        let notify = config.notify.command.first().map(Path::new);
        let mut found: Vec<String> = notify.and_then(program).into_iter().collect();
        found.extend(record(
            &self.setup.record_directory,
            config.record.warn_below_mb.max(config.record.reserve_mb),
        ));
        let frame_s = match &self.frames {
            FramesFrom::Rig(rig) => Some(rig.plan.duration(&rig.timing).as_secs_f64()),
            FramesFrom::Recording { .. } => None,
        };
        if let (Some(every_s), Some(frame_s)) = (config.schedule.every_s, frame_s)
            && every_s < frame_s
        {
            found.push(format!(
                "schedule.every_s is {every_s}, but a frame takes {frame_s:.2} s: frames will come back to back; lengthen it, or \
                 shorten the frame (`tactusd --plan` says what takes long)"
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
            "notify.command: {shown} is no executable file; nobody would be notified (`sudo chmod 755 {shown}`)"
        )),
        Ok(_) => None,
    }
}

/// Why nothing could be recorded in this folder, or not for long. The daemon creates a missing folder.
fn record(folder: &Path, wanted_mb: u64) -> Option<String> {
    let there = folder.ancestors().find(|folder| folder.exists())?;
    let shown = folder.display();
    if !there.is_dir() {
        return Some(format!(
            "record.directory: {} is no folder, so {shown} cannot be made",
            there.display()
        ));
    }
    if access(there, Access::WRITE_OK | Access::EXEC_OK).is_err() {
        return Some(format!(
            "record.directory: this user cannot write in {}; run the check as the daemon's user (`sudo -u tactusd tactusd --check`), \
             or name another folder",
            there.display()
        ));
    }
    match free_bytes(there) {
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
        let text = record(&not_yet, 0).unwrap();
        assert!(text.contains("is no folder"), "{text}");
    }
}
