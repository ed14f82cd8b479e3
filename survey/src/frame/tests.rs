use super::*;

fn frame(readings: Vec<Reading>) -> Frame {
    Frame {
        sequence: 1,
        readings,
        extra: Vec::new(),
        monotonic: Duration::ZERO,
        wall: DateTime::UNIX_EPOCH,
        duration: Duration::from_secs(1),
        settings: Settings {
            protocol_hash: "p".into(),
            current: Amps(1e-3),
            range: Volts(1.0),
            nplc: 1.0,
            settle: Duration::from_millis(1),
            wiring: "w".into(),
            precautions: Precautions::default(),
        },
        compliance: Vec::new(),
        simulated: true,
    }
}

#[test]
fn baseline_averages_valid_readings_and_flags_the_never_valid() {
    let frames = [
        frame(vec![
            Reading::Ok(Volts(1.0)),
            Reading::Overload,
            Reading::NotMeasured,
        ]),
        frame(vec![
            Reading::Ok(Volts(3.0)),
            Reading::Ok(Volts(5.0)),
            Reading::NotMeasured,
        ]),
    ];
    let baseline = Baseline::from_frames("b", &frames).unwrap();
    assert_eq!(
        baseline.readings,
        [
            Reading::Ok(Volts(2.0)),
            Reading::Ok(Volts(5.0)),
            Reading::NotMeasured
        ]
    );
    assert_eq!(baseline.deviation, [Some(2.0_f64.sqrt()), None, None]);
}

#[test]
fn a_baseline_taken_with_other_settings_is_refused_by_name() {
    let taken = frame(vec![Reading::Ok(Volts(1.0))]);
    let baseline = Baseline::from_frames("monday", std::slice::from_ref(&taken)).unwrap();
    let mut other = taken.settings.clone();
    other.current = Amps(2e-3);
    let refusal = baseline.check(&other, 1, true).unwrap_err().to_string();
    assert!(
        refusal.contains("'monday'") && refusal.contains("current 1 mA against 2 mA"),
        "{refusal}"
    );
    assert!(baseline.check(&taken.settings, 1, false).is_err());
    assert!(baseline.check(&taken.settings, 2, true).is_err());
}

#[test]
fn frame_of_another_length_is_refused_with_its_length() {
    let volt = Reading::Ok(Volts(1.0));
    let frames = [frame(vec![volt; 3]), frame(vec![volt; 2])];
    assert_eq!(
        Baseline::from_frames("monday", &frames),
        Err(BaselineError::Length {
            baseline: "monday".into(),
            has: 3,
            wants: 2,
        })
    );
}

#[test]
fn not_a_number_has_no_flag_ok() {
    assert_eq!(Reading::from_flag(0, f64::NAN), None);
    assert_eq!(Reading::from_flag(2, 1.0), None);
    assert_eq!(Reading::from_flag(9, 1.0), None);
    for reading in [
        Reading::Ok(Volts(1.0)),
        Reading::Overload,
        Reading::NotMeasured,
    ] {
        assert_eq!(Reading::from_flag(reading.flag(), 1.0), Some(reading));
    }
}
