//! A set of recorded cases in the file format of simulated sets: one shard, whose header contains the hash of the
//! recording.

use std::io::{BufWriter, Write};
use std::path::Path;

use eit::{Case, TrainingSettings};
use outfile::Existing;
use rand::seq::SliceRandom;
use shards::Shard;

use super::folder::{Paths, close, lock, refuse_others};
use super::{DataSetError, MadeShard, baseline, full, header, record};
use crate::samples::{Purpose, Sample, stream};

/// Writes recorded cases as a set, in a random order given by `seed`: trainings hold out the last cases for evaluation,
/// which must not all be the last presses of the recording. `unloaded`: the baseline at 1 A, V. `source`: hash of the
/// recording.
///
/// # Errors
/// A case with a number that is not finite; files that cannot be written or that belong to another set.
pub fn keep_recorded(
    case: &Case,
    samples: &[Sample],
    unloaded: &[f64],
    source: &str,
    seed: u64,
    folder: &Path,
) -> Result<MadeShard, DataSetError> {
    for (number, sample) in samples.iter().enumerate() {
        sample.check("the recording", number)?;
    }
    let usual = TrainingSettings::default();
    let settings = TrainingSettings {
        cases: samples.len(),
        // fewer samples than neurons would be refused, and a few presses are a valid set
        neurons: usual.neurons.min(samples.len()),
        seed,
        ..usual
    };
    let mut header = header(case, &settings, Shard::WHOLE);
    header["recorded"] = source.into();
    outfile::check_folder(folder, Existing::Replace)?;
    refuse_others(folder, &header, Shard::WHOLE)?;
    let paths = Paths::new(folder, Shard::WHOLE);
    let cases = 0..samples.len();
    let made = |sha256| MadeShard {
        file: paths.whole.clone(),
        cases: cases.clone(),
        kept: 0,
        sha256,
    };
    if paths.manifest.exists() {
        return Ok(made(None));
    }
    outfile::make_folder(folder, Existing::Replace)?;
    let Some(part) = lock(folder, &paths, &header, Shard::WHOLE)? else {
        return Ok(made(None));
    };
    let path = part.path().to_owned();
    let failed = |cause: std::io::Error| full(&path, &cause);
    part.file.set_len(0).map_err(failed)?;
    let mut order: Vec<usize> = cases.clone().collect();
    order.shuffle(&mut stream(seed, Purpose::Order, 0));
    let mut writer = BufWriter::new(&part.file);
    writeln!(writer, "{header}").map_err(failed)?;
    baseline(&mut writer, unloaded).map_err(failed)?;
    for sample in order {
        record(&mut writer, &samples[sample]).map_err(failed)?;
    }
    writer.flush().map_err(failed)?;
    drop(writer);
    let hash = close(part, &paths, &header, &cases)?;
    Ok(made(Some(hash)))
}
