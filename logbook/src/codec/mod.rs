//! Packs the readings of one frame or several into a few hundred bytes each, without loss.
//!
//! A voltmeter sends decimals of nine digits, `+d.ddddddddE+dd`, most of them with zeros at the end (a step of 0.1 uV).
//! Each reading becomes an integer over a power of ten; its difference to the prediction from a reference (the
//! baseline, or a mean of earlier frames) is stored. The crate `pco` packs the differences; its format is also read by
//! [pcodec](https://pypi.org/project/pcodec/) in Python. A voltage that is no such decimal is stored as its 64 bits.
//! Every finite `f64` is restored bit by bit; property tests prove it.
//!
//! A blob holds frames of equal length one after the other, reading by reading. The caller must know the number of
//! readings of a frame (from the session's protocol); the number of frames follows.
//!
//! | bytes | what |
//! |---|---|
//! | 1 | p: the most decimal places that the readings need, 0 to 22 |
//! | 1 | 1 where notes follow, else 0 |
//! | 4 | with notes: bytes of their stream, little-endian |
//! | as many | with notes: a number for each reading, as a stream |
//! | the rest | a number d for each reading, as a stream |
//!
//! A stream is of pco's standalone format: one chunk of 16, 32 or 64 bit integers, in its classic mode and without
//! differences of its own.
//!
//! The decimal places q of a reading are p; with a reference of R volts (ok and not 0) the smaller of p and the places of
//! the ninth digit of R (8 - floor(log10 |R|) of R rounded to nine digits, between 0 and 22). The prediction is R x 10^q,
//! rounded to an integer, half to even; 0 where there is no R, or from 2^53 on. By its note a reading is
//!
//! | note | reading |
//! |---|---|
//! | 0, or no notes | (prediction + d) / 10^q volts |
//! | 1, 2, 3 | not ok, by its flag ([`survey::Reading::flag`]) |
//! | 4 | the `f64` whose bits are d |
//! | 4 + n | as with note 0, with n decimal places more than q |
//!
//! Normal noise of 20 steps has an entropy of 6.37 bits a reading; `append_rate` prints what is reached.

mod decimal;
mod numbers;

use pco::errors::PcoError;
use survey::{Reading, Volts};

use decimal::{MOST_PLACES, integer, most_places, ninth_digit, places, predicted, value};
use numbers::{pack, unpack};

/// The note of a voltage that is kept as its bits.
const BITS: u8 = 4;

/// Most frames of one blob: reading one of them unpacks all.
pub const MOST_FRAMES: usize = 32;

/// Readings that [`encode`] does not pack.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum EncodeError {
    /// The reading at this index of its frame is flagged ok and is not finite.
    #[error("reading {0} is not finite")]
    NotFinite(usize),
    /// More than 65,535 readings.
    #[error("{0} readings; a frame holds 65,535 at most")]
    TooMany(usize),
    /// No frames, more than [`MOST_FRAMES`], or frames of several lengths.
    #[error("{0} frames cannot be packed together: hand over 1 to {most} of the same length", most = MOST_FRAMES)]
    Frames(usize),
    /// pco refuses.
    #[error("the readings cannot be packed: {0}")]
    Refused(PcoError),
}

/// A blob that [`encode`] did not write.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the readings cannot be unpacked: {0}")]
pub struct DecodeError(String);

impl DecodeError {
    pub(crate) fn of(why: &str) -> Self {
        Self(why.to_owned())
    }
}

impl From<PcoError> for DecodeError {
    fn from(refusal: PcoError) -> Self {
        Self(refusal.to_string())
    }
}

