//! Conditions for the reuse of an electrode that lost its contact. Readings of the open contact are from a finer mesh.

use std::sync::Arc;

use drift::{
    Answer, ElectrodeCheck, ElectrodeFault, Injection, Judgement, TimedReading, Tracker,
    TrackingOrder,
};
use nalgebra::DVector;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use survey::{Electrode, Reading, Volts};

use crate::sheet::Sheet;
use crate::walk::{EVERY_S, Walk, walked};

const OPEN: usize = 7;
/// Frames within an hour.
const HOUR: usize = 6;

/// The walk and its tracker, after a day of frames.
struct Days {
    walk: Walk,
    tracker: Tracker,
    frame: usize,
    /// Ratios of the electrode's readings with an open contact to those with a closed one.
    of_open: Vec<f64>,
    load: nalgebra::DVector<f64>,
}

impl Days {
    fn new() -> Self {
        let frame = 24 * HOUR;
        let (walk, tracker) = walked(frame);
        let open = |electrode| if electrode == OPEN { 1e7 } else { 1.0 };
        let open = walk.sheet.readings(open, |_| 1.0);
        let volts = |reading: &Reading| reading.volts().unwrap().0;
        let both = open.iter().zip(&walk.sheet.baseline);
        let disc = |[x, y]: [f64; 2]| (x - 0.080_f64).hypot(y - 0.140) < 15e-3;
        let loaded = walk
            .sheet
            .readings(|_| 1.0, |at| if disc(at) { 0.5 } else { 1.0 });
        Self {
            of_open: both
                .map(|(open, closed)| volts(open) / volts(closed))
                .collect(),
            load: walk.model.relative(&loaded).unwrap().data,
            walk,
            tracker,
            frame,
        }
    }

    /// Follows a frame after this number of intervals.
    fn follow(&mut self, intervals: usize, open: bool, loaded: bool) -> Answer {
        self.frame += intervals;
        let load = self.load.clone();
        let mut readings = self.walk.frame(loaded.then_some((&load, 1.0)));
        if open {
            for (reading, factor) in readings.iter_mut().zip(&self.of_open) {
                *reading = Reading::Ok(Volts(reading.volts().unwrap().0 * factor));
            }
        }
        let at_s = EVERY_S * self.frame as f64;
        self.tracker.follow(&readings, at_s).unwrap()
    }
}

fn names_it(answer: &Answer) -> bool {
    matches!(
        answer.fault,
        Some(ElectrodeFault::Risen {
            electrode: OPEN,
            ..
        })
    )
}

#[test]
fn electrode_that_heals_is_used_again_after_an_hour() {
    let mut days = Days::new();
    let known = days.tracker.state().deviation();
    assert!(names_it(&days.follow(1, true, false)));
    for _ in 0..4 * 24 * HOUR {
        let answer = days.follow(1, true, false);
        assert_eq!(answer.masked, [OPEN]);
        assert_eq!(answer.judgement, Judgement::Empty);
    }
    // the uncertainty of what the lost readings would show grows with each frame
    let grown = days.tracker.state().deviation() / known;
    assert!(grown > 40.0, "{grown}");
    for _ in 1..HOUR {
        // a restart does not prolong the wait
        let state = days.tracker.state().clone();
        days.tracker = Tracker::restore(Arc::clone(days.tracker.model()), state).unwrap();
        assert_eq!(days.follow(1, false, false).masked, [OPEN]);
    }
    for _ in 0..24 * HOUR {
        let answer = days.follow(1, false, false);
        assert!(answer.masked.is_empty() && answer.fault.is_none());
        assert_eq!(answer.judgement, Judgement::Empty);
    }
}

#[test]
fn electrode_that_is_open_for_weeks_is_named_once() {
    let mut days = Days::new();
    assert!(names_it(&days.follow(1, true, false)));
    // intervals shorter than the hour after which an electrode without a fault is used again
    let often = HOUR - 1;
    for _ in 0..20 * 24 * HOUR / often {
        let answer = days.follow(often, true, false);
        assert_eq!(answer.masked, [OPEN]);
        assert!(answer.fault.is_none() && answer.judgement == Judgement::Empty);
    }
    assert_eq!(days.follow(1, false, false).masked, [OPEN]);
    days.follow(often, false, false);
    assert!(days.follow(1, false, false).masked.is_empty());
}

#[test]
fn electrode_stays_masked_while_a_load_hides_whether_it_healed() {
    let mut days = Days::new();
    assert!(names_it(&days.follow(1, true, false)));
    let came = days.follow(1, true, true);
    assert!(came.event.is_some_and(|event| event.came));
    // ten hours, then a gap of as many
    for frame in 0..20 * HOUR {
        let intervals = if frame == 10 * HOUR { 10 * HOUR } else { 1 };
        let answer = days.follow(intervals, frame < 15 * HOUR, true);
        assert_eq!(answer.masked, [OPEN], "{frame}");
        assert_eq!(answer.judgement, Judgement::Loaded);
        assert!(answer.event.is_none(), "{frame}");
    }
    let went = days.follow(1, false, false);
    assert_eq!(went.judgement, Judgement::Empty);
    for _ in 1..HOUR {
        assert_eq!(days.follow(1, false, false).masked, [OPEN]);
    }
    assert!(days.follow(1, false, false).masked.is_empty());
}

#[test]
fn electrode_waits_an_hour_after_the_clock_was_set_back() {
    let mut days = Days::new();
    assert!(names_it(&days.follow(1, true, false)));
    days.frame -= 2 * HOUR;
    for _ in 0..HOUR {
        assert_eq!(days.follow(1, false, false).masked, [OPEN]);
    }
    // it stays in use at the time at which it was faulty by the clock before
    for _ in 0..3 * HOUR {
        assert!(days.follow(1, false, false).masked.is_empty());
    }
}

