//! Free disk space for sessions, and how long it lasts at the rate of the running session.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use logbook::Volume;

use crate::locked::locked;

/// Free bytes of a folder's file system for unprivileged users.
///
/// # Errors
/// The error of the system.
pub(crate) fn free_bytes(folder: &Path) -> std::io::Result<u64> {
    let found = rustix::fs::statvfs(folder)?;
    Ok(found.f_bavail.saturating_mul(found.f_frsize))
}

/// Time for which a measurement is reused.
const CACHE_TIME: Duration = Duration::from_secs(5);
/// Timeout of a query to the disk.
const QUERY_TIMEOUT: Duration = Duration::from_secs(2);
/// Minimum number of frames for a rate: a file grows by pages, and this many frames fill more than ten pages.
const RATE_FRAMES: u64 = 100;

const DAY_S: f64 = 86_400.0;

/// The last measurement.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct FreeSpace {
    /// Bytes that the daemon may still write; `None` if unknown.
    pub free: Option<u64>,
    /// Bytes a day of the running session; `None` without one, or before enough frames.
    pub per_day: Option<f64>,
}

impl FreeSpace {
    /// Days until the disk is full.
    pub(crate) fn days(&self) -> Option<f64> {
        let (free, per_day) = (self.free?, self.per_day.filter(|rate| *rate > 0.0)?);
        Some(free as f64 / per_day)
    }
}

/// Queries the disk, one query at a time, and stores the start of the rate measurement.
#[derive(Debug, Default)]
pub(crate) struct Disk {
    seen: Mutex<DiskState>,
    /// Locked during a query, even if its caller has stopped waiting.
    looking: Arc<tokio::sync::Mutex<()>>,
}

#[derive(Debug, Default)]
struct DiskState {
    space: FreeSpace,
    at: Option<Duration>,
    growth: Option<Growth>,
}

/// Size of a session's file at the first measurement.
#[derive(Debug, Clone, PartialEq)]
struct Growth {
    path: PathBuf,
    first: Volume,
    at: Duration,
}

impl Growth {
    /// Bytes a day since then.
    fn per_day(&self, volume: Volume, now: Duration) -> Option<f64> {
        let frames = volume.frames.saturating_sub(self.first.frames);
        let seconds = now.saturating_sub(self.at).as_secs_f64();
        let bytes = volume.bytes.saturating_sub(self.first.bytes);
        (frames >= RATE_FRAMES && seconds > 0.0).then(|| bytes as f64 * DAY_S / seconds)
    }
}

impl Disk {
    /// The free space in `directory`, and the growth rate of the session written to `file`; `now` by the daemon's
    /// clock. If the disk does not respond within [`QUERY_TIMEOUT`], returns the last values.
    pub(crate) async fn space(
        self: &Arc<Self>,
        directory: &Path,
        file: Option<PathBuf>,
        now: Duration,
    ) -> FreeSpace {
        let look = async {
            let looking = Arc::clone(&self.looking).lock_owned().await;
            let last = locked(&self.seen).at;
            if last.is_some_and(|at| now.saturating_sub(at) < CACHE_TIME) {
                return;
            }
            let (disk, directory) = (Arc::clone(self), directory.to_owned());
            let look = tokio::task::spawn_blocking(move || {
                disk.measure(&directory, file, now);
                drop(looking);
            });
            let _ = look.await;
        };
        let _ = tokio::time::timeout(QUERY_TIMEOUT, look).await;
        locked(&self.seen).space
    }

    fn measure(&self, directory: &Path, file: Option<PathBuf>, now: Duration) {
        let free = free_bytes(directory).ok();
        let volume = file.and_then(|path| Some((logbook::volume(&path).ok()?, path)));
        let mut seen = locked(&self.seen);
        seen.at = Some(now);
        seen.space = FreeSpace {
            free,
            per_day: None,
        };
        let Some((volume, path)) = volume else {
            seen.growth = None;
            return;
        };
        match &seen.growth {
            Some(growth) if growth.path == path && growth.first.part == volume.part => {
                seen.space.per_day = growth.per_day(volume, now);
            }
            _ => {
                seen.growth = Some(Growth {
                    path,
                    first: volume,
                    at: now,
                });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::monitoring::disk::*;

    #[test]
    fn growth_rate_and_days_need_enough_frames() {
        let growth = Growth {
            path: PathBuf::from("s"),
            first: Volume {
                part: 1,
                bytes: 90_000,
                frames: 10,
            },
            at: Duration::from_secs(100),
        };
        let at = |frames, bytes, seconds| {
            let volume = Volume {
                part: 1,
                bytes,
                frames,
            };
            growth.per_day(volume, Duration::from_secs(seconds))
        };
        assert_eq!(at(109, 200_000, 200), None);
        assert_eq!(at(110, 190_000, 100), None);
        let rate = at(110, 190_000, 200).unwrap();
        assert!((rate - 1_000.0 * 86_400.0).abs() < 1e-6, "{rate}");
        let space = FreeSpace {
            free: Some(864_000_000),
            per_day: Some(rate),
        };
        assert!((space.days().unwrap() - 10.0).abs() < 1e-12);
        let unknown = FreeSpace {
            per_day: None,
            ..space
        };
        assert_eq!(unknown.days(), None);
    }

    #[tokio::test]
    async fn free_bytes_are_those_of_the_file_system() {
        let folder = tempfile::tempdir().unwrap();
        let disk = Arc::new(Disk::default());
        let reported = rustix::fs::statvfs(folder.path()).unwrap();
        let space = disk.space(folder.path(), None, Duration::ZERO).await;
        let free = space.free.unwrap() as f64;
        let all = (reported.f_blocks * reported.f_frsize) as f64;
        assert!(free > 0.0 && free <= all, "{free} of {all}");
        // the free space of a missing directory is unknown; the last values are reused before it is queried
        let nowhere = folder.path().join("gone");
        let again = disk.space(&nowhere, None, Duration::from_secs(1)).await;
        assert_eq!(again, space);
        let later = disk.space(&nowhere, None, Duration::from_secs(9)).await;
        assert_eq!(later, FreeSpace::default());
    }
}
