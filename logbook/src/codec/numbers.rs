//! Integers as a stream of pco's standalone format, unpacked within bounds.

use pco::data_types::{Number, NumberType};
use pco::errors::PcoError;
use pco::standalone::{DecompressorItem, FileDecompressor, simple_compress};
use pco::{ChunkConfig, DeltaSpec, ModeSpec};

use super::DecodeError;

/// Packs numbers in the narrowest type that holds all of them, which shortens pco's description of their distribution.
pub(super) fn pack(numbers: &[i64]) -> Result<Vec<u8>, PcoError> {
    // Neighbouring numbers are different positions on the sheet: differences between them would only add their noise.
    let config = ChunkConfig::default()
        .with_mode_spec(ModeSpec::Classic)
        .with_delta_spec(DeltaSpec::NoOp);
    if let Some(narrow) = all_as::<i16>(numbers) {
        simple_compress(&narrow, &config)
    } else if let Some(narrow) = all_as::<i32>(numbers) {
        simple_compress(&narrow, &config)
    } else {
        simple_compress(numbers, &config)
    }
}

fn all_as<T: TryFrom<i64>>(numbers: &[i64]) -> Option<Vec<T>> {
    numbers
        .iter()
        .map(|number| T::try_from(*number).ok())
        .collect()
}

/// Bytes of a chunk before its description: the type and count of its numbers.
const CHUNK_HEAD: usize = 4;
/// First byte of a description in [`pack`]'s streams: four bits for pco's mode, four for its delta encoding.
const PLAIN: u8 = 0;
/// First version of pco's format with this description.
const FORMAT: u8 = 3;
/// End of a stream.
const END: [u8; 1] = [0];

/// Unpacks a stream of [`pack`] that has at most `most` numbers.
pub(super) fn unpack(stream: &[u8], most: usize) -> Result<Vec<i64>, DecodeError> {
    let (file, rest) = FileDecompressor::new(stream)?;
    if rest == END {
        return Ok(Vec::new());
    }
    match file.peek_number_type_or_termination(rest)? {
        Some(NumberType::I16) => chunk::<i16>(&file, rest, most),
        Some(NumberType::I32) => chunk::<i32>(&file, rest, most),
        Some(NumberType::I64) => chunk::<i64>(&file, rest, most),
        _ => Err(DecodeError::of("its numbers are of another type")),
    }
}

/// The one chunk of a stream.
fn chunk<T: Number + Into<i64>>(
    file: &FileDecompressor,
    rest: &[u8],
    most: usize,
) -> Result<Vec<i64>, DecodeError> {
    // Checked before reading: the headers of other modes alone allocate memory.
    if file.format_version().major < FORMAT || rest.get(CHUNK_HEAD) != Some(&PLAIN) {
        return Err(DecodeError::of("its numbers are coded in another way"));
    }
    let DecompressorItem::Chunk(mut chunk) = file.chunk_decompressor::<T, _>(rest)? else {
        return Err(DecodeError::of("it is longer than it states"));
    };
    if chunk.n() > most {
        return Err(DecodeError::of("it holds more numbers than readings"));
    }
    let mut numbers = vec![T::default(); chunk.n()];
    if !chunk.read(&mut numbers)?.finished {
        return Err(DecodeError::of("it ends early"));
    }
    if chunk.into_src() != END {
        return Err(DecodeError::of("it is longer than it states"));
    }
    Ok(numbers.into_iter().map(Into::into).collect())
}

#[cfg(test)]
mod tests {
    use pco::standalone::FileCompressor;

    use super::*;

    fn refusal(stream: &[u8], most: usize) -> String {
        unpack(stream, most).unwrap_err().to_string()
    }

    #[test]
    fn numbers_come_back_in_the_narrowest_type() {
        let cases: [&[i64]; 5] = [
            &[],
            &[-32_768, 32_767],
            &[-32_769, 5],
            &[i64::from(i32::MAX) + 1],
            &[i64::MIN, 0, i64::MAX],
        ];
        for numbers in cases {
            let stream = pack(numbers).unwrap();
            assert_eq!(unpack(&stream, numbers.len()).unwrap(), numbers);
        }
        let lengths = [100, 100_000].map(|size| pack(&[size; 10]).unwrap().len());
        assert!(lengths[0] < lengths[1], "{lengths:?}");
    }

    #[test]
    fn more_numbers_than_expected_are_refused() {
        let stream = pack(&[0; 1000]).unwrap();
        assert!(unpack(&stream, 1000).is_ok());
        assert!(refusal(&stream, 999).contains("more numbers"));
    }

    #[test]
    fn other_codings_of_pco_are_refused_before_they_are_read() {
        let numbers: Vec<i64> = (0..400).map(|k| k * 3 % 97 * 7).collect();
        for config in [
            ChunkConfig::default().with_mode_spec(ModeSpec::TryIntMult(7)),
            ChunkConfig::default().with_mode_spec(ModeSpec::TryDict),
            ChunkConfig::default()
                .with_mode_spec(ModeSpec::Classic)
                .with_delta_spec(DeltaSpec::TryLookback),
            ChunkConfig::default()
                .with_mode_spec(ModeSpec::Classic)
                .with_delta_spec(DeltaSpec::TryConsecutive(1)),
        ] {
            let stream = simple_compress(&numbers, &config).unwrap();
            assert!(refusal(&stream, 400).contains("another way"), "{config:?}");
        }
        let floats = simple_compress(&[0.5, 0.25], &ChunkConfig::default()).unwrap();
        assert!(refusal(&floats, 2).contains("another type"));
    }

    #[test]
    fn a_stream_with_anything_behind_it_is_refused() {
        let mut stream = pack(&[1, 2, 3]).unwrap();
        stream.push(0);
        assert!(refusal(&stream, 3).contains("longer"));
        let mut twice = Vec::new();
        let file = FileCompressor::default();
        file.write_header(&mut twice).unwrap();
        for _ in 0..2 {
            let mut chunk = file
                .chunk_compressor(&[1_i64, 2], &ChunkConfig::default())
                .unwrap();
            chunk.write(&mut twice).unwrap();
        }
        file.write_footer(&mut twice).unwrap();
        assert!(refusal(&twice, 4).contains("longer"));
    }
}
