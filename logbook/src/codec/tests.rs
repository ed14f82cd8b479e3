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

/// Readings in steps of 0.1 uV: the same means in each frame, with up to `noise` steps of noise.
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
    // uniform noise of 61 steps: log2(61) bits a reading
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
