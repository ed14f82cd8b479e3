//! Damage to the bytes of a file.

use crate::{Dice, Files};

/// Changes one of the files and returns a description. The index of the journal stays as it is: each open rebuilds it.
pub fn mutate(files: &mut Files, dice: &mut Dice) -> String {
    let names: Vec<&'static str> = files.keys().copied().filter(|end| *end != "-shm").collect();
    let name = names[dice.throw(names.len())];
    let bytes = files.get_mut(name).expect("one of them");
    let size = bytes.len();
    let at = place(bytes, dice);
    let what = match dice.throw(8) {
        0..=2 => {
            let bit = dice.throw(8);
            bytes[at] ^= 1 << bit;
            format!("bit {bit} flipped")
        }
        3 => {
            let end = (at + 1 + dice.throw(600)).min(size);
            bytes[at..end].fill(0);
            format!("zeros up to {end}")
        }
        4 => {
            let end = (at + 1 + dice.throw(9)).min(size);
            for byte in &mut bytes[at..end] {
                *byte = dice.throw(256) as u8;
            }
            format!("other bytes up to {end}")
        }
        5 => {
            bytes.truncate(if dice.throw(8) == 0 { 0 } else { at });
            format!("cut off, {} left", bytes.len())
        }
        6 => {
            // a sector or page that is copied to another place, or swapped with another
            let unit = [512, 4096, 16_384][dice.throw(3)].min(size / 2);
            let [from, to] = [dice.throw(size / unit), dice.throw(size / unit)].map(|n| n * unit);
            let (here, there) = (
                bytes[from..from + unit].to_vec(),
                bytes[to..to + unit].to_vec(),
            );
            bytes[to..to + unit].copy_from_slice(&here);
            let swapped = dice.throw(2) == 0;
            if swapped {
                bytes[from..from + unit].copy_from_slice(&there);
            }
            format!("{unit} bytes of {from} over {to}, swapped: {swapped}")
        }
        _ => {
            bytes.drain(at..(at + 1 + dice.throw(40)).min(size));
            format!("{} bytes taken out", size - bytes.len())
        }
    };
    format!("file{name} of {size} bytes at {at}: {what}")
}

/// A position with a nonzero byte; every fourth time in the first page, which describes the file.
fn place(bytes: &[u8], dice: &mut Dice) -> usize {
    let range = match dice.throw(4) {
        0 => bytes.len().min(512),
        _ => bytes.len(),
    };
    let wanted = dice.throw(range);
    let later = bytes[wanted..].iter().position(|byte| *byte != 0);
    later.map_or(wanted, |later| wanted + later)
}
