//! Changes outside of the region of interest are not mapped as loads inside of it if the whole sheet is unknown. Frames
//! are simulated on a finer mesh than the model's, with 2 uV of noise on baseline and frame.

use imaging::{Conditions, Geometry, Method, ReconstructionSettings, Unknowns, build};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use studies::honesty::FineSheet;
use studies::{add_noise, measured};
use survey::{Amps, Map, Protocol, Reading};

const CURRENT: f64 = 1e-3;
const NOISE: f64 = 2e-6;

/// Frames of the finer sheet, with noise.
struct Rig {
    sheet: FineSheet,
    random: ChaCha8Rng,
}

impl Rig {
    /// A frame; `factor` is the factor of the conductance as a function of the position (m) of a triangle.
    fn frame(&mut self, factor: impl Fn([f64; 2]) -> f64) -> Vec<Reading> {
        let answers = self.sheet.readings(&self.sheet.factors(factor)).unwrap();
        let mut volts: Vec<f64> = answers.iter().map(|answer| CURRENT * answer).collect();
        add_noise(&mut volts, NOISE, &mut self.random);
        measured(&volts)
    }
}

struct Maps {
    geometry: Geometry,
    protocol: Protocol,
}

impl Maps {
    fn of(&self, settings: &ReconstructionSettings, frames: [&[Reading]; 2]) -> Map {
        let mut conditions = Conditions::live(&self.geometry, &self.protocol, Amps(CURRENT));
        conditions.noise_v = Some(NOISE);
        let model = build(settings, &conditions).unwrap();
        model
            .reconstructor
            .reconstruct(frames[0], frames[1])
            .unwrap()
    }

    /// Position of an electrode, m.
    fn electrode(&self, index: usize) -> [f64; 2] {
        let mesh = &self.geometry.mesh;
        let ends: Vec<[f64; 2]> = mesh.electrode_edges()[index]
            .iter()
            .map(|edge| mesh.nodes()[edge[0]])
            .collect();
        [0, 1].map(|axis| ends.iter().map(|end| end[axis]).sum::<f64>() / ends.len() as f64)
    }

    /// Distance between the position in the map and the true one, mm.
    fn error_mm(&self, map: &Map, at: [f64; 2]) -> f64 {
        let mesh = &self.geometry.mesh;
        let found = map
            .found(&mesh.region_centroids(), &mesh.region_areas())
            .unwrap();
        1e3 * (found[0] - at[0]).hypot(found[1] - at[1])
    }
}

fn disc(at: [f64; 2], radius: f64, inside: f64, outside: f64) -> impl Fn([f64; 2]) -> f64 {
    move |place| match (place[0] - at[0]).hypot(place[1] - at[1]) <= radius {
        true => inside,
        false => outside,
    }
}

/// A method with the limits of each test.
struct MethodLimits {
    method: Method,
    loss_only: bool,
    /// Position error of the press on the changed sheet, mm: upper limit with the whole sheet unknown, lower limit with
    /// the region alone.
    press_mm: [f64; 2],
    /// Largest loss for a load over an electrode: upper limit with the whole sheet unknown, lower limit with the region
    /// alone.
    electrode: [f64; 2],
}

const CASES: [MethodLimits; 4] = [
    MethodLimits {
        method: Method::OneStep,
        loss_only: false,
        press_mm: [4.5, 3.0],
        electrode: [1.2, 1.0],
    },
    MethodLimits {
        method: Method::OneStep,
        loss_only: true,
        press_mm: [4.0, 8.0],
        // the triangle next to the electrode, which the load does cover, is at the bound
        electrode: [1.0, 1.0],
    },
    MethodLimits {
        method: Method::Tv,
        loss_only: false,
        press_mm: [6.5, 3.0],
        electrode: [0.4, 3.0],
    },
    MethodLimits {
        method: Method::Tv,
        loss_only: true,
        press_mm: [7.0, 40.0],
        electrode: [0.45, 1.0],
    },
];

