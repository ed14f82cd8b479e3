//! A private filesystem for a test, in an image on a loop device, that can be made to fail.

use std::path::{Path, PathBuf};
use std::process::Command;

/// A separate filesystem (ext4) in an image, on a loop device.
pub struct Disk {
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

impl Drop for Disk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(&self.folder).output();
    }
}

impl Disk {
    /// Creates the image and mounts it; the folder must not exist.
    pub fn mounted(image: PathBuf, folder: PathBuf) -> Self {
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
    pub fn turn_read_only(&self) {
        let device = run("findmnt", &["-n", "-o", "SOURCE", self.folder()]);
        let device = Path::new(device.trim()).file_name().unwrap();
        let trigger = Path::new("/sys/fs/ext4").join(device);
        std::fs::write(trigger.join("trigger_fs_error"), "1").unwrap();
    }

    /// Checks the filesystem and mounts it again, as an administrator does.
    pub fn repair(&self) {
        run("umount", &[self.folder()]);
        // 1: errors were corrected
        let checked = Command::new("e2fsck").args(["-fy", self.image()]).status();
        assert!(matches!(checked.unwrap().code(), Some(0 | 1)));
        self.mount();
    }
}

/// Whether a filesystem can be created and mounted here.
pub fn has_disks(folder: &Path) -> bool {
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
