//! `tactus-lab dataset`.

use eit::{Preset, TrainingSettings};
use studies::{Failure, progress};
use survey::Amps;
use training::dataset::make_shard;

use crate::args::DatasetOptions;
use crate::geometry;
use crate::output::print_line;

/// Makes or resumes one shard.
pub(crate) fn dataset(options: &DatasetOptions) -> Result<(), Failure> {
    let case = match &options.case {
        Some(folder) => geometry::read(folder)?,
        None => geometry::case(&Preset::default(), Amps(1e-3))?,
    };
    let mut settings: TrainingSettings = match &options.settings {
        None => TrainingSettings::default(),
        Some(path) => {
            let text = std::fs::read_to_string(path)
                .map_err(|cause| Failure::of(&format!("{}", path.display()), &cause))?;
            toml::from_str(&text).map_err(|fault| {
                Failure::because(format!("{}: {}", path.display(), fault.message()))
            })?
        }
    };
    settings.seed = options.seed;
    if let Some(cases) = options.cases {
        settings.cases = cases;
    }
    let part = shard(&options.shard)?;
    let bars = progress::Training::default();
    let show = |done, of| bars.show(training::samples::Stage::Cases, done, of);
    let made = make_shard(&case, &settings, part, &options.out, &show)?;
    drop(bars);
    match made.sha256 {
        None => print_line!(
            "{}: is there already, {} cases",
            made.file.display(),
            made.cases.len()
        ),
        Some(hash) => print_line!(
            "{}: cases {} to {} of {}, {} of them from an earlier run, sha256 {hash}",
            made.file.display(),
            made.cases.start,
            made.cases.end,
            settings.cases,
            made.kept
        ),
    }
    Ok(())
}

/// `I/N` with 0 <= I < N.
fn shard(text: &str) -> Result<[usize; 2], Failure> {
    text.split_once('/')
        .and_then(|(index, of)| Some([index.parse().ok()?, of.parse().ok()?]))
        .filter(|[index, of]| index < of)
        .ok_or_else(|| {
            Failure::usage(format!(
                "--shard {text}: I/N is expected with I from 0 to N - 1, e.g. 0/4"
            ))
        })
}

#[cfg(test)]
mod tests {
    use super::shard;

    #[test]
    fn shards_are_read_as_part_of_whole() {
        assert_eq!(shard("2/3").unwrap(), [2, 3]);
        for wrong in ["3/3", "1", "a/b", "-1/2"] {
            assert!(shard(wrong).is_err());
        }
    }
}
