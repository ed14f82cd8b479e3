//! A frame's readings as a few hundred bytes, and back to the last bit.
//!
//! A voltmeter sends decimals of nine digits, `+d.ddddddddE+dd`, most of them with zeros at the end (a step of 0.1 uV).
//! Each reading becomes an integer times a power of ten; what is kept is its difference to a reference (the baseline,
//! or an earlier frame) counted in the same power of ten. A voltage that is no such decimal is kept as its 64 bits.
//! Every finite `f64` comes back bit by bit; proven by property tests.
//!
//! The blob is zstd over, all little-endian:
//!
//! | bytes | what |
//! |---|---|
//! | 4 | number of readings, n |
//! | 1 | parts: bit 0 flags, bit 1 powers, bit 2 raw voltages follow |
//! | 1 | w, bytes a difference, 0 to 8 |
//! | 2 | g, the grid: the smallest power of ten in the frame |
//! | n | flags ([`survey::Reading::flag`]), if bit 0 is set; else all are ok |
//! | 2 m | for each of the m ok readings its power minus the expected one, if bit 1 is set, low bytes first, then high bytes; -32768 marks a raw voltage |
//! | w d | for each of the d decimals the zigzag difference, all lowest bytes first, then the next |
//! | 8 r | for each of the r raw voltages its bits, in the same way |
//!
//! The expected power of a reading whose reference is R: the larger of g and floor(log10 |R|) - 8; without a
//! reference, or where R = 0: g. The predicted integer: R over that reading's power of ten, rounded half away from zero.

use survey::{Reading, Volts};

const FLAGS: u8 = 1;
const POWERS: u8 = 2;
const RAW: u8 = 4;
const RAW_MARK: i16 = i16::MIN;
/// A frame is far smaller; a length field beyond this is damage, not data.
const MOST_BYTES: usize = 64 << 20;
const LEVEL: i32 = 3;

