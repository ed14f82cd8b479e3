use super::course::CourseSettings;
use super::*;

/// A square sheet of 200 mm, cut to squares of 2.5 mm of two triangles each.
const SIDE: f64 = 0.2;
const SQUARES: usize = 80;

fn triangles() -> Vec<[[f64; 2]; 3]> {
    let at = |k: usize| SIDE * k as f64 / SQUARES as f64;
    let mut triangles = Vec::new();
    for row in 0..SQUARES {
        for column in 0..SQUARES {
            let ([x0, x1], [y0, y1]) = ([at(column), at(column + 1)], [at(row), at(row + 1)]);
            triangles.push([[x0, y0], [x1, y0], [x1, y1]]);
            triangles.push([[x0, y0], [x1, y1], [x0, y1]]);
        }
    }
    triangles
}

fn rectangle(name: &str, rectangle_mm: [f64; 4]) -> RegionSettings {
    RegionSettings {
        name: name.into(),
        rectangle_mm: Some(rectangle_mm),
        polygon_mm: None,
    }
}

fn surface(regions: &[RegionSettings]) -> Surface {
    Surface::of_triangles(&triangles(), 9.5e-4, regions).unwrap()
}

/// Values at the centroids as a function of the distance from a point, mm.
fn about(surface: &Surface, [x, y]: [f64; 2], value: impl Fn(f64) -> f64) -> Vec<f64> {
    let centroids = surface.adjacency().centroids();
    let distance = |at: &[f64; 2]| (1e3 * at[0] - x).hypot(1e3 * at[1] - y);
    centroids.iter().map(|at| value(distance(at))).collect()
}

fn of(surface: &Surface, kpa: &[f64]) -> Vec<frame::MapValues> {
    frame::of_map(surface, kpa, 0.667, LoadUnit::Pressure)
}

fn near(found: Option<f64>, expected: f64, relative: f64) {
    let found = found.unwrap();
    assert!(
        (found - expected).abs() <= relative * expected.abs(),
        "{found} instead of {expected}"
    );
}

#[test]
fn a_uniform_disc_has_its_closed_form() {
    let surface = surface(&[]);
    // 8 kPa within 30 mm of (120, 80) mm: area pi 900 mm2, load 22.6 N
    let disc = about(
        &surface,
        [120.0, 80.0],
        |r| if r <= 30.0 { 8.0 } else { 0.0 },
    );
    let found = of(&surface, &disc).remove(0);
    let area = std::f64::consts::PI * 900.0;
    near(found.values.get(Quantity::Contact), area, 0.01);
    near(found.values.get(Quantity::Load), 8e-3 * area, 0.01);
    near(found.values.get(Quantity::Mean), 8.0, 1e-12);
    near(found.values.get(Quantity::CentreX), 120.0, 1e-3);
    near(found.values.get(Quantity::CentreY), 80.0, 1e-3);
    // a disc of 9.5 cm2 lies inside of it: its mean is that of the plateau
    near(found.values.get(Quantity::Ppi), 8.0, 1e-12);
    near(found.values.get(Quantity::Dispersion), 100.0, 1e-12);
    assert!(found.values.get(Quantity::Variation).unwrap() < 1e-3);
    assert_eq!(surface.adjacency().hot_spots(&disc, 0.667).len(), 1);
}

#[test]
fn the_centre_of_a_ring_is_outside_the_load() {
    let surface = surface(&[rectangle("hole", [80.0, 80.0, 120.0, 120.0])]);
    let ring = about(&surface, [100.0, 100.0], |r| {
        if (40.0..=60.0).contains(&r) { 5.0 } else { 0.0 }
    });
    let found = of(&surface, &ring);
    let area = std::f64::consts::PI * (3600.0 - 1600.0);
    near(found[0].values.get(Quantity::Contact), area, 0.01);
    near(found[0].values.get(Quantity::CentreX), 100.0, 1e-3);
    // the square of 40 mm lies in the hole of radius 40 mm, where there is no load
    assert_eq!(found[1].values.get(Quantity::Contact), Some(0.0));
    assert_eq!(found[1].values.get(Quantity::Mean), None);
    assert_eq!(found[1].values.get(Quantity::Dispersion), Some(0.0));
    // the ring is 20 mm wide, the disc 34.8 mm
    assert!(found[0].values.get(Quantity::Ppi).unwrap() < 4.5);
}

