//! Possible contents of a disk after a power cut: for each file everything synced, and of the writes since then all,
//! none, any subset, or one torn between two sectors of 512 bytes.

use std::collections::BTreeMap;
use std::path::Path;

use crate::vfs::{Mark, Operation, Step};

const SECTOR: usize = 512;

#[derive(Debug, Clone, Default)]
struct File {
    /// Durable content; `None` if the file does not exist.
    durable: Option<Vec<u8>>,
    /// Operations since the last sync: writes, truncations, a deletion.
    since: Vec<Operation>,
    made: bool,
}

/// The disk as it would be after some of the steps of a recording.
#[derive(Debug, Clone, Default)]
pub struct Disk {
    files: BTreeMap<String, File>,
    /// What had been acknowledged to the writer.
    pub reported: Mark,
}

/// Which writes since the last sync are lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lost {
    /// None: the process was killed, but the power stayed on.
    Nothing,
    /// All of them.
    Everything,
    /// All but the first sectors (this many) of the last write.
    TornAfter(usize),
    /// A pseudo-random subset by this seed; some writes are torn.
    Some(u64),
}

impl Disk {
    pub fn take(&mut self, step: &Step) {
        if let Operation::Mark(mark) = step.operation {
            self.reported = mark;
            return;
        }
        let file = self.files.entry(step.file.clone()).or_default();
        match &step.operation {
            Operation::Open => {
                if !file.made {
                    file.made = true;
                    file.durable = Some(Vec::new());
                    file.since.clear();
                }
            }
            Operation::Sync => {
                let since = std::mem::take(&mut file.since);
                let mut content = file.durable.take();
                for operation in &since {
                    apply(&mut content, operation, usize::MAX);
                }
                file.durable = content;
            }
            Operation::Delete { lasting } => {
                file.since.push(step.operation.clone());
                file.made = false;
                if *lasting {
                    file.durable = None;
                    file.since.clear();
                }
            }
            operation => file.since.push(operation.clone()),
        }
    }

    /// Sectors of the last write, if the last step was one.
    pub fn last_sectors(&self, step: &Step) -> usize {
        match &step.operation {
            Operation::Write { offset, bytes } => {
                (offset + bytes.len()).div_ceil(SECTOR) - offset / SECTOR
            }
            _ => 0,
        }
    }

    /// Writes the files of one possible disk content to a folder.
    pub fn write_to(&self, folder: &Path, lost: Lost, last: &str) {
        let mut dice = match lost {
            Lost::Some(seed) => seed | 1,
            _ => 1,
        };
        let mut throw = |sides: u64| {
            dice ^= dice << 13;
            dice ^= dice >> 7;
            dice ^= dice << 17;
            dice % sides
        };
        for (name, file) in &self.files {
            let mut content = file.durable.clone();
            let count = file.since.len();
            for (place, operation) in file.since.iter().enumerate() {
                let sectors = match lost {
                    Lost::Nothing => usize::MAX,
                    Lost::Everything => 0,
                    Lost::TornAfter(sectors) if name == last && place + 1 == count => sectors,
                    Lost::TornAfter(_) => usize::MAX,
                    Lost::Some(_) => match throw(3) {
                        0 => 0,
                        1 => usize::MAX,
                        _ => throw(40) as usize,
                    },
                };
                apply(&mut content, operation, sectors);
            }
            if let Some(content) = content {
                std::fs::write(folder.join(name), content).expect("an image is written");
            }
        }
    }
}

/// Applies an operation; of a write only the first `sectors` sectors.
fn apply(content: &mut Option<Vec<u8>>, operation: &Operation, sectors: usize) {
    match operation {
        Operation::Write { offset, bytes } if sectors > 0 => {
            let end = (offset / SECTOR)
                .saturating_add(sectors)
                .saturating_mul(SECTOR);
            let count = bytes.len().min(end.saturating_sub(*offset));
            let content = content.get_or_insert_default();
            if content.len() < offset + count {
                content.resize(offset + count, 0);
            }
            content[*offset..offset + count].copy_from_slice(&bytes[..count]);
        }
        Operation::Truncate(size) if sectors > 0 => {
            content.get_or_insert_default().resize(*size, 0)
        }
        Operation::Delete { .. } if sectors > 0 => *content = None,
        _ => {}
    }
}