/// A blob that is not what [`encode`] writes.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the readings cannot be unpacked: {0}")]
pub struct DecodeError(&'static str);

/// Packs readings, as differences to `reference` where it has the same length (an empty one for none).
///
/// # Errors
/// The index of a reading that is flagged ok and is not finite.
pub fn encode(readings: &[Reading], reference: &[Reading]) -> Result<Vec<u8>, usize> {
    let plain = plain(readings, reference)?;
    Ok(zstd::bulk::compress(&plain, LEVEL).expect("zstd compresses any bytes it has memory for"))
}

fn plain(readings: &[Reading], reference: &[Reading]) -> Result<Vec<u8>, usize> {
    let reference = Reference::new(reference, readings.len());
    let mut ok = Vec::with_capacity(readings.len());
    for (index, reading) in readings.iter().enumerate() {
        if let Some(Volts(volts)) = reading.volts() {
            if !volts.is_finite() {
                return Err(index);
            }
            ok.push((volts, Decimal::of(volts), reference.at(index)));
        }
    }
    let grid = ok
        .iter()
        .filter_map(|(_, decimal, _)| decimal.as_ref()?.finest())
        .min()
        .unwrap_or(0);

    let mut powers = Vec::with_capacity(ok.len());
    let mut differences = Vec::with_capacity(ok.len());
    let mut raw = Vec::new();
    for (volts, decimal, reference) in &ok {
        let expected = expected_power(*reference, grid);
        let packed = decimal
            .as_ref()
            .and_then(|decimal| decimal.on(grid, expected))
            .filter(|(integer, power)| value(*integer, *power).to_bits() == volts.to_bits());
        match packed {
            Some((integer, power)) => {
                powers.push(power - expected);
                differences.push(zigzag(integer.wrapping_sub(predicted(*reference, power))));
            }
            None => {
                powers.push(RAW_MARK);
                raw.push(volts.to_bits());
            }
        }
    }
    let widest = differences.iter().copied().max().unwrap_or(0);
    let width = (8 - widest.leading_zeros() as usize / 8) as u8;
    let flagged = readings.iter().any(|reading| !reading.is_ok());
    let moved = powers.iter().any(|power| *power != 0);
    let parts = if flagged { FLAGS } else { 0 }
        | if moved { POWERS } else { 0 }
        | if raw.is_empty() { 0 } else { RAW };

    let mut plain = Vec::with_capacity(readings.len() * 4);
    plain.extend((readings.len() as u32).to_le_bytes());
    plain.extend([parts, width]);
    plain.extend(grid.to_le_bytes());
    if flagged {
        plain.extend(readings.iter().map(|reading| reading.flag()));
    }
    if moved {
        let words: Vec<u64> = powers.iter().map(|power| *power as u16 as u64).collect();
        shuffle(&words, 2, &mut plain);
    }
    shuffle(&differences, width as usize, &mut plain);
    shuffle(&raw, 8, &mut plain);
    Ok(plain)
}

/// Unpacks readings against the same reference as they were packed with.
///
/// # Errors
/// The blob is not what [`encode`] writes.
pub fn decode(blob: &[u8], reference: &[Reading]) -> Result<Vec<Reading>, DecodeError> {
    let size = zstd::bulk::Decompressor::upper_bound(blob)
        .filter(|size| *size <= MOST_BYTES)
        .ok_or(DecodeError("not a zstd frame of known size"))?;
    let plain =
        zstd::bulk::decompress(blob, size).map_err(|_| DecodeError("zstd finds it broken"))?;
    let mut rest = plain.as_slice();
    let count = u32::from_le_bytes(take(&mut rest, 4)?.try_into().expect("four bytes")) as usize;
    let &[parts, width] = take(&mut rest, 2)? else {
        return Err(DecodeError("it ends early"));
    };
    let width = width as usize;
    let grid = i16::from_le_bytes(take(&mut rest, 2)?.try_into().expect("two bytes"));
    if width > 8 || parts & !(FLAGS | POWERS | RAW) != 0 || count > MOST_BYTES {
        return Err(DecodeError("its head makes no sense"));
    }
    let all_ok;
    let flags = if parts & FLAGS != 0 {
        take(&mut rest, count)?
    } else {
        all_ok = vec![0; count];
        &all_ok
    };
    let ok = flags.iter().filter(|flag| **flag == 0).count();
    let powers: Vec<i16> = if parts & POWERS != 0 {
        let words = unshuffle(&mut rest, ok, 2)?;
        words.into_iter().map(|word| word as u16 as i16).collect()
    } else {
        vec![0; ok]
    };
    let raw = powers.iter().filter(|power| **power == RAW_MARK).count();
    let mut differences = unshuffle(&mut rest, ok - raw, width)?.into_iter();
    let mut raw = unshuffle(&mut rest, raw, 8)?.into_iter();
    if !rest.is_empty() {
        return Err(DecodeError("it is longer than it says"));
    }

    let reference = Reference::new(reference, count);
    let mut powers = powers.into_iter();
    let ended = || DecodeError("it ends early");
    flags
        .iter()
        .enumerate()
        .map(|(index, &flag)| {
            let volts = if flag != 0 {
                0.0
            } else {
                match powers.next().ok_or_else(ended)? {
                    RAW_MARK => f64::from_bits(raw.next().ok_or_else(ended)?),
                    moved => {
                        let reference = reference.at(index);
                        let power = expected_power(reference, grid).wrapping_add(moved);
                        let difference = unzigzag(differences.next().ok_or_else(ended)?);
                        value(predicted(reference, power).wrapping_add(difference), power)
                    }
                }
            };
            Reading::from_flag(flag, volts).ok_or(DecodeError("a flag or a voltage is impossible"))
        })
        .collect()
}

/// Readings to take differences against; none where lengths differ.
struct Reference<'a>(&'a [Reading]);

impl<'a> Reference<'a> {
    fn new(readings: &'a [Reading], length: usize) -> Self {
        Self(if readings.len() == length {
            readings
        } else {
            &[]
        })
    }

    fn at(&self, index: usize) -> f64 {
        self.0
            .get(index)
            .and_then(|reading| reading.volts())
            .map_or(0.0, |volts| volts.0)
    }
}

/// Nine digits, no more: `integer` has at most nine, the first not 0, so `power` is the coarsest that holds all nine.
struct Decimal {
    integer: i64,
    power: i16,
}

impl Decimal {
    /// `None` where nine digits do not give the same bits (and for -0, which an integer cannot hold).
    fn of(volts: f64) -> Option<Self> {
        if volts == 0.0 {
            return volts.is_sign_positive().then_some(Self {
                integer: 0,
                power: 0,
            });
        }
        let text = format!("{volts:.8e}");
        let (mantissa, exponent) = text.split_once('e')?;
        let integer: i64 = mantissa.replace('.', "").parse().ok()?;
        let power = exponent.parse::<i16>().ok()? - 8;
        (value(integer, power).to_bits() == volts.to_bits()).then_some(Self { integer, power })
    }