#[test]
fn floating_electrode_is_no_slow_load_of_an_order() {
    let mut days = Days::new();
    let measurements = days.walk.model.pairs().protocol().measurements().to_vec();
    // one of the two looks like a loss, the other like a gain
    for volts in [1e-3, -1e-3] {
        let mut tracker = days.tracker.clone();
        let mut follow = |tracker: &mut Tracker, intervals: usize| {
            let mut readings = days.walk.frame(None);
            for (k, (reading, one)) in readings.iter_mut().zip(&measurements).enumerate() {
                if one.electrodes().contains(&Electrode(OPEN)) {
                    let own = reading.volts().unwrap().0;
                    *reading = Reading::Ok(Volts(own + volts * (k as f64).sin()));
                }
            }
            let at_s = EVERY_S * (days.frame + intervals) as f64;
            tracker.follow(&readings, at_s).unwrap()
        };
        assert_eq!(follow(&mut tracker, 1).masked, [OPEN]);
        let before = tracker.baseline();
        tracker.order(TrackingOrder::LoadedNow);
        assert!(follow(&mut tracker, 2).held);
        // no loss had been learnt as drift
        assert_eq!(tracker.baseline(), before);
    }
}

/// Readings with noise of 2 uV.
fn noisy(readings: &[Reading], random: &mut ChaCha8Rng) -> Vec<Reading> {
    let with = |reading: &Reading| {
        let normal: f64 = StandardNormal.sample(random);
        Reading::Ok(Volts(reading.volts().unwrap().0 + 2e-6 * normal))
    };
    readings.iter().map(with).collect()
}

#[test]
fn what_a_lost_contact_changes_elsewhere_is_not_in_the_map() {
    let sheet = Sheet::new();
    let model = Arc::new(sheet.model());
    let mut random = ChaCha8Rng::seed_from_u64(23);
    let open = |electrode| if electrode == OPEN { 1e7 } else { 1.0 };
    let disc = |[x, y]: [f64; 2]| (x - 0.080_f64).hypot(y - 0.140) < 15e-3;
    let near = |[x, y]: [f64; 2]| (x - 0.190_f64).hypot(y - 0.040) < 15e-3;
    let bar = |[x, y]: [f64; 2]| (0.05..0.12).contains(&x) && (0.10..0.13).contains(&y);
    let none = |_: [f64; 2]| false;
    // a load beside the electrode changes the same readings as the contact
    let loads = [&none as &dyn Fn([f64; 2]) -> bool, &disc, &bar, &near];
    for (load, most) in loads.into_iter().zip([0.02, 0.02, 0.1, 0.4]) {
        let mut tracker = Tracker::new(Arc::clone(&model), 0.0).unwrap();
        let mut frame = 0;
        let mut follow = |tracker: &mut Tracker, readings: &[Reading], times: usize| {
            for _ in 0..times {
                frame += 1;
                let readings = noisy(readings, &mut random);
                tracker.follow(&readings, EVERY_S * frame as f64).unwrap();
            }
        };
        let sigma = |at: [f64; 2]| if load(at) { 0.5 } else { 1.0 };
        let lost = sheet.readings(open, |_| 1.0);
        let loaded = sheet.readings(open, sigma);
        follow(&mut tracker, &sheet.baseline.clone(), 30);
        follow(&mut tracker, &lost, 3);
        assert_eq!(tracker.state().masked(), [OPEN]);
        follow(&mut tracker, &loaded, 1);
        let now = |readings: &[Reading]| model.relative(readings).unwrap().data;
        let check = ElectrodeCheck::new(&model);
        let rows = check.without(&(0..299).collect::<Vec<_>>(), &[OPEN]);
        let size = |change: &DVector<f64>| change.select_rows(&rows).norm();
        let of_contact = now(&loaded) - now(&sheet.readings(|_| 1.0, sigma));
        let found = tracker.unlearnt().unwrap().unwrap();
        let left = size(&(&of_contact - found)) / size(&of_contact);
        println!("{left:.4}");
        assert!(left < most, "{left}");
    }
}

#[test]
fn lost_contact_is_no_load_after_an_injection() {
    let sheet = Sheet::new();
    let mut tracker = Tracker::new(Arc::new(sheet.model()), 0.0).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(29);
    let open = |electrode| if electrode == OPEN { 1e7 } else { 1.0 };
    let lost = sheet.readings(open, |_| 1.0);
    for frame in 1..=33 {
        let readings = if frame > 30 { &lost } else { &sheet.baseline };
        let readings = noisy(readings, &mut random);
        tracker.follow(&readings, EVERY_S * frame as f64).unwrap();
    }
    assert_eq!(tracker.state().masked(), [OPEN]);
    let readings = noisy(&lost, &mut random);
    let measurements = tracker.model().pairs().protocol().measurements();
    let injections = (0..26).map(|drive| Injection {
        at_s: EVERY_S * 33.0 + 0.5 * drive as f64,
        readings: (0..readings.len())
            .filter(|&reading| measurements[reading].drive.plus.0 == drive)
            .map(|reading| TimedReading {
                reading,
                volts: readings[reading].volts().unwrap().0,
            })
            .collect(),
    });
    let injections: Vec<Injection> = injections.collect();
    let found = tracker.moving_load(&injections, EVERY_S * 33.0 + 13.0);
    assert_eq!(found.unwrap(), None);
}