/// Packs frames of equal length as differences to `reference`, if it has the same length ([`Reference::NONE`] for
/// none). Frames packed together take less space than one by one.
///
/// # Errors
/// A reading that is flagged ok and is not finite; more readings than a frame can hold; no frames, too many, or frames of
/// several lengths.
pub fn encode(frames: &[&[Reading]], reference: &Reference) -> Result<Vec<u8>, EncodeError> {
    let count = frames.first().map_or(0, |frame| frame.len());
    u16::try_from(count).map_err(|_| EncodeError::TooMany(count))?;
    if !(1..=MOST_FRAMES).contains(&frames.len()) || frames.iter().any(|f| f.len() != count) {
        return Err(EncodeError::Frames(frames.len()));
    }
    let reference = reference.if_same_length(count);
    let grid = grid(frames)?;
    let (mut notes, mut numbers) = (Vec::new(), Vec::new());
    for frame in frames {
        for (index, reading) in frame.iter().enumerate() {
            let (note, number) = match reading.volts() {
                Some(Volts(volts)) => coded(volts, reference.at(index), grid),
                None => (reading.flag(), 0),
            };
            notes.push(i64::from(note));
            numbers.push(number);
        }
    }
    let mut blob = vec![grid, 0];
    if notes.iter().any(|note| *note != 0) {
        let notes = pack(&notes).map_err(EncodeError::Refused)?;
        blob[1] = 1;
        blob.extend((notes.len() as u32).to_le_bytes());
        blob.extend(notes);
    }
    blob.extend(pack(&numbers).map_err(EncodeError::Refused)?);
    Ok(blob)
}

/// The decimal places that represent all decimals of the frames, as far as the largest stays an exact integer.
fn grid(frames: &[&[Reading]]) -> Result<u8, EncodeError> {
    let (mut grid, mut largest) = (0, 0.0_f64);
    for frame in frames {
        for (index, reading) in frame.iter().enumerate() {
            let Some(Volts(volts)) = reading.volts() else {
                continue;
            };
            if !volts.is_finite() {
                return Err(EncodeError::NotFinite(index));
            }
            if let Some(places) = places(volts) {
                grid = grid.max(places);
                largest = largest.max(volts.abs());
            }
        }
    }
    Ok(grid.min(most_places(largest)))
}

/// The note and the number that encode a voltage.
fn coded(volts: f64, reference: Expected, grid: u8) -> (u8, i64) {
    let expected = reference.places(grid);
    let difference = |places| {
        let integer = integer(volts, places)?;
        Some(integer - predicted(reference.volts, places))
    };
    if let Some(difference) = difference(expected) {
        return (0, difference);
    }
    places(volts)
        .filter(|places| *places > expected)
        .and_then(|places| Some((BITS + places - expected, difference(places)?)))
        .unwrap_or((BITS, volts.to_bits() as i64))
}

/// Unpacks the frames of a blob, of `readings` readings each, with the reference that they were packed with. At most
/// [`MOST_FRAMES`] times `readings` readings are kept in memory.
///
/// # Errors
/// [`encode`] did not write the blob. A damaged blob may decode to other readings: only the row's checksum detects
/// damage.
pub fn decode(
    blob: &[u8],
    reference: &Reference,
    count: usize,
) -> Result<Vec<Vec<Reading>>, DecodeError> {
    let (grid, notes, rest) = match blob {
        [grid @ 0..=MOST_PLACES, 0, rest @ ..] => (*grid, None, rest),
        [grid @ 0..=MOST_PLACES, 1, rest @ ..] => {
            let (length, rest) = rest
                .split_first_chunk()
                .ok_or_else(|| DecodeError::of("it ends early"))?;
            let (notes, rest) = rest
                .split_at_checked(u32::from_le_bytes(*length) as usize)
                .ok_or_else(|| DecodeError::of("it ends early"))?;
            (*grid, Some(notes), rest)
        }
        _ => return Err(DecodeError::of("its head makes no sense")),
    };
    if count > usize::from(u16::MAX) {
        return Err(DecodeError::of("no frame has so many readings"));
    }
    let most = MOST_FRAMES * count;
    let numbers = unpack(rest, most)?;
    let notes = match notes {
        Some(notes) => unpack(notes, most)?,
        None => vec![0; numbers.len()],
    };
    let whole = count == 0 || (!numbers.is_empty() && numbers.len() % count == 0);
    if notes.len() != numbers.len() || !whole {
        return Err(DecodeError::of("it holds another number of readings"));
    }
    let reference = reference.if_same_length(count);
    if count == 0 {
        return Ok(vec![Vec::new()]);
    }
    let coded: Vec<(i64, i64)> = notes.into_iter().zip(numbers).collect();
    let frame = |coded: &[(i64, i64)]| {
        let readings = coded.iter().enumerate();
        readings
            .map(|(index, (note, number))| reading(*note, *number, reference.at(index), grid))
            .collect()
    };
    coded.chunks(count).map(frame).collect()
}

