use super::*;
use crate::effects::{EffectSettings, Effects};
use crate::law::Pressure;

#[test]
fn punch_and_sphere_integrate_to_their_force() {
    let sphere = Contact::Sphere { radius_mm: 20.0 };
    for contact in [Contact::Even, Contact::Punch, sphere] {
        // the pressure (in F / (pi a²)) is integrated with r = sin(angle), which removes the singularity at the punch's
        // edge
        let steps = 2000;
        let width = 0.5 * PI / f64::from(steps);
        let mut force = 0.0;
        for step in 0..steps {
            let (r, left) = ((f64::from(step) + 0.5) * width).sin_cos();
            let density = match contact {
                Contact::Even => 1.0,
                Contact::Punch => 0.5 / left,
                Contact::Sphere { .. } => 1.5 * left,
            };
            force += density * 2.0 * r * left * width;
            let edge = (f64::from(step + 1) * width).sin();
            assert!(
                (force - contact.within(edge)).abs() < 1e-6,
                "{contact:?} {edge}"
            );
        }
        assert_eq!(contact.within(1.0), 1.0);
        // the force of 300 g on 12 mm, summed over the rings
        let mut within = 0.0;
        let mut newton = 0.0;
        for (outer, kpa) in rings(contact, 300.0, 12.0) {
            newton += kpa * 1e3 * PI * 36e-6 * (outer * outer - within * within);
            within = outer;
        }
        let wanted = 0.3 * GRAVITY;
        assert!(
            (newton / wanted - 1.0).abs() <= 1e-12,
            "{contact:?} {newton}"
        );
    }
}

#[test]
fn hertz_has_his_radius_and_his_pressure() {
    let (mass, radius, modulus) = (300.0, 30.0, 200.0);
    let a = hertz_radius_mm(radius, mass, modulus) * 1e-3;
    let force = 0.3 * GRAVITY;
    assert!((a.powi(3) * 4.0 * 200e3 / (3.0 * force * 30e-3) - 1.0).abs() <= 1e-12);
    // p_0 = 3 F / (2 pi a²); the mean over the innermost ring is lower, by a quarter of its relative radius squared
    let peak = 1.5 * force / (PI * a * a) * 1e-3;
    let rings = rings(Contact::Sphere { radius_mm: radius }, mass, 2e3 * a);
    let (outer, first) = rings[0];
    assert!((first / peak - (1.0 - 0.25 * outer * outer)).abs() < 1e-6);
}

#[test]
fn what_is_lost_under_an_uneven_pressure_is_that_of_its_force() {
    let effects: EffectSettings = toml::from_str("gauge-law.factor = 1e-6").unwrap();
    let law = Effects::new(&effects, 0).law(Pressure {
        modulus_kpa: 1e3,
        ..Pressure::default()
    });
    let mesh = eit::PaperSheet::default().mesh().unwrap();
    for contact in [
        Contact::Even,
        Contact::Punch,
        Contact::Sphere { radius_mm: 80.0 },
    ] {
        let timed = TimedLoad {
            amount: Amount::Mass(300.0),
            contact,
            ..TimedLoad::still(Load::disc([101.3, 120.7], 14.0, 0.0), Duration::ZERO, None)
        };
        let print = timed.print([0, 0], &law, &mesh).unwrap();
        // the loss is 1e-6 of the strain and the strain is p / 1 MPa, so the sum is the force in newtons
        let force: f64 = print
            .iter()
            .map(|(t, lost)| lost * mesh.area(*t) * 1e12)
            .sum();
        assert!(
            (force / (0.3 * GRAVITY) - 1.0).abs() < 1e-6,
            "{contact:?} {force}"
        );
    }
}

#[test]
fn a_way_has_its_steps_at_their_times() {
    let seconds = Duration::from_secs;
    let waypoint = |at, x, mass| Waypoint {
        at: seconds(at),
        centre_mm: [x, 50.0],
        amount: Amount::Mass(mass),
    };
    let timed = TimedLoad {
        amount: Amount::Mass(100.0),
        path: vec![
            waypoint(20, 50.0, 100.0),
            waypoint(30, 60.0, 100.0),
            waypoint(40, 60.0, 200.0),
        ],
        ..TimedLoad::still(
            Load::disc([50.0, 50.0], 10.0, 0.0),
            seconds(10),
            Some(seconds(60)),
        )
    };
    assert_eq!(timed.stage(seconds(9)), None);
    assert_eq!(timed.stage(seconds(15)), Some([0, 0]));
    // the path of 10 mm has steps of 0.25 mm, the force of 100 g of 200 has steps of 2 %
    assert_eq!(timed.stage(seconds(25)), Some([1, 20]));
    assert_eq!(timed.stage(Duration::from_millis(39_999)), Some([2, 24]));
    assert_eq!(timed.stage(seconds(59)), Some([3, 0]));
    assert_eq!(timed.stage(seconds(60)), None);
    let mut changes = Vec::new();
    let mut last = Duration::ZERO;
    while let Some(next) = timed.next_change(last) {
        assert!(next > last);
        changes.push(next.as_secs_f64());
        last = next;
    }
    assert_eq!(changes.len(), 1 + 1 + 40 + 25 + 1, "{changes:?}");
    // the repetitions are like the first time
    let again = TimedLoad {
        repeat: Some(Repeat::new(100.0, 3).unwrap()),
        ..timed.clone()
    };
    assert_eq!(again.end(), Some(seconds(260)));
    let mut all = Vec::new();
    let mut last = Duration::ZERO;
    while let Some(next) = again.next_change(last) {
        all.push(next.as_secs_f64());
        last = next;
    }
    assert_eq!(all.len(), 3 * changes.len());
    for (k, moment) in all.iter().enumerate() {
        let first = changes[k % changes.len()];
        let round = (k / changes.len()) as f64;
        assert!((moment - first - 100.0 * round).abs() < 1e-6, "{k}");
    }
    assert_eq!(again.stage(seconds(225)), timed.stage(seconds(25)));
    for off in [9, 60, 109, 160, 260, 325] {
        assert_eq!(again.stage(seconds(off)), None, "{off}");
    }
    // the error of the position is at most half a step
    for millis in (20_000..30_000).step_by(7) {
        let stage = timed.stage(Duration::from_millis(millis)).unwrap();
        let exact = 50.0 + (millis - 20_000) as f64 / 1000.0;
        let off = timed.middle(stage).centre_mm[0] - exact;
        assert!(off.abs() <= 0.5 * STEP_MM + 1e-9, "{off}");
    }
}