#[test]
fn a_hertz_contact_has_its_closed_form() {
    let surface = surface(&[]);
    // p = p0 sqrt(1 - r2/a2): load 2/3 pi a2 p0; mean over a disc of radius b: p0 (2 a2 / 3 b2) (1 - (1 - b2/a2)^1.5)
    let (largest, a) = (30.0, 40.0_f64);
    let hertz = about(&surface, [100.0, 100.0], |r| {
        largest * (1.0 - (r / a).powi(2)).max(0.0).sqrt()
    });
    let found = of(&surface, &hertz).remove(0);
    near(
        found.values.get(Quantity::Load),
        1e-3 * largest * 2.0 / 3.0 * std::f64::consts::PI * a * a,
        0.01,
    );
    near(found.values.get(Quantity::Peak), largest, 0.01);
    let b2 = 950.0 / std::f64::consts::PI;
    let index = largest * 2.0 * a * a / (3.0 * b2) * (1.0 - (1.0 - b2 / (a * a)).powf(1.5));
    near(found.values.get(Quantity::Ppi), index, 0.01);
    // sd over the contact area: E p2 = p0^2 / 2, E p = 2/3 p0; the threshold leaves out only the rim
    near(
        found.values.get(Quantity::Variation),
        100.0 * (0.5_f64 - 4.0 / 9.0).sqrt() * 1.5,
        0.05,
    );
    let at = found.ppi.unwrap();
    assert!((at[0] - 0.1).hypot(at[1] - 0.1) < 3e-3, "{at:?}");
}

#[test]
fn a_slope_has_its_gradient_and_a_corner_clips_the_disc() {
    let surface = surface(&[]);
    let centroids = surface.adjacency().centroids().to_vec();
    // 0.05 kPa per mm along x: exact inside of the sheet; at a corner of the sheet the means of unequal triangles are
    // 2.4 % off
    let slope: Vec<f64> = centroids.iter().map(|[x, _]| 50.0 * x).collect();
    near(
        of(&surface, &slope)[0].values.get(Quantity::Gradient),
        0.05,
        0.03,
    );
    // a load in the corner: the disc is clipped to the sheet, so that its mean is not that over 9.5 cm2
    let corner = about(&surface, [0.0, 0.0], |r| if r <= 60.0 { 4.0 } else { 0.0 });
    let found = of(&surface, &corner).remove(0);
    near(found.values.get(Quantity::Ppi), 4.0, 1e-9);
}

#[test]
fn a_region_cuts_triangles_in_their_share() {
    // the left edge of the region halves the squares of column 40
    let surface = surface(&[rectangle("right", [101.25, -10.0, 210.0, 210.0])]);
    let found = of(&surface, &vec![2.0; 2 * SQUARES * SQUARES]);
    near(found[1].values.get(Quantity::Contact), 98.75 * 200.0, 1e-3);
    near(
        found[1].values.get(Quantity::Dispersion),
        100.0 * 98.75 / 200.0,
        1e-3,
    );
    let refused = Surface::of_triangles(
        &triangles(),
        9.5e-4,
        &[rectangle("off", [300.0, 0.0, 400.0, 9.0])],
    );
    let reported = refused.err().map(|error| error.to_string()).unwrap();
    assert!(
        reported.contains("'off'") && reported.contains("(200, 200) mm"),
        "{reported}"
    );
}

/// A sheet of four squares of 10 mm, whose first is loaded.
fn course() -> (Surface, Course) {
    let triangles: Vec<_> = triangles().into_iter().take(8).collect();
    let surface = Surface::of_triangles(&triangles, 9.5e-4, &[]).unwrap();
    let settings = CourseSettings {
        threshold: 1.0,
        relief_s: 60.0,
        window_s: 480.0,
        hold_s: 100.0,
    };
    let course = Course::new(settings, 8, 1);
    (surface, course)
}

fn completed(surface: &Surface, course: &Course) -> Values {
    let mut values = Values::default();
    course.complete(surface, 0, &mut values);
    values
}

#[test]
fn dose_and_time_without_relief_by_hand() {
    let (surface, mut course) = course();
    let mut take = |at: f64, kpa: f64| {
        let mut loads = vec![0.0; 8];
        loads[0] = kpa;
        let values = of(&surface, &loads);
        course.take(at, &loads, &[values[0].values]);
        let found = completed(&surface, &course);
        [Quantity::Dose, Quantity::Unrelieved].map(|quantity| found.get(quantity).unwrap())
    };
    assert_eq!(take(0.0, 3.0), [0.0, 0.0]);
    // (3 - 1) kPa for 50 s
    assert_eq!(take(50.0, 3.0), [100.0, 50.0]);
    // 40 s below the threshold are no relief
    assert_eq!(take(100.0, 0.5), [200.0, 100.0]);
    assert_eq!(take(140.0, 3.0), [200.0, 100.0]);
    assert_eq!(take(150.0, 0.5), [220.0, 110.0]);
    // 60 s below it are a relief
    assert_eq!(take(210.0, 3.0), [220.0, 0.0]);
    // 101 s without a frame count for nothing
    assert_eq!(take(311.0, 3.0), [220.0, 0.0]);
    assert_eq!(take(321.0, 3.0), [240.0, 10.0]);
}

