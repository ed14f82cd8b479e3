//! Packs the readings of one or several frames into a few hundred bytes each, without loss.
//!
//! A voltmeter sends decimals of nine digits, `+d.ddddddddE+dd`, most of them with zeros at the end (a step of 0.1 uV).
//! Each reading becomes an integer over a power of ten; its difference to the prediction from a reference (the
//! baseline, or a mean of earlier frames) is stored. The crate `pco` packs the differences; its format is also read by
//! [pcodec](https://pypi.org/project/pcodec/) in Python. A voltage that is not such a decimal is stored as its 64
//! bits. Every finite `f64` is restored bit by bit, which property tests check.
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
//! A stream has pco's standalone format: one chunk of 16, 32 or 64 bit integers, in classic mode and without pco's
//! delta encoding.
//!
//! The number of decimal places q of a reading is p. With a reference of R volts (valid and not 0) it is the smaller
//! of p and the places of the ninth digit of R (8 - floor(log10 |R|) of R rounded to nine digits, between 0 and 22).
//! The prediction is R x 10^q, rounded to an integer, half to even; 0 if there is no R, or from 2^53 on. The note of
//! a reading determines its meaning:
//!
//! | note | reading |
//! |---|---|
//! | 0, or no notes | (prediction + d) / 10^q volts |
//! | 1, 2, 3 | not ok, by its flag ([`survey::Reading::flag`]) |
//! | 4 | the `f64` whose bits are d |
//! | 4 + n | as with note 0, with n decimal places more than q |
//!
//! Normal noise of 20 steps has an entropy of 6.37 bits a reading; `append_rate` prints the size that is reached.

mod decimal;
mod numbers;
#[cfg(test)]
mod tests;

use pco::errors::PcoError;
use survey::{Reading, Volts};

use decimal::{MOST_PLACES, integer, most_places, ninth_digit, places, predicted, value};
use numbers::{pack, unpack};

/// The note of a voltage that is stored as its bits.
const BITS: u8 = 4;

/// Maximum number of frames of one blob: reading one of them unpacks all.
pub const MOST_FRAMES: usize = 32;

/// Readings that [`encode`] cannot pack.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum EncodeError {
    /// The reading at this index of its frame is flagged ok and is not finite.
    #[error("reading {0} is flagged ok and is not a finite number; flag it instead")]
    NotFinite(usize),
    /// More than 65,535 readings.
    #[error("a frame of {0} readings is too long to be kept; 65,535 is the most")]
    TooMany(usize),
    /// No frames, more than [`MOST_FRAMES`], or frames of different lengths.
    #[error("a frame cannot be kept: {0} frames cannot be packed together: pass 1 to {most} of the same length", most = MOST_FRAMES)]
    Frames(usize),
    /// An error of pco.
    #[error("a frame cannot be kept: the readings cannot be packed: {0}")]
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
/// A reading that is flagged ok and is not finite; more readings than a frame can hold; no frames, too many, or
/// frames of different lengths.
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

/// The number of decimal places that represents all decimals of the frames, limited so that the largest is an exact
/// integer.
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
        _ => return Err(DecodeError::of("its first bytes are invalid")),
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

    /// From readings that are also available for decoding: a baseline, or a reference in the session's file.
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