/// Computes `figure` of each method's maps, with the whole sheet unknown and with the region alone, and checks the
/// limits.
fn compare(
    before: &[Reading],
    loaded: &[Reading],
    maps: &Maps,
    figure: impl Fn(&Map) -> f64,
    limits: impl Fn(&MethodLimits) -> [f64; 2],
) {
    for case in &CASES {
        let of = |unknowns| {
            let settings = ReconstructionSettings {
                method: Some(case.method),
                loss_only: Some(case.loss_only),
                unknowns: Some(unknowns),
                ..ReconstructionSettings::default()
            };
            figure(&maps.of(&settings, [before, loaded]))
        };
        let (whole, region) = (of(Unknowns::Sheet), of(Unknowns::Region));
        let text = format!(
            "{}, loss only {}: whole sheet {whole:.3}, region alone {region:.3}",
            case.method.name(),
            case.loss_only
        );
        println!("{text}");
        let [at_most, at_least] = limits(case);
        assert!(whole <= at_most && region >= at_least, "{text}");
    }
}

fn paper_sheet() -> (Maps, Rig) {
    let protocol = Protocol::sheffield(26).unwrap();
    let rig = Rig {
        sheet: FineSheet::new(&protocol).unwrap(),
        random: ChaCha8Rng::seed_from_u64(26),
    };
    let geometry = Geometry::from_preset(&eit::Preset::default()).unwrap();
    (Maps { geometry, protocol }, rig)
}

#[test]
fn a_press_is_found_on_a_sheet_that_has_changed_by_one_percent() {
    let (maps, mut rig) = paper_sheet();
    let at = [0.03, 0.02];
    let before = rig.frame(|_| 1.0);
    let pressed = rig.frame(disc(at, 5e-3, 0.5, 0.99));
    let error = |map: &Map| maps.error_mm(map, at);
    compare(&before, &pressed, &maps, error, |case| case.press_mm);
}

#[test]
fn a_load_over_an_electrode_is_no_load_in_the_region() {
    let (maps, mut rig) = paper_sheet();
    let before = rig.frame(|_| 1.0);
    let loaded = rig.frame(disc(maps.electrode(3), 8e-3, 0.5, 1.0));
    let largest = |map: &Map| map.largest_loss().map_or(0.0, |(_, loss)| loss);
    compare(&before, &loaded, &maps, largest, |case| case.electrode);
}

/// Loads between two electrodes are outside of the region; the quality of the map reports that, and the nearest
/// electrode.
#[test]
fn a_load_outside_of_the_region_is_reported() {
    let (maps, mut rig) = paper_sheet();
    let mut conditions = Conditions::live(&maps.geometry, &maps.protocol, Amps(CURRENT));
    conditions.noise_v = Some(NOISE);
    let model = build(&ReconstructionSettings::default(), &conditions).unwrap();
    let before = rig.frame(|_| 1.0);
    let mut remark = |at: [f64; 2]| {
        let loaded = rig.frame(disc(at, 5e-3, 0.5, 1.0));
        let quality = model
            .reconstruct(&before, &loaded)
            .unwrap()
            .quality
            .unwrap();
        let reasons = quality.reasons.into_iter();
        let found = reasons.filter(|reason| reason.kind == "outside_region");
        found.map(|reason| (reason.electrode, reason.text)).next()
    };
    for first in [1, 7, 15, 20] {
        let [a, b] = [first, first + 1].map(|index| maps.electrode(index));
        let between = [0, 1].map(|axis| 0.5 * (a[axis] + b[axis]));
        let (electrode, text) = remark(between).expect("it is outside");
        let electrode = electrode.unwrap();
        // a loss of half of the conductance on 79 mm2 equals a total loss on 39 mm2
        let words = text.split_whitespace();
        let lost: f64 = words.rev().find_map(|word| word.parse().ok()).unwrap();
        assert!((35.0..=45.0).contains(&lost), "{text}");
        assert!(
            [first + 1, first + 2].contains(&electrode),
            "electrode {electrode} for a load between {} and {}",
            first + 1,
            first + 2
        );
    }
    for inside in [[0.107, 0.115], [0.03, 0.03], [0.15, 0.05]] {
        assert_eq!(remark(inside), None, "{inside:?}");
    }
}
