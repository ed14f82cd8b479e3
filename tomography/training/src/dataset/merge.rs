//! Merges all shards to one file, bit for bit that of an undivided run.

use std::io::{BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::Path;

use eit::{Case, TrainingSettings};
use outfile::Existing;
use shards::{Shard, ShardError, StopRequest};

use super::folder::{Paths, close, lock, refuse_others};
use super::{DataSet, DataSetError, MadeShard, header, missing};

/// Writes the `of` shards in `parts` as the only shard of a set in `folder`. The file is created complete or not at
/// all.
///
/// # Errors
/// Shards that are missing, damaged or of another set; files that cannot be written or that another process writes;
/// SIGTERM.
pub fn merge(
    case: &Case,
    settings: &TrainingSettings,
    [parts, folder]: [&Path; 2],
    of: usize,
    stop: &StopRequest,
) -> Result<MadeShard, DataSetError> {
    let absent = missing(case, settings, of, parts)?;
    if !absent.is_empty() {
        let names: Vec<String> = Shard::all(of)
            .filter(|shard| absent.contains(&shard.index()))
            .map(|shard| format!("{}.tset", shard.name()))
            .collect();
        return Err(ShardError::missing(parts, &names).into());
    }
    // checks that every shard matches its checksum
    DataSet::open(parts, case)?;
    let header = header(case, settings, Shard::WHOLE);
    outfile::make_folder(folder, Existing::Replace)?;
    refuse_others(folder, &header, Shard::WHOLE)?;
    let paths = Paths::new(folder, Shard::WHOLE);
    let cases = 0..settings.cases;
    let Some(part) = lock(folder, &paths, &header, Shard::WHOLE)? else {
        return Ok(MadeShard {
            file: paths.whole,
            kept: settings.cases,
            cases,
            sha256: None,
        });
    };
    let failed = |cause: std::io::Error| super::full(&paths.part, &cause);
    part.file.set_len(0).map_err(failed)?;
    let mut writer = BufWriter::new(&part.file);
    writeln!(writer, "{header}").map_err(failed)?;
    for shard in Shard::all(of) {
        if stop.is_set() {
            return Err(DataSetError::Shard(ShardError::Stopped {
                path: paths.part.clone(),
                done: shard.items(settings.cases).start,
                of: settings.cases,
            }));
        }
        let path = Paths::new(parts, shard).whole;
        let unreadable = |cause| DataSetError::from(ShardError::io(&path)(cause));
        let mut reader = BufReader::new(std::fs::File::open(&path).map_err(unreadable)?);
        let mut head = Vec::new();
        std::io::BufRead::read_until(&mut reader, b'\n', &mut head).map_err(unreadable)?;
        // every shard has the unloaded readings; the merged file has them once
        if shard.index() > 0 {
            let baseline = 8 * case.protocol.len() as u64;
            let records = head.len() as u64 + baseline;
            reader.seek(SeekFrom::Start(records)).map_err(unreadable)?;
        }
        copy(&mut reader, &mut writer).map_err(|(reading, cause)| match reading {
            true => unreadable(cause),
            false => failed(cause),
        })?;
    }
    writer.flush().map_err(failed)?;
    drop(writer);
    let hash = close(part, &paths, &header, &cases)?;
    Ok(MadeShard {
        file: paths.whole,
        kept: settings.cases,
        cases,
        sha256: Some(hash),
    })
}

/// Copies all bytes. The flag of an error is `true` if reading failed and `false` if writing failed.
fn copy(from: &mut impl Read, to: &mut impl Write) -> Result<(), (bool, std::io::Error)> {
    let mut piece = vec![0; 1 << 16];
    loop {
        let read = from.read(&mut piece).map_err(|cause| (true, cause))?;
        if read == 0 {
            return Ok(());
        }
        to.write_all(&piece[..read])
            .map_err(|cause| (false, cause))?;
    }
}
