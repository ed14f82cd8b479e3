//! A frame's readings as a few hundred bytes, and back to the last bit.
//!
//! A voltmeter sends decimals of nine digits, `+d.ddddddddE+dd`, most of them with zeros at the end (a step of 0.1 uV).
//! Each reading becomes an integer times a power of ten; what is kept is its difference to a reference (the baseline,
//! or an earlier frame) counted in the same power of ten. A voltage that is no such decimal is kept as its 64 bits.
//! Every finite `f64` comes back bit by bit; proven by property tests.
//!
//! The blob, all little-endian; how many readings there are is for the caller to know (a session's protocol says it):
//!
//! | bytes | what |
//! |---|---|
//! | 1 | parts: bit 0 some readings are not ok, bit 1 some decimals have another power than expected, bit 2 some voltages are raw, bit 3 the next two are of two bytes each |
//! | 1 (2) | g, the grid: the smallest power of ten in the frame |
//! | 1 (2) | mean size of the differences, in sixteenths of an octave of the grid's unit |
//! | the rest | range coded (`range.rs`), reading by reading, what the parts say: whether it is ok, else its flag ([`survey::Reading::flag`]); whether it is raw, then its 64 bits; whether its power is another than expected, then by how much; the difference of its decimal (`difference.rs`) |
//!
//! The expected power of a reading whose reference is R: the larger of g and floor(log10 |R|) - 8; without a
//! reference, or where R = 0: g. The predicted integer: R over that reading's power of ten, rounded half away from zero.
//! Normal noise of 20 steps has an entropy of 6.37 bits a reading; `append_rate` prints what is reached.

mod decimal;
mod difference;
mod extras;
mod range;

use survey::{Reading, Volts};

use crate::codec::extras::Beside;
use decimal::{Decimal, finest_power, predicted, value};
use difference::{Model, Scale};
use range::{Decoder, Encoder};

const FLAGS: u8 = 1;
const POWERS: u8 = 2;
const RAW: u8 = 4;
const WIDE: u8 = 8;

/// Readings that [`encode`] does not pack.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum EncodeError {
    /// The reading at this index is flagged ok and is not finite.
    #[error("reading {0} is not finite")]
    NotFinite(usize),
    /// More than 65,535 readings.
    #[error("{0} readings; a frame holds 65,535 at most")]
    TooMany(usize),
}

