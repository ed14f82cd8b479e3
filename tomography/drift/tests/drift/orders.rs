//! A user's orders overrule the tracker; and the separation of drift by kind. Data are linear draws of the drift.

use std::sync::Arc;

use drift::{Judgement, Sizes, Tracker, TrackerState, TrackingOrder};

use crate::walk::{EVERY_S, follow, walked};

#[test]
fn empty_now_makes_a_present_load_part_of_the_sheet() {
    let (mut walk, mut tracker) = walked(0);
    let fixture = walk.model.disc([0.06, 0.07], 0.06) * -0.3;
    for frame in 1..=30 {
        follow(&mut tracker, &mut walk, frame, None);
    }
    for frame in 31..=60 {
        let answer = follow(&mut tracker, &mut walk, frame, Some((&fixture, 1.0)));
        assert_eq!(answer.judgement, Judgement::Loaded, "frame {frame}");
    }
    tracker.order(TrackingOrder::LoadedNow);
    tracker.order(TrackingOrder::EmptyNow); // the later of two that contradict each other
    let pace = tracker.state().pace();
    for frame in 61..=250 {
        let answer = follow(&mut tracker, &mut walk, frame, Some((&fixture, 1.0)));
        let carried_out = if frame == 61 {
            vec![TrackingOrder::EmptyNow]
        } else {
            vec![]
        };
        assert_eq!(answer.orders, carried_out, "frame {frame}");
        let expected = (Judgement::Empty, 0, 0.0);
        assert_eq!(
            (answer.judgement, answer.loads, answer.since_empty_s),
            expected,
            "frame {frame}"
        );
        // the comparison with a day-old anchor does not report it either
        assert_eq!(answer.anchor, None, "frame {frame}");
    }
    assert_eq!(tracker.state().pace(), pace, "it is no drift");
    let press = &fixture + walk.model.disc([0.12, 0.15], 0.02) * -0.5;
    let answer = follow(&mut tracker, &mut walk, 251, Some((&press, 1.0)));
    let found = answer
        .event
        .expect("a press beside it is seen")
        .fit
        .disc
        .centre;
    assert!((found[0] - 0.12).hypot(found[1] - 0.15) < 1e-3, "{found:?}");
}

#[test]
fn loaded_now_learns_nothing_until_empty_now() {
    let (mut walk, mut tracker) = walked(0);
    let load = walk.model.disc([0.1, 0.1], 0.03);
    for frame in 1..=30 {
        follow(&mut tracker, &mut walk, frame, None);
    }
    tracker.order(TrackingOrder::LoadedNow);
    let before = tracker.baseline();
    for frame in 31..=100 {
        // the loss rises by 2 % a day: without the order it would be learnt as drift
        let loss = -0.02 * (frame - 30) as f64 / 144.0;
        let answer = follow(&mut tracker, &mut walk, frame, Some((&load, loss)));
        assert!(
            answer.held && answer.judgement == Judgement::Loaded,
            "frame {frame}"
        );
        assert_eq!(tracker.baseline(), before, "frame {frame}");
    }
    tracker.order(TrackingOrder::EmptyNow);
    let answer = follow(&mut tracker, &mut walk, 101, None);
    assert!(!answer.held && answer.judgement == Judgement::Empty);
    assert_ne!(tracker.baseline(), before);
}

