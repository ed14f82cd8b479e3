//! Loads other than a single disc: with a soft edge, several at once, and on a sheet that is never empty. Nonlinear
//! data of a finer mesh on a drifting sheet.

use drift::{Answer, Judgement, Tracker};
use nalgebra::DVector;

use crate::walk::{EVERY_S, Walk, walked};

const DAY: usize = 144;

struct Rig {
    walk: Walk,
    tracker: Tracker,
    frame: usize,
}

impl Rig {
    /// A rig after this number of frames of the empty sheet.
    fn new(frames: usize) -> Self {
        let (walk, tracker) = walked(frames);
        Self {
            walk,
            tracker,
            frame: frames,
        }
    }

    /// The change of the data by a loss as a function of position, m.
    fn load(&self, loss: impl Fn([f64; 2]) -> f64) -> DVector<f64> {
        let loaded = self.walk.sheet.readings(|_| 1.0, |at| 1.0 - loss(at));
        self.walk.model.relative(&loaded).unwrap().data
    }

    fn follow(&mut self, load: Option<&DVector<f64>>) -> Answer {
        self.frame += 1;
        let readings = self.walk.frame(load.map(|load| (load, 1.0)));
        let at_s = EVERY_S * self.frame as f64;
        self.tracker.follow(&readings, at_s).unwrap()
    }
}

fn away([x, y]: [f64; 2], place: [f64; 2]) -> f64 {
    (x - place[0]).hypot(y - place[1])
}

fn disc(place: [f64; 2]) -> impl Fn([f64; 2]) -> f64 {
    move |at| if away(at, place) < 15e-3 { 0.5 } else { 0.0 }
}

#[test]
fn soft_edged_load_comes_and_goes_at_its_place() {
    let mut rig = Rig::new(30);
    for (place, width) in [
        ([0.08, 0.14], 8e-3),
        ([0.12, 0.09], 15e-3),
        ([0.07, 0.06], 25e-3),
    ] {
        let soft = |at| 0.5 * (-0.5 * (away(at, place) / width).powi(2)).exp();
        let load = rig.load(soft);
        let came = rig.follow(Some(&load)).event.expect("a step");
        let off = away(came.fit.disc.centre, place);
        // the load is not a disc, so the fitted disc may be rejected; its centre is then less accurate
        let bound = if came.fit.accepted { 0.5e-3 } else { 2e-3 };
        assert!(came.came && off < bound, "{width} {off}");
        for _ in 0..12 {
            let answer = rig.follow(Some(&load));
            assert_eq!((answer.judgement, answer.loads), (Judgement::Loaded, 1));
            assert!(answer.event.is_none() && answer.fault.is_none(), "{width}");
        }
        let went = rig.follow(None);
        assert_eq!(went.judgement, Judgement::Empty, "{width}");
        assert!(went.event.is_some_and(|event| !event.came), "{width}");
        for _ in 0..6 {
            assert_eq!(rig.follow(None).judgement, Judgement::Empty, "{width}");
        }
    }
}

/// Loads that come with one frame count as one until one of them goes.
#[test]
fn loads_that_come_at_once_go_one_by_one() {
    let mut rig = Rig::new(30);
    let places = [[0.06, 0.07], [0.15, 0.16]];
    let first = rig.load(disc(places[0]));
    let both = rig.load(|at| disc(places[0])(at) + disc(places[1])(at));
    let came = rig.follow(Some(&both)).event.expect("a step");
    // one disc cannot explain both loads: the fit is rejected
    assert!(came.came && !came.fit.accepted);
    for _ in 0..6 {
        assert_eq!(rig.follow(Some(&both)).judgement, Judgement::Loaded);
    }
    let went = rig.follow(Some(&first));
    let event = went.event.expect("a step");
    let off = away(event.fit.disc.centre, places[1]);
    assert!(!event.came && off < 1e-3, "{off}");
    assert_eq!(went.judgement, Judgement::Loaded);
    for _ in 0..12 {
        let answer = rig.follow(Some(&first));
        assert_eq!(answer.judgement, Judgement::Loaded);
        assert!(answer.event.is_none());
    }
    assert_eq!(rig.follow(None).judgement, Judgement::Empty);
}

#[test]
fn presses_are_found_beside_loads_that_never_leave() {
    let mut rig = Rig::new(DAY);
    let lie = |at| disc([0.06, 0.07])(at) + disc([0.15, 0.16])(at);
    let lying = rig.load(lie);
    let presses = [[0.10, 0.12], [0.06, 0.15], [0.15, 0.06]];
    let pressed: Vec<DVector<f64>> = presses
        .iter()
        .map(|&place| rig.load(|at| lie(at) + disc(place)(at)))
        .collect();
    rig.follow(Some(&lying));
    // three days without an empty frame, a press every eight hours
    for visit in 0..9 {
        for _ in 0..47 {
            let answer = rig.follow(Some(&lying));
            assert_eq!(answer.judgement, Judgement::Loaded, "visit {visit}");
            assert!(
                answer.event.is_none() && answer.fault.is_none(),
                "visit {visit}"
            );
        }
        let k = visit % presses.len();
        let came = rig.follow(Some(&pressed[k])).event.expect("a step");
        let off = away(came.fit.disc.centre, presses[k]);
        assert!(came.came && off < 1e-3, "visit {visit}: {off}");
        let went = rig.follow(Some(&lying));
        assert!(went.event.is_some_and(|event| !event.came), "visit {visit}");
        assert_eq!(went.judgement, Judgement::Loaded, "visit {visit}");
    }
    // the loads were not learnt as drift: without them the sheet is empty
    let empty = rig.follow(None);
    assert_eq!((empty.judgement, empty.loads), (Judgement::Empty, 0));
}