/// Quantities, as JSON, of a press that appears, moves and is removed; from the first frame or from a stored state.
fn from_frame(quantifier: &mut Quantifier, frames: std::ops::Range<u32>) -> Vec<String> {
    let taken = frames.map(|frame| {
        let loss = if frame % 7 == 6 { 0.0 } else { -0.3 };
        let mut map = Map::relative("", vec![loss; 8], "");
        map.values[3] = -0.1 * f64::from(frame % 5);
        let judged = JudgedMap {
            map: &map,
            pressure: None,
            noise: Some(0.05),
            tracked: None,
            compared: None,
        };
        let found = quantifier.take(20.0 * f64::from(frame), Some(&judged));
        serde_json::to_string(&found).unwrap()
    });
    taken.collect()
}

#[test]
fn quantities_over_time_of_frames_without_times_are_unknown() {
    let surface = Surface::of_triangles(&triangles(), 9.5e-4, &[]).unwrap();
    let disc = |x: f64| about(&surface, [x, 100.0], |r| if r <= 20.0 { -0.3 } else { 0.0 });
    let maps = [60.0, 70.0].map(|x| Map::relative("", disc(x), ""));
    let settings = QuantitySettings::default();
    let mut quantifier = Quantifier::of_surface(surface, settings, LoadUnit::RelativeLoss);
    let over_time = [
        Quantity::Speed,
        Quantity::Path,
        Quantity::Dose,
        Quantity::Unrelieved,
        Quantity::UnrelievedArea,
    ];
    let mut taken = |map: Option<&Map>| {
        let judged = map.map(|map| JudgedMap {
            map,
            pressure: None,
            noise: Some(0.05),
            tracked: None,
            compared: None,
        });
        let found = quantifier.take(None::<f64>, judged.as_ref());
        let sheet = &found.regions[0];
        assert!(over_time.iter().all(|of| sheet.values.get(*of).is_none()));
        assert_eq!((sheet.dose_mm, sheet.unrelieved_mm), (None, None));
        let [spot] = &found.spots[..] else {
            panic!("one hot spot: {:?}", found.spots);
        };
        assert_eq!((spot.number, spot.age_s, spot.speed_mm_s), (1, None, None));
        found
    };
    for map in &maps {
        let found = taken(Some(map));
        assert!(found.regions[0].values.get(Quantity::Load).unwrap() > 0.0);
    }
    taken(None);
}

#[test]
fn a_restart_at_any_frame_changes_no_bit() {
    let quantifier = |threshold_percent: f64| {
        let triangles: Vec<_> = triangles().into_iter().take(8).collect();
        let surface = Surface::of_triangles(&triangles, 9.5e-4, &[]).unwrap();
        let settings = QuantitySettings {
            threshold_percent,
            relief_s: 30.0,
            unrelieved_h: 0.05,
            ..QuantitySettings::default()
        };
        Quantifier::of_surface(surface, settings, LoadUnit::RelativeLoss)
    };
    let whole = from_frame(&mut quantifier(5.0), 0..30);
    for end in 1..30 {
        let mut before = quantifier(5.0);
        let mut taken = from_frame(&mut before, 0..end);
        let text = serde_json::to_string(&before.state()).unwrap();
        let state: QuantifierState = serde_json::from_str(&text).unwrap();
        let mut after = quantifier(5.0);
        after.restore(&state).unwrap();
        taken.extend(from_frame(&mut after, end..30));
        assert_eq!(taken, whole, "restart after {end}");
        // the state of another threshold is refused, because its dose differs
        let mut other = quantifier(6.0);
        assert!(other.restore(&state).is_err());
        assert_ne!(from_frame(&mut other, end..30), whole[end as usize..]);
    }
}

#[test]
fn a_dose_of_90_days_keeps_twelve_digits() {
    let settings = CourseSettings {
        threshold: 0.0,
        relief_s: 60.0,
        window_s: 14_400.0,
        hold_s: 900.0,
    };
    let mut course = Course::new(settings, 1, 0);
    let begin = 1_800_000_000.0;
    let seconds = 90 * 86_400;
    for second in 0..=seconds {
        course.take(begin + f64::from(second), &[0.1], &[]);
    }
    let exact = 0.1 * f64::from(seconds);
    let error = (course.dose()[0] - exact).abs() / exact;
    // a plain sum is off by 1e-10
    assert!(error <= 1e-12, "{error:e}");
    // a clock that is set back, and a gap, add nothing
    let before = course.dose()[0];
    course.take(begin, &[0.1], &[]);
    course.take(begin + 901.0, &[0.1], &[]);
    assert_eq!(course.dose()[0], before);
}