    /// The power of ten of the last digit that is not 0; `None` for zero, which lies on any grid.
    fn finest(&self) -> Option<i16> {
        let (mut integer, mut power) = (self.integer, self.power);
        if integer == 0 {
            return None;
        }
        while integer % 10 == 0 {
            integer /= 10;
            power += 1;
        }
        Some(power)
    }

    /// As an integer times the larger of the grid's power and its own; a zero takes the expected power.
    fn on(&self, grid: i16, expected: i16) -> Option<(i64, i16)> {
        if self.integer == 0 {
            return Some((0, expected));
        }
        let power = grid.max(self.power);
        let places = u32::from(power.abs_diff(self.power));
        // No digit is lost: the grid is no coarser than this value's last digit that is not 0.
        Some((self.integer / 10_i64.checked_pow(places)?, power))
    }
}

fn expected_power(reference: f64, grid: i16) -> i16 {
    if reference == 0.0 {
        return grid;
    }
    let text = format!("{reference:.8e}");
    let own = text
        .split_once('e')
        .and_then(|(_, exponent)| exponent.parse::<i16>().ok())
        .map_or(grid, |exponent| exponent - 8);
    grid.max(own)
}

fn predicted(reference: f64, power: i16) -> i64 {
    let power = i32::from(power);
    let counts = if power >= 0 {
        reference / power_of_ten(power)
    } else {
        reference * power_of_ten(-power)
    };
    // `as` saturates, and gives 0 for NaN: the same on every machine, as the decoder needs.
    counts.round() as i64
}

/// integer x 10^power, correctly rounded.
fn value(integer: i64, power: i16) -> f64 {
    let power = i32::from(power);
    let exact = integer.unsigned_abs() < 1 << 53 && power.unsigned_abs() <= 22;
    match power {
        _ if !exact => format!("{integer}e{power}").parse().unwrap_or(f64::NAN),
        0.. => integer as f64 * power_of_ten(power),
        _ => integer as f64 / power_of_ten(-power),
    }
}

fn power_of_ten(power: i32) -> f64 {
    const EXACT: [f64; 23] = [
        1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16,
        1e17, 1e18, 1e19, 1e20, 1e21, 1e22,
    ];
    match EXACT.get(power as usize) {
        Some(exact) => *exact,
        None => format!("1e{power}").parse().unwrap_or(f64::INFINITY),
    }
}

fn zigzag(difference: i64) -> u64 {
    ((difference << 1) ^ (difference >> 63)) as u64
}

fn unzigzag(word: u64) -> i64 {
    (word >> 1) as i64 ^ -((word & 1) as i64)
}

fn shuffle(words: &[u64], width: usize, into: &mut Vec<u8>) {
    for plane in 0..width {
        into.extend(words.iter().map(|word| word.to_le_bytes()[plane]));
    }
}

fn unshuffle(rest: &mut &[u8], count: usize, width: usize) -> Result<Vec<u64>, DecodeError> {
    let mut words = vec![0; count];
    for plane in 0..width {
        for (word, byte) in words.iter_mut().zip(take(rest, count)?) {
            *word |= u64::from(*byte) << (8 * plane);
        }
    }
    Ok(words)
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
            let blob = encode(&readings, &reference).unwrap();
            prop_assert!(same_bits(&decode(&blob, &reference).unwrap(), &readings));
        }

        #[test]
        fn a_reference_of_the_same_length_serves_whatever_it_holds(
            pairs in prop::collection::vec((any_reading(), any_reading()), 1..80)
        ) {
            let (readings, reference): (Vec<_>, Vec<_>) = pairs.into_iter().unzip();
            let blob = encode(&readings, &reference).unwrap();
            prop_assert!(same_bits(&decode(&blob, &reference).unwrap(), &readings));
        }

        #[test]
        fn rubbish_is_refused_and_never_panics(
            bytes in prop::collection::vec(any::<u8>(), 0..200),
            reference in any_frame(),
        ) {
            let _ = decode(&bytes, &reference);
            let _ = decode(&zstd::bulk::compress(&bytes, LEVEL).unwrap(), &reference);
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
        let blob = encode(&readings, &reference).unwrap();
        assert!(blob.len() < 598, "{} bytes", blob.len());
        assert_eq!(decode(&blob, &reference).unwrap(), readings);
    }

    #[test]
    fn what_is_not_finite_is_refused_by_its_index() {
        let readings = [Reading::Overload, Reading::Ok(Volts(f64::NAN))];
        assert_eq!(encode(&readings, &[]), Err(1));
    }
}