#[test]
fn a_slow_load_that_a_person_confirms_is_shown_again() {
    let (mut walk, mut tracker) = walked(0);
    let load = walk.model.disc([0.06, 0.15], 0.03);
    let loss = |frame: usize| -0.02 * (frame as f64 / 144.0 - 1.0).clamp(0.0, 6.0);
    let mut alarmed = None;
    for frame in 1..=144 * 9 {
        let answer = follow(&mut tracker, &mut walk, frame, Some((&load, loss(frame))));
        if answer.anchor.is_some() {
            alarmed = Some(frame);
            break;
        }
    }
    let alarmed = alarmed.expect("an anchor shows it");
    let shown = |tracker: &Tracker| {
        let fit = tracker
            .whitened()
            .unwrap()
            .fit_disc(&walk_model(tracker))
            .unwrap();
        (fit.is_load(), fit.disc)
    };
    assert!(!shown(&tracker).0, "it was learnt as drift");
    let mut silenced = tracker.clone();
    tracker.order(TrackingOrder::LoadedNow);
    follow(
        &mut tracker,
        &mut walk,
        alarmed + 1,
        Some((&load, loss(alarmed + 1))),
    );
    let (is_load, disc) = shown(&tracker);
    let off = (disc.centre[0] - 0.06).hypot(disc.centre[1] - 0.15);
    assert!(is_load && off < 10e-3 && disc.loss > 0.005, "{disc:?}");
    // alternatively, the user declares it ageing: no alarm for a day without further change
    silenced.order(TrackingOrder::ForgetAnchor);
    for frame in alarmed + 1..alarmed + 145 {
        let answer = follow(
            &mut silenced,
            &mut walk,
            frame,
            Some((&load, loss(alarmed))),
        );
        assert_eq!(answer.anchor, None, "frame {frame}");
    }
}

fn walk_model(tracker: &Tracker) -> Arc<drift::DriftModel> {
    Arc::clone(tracker.model())
}

#[test]
fn an_order_waits_in_the_stored_state_for_its_frame() {
    let (mut walk, mut tracker) = walked(0);
    let load = walk.model.disc([0.06, 0.07], 0.06) * -0.3;
    for frame in 1..=20 {
        follow(
            &mut tracker,
            &mut walk,
            frame,
            Some((&load, f64::from(u8::from(frame > 10)))),
        );
    }
    tracker.order(TrackingOrder::EmptyNow);
    let text = serde_json::to_string(tracker.state()).unwrap();
    let state: TrackerState = serde_json::from_str(&text).unwrap();
    let mut again = Tracker::restore(Arc::clone(&walk.model), state).unwrap();
    // too few readings to judge the frame: the order stays pending
    let none = vec![survey::Reading::NotMeasured; 598];
    assert!(again.follow(&none, EVERY_S * 20.5).is_err());
    assert!(tracker.follow(&none, EVERY_S * 20.5).is_err());
    // a repeated order is executed once
    again.order(TrackingOrder::EmptyNow);
    for frame in 21..=40 {
        let readings = walk.frame(Some((&load, 1.0)));
        let at_s = EVERY_S * frame as f64;
        let one = tracker.follow(&readings, at_s).unwrap();
        assert_eq!(one, again.follow(&readings, at_s).unwrap());
        assert_eq!(one.judgement, Judgement::Empty);
        assert_eq!(tracker.state(), again.state());
    }
}

#[test]
fn drift_by_kind_names_gain_contact_and_place() {
    let (walk, tracker) = walked(0);
    let model = &walk.model;
    let error = model.noise().clone();
    let none = Sizes {
        gain: 0.0,
        contact: 0.0,
        field: 0.0,
        local: 0.0,
    };
    assert!(model.drift(&none).norm() == 0.0);
    let gain = model.fit().readings.clone() * 0.02;
    let kinds = model.kinds(&gain, &error, 7.0, 1.0).unwrap();
    assert!((kinds.gain - 0.02).abs() < 0.004, "{kinds:?}");
    let rest = kinds.data_v.contact + kinds.data_v.field + kinds.data_v.local;
    assert!(rest < 0.3 * kinds.data_v.gain, "{kinds:?}");
    let place = model.disc([0.05, 0.15], 0.03) * -0.05;
    let kinds = model.kinds(&place, &error, 30.0, 1.0).unwrap();
    let [x, y] = kinds.local.centre;
    let off = (x - 0.05).hypot(y - 0.15);
    assert!(off < 15e-3 && kinds.local.change < -0.01, "{kinds:?}");
    assert!(kinds.data_v.local > kinds.data_v.gain, "{kinds:?}");
    // nothing has changed
    let kinds = tracker.kinds(0.0).unwrap();
    assert_eq!((kinds.gain, kinds.local.change), (0.0, 0.0));
}
