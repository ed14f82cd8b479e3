//! The codec of a frame's readings in both directions: arbitrary bytes are unpacked or refused, and arbitrary
//! readings are restored to the last bit with any reference. Nothing panics.

#![no_main]

use libfuzzer_sys::fuzz_target;
use logbook::codec::{EncodeError, MOST_FRAMES, Reference, decode, encode};
use survey::{Reading, Volts};

fuzz_target!(|bytes: &[u8]| {
    let Some((&[against, count], bytes)) = bytes.split_first_chunk() else {
        return;
    };
    let against = usize::from(against) * bytes.len() / 255;
    let (first, second) = bytes.split_at(against);
    let reference = Reference::new(&readings(first));

    if let Ok(unpacked) = decode(second, &reference, usize::from(count)) {
        assert!((1..=MOST_FRAMES).contains(&unpacked.len()));
        assert!(
            unpacked
                .iter()
                .all(|frame| frame.len() == usize::from(count))
        );
        comes_back(&unpacked, &reference);
    }
    let second = readings(second);
    comes_back(std::slice::from_ref(&second), &reference);
    comes_back(std::slice::from_ref(&second), &Reference::NONE);
    let half = second.len() / 2;
    comes_back(
        &[second[..half].to_vec(), second[half..2 * half].to_vec()],
        &reference,
    );
    // A reference of the same length, so that every reading has a reference value.
    let turned: Vec<Reading> = second.iter().rev().copied().collect();
    comes_back(&[second], &Reference::new(&turned));
});

fn comes_back(frames: &[Vec<Reading>], reference: &Reference) {
    let slices: Vec<&[Reading]> = frames.iter().map(Vec::as_slice).collect();
    let packed = match encode(&slices, reference) {
        Ok(packed) => packed,
        Err(EncodeError::NotFinite(at)) => {
            let infinite =
                |frame: &Vec<Reading>| frame[at].volts().is_some_and(|volts| !volts.0.is_finite());
            assert!(frames.iter().any(infinite));
            return;
        }
        Err(refusal) => panic!("{refusal}"),
    };
    let unpacked = decode(&packed, reference, frames[0].len()).expect("what was packed");
    if !frames[0].is_empty() {
        let bits = |frames: &[Vec<Reading>]| -> Vec<_> { frames.iter().map(|f| bits(f)).collect() };
        assert_eq!(bits(&unpacked), bits(frames));
    }
}

fn bits(readings: &[Reading]) -> Vec<(u8, u64)> {
    readings
        .iter()
        .map(|reading| {
            let volts = reading.volts().map_or(0.0, |volts| volts.0);
            (reading.flag(), volts.to_bits())
        })
        .collect()
}

/// One reading for each first byte and the bytes that its kind needs: any 64 bits, a decimal as sent by a voltmeter,
/// a small step from the previous reading, or a flag.
fn readings(mut bytes: &[u8]) -> Vec<Reading> {
    let mut readings = Vec::new();
    let mut counts = 0_i32;
    while let Some((kind, rest)) = bytes.split_first() {
        bytes = rest;
        let reading = match kind % 8 {
            0 => take(&mut bytes).map(|bits| Reading::Ok(Volts(f64::from_le_bytes(bits)))),
            1..4 => take(&mut bytes).map(|[low, high, power]| {
                counts = i32::from(i16::from_le_bytes([low, high])) * 9973;
                let power = i32::from(power % 48) - 24;
                Reading::Ok(Volts(
                    format!("{counts}e{power}").parse().unwrap_or_default(),
                ))
            }),
            4..7 => {
                counts = counts.wrapping_add(i32::from(*kind) - 128);
                Some(Reading::Ok(Volts(f64::from(counts) / 1e7)))
            }
            _ => Reading::from_flag(1 + (kind >> 3) % 3, 0.0),
        };
        readings.extend(reading);
    }
    readings
}

fn take<const N: usize>(bytes: &mut &[u8]) -> Option<[u8; N]> {
    let (taken, rest) = bytes.split_first_chunk()?;
    *bytes = rest;
    Some(*taken)
}