#[test]
fn a_gap_is_no_relief() {
    let (surface, mut course) = course();
    let mut take = |at: f64| {
        let mut loads = vec![0.0; 8];
        loads[0] = 3.0;
        course.take(at, &loads, &[Values::default()]);
        completed(&surface, &course).get(Quantity::Unrelieved)
    };
    take(0.0);
    assert_eq!(take(50.0), Some(50.0));
    // after an hour without frames the time continues from its last value
    assert_eq!(take(3650.0), Some(50.0));
    assert_eq!(take(3660.0), Some(60.0));
}

#[test]
fn the_unrelieved_area_is_known_after_a_whole_window() {
    let (surface, mut course) = course();
    let mut loads = vec![0.0; 8];
    loads[..2].fill(2.0);
    let mut take = |second: u32, loads: &[f64]| {
        course.take(f64::from(second), loads, &[Values::default()]);
        completed(&surface, &course).get(Quantity::UnrelievedArea)
    };
    for second in (0..450).step_by(10) {
        assert_eq!(take(second, &loads), None, "{second} s");
    }
    // two triangles, each half of a square of 2.5 mm
    near(take(460, &loads), 6.25, 1e-9);
    // a relief of 30 s is more than 5 % of 480 s
    loads[0] = 0.0;
    for second in [470, 480, 490] {
        take(second, &loads);
    }
    near(take(500, &loads), 3.125, 1e-9);
}

#[test]
fn the_unrelieved_area_has_one_window_after_a_clock_step_back() {
    let (surface, mut course) = course();
    let mut loads = vec![0.0; 8];
    let mut take = |second: u32, loads: &[f64]| {
        course.take(f64::from(second), loads, &[Values::default()]);
        completed(&surface, &course).get(Quantity::UnrelievedArea)
    };
    for second in (0..=480).step_by(10) {
        take(second, &loads);
    }
    loads[..2].fill(2.0);
    for second in (240..720).step_by(10) {
        take(second, &loads);
    }
    // loaded during all of the last 480 s; half of them were counted twice because the clock was set back
    near(take(720, &loads), 6.25, 1e-9);
}

#[test]
fn the_path_of_the_centre_is_the_sum_of_its_steps() {
    let surface = surface(&[]);
    let settings = CourseSettings {
        threshold: 0.667,
        relief_s: 60.0,
        window_s: 480.0,
        hold_s: 100.0,
    };
    let mut course = Course::new(settings, 2 * SQUARES * SQUARES, 1);
    let mut speeds = Vec::new();
    for (second, x) in [(0.0, 60.0), (2.0, 70.0), (4.0, 65.0)] {
        let disc = about(&surface, [x, 100.0], |r| if r <= 20.0 { 5.0 } else { 0.0 });
        let values = of(&surface, &disc)[0].values;
        course.take(second, &disc, &[values]);
        speeds.push(completed(&surface, &course).get(Quantity::Speed));
    }
    assert_eq!(speeds[0], None);
    near(speeds[1], 5.0, 0.01);
    near(completed(&surface, &course).get(Quantity::Path), 15.0, 0.01);
}

#[test]
fn rows_have_the_smallest_mean_and_largest_of_their_frames() {
    let frame = |load: f64, known: bool| {
        let mut values = Values::default();
        values.set(Quantity::Load, Some(load));
        FrameQuantities {
            known,
            reason: None,
            unit: LoadUnit::Pressure,
            regions: vec![RegionQuantities {
                name: SHEET.into(),
                values,
                deviations: Values::default(),
                peak_mm: None,
                ppi_mm: None,
                dose_mm: None,
                unrelieved_mm: None,
            }],
            spots: Vec::new(),
            changes: Vec::new(),
        }
    };
    let mut rows = Rows::new(60);
    assert!(rows.take(119.0, &frame(9.0, true)).is_empty());
    let first = rows.take(120.0, &frame(4.0, true));
    assert_eq!(
        (first[0].begin_s, first[0].max, first[0].frames),
        (60, 9.0, 1)
    );
    rows.take(150.0, &frame(1.0, false));
    rows.take(179.9, &frame(7.0, true));
    let second = rows.end().remove(0);
    assert_eq!(
        (second.begin_s, second.min, second.mean, second.max),
        (120, 1.0, 4.0, 7.0)
    );
    assert_eq!((second.frames, second.known), (3, 2));
}