fn reading(note: i64, number: i64, reference: Expected, grid: u8) -> Result<Reading, DecodeError> {
    let expected = reference.places(grid);
    let note = u8::try_from(note).unwrap_or(u8::MAX);
    let (flag, volts) = match note {
        1..BITS => (note, 0.0),
        BITS => (0, f64::from_bits(number as u64)),
        _ => {
            let places = expected.saturating_add(note.saturating_sub(BITS));
            if places > MOST_PLACES {
                return Err(DecodeError::of("a decimal has too many places"));
            }
            let integer = predicted(reference.volts, places).wrapping_add(number);
            (0, value(integer, places))
        }
    };
    Reading::from_flag(flag, volts)
        .filter(|reading| reading.volts().is_none_or(|volts| volts.0.is_finite()))
        .ok_or_else(|| DecodeError::of("a flag or a voltage is impossible"))
}

/// Reference readings, prepared once for many frames.
#[derive(Debug, Clone, Default)]
pub struct Reference(Vec<Expected>);

/// A reading of a reference.
#[derive(Debug, Clone, Copy, Default)]
struct Expected {
    volts: f64,
    /// Decimal places of its ninth digit.
    ninth_digit: Option<u8>,
}

impl Expected {
    fn places(self, grid: u8) -> u8 {
        self.ninth_digit.map_or(grid, |own| own.min(grid))
    }
}

impl Reference {
    /// No reference.
    pub const NONE: Self = Self(Vec::new());

    /// From readings that the decoder has too: a baseline, or a reference of the record.
    pub fn new(readings: &[Reading]) -> Self {
        let prepared = readings.iter().map(|reading| {
            let volts = reading.volts().map_or(0.0, |volts| volts.0);
            Expected {
                volts,
                ninth_digit: ninth_digit(volts),
            }
        });
        Self(prepared.collect())
    }

    /// This reference, or none if its length differs from the frame's.
    fn if_same_length(&self, readings: usize) -> &Self {
        if self.0.len() == readings {
            self
        } else {
            const { &Self::NONE }
        }
    }

    fn at(&self, index: usize) -> Expected {
        self.0.get(index).copied().unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn same_bits(a: &[Reading], b: &[Reading]) -> bool {
        a.len() == b.len()
            && a.iter().zip(b).all(|(a, b)| match (a, b) {
                (Reading::Ok(a), Reading::Ok(b)) => a.0.to_bits() == b.0.to_bits(),
                _ => a == b,
            })
    }

    fn any_reading() -> impl Strategy<Value = Reading> {
        prop_oneof![
            8 => any::<f64>().prop_filter("finite", |volts| volts.is_finite()).prop_map(|volts| Reading::Ok(Volts(volts))),
            8 => (-999_999_999_i64..=999_999_999, -40_i32..30).prop_map(|(integer, power)| {
                Reading::Ok(Volts(format!("{integer}e{power}").parse().unwrap()))
            }),
            8 => (-20_000_000_i64..20_000_000).prop_map(|counts| Reading::Ok(Volts(counts as f64 / 1e7))),
            1 => Just(Reading::Ok(Volts(-0.0))),
            1 => Just(Reading::Ok(Volts(0.0))),
            1 => Just(Reading::Ok(Volts(f64::MIN_POSITIVE / 8.0))),
            1 => Just(Reading::Overload),
            1 => Just(Reading::Timeout),
            1 => Just(Reading::NotMeasured),
        ]
    }

    fn any_frame() -> impl Strategy<Value = Vec<Reading>> {
        prop::collection::vec(any_reading(), 0..80)
    }

    proptest! {
        #[test]
        fn every_reading_comes_back_to_the_last_bit(readings in any_frame(), reference in any_frame()) {
            let blob = encode(&[&readings], &Reference::new(&reference)).unwrap();
            let frames = decode(&blob, &Reference::new(&reference), readings.len()).unwrap();
            prop_assert!(frames.len() == 1 && same_bits(&frames[0], &readings));
        }

        #[test]
        fn frames_together_come_back_to_the_last_bit(
            (frames, reference) in (1_usize..20).prop_flat_map(|count| {
                let frame = || prop::collection::vec(any_reading(), count);
                (prop::collection::vec(frame(), 1..=MOST_FRAMES), frame())
            })
        ) {
            let reference = Reference::new(&reference);
            let slices: Vec<&[Reading]> = frames.iter().map(Vec::as_slice).collect();
            let blob = encode(&slices, &reference).unwrap();
            let back = decode(&blob, &reference, frames[0].len()).unwrap();
            prop_assert_eq!(back.len(), frames.len());
            prop_assert!(back.iter().zip(&frames).all(|(a, b)| same_bits(a, b)));
        }

        #[test]
        fn rubbish_is_refused_and_never_panics(
            bytes in prop::collection::vec(any::<u8>(), 0..200),
            reference in any_frame(),
        ) {
            for count in [0, bytes.len(), reference.len(), 65_536] {
                let _ = decode(&bytes, &Reference::new(&reference), count);
            }
            for notes in 0..2 {
                let mut blob = vec![7, notes];
                blob.extend(&bytes);
                let _ = decode(&blob, &Reference::new(&reference), reference.len());
            }
        }

        #[test]
        fn a_changed_blob_gives_no_more_frames_than_one_holds(
            readings in prop::collection::vec(any_reading(), 1..80),
            changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
            cut in any::<prop::sample::Index>(),
        ) {
            let mut blob = encode(&[&readings], &Reference::NONE).unwrap();
            for (at, byte) in changes {
                let at = at.index(blob.len());
                blob[at] = byte;
            }
            let cut = cut.index(2 * blob.len());
            blob.truncate(cut.max(1));
            if let Ok(frames) = decode(&blob, &Reference::NONE, readings.len()) {
                prop_assert!((1..=MOST_FRAMES).contains(&frames.len()));
                prop_assert!(frames.iter().all(|frame| frame.len() == readings.len()));
            }
        }
    }

    /// 0.1 uV steps, so many steps of noise about the same means.
    fn steps(number: i64, noise: i64) -> Vec<Reading> {
        let mut state = number as u64;
        let mut counts = |k: i64| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (k * 7919) % 3_000_000 + (state >> 33) as i64 % (2 * noise + 1) - noise
        };
        (0..598)
            .map(|k| Reading::Ok(Volts(counts(k) as f64 / 1e7)))
            .collect()
    }

