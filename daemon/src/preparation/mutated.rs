//! Configurations with random changes: each is either rejected with its file and the reason, or accepted and written
//! out in a form that parses to the same configuration.

use std::path::Path;

use crate::preparation::prepare;

const SHIPPED: &str = include_str!("../../../config.toml");

/// Numbers in a fixed order (SplitMix64), so that a failure can be reproduced with its seed.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    fn below(&mut self, count: usize) -> usize {
        (self.next() % count.max(1) as u64) as usize
    }
}

/// The shipped file for a small tank: accepted configurations are prepared, which takes a thousandth of the time for a
/// tank, compared with a sheet.
fn small() -> String {
    SHIPPED
        .replace("preset = \"paper-sheet\"", "preset = \"disc-tank\"")
        .replace("# [geometry.disc-tank]", "[geometry.disc-tank]")
        .replace("# electrodes = 16", "electrodes = 26\nfineness = 0.25")
}

const VALUES: [&str; 20] = [
    "0",
    "-1",
    "1",
    "2.5",
    "1e308",
    "-1e308",
    "1e-300",
    "nan",
    "inf",
    "9223372036854775807",
    "18446744073709551616",
    "true",
    "\"\"",
    "\"x\"",
    "\"\\u001b[2J\\n\"",
    "[]",
    "[1, 2]",
    "{}",
    "'",
    "1970-01-01",
];

fn mutated(text: &str, random: &mut Random) -> Vec<u8> {
    let mut lines: Vec<Vec<u8>> = text.lines().map(|line| line.as_bytes().to_vec()).collect();
    for _ in 0..=random.below(3) {
        // in three of four cases a line with a key, not a comment
        let keys: Vec<usize> = (0..lines.len())
            .filter(|&at| lines[at].contains(&b'=') && !lines[at].starts_with(b"#"))
            .collect();
        let at = match random.below(4) {
            0 => random.below(lines.len()),
            _ => keys.get(random.below(keys.len())).copied().unwrap_or(0),
        };
        let Some(line) = lines.get_mut(at) else {
            continue;
        };
        match random.below(7) {
            0..3 => {
                let value = line.iter().position(|byte| *byte == b'=');
                line.truncate(value.map_or(0, |at| at + 1));
                line.extend(VALUES[random.below(VALUES.len())].bytes());
            }
            3 if line.starts_with(b"# ") => drop(line.drain(..2)),
            3 => line.clear(),
            4 => {
                let copy = line.clone();
                lines.push(copy);
            }
            5 if !line.is_empty() => {
                let at = random.below(line.len());
                line[at] = random.next() as u8;
            }
            _ => {
                let at = random.below(line.len());
                line.truncate(at);
            }
        }
    }
    lines.join(&b'\n')
}

fn refused_with_its_file(path: &Path, problems: &[config::problems::Problem], seed: u64) {
    assert!(!problems.is_empty(), "{seed}");
    for problem in problems {
        assert_eq!(problem.file, path, "{seed}");
        assert!(!problem.text.is_empty(), "{seed}");
    }
}

#[test]
fn a_mutated_configuration_is_refused_or_understood() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("config.toml");
    let again = folder.path().join("again.toml");
    let text = small();
    std::fs::write(&path, &text).unwrap();
    assert!(prepare(&path).is_ok());
    let count = std::env::var("TACTUS_MUTATIONS").map_or(200, |text| text.parse().unwrap());
    let mut understood = 0;
    for seed in 0..count {
        std::fs::write(&path, mutated(&text, &mut Random(seed))).unwrap();
        match prepare(&path) {
            Ok(prepared) => {
                understood += 1;
                // the output of `--print-config` is the configuration
                std::fs::write(&again, &prepared.setup.config_toml).unwrap();
                let (_, config) = crate::preparation::load(&again).unwrap_or_else(|problems| {
                    panic!("{seed}: {problems:?}");
                });
                assert_eq!(
                    toml::to_string_pretty(&config).unwrap(),
                    toml::to_string_pretty(&prepared.setup.config).unwrap(),
                    "{seed}"
                );
            }
            Err(problems) => refused_with_its_file(&path, &problems, seed),
        }
    }
    // some are accepted and some rejected, so that both results are tested
    assert!(understood > 0 && understood < count, "{understood}");
}