/// A blob that is not what [`encode`] writes.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the readings cannot be unpacked: {0}")]
pub struct DecodeError(&'static str);

/// Packs readings, as differences to `reference` where it has the same length (an empty one for none).
///
/// # Errors
/// A reading that is flagged ok and is not finite; more readings than a frame can hold.
pub fn encode(readings: &[Reading], reference: &Reference) -> Result<Vec<u8>, EncodeError> {
    u16::try_from(readings.len()).map_err(|_| EncodeError::TooMany(readings.len()))?;
    let reference = reference.serves(readings.len());
    let mut ok = Vec::with_capacity(readings.len());
    for (index, reading) in readings.iter().enumerate() {
        if let Some(Volts(volts)) = reading.volts() {
            if !volts.is_finite() {
                return Err(EncodeError::NotFinite(index));
            }
            ok.push((volts, Decimal::of(volts), reference.at(index)));
        }
    }
    let grid = ok
        .iter()
        .filter_map(|(_, decimal, _)| decimal.as_ref()?.finest())
        .min()
        .unwrap_or(0);

    let words: Vec<Word> = ok
        .iter()
        .map(|(volts, decimal, (reference, own))| {
            let expected = expected_power(*own, grid);
            decimal
                .as_ref()
                .and_then(|decimal| decimal.on(grid, expected))
                .filter(|(integer, power)| value(*integer, *power).to_bits() == volts.to_bits())
                .map_or(Word::Raw(volts.to_bits()), |(integer, power)| {
                    Word::Decimal {
                        difference: integer.wrapping_sub(predicted(*reference, power)),
                        moved: power - expected,
                        above_grid: power - grid,
                    }
                })
        })
        .collect();
    let scale = Scale::of(words.iter().filter_map(|word| match word {
        Word::Decimal {
            difference,
            above_grid,
            ..
        } => Some((*difference, *above_grid)),
        Word::Raw(_) => None,
    }));
    let has = |part: u8, any: bool| if any { part } else { 0 };
    let narrow = i8::try_from(grid).ok().zip(u8::try_from(scale.0).ok());
    let parts = has(FLAGS, ok.len() < readings.len())
        | has(
            POWERS,
            words
                .iter()
                .any(|word| matches!(word, Word::Decimal { moved, .. } if *moved != 0)),
        )
        | has(RAW, words.iter().any(|word| matches!(word, Word::Raw(_))))
        | has(WIDE, narrow.is_none());

    let mut blob = Vec::with_capacity(readings.len() * 2);
    blob.push(parts);
    match narrow {
        Some((grid, scale)) => {
            blob.extend(grid.to_le_bytes());
            blob.push(scale);
        }
        None => {
            blob.extend(grid.to_le_bytes());
            blob.extend(scale.0.to_le_bytes());
        }
    }
    let began = blob.len();
    let mut encoder = Encoder::new(blob);
    let mut beside = Beside::default();
    let mut model = Model::new(scale);
    let mut words = words.into_iter();
    for reading in readings {
        if parts & FLAGS != 0 {
            beside.write_flag(&mut encoder, reading.flag());
        }
        if !reading.is_ok() {
            continue;
        }
        let word = words.next().expect("a word for each reading that is ok");
        if parts & RAW != 0 {
            beside.write_raw(&mut encoder, matches!(word, Word::Raw(_)));
        }
        match word {
            Word::Raw(bits) => encoder.plain(bits, 64),
            Word::Decimal {
                difference,
                moved,
                above_grid,
            } => {
                if parts & POWERS != 0 {
                    beside.write_moved(&mut encoder, moved);
                }
                model.write(&mut encoder, difference, above_grid);
            }
        }
    }
    Ok(encoder.finish(began))
}

/// A reading that is ok.
enum Word {
    Raw(u64),
    Decimal {
        difference: i64,
        /// Its power minus the expected one.
        moved: i16,
        above_grid: i16,
    },
}

/// Unpacks so many readings against the same reference as they were packed with.
///
/// # Errors
/// The blob is not what [`encode`] writes. One cut short or taken for another number of readings may be taken for other
/// readings: the row's checksum is what tells damage from data.
pub fn decode(
    blob: &[u8],
    reference: &Reference,
    count: usize,
) -> Result<Vec<Reading>, DecodeError> {
    let mut rest = blob;
    let parts = take(&mut rest, 1)?[0];
    if parts & !(FLAGS | POWERS | RAW | WIDE) != 0 || count > usize::from(u16::MAX) {
        return Err(DecodeError("its head makes no sense"));
    }
    let (grid, scale) = if parts & WIDE == 0 {
        let head = take(&mut rest, 2)?;
        (i16::from(head[0] as i8), u16::from(head[1]))
    } else {
        let head = take(&mut rest, 4)?;
        (
            i16::from_le_bytes([head[0], head[1]]),
            u16::from_le_bytes([head[2], head[3]]),
        )
    };
    let reference = reference.serves(count);
    let mut decoder = Decoder::new(rest);
    let mut beside = Beside::default();
    let mut model = Model::new(Scale(scale));
    let mut readings = Vec::with_capacity(count);
    for index in 0..count {
        let flag = match parts & FLAGS {
            0 => 0,
            _ => beside.read_flag(&mut decoder),
        };
        let volts = if flag != 0 {
            0.0
        } else if parts & RAW != 0 && beside.read_raw(&mut decoder) {
            f64::from_bits(decoder.plain(64))
        } else {
            let moved = match parts & POWERS {
                0 => 0,
                _ => beside
                    .read_moved(&mut decoder)
                    .ok_or(DecodeError("a power of ten is impossible"))?,
            };
            let (reference, own) = reference.at(index);
            let power = expected_power(own, grid).wrapping_add(moved);
            let difference = model
                .read(&mut decoder, power.wrapping_sub(grid))
                .ok_or(DecodeError("a difference is impossible"))?;
            value(predicted(reference, power).wrapping_add(difference), power)
        };
        readings.push(
            Reading::from_flag(flag, volts)
                .ok_or(DecodeError("a flag or a voltage is impossible"))?,
        );
    }
    if decoder.has_rest() {
        return Err(DecodeError("it is longer than it says"));
    }
    Ok(readings)
}

/// Readings to take differences against, looked at once for many frames.
#[derive(Debug, Clone, Default)]
pub struct Reference(Vec<(f64, Option<i16>)>);

impl Reference {
    /// Nothing to take differences against.
    pub const NONE: Self = Self(Vec::new());

    /// Of readings that the decoder will have too: a baseline, or a record of its own.
    pub fn new(readings: &[Reading]) -> Self {
        let prepared = readings.iter().map(|reading| {
            let volts = reading.volts().map_or(0.0, |volts| volts.0);
            (volts, finest_power(volts))
        });
        Self(prepared.collect())
    }

    /// Of another length than the frame it serves nothing.
    fn serves(&self, readings: usize) -> &Self {
        if self.0.len() == readings {
            self
        } else {
            const { &Self::NONE }
        }
    }

    /// The voltage and the power of its ninth digit.
    fn at(&self, index: usize) -> (f64, Option<i16>) {
        self.0.get(index).copied().unwrap_or((0.0, None))
    }
}

fn expected_power(own: Option<i16>, grid: i16) -> i16 {
    own.map_or(grid, |own| own.max(grid))
}

fn take<'a>(rest: &mut &'a [u8], count: usize) -> Result<&'a [u8], DecodeError> {
    let (taken, left) = rest
        .split_at_checked(count)
        .ok_or(DecodeError("it ends early"))?;
    *rest = left;
    Ok(taken)
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
            let blob = encode(&readings, &Reference::new(&reference)).unwrap();
            prop_assert!(same_bits(&decode(&blob, &Reference::new(&reference), readings.len()).unwrap(), &readings));
        }

        #[test]
        fn a_reference_of_the_same_length_serves_whatever_it_holds(
            pairs in prop::collection::vec((any_reading(), any_reading()), 1..80)
        ) {
            let (readings, reference): (Vec<_>, Vec<_>) = pairs.into_iter().unzip();
            let blob = encode(&readings, &Reference::new(&reference)).unwrap();
            prop_assert!(same_bits(&decode(&blob, &Reference::new(&reference), readings.len()).unwrap(), &readings));
        }

        #[test]
        fn rubbish_is_refused_and_never_panics(
            bytes in prop::collection::vec(any::<u8>(), 0..200),
            reference in any_frame(),
        ) {
            for count in [0, bytes.len(), reference.len(), 65_536] {
                let _ = decode(&bytes, &Reference::new(&reference), count);
            }
            for parts in 0..16 {
                let mut blob = vec![parts];
                blob.extend(&bytes);
                let _ = decode(&blob, &Reference::new(&reference), reference.len());
            }
        }
    }

    #[test]
    fn the_instruments_own_digits_are_small() {
        // 0.1 uV steps, noise of a few steps: a byte a reading at most.
        let reference: Vec<Reading> = (0..598)
            .map(|k| Reading::Ok(Volts(((k * 7919) % 3_000_000) as f64 / 1e7)))
            .collect();
        let readings: Vec<Reading> = (0..598)
            .map(|k| {
                let noise = (k * k * 31) % 61 - 30;
                Reading::Ok(Volts(((k * 7919) % 3_000_000 + noise) as f64 / 1e7))
            })
            .collect();
        let blob = encode(&readings, &Reference::new(&reference)).unwrap();
        assert!(blob.len() < 598, "{} bytes", blob.len());
        assert_eq!(
            decode(&blob, &Reference::new(&reference), readings.len()).unwrap(),
            readings
        );
    }

    #[test]
    fn what_is_not_finite_is_refused_by_its_index() {
        let readings = [Reading::Overload, Reading::Ok(Volts(f64::NAN))];
        assert_eq!(
            encode(&readings, &Reference::NONE),
            Err(EncodeError::NotFinite(1))
        );
    }
}