    #[test]
    fn the_instruments_own_digits_are_small() {
        let reference = Reference::new(&steps(0, 0));
        let frames: Vec<_> = (1..17).map(|number| steps(number, 30)).collect();
        let frames: Vec<&[Reading]> = frames.iter().map(Vec::as_slice).collect();
        // log2 61 bits a reading
        let entropy = 443;
        let alone = encode(&frames[..1], &reference).unwrap().len();
        assert!((entropy..entropy + 60).contains(&alone), "{alone}");
        let together = encode(&frames, &reference).unwrap().len() / frames.len();
        assert!((entropy..entropy + 15).contains(&together), "{together}");
    }

    #[test]
    fn a_decimal_of_more_places_than_its_reference_stays_one() {
        let [above, below] = [0.100_000_001, 0.099_999_999_9];
        let reference = Reference::new(&[Reading::Ok(Volts(above)); 598]);
        let readings = [Reading::Ok(Volts(below)); 598];
        let blob = encode(&[&readings], &reference).unwrap();
        assert!(blob.len() < 100, "{}", blob.len());
        assert_eq!(decode(&blob, &reference, 598).unwrap(), [readings]);
    }

    #[test]
    fn what_is_not_finite_is_refused_by_its_index() {
        let readings = [Reading::Overload, Reading::Ok(Volts(f64::NAN))];
        let good = [Reading::Overload; 2];
        assert_eq!(
            encode(&[&good, &readings], &Reference::NONE),
            Err(EncodeError::NotFinite(1))
        );
    }

    #[test]
    fn frames_that_do_not_fit_together_are_refused() {
        let refused = |frames: &[&[Reading]]| encode(frames, &Reference::NONE).unwrap_err();
        let frame = [Reading::Overload; 2];
        assert_eq!(refused(&[]), EncodeError::Frames(0));
        let many = [&frame[..]; MOST_FRAMES + 1];
        assert_eq!(refused(&many), EncodeError::Frames(MOST_FRAMES + 1));
        assert_eq!(refused(&[&frame, &frame[..1]]), EncodeError::Frames(2));
        let long = vec![Reading::Overload; 65_536];
        assert_eq!(refused(&[&long]), EncodeError::TooMany(65_536));
    }
}
