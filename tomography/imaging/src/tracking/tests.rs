//! Frames that cannot be judged, and a clock that is set back.

use eit::{Forward, PaperSheet, Preset};
use survey::{Amps, Protocol, Volts};

use super::*;
use crate::geometry::Geometry;

/// Time of the baseline, and of the first frame, s.
const BEGAN_S: f64 = 1e6;
const FIRST_S: f64 = BEGAN_S + 600.0;
const FLOATING: Electrode = Electrode(5);

/// A sheet on a coarse mesh, and its baseline.
fn tracking() -> (Tracking, Vec<Reading>) {
    let sheet = PaperSheet {
        fineness: 0.5,
        ..PaperSheet::default()
    };
    let geometry = Geometry::from_preset(&Preset::PaperSheet(sheet)).unwrap();
    let protocol = Protocol::sheffield(26).unwrap();
    let forward = Forward::new(Arc::clone(&geometry.mesh), &geometry.contact_ohm_m).unwrap();
    let ohms = forward.readings(&geometry.sigma0, &protocol).unwrap();
    let baseline = Reading::of_volts(ohms.iter().map(|ohms| 1e-3 * ohms));
    let conditions = Conditions::live(&geometry, &protocol, Amps(1e-3));
    let tracking = Tracking::new(&conditions, &baseline, 2e-6, BEGAN_S).unwrap();
    (tracking, baseline)
}

#[test]
fn faulty_electrode_is_left_out_where_readings_are_missing() {
    let (mut tracking, baseline) = tracking();
    let pairs = tracking.model().pairs().clone();
    let measurements = pairs.protocol().measurements();
    let uses = |reading: usize| measurements[reading].electrodes().contains(&FLOATING);
    let frame: Vec<Reading> = baseline
        .iter()
        .enumerate()
        .map(
            |(reading, baseline)| match (uses(reading), baseline.volts()) {
                (true, Some(Volts(volts))) => {
                    Reading::Ok(Volts(volts + 1e-3 * (reading as f64).sin()))
                }
                _ => *baseline,
            },
        )
        .collect();
    let found = tracking.follow(&frame, FIRST_S).unwrap().tracked;
    assert_eq!(found.masked, [FLOATING.number()]);
    let others: Vec<usize> = (0..pairs.len())
        .map(|row| pairs.readings(row)[0])
        .filter(|reading| !uses(*reading))
        .collect();
    // fewer than half of the pairs are left: in the first case only because those of the faulty electrode are excluded,
    // in the second case with them too
    for missing in [120, 160] {
        let mut frame = frame.clone();
        for &reading in &others[..missing] {
            frame[reading] = Reading::NotMeasured;
        }
        let followed = tracking.follow(&frame, FIRST_S + 60.0).unwrap();
        let tracked = followed.tracked;
        assert_eq!(tracked.reason, Some(Doubtful::TooFewReadings), "{missing}");
        let stated = tracked.text.unwrap_or_default();
        assert!(
            stated.contains("those of faulty electrodes (6) are not used; this ends"),
            "{missing}: {stated}"
        );
        for (reading, value) in followed.readings.iter().enumerate() {
            assert!(
                !uses(reading) || value.volts().is_none(),
                "{missing}: {reading}"
            );
        }
    }
}

#[test]
fn frame_of_nearly_0_v_is_unknown_and_not_an_empty_sheet() {
    let (mut tracking, _) = tracking();
    let readings = tracking.model().pairs().protocol().len();
    let frame = vec![Reading::Ok(Volts(1e-7)); readings];
    let followed = tracking.follow(&frame, FIRST_S).unwrap();
    assert_eq!(followed.tracked.judgement, Judgement::Unknown);
    let reason = followed.tracked.reason;
    assert_eq!(reason, Some(Doubtful::TooFewReadings));
    assert!(
        followed
            .readings
            .iter()
            .all(|reading| reading.volts().is_none())
    );
}

#[test]
fn baseline_is_not_younger_than_its_frames() {
    let (mut tracking, baseline) = tracking();
    tracking.follow(&baseline, FIRST_S).unwrap();
    // the baseline was recorded with a clock that was ahead
    tracking.follow(&baseline, FIRST_S - 86_400.0).unwrap();
    assert_eq!(tracking.state().began_s, FIRST_S - 86_400.0);
    assert!(tracking.drift().is_ok());
}

#[test]
fn injections_of_nearly_0_v_are_not_known() {
    let (tracking, baseline) = tracking();
    let measurements = tracking.model().pairs().protocol().measurements();
    let after = |share: f64| {
        let mut window = InjectionWindow::default();
        for drive in 0..7 {
            let of_drive = |reading: &usize| measurements[*reading].drive.plus.0 == drive;
            let readings = (0..baseline.len()).filter(of_drive).map(|reading| {
                let volts = share * baseline[reading].volts().unwrap().0;
                TimedReading { reading, volts }
            });
            let at_s = 0.5 * drive as f64;
            let readings = readings.collect();
            window.push(Injection { at_s, readings }, 0.4);
        }
        let (after, disc) = tracking
            .after_injection(&window, measurements[0].drive, FIRST_S)
            .unwrap();
        assert_eq!((&after.load, disc), (&None, None));
        after
    };
    let empty = after(1.0);
    assert!(empty.known, "{empty}");
    assert_eq!(empty.to_string(), "the sheet is empty");
    // no current flows
    let off = after(1e-3);
    assert!(!off.known, "{off}");
    let text = off.to_string();
    assert!(text.starts_with("no load was found; not known"), "{text}");
    assert!(text.contains("nearly 0 V"), "{text}");
}
