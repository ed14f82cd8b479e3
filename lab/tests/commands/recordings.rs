//! Recordings of real tanks: the Kuopio challenge and the Ottawa recordings, by command lines.

use std::path::Path;
use std::sync::Arc;

use crate::program::{done, numbers, words};
use eit::{Case, Mesh};

/// Lines and columns of a label image.
const PIXELS: usize = 256;

/// The triangle at the centre of each pixel of a label image (line 0 at the top); none outside the tank.
fn triangles(mesh: &Mesh, radius: f64) -> Vec<Option<usize>> {
    let corner = |p: [f64; 2], q: [f64; 2], x: f64, y: f64| {
        (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])
    };
    let half = PIXELS as f64 / 2.0;
    let mut at = vec![None; PIXELS * PIXELS];
    for triangle in 0..mesh.triangles().len() {
        let corners @ [a, b, c] = mesh.corners(triangle);
        let columns =
            corners.map(|[x, _]| ((x / radius + 1.0) * half - 0.5).floor().max(0.0) as usize);
        let lines =
            corners.map(|[_, y]| ((1.0 - y / radius) * half - 0.5).floor().max(0.0) as usize);
        let reach = |ends: [usize; 3]| {
            let [first, last] = [ends.iter().min(), ends.iter().max()].map(|end| *end.unwrap());
            first..(last + 2).min(PIXELS)
        };
        for line in reach(lines) {
            for column in reach(columns) {
                let x = ((column as f64 + 0.5) / half - 1.0) * radius;
                let y = (1.0 - (line as f64 + 0.5) / half) * radius;
                if corner(a, b, x, y) >= 0.0
                    && corner(b, c, x, y) >= 0.0
                    && corner(c, a, x, y) >= 0.0
                {
                    at[line * PIXELS + column].get_or_insert(triangle);
                }
            }
        }
    }
    at
}

/// Correlation of a map with a label image over the pixels inside the tank.
fn correlation(triangles: &[Option<usize>], map: &[f64], labels: &[f64]) -> f64 {
    let inside = triangles.iter().zip(labels);
    let pairs: Vec<(f64, f64)> = inside
        .filter_map(|(triangle, label)| Some((map[(*triangle)?], *label)))
        .collect();
    let n = pairs.len() as f64;
    let mean = pairs.iter().fold((0.0, 0.0), |sum, pair| {
        (sum.0 + pair.0 / n, sum.1 + pair.1 / n)
    });
    let (mut cross, mut own, mut other) = (0.0, 0.0, 0.0);
    for (a, b) in pairs {
        cross += (a - mean.0) * (b - mean.1);
        own += (a - mean.0).powi(2);
        other += (b - mean.1).powi(2);
    }
    cross / (own * other).sqrt()
}

/// Creates the case folder of a disc tank; returns its mesh.
fn tank(settings: &str, case: &Path) -> Arc<Mesh> {
    let line = format!("mesh --preset disc-tank {settings} --out {{}}");
    done(&words(&line, &[case]));
    Case::read(case).unwrap().mesh
}

fn labels(path: &Path) -> Vec<f64> {
    std::fs::read_to_string(path)
        .unwrap()
        .chars()
        .filter_map(|label| match label {
            '0' => Some(0.0),
            '1' => Some(-1.0),
            '2' => Some(1.0),
            _ => None,
        })
        .collect()
}

/// The tank of the Kuopio challenge with its first electrode in this direction.
fn kuopio_tank(first_deg: f64, case: &Path) -> Arc<Mesh> {
    let settings =
        format!("--force --set radius_mm=115.0 --set arc_deg=5.625 --set first_deg={first_deg}");
    tank(&settings, case)
}

/// The compared values: relative changes; changes of ln sigma; or changes of ln sigma, with those below a tenth of the
/// largest set to zero.
#[derive(Debug, Clone, Copy)]
enum Shown {
    Relative,
    Logarithm,
    Shrunk,
}

impl Shown {
    fn of(self, map: &[f64]) -> Vec<f64> {
        let logarithms = || map.iter().map(|x| x.ln_1p()).collect::<Vec<f64>>();
        match self {
            Self::Relative => map.to_vec(),
            Self::Logarithm => logarithms(),
            Self::Shrunk => {
                let all = logarithms();
                let most = all.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
                let kept = |x: &f64| if x.abs() < 0.1 * most { 0.0 } else { *x };
                all.iter().map(kept).collect()
            }
        }
    }
}

#[test]
fn kuopio_four_targets_with_one_setting() {
    let Some(data) = needs::shared("data/ktc2023") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let (case, maps) = (folder.path().join("tank"), folder.path().join("maps.csv"));
    // The least mean correlation. 84.375 degrees is the angle stated by the source. Only the labels show that 90
    // degrees, the top of their picture, agrees better, and that small changes are to be ignored.
    let noser = "--method one-step --prior noser --lambda 1";
    for (how, first_deg, judged) in [
        (noser, 84.375, [(Shown::Relative, 0.81)].as_slice()),
        ("--method best", 84.375, &[(Shown::Logarithm, 0.85)]),
        (
            "--method best",
            90.0,
            &[(Shown::Logarithm, 0.865), (Shown::Shrunk, 0.87)],
        ),
    ] {
        let triangles = triangles(&kuopio_tank(first_deg, &case), 0.115);
        let line = format!("reconstruct --force --case {{}} {how} --frames {{}} --out {{}}");
        let message = done(&words(
            &line,
            &[&case, &data.join("adj16_frames.csv"), &maps],
        ));
        let maps = numbers(&maps);
        assert_eq!(maps.len(), 5);
        assert!(maps[0].iter().all(|value| *value == 0.0));
        for (shown, least) in judged {
            let correlations: Vec<f64> = (1..=4)
                .map(|target| {
                    let truth = labels(&data.join(format!("truth_train{target}.txt")));
                    correlation(&triangles, &shown.of(&maps[target]), &truth)
                })
                .collect();
            let mean = correlations.iter().sum::<f64>() / 4.0;
            println!(
                "{how}, first electrode at {first_deg}, {shown:?}: {correlations:.3?}, mean {mean:.4}\n{message}"
            );
            assert!(mean >= *least, "{how} {first_deg} {shown:?}: {mean}");
        }
    }
}

#[test]
fn ottawa_the_ball_is_found_within_two_centimetres() {
    let Some(data) = needs::shared("data/uottawa2005") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let (case, maps) = (folder.path().join("tank"), folder.path().join("maps.csv"));
    let mesh = tank("--set radius_mm=150.0", &case);
    let (centroids, areas) = (mesh.region_centroids(), mesh.region_areas());
    for how in [
        "--method one-step --prior noser --lambda 1",
        "--method one-step",
        "--method best",
    ] {
        let line = format!(
            "reconstruct --force --case {{}} {how} --negate --frames {{}} --out {{}} --timing"
        );
        let message = done(&words(&line, &[&case, &data.join("frames.csv"), &maps]));
        assert!(
            message.contains("frame ") && message.contains(" ms"),
            "{message}"
        );
        for (row, truth) in [(1, [0.0, 0.0]), (2, [0.0, 0.07])] {
            let map = survey::Map::relative(mesh.hash(), numbers(&maps)[row].clone(), "");
            let found = map.found(&centroids, &areas).unwrap();
            let error = (found[0] - truth[0]).hypot(found[1] - truth[1]);
            println!(
                "{how}: frame {row} found {found:.4?}, error {:.2} cm\n{message}",
                100.0 * error
            );
            assert!(error < 0.02, "{how}: frame {row}: {found:?}");
        }
    }
}

/// Distances (m) between the found and the true positions of the balls for the three states with balls, in the order of
/// `BALLS`.
fn ball_errors(mesh: &Mesh, maps: &[Vec<f64>]) -> Vec<f64> {
    let (centroids, areas) = (mesh.region_centroids(), mesh.region_areas());
    BALLS
        .iter()
        .map(|(frame, ball, other)| {
            // with two balls, only the half of the tank that is nearer to this one counts
            let near = |at: &[f64; 2]| {
                let to = |ball: &[f64; 2]| (at[0] - ball[0]).hypot(at[1] - ball[1]);
                other.is_none_or(|other| to(ball) < to(&other))
            };
            let values = maps[*frame].iter().zip(&centroids);
            let values = values.map(|(value, at)| if near(at) { *value } else { 0.0 });
            let map = survey::Map::relative(mesh.hash(), values.collect(), "");
            let found = map.found(&centroids, &areas).unwrap();
            (found[0] - ball[0]).hypot(found[1] - ball[1])
        })
        .collect()
}

/// Frame, position of a ball, and position of the other ball in the same frame, m (truth.csv).
type Ball = (usize, [f64; 2], Option<[f64; 2]>);
const BALLS: [Ball; 4] = [
    (1, [0.0, 0.0], None),
    (2, [0.0, 0.07], None),
    (3, [0.0, 0.07], Some([0.07, 0.0])),
    (3, [0.07, 0.0], Some([0.0, 0.07])),
];

/// The two misfits in the note on the depth, percent: with the depth and without.
fn misfits(message: &str) -> [f64; 2] {
    let note = message
        .lines()
        .find(|line| line.contains("the baseline differs by"))
        .unwrap_or_else(|| panic!("no note on the depth: {message}"));
    let mut percent = note.split(" %").filter_map(|before| {
        before
            .rsplit(' ')
            .next()
            .and_then(|number| number.parse().ok())
    });
    [percent.next().unwrap(), percent.next().unwrap()]
}

#[test]
fn ottawa_balls_are_nearer_to_their_places_with_the_depth() {
    let Some(data) = needs::shared("data/uottawa2005") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let (case, maps) = (folder.path().join("tank"), folder.path().join("maps.csv"));
    let mesh = tank("--set radius_mm=150.0", &case);
    // the source states the depth of the liquid and the plane of the electrodes; their height and width are assumed
    let depth =
        " --depth-mm 260 --electrode-height-mm 10 --electrode-centre-mm 130 --target-height-mm 40";
    // Largest error of a ball, m. The goal of 0.01 is missed for the second of two balls at (7, 0) cm, and, with a
    // lambda for each frame and the exponent 0.25, for the ball in the middle: no map explains its frame.
    for (how, worst) in [
        ("--method one-step --prior noser --lambda 1", 0.01),
        ("--method one-step --prior noser", 0.0125),
        ("--method tv", 0.013),
        ("--method best", 0.026),
    ] {
        let errors = |depth: &str| {
            let line = format!(
                "reconstruct --force --case {{}} {how}{depth} --negate --frames {{}} --out {{}} --timing"
            );
            let message = done(&words(&line, &[&case, &data.join("frames.csv"), &maps]));
            (ball_errors(&mesh, &numbers(&maps)), message)
        };
        let (flat, _) = errors("");
        let (deep, message) = errors(depth);
        let cm = |errors: &[f64]| errors.iter().map(|m| 100.0 * m).collect::<Vec<_>>();
        println!(
            "{how}: flat {:.2?} cm, with depth {:.2?} cm\n{message}",
            cm(&flat),
            cm(&deep)
        );
        let [with, without] = misfits(&message);
        assert!(with < 5.0 && without > 20.0, "{message}");
        assert!(!message.contains("contradict"), "{message}");
        assert!(deep.iter().all(|error| *error < worst), "{how}: {deep:?}");
        // all but the ball in the middle are found more accurately with the depth
        let nearer = flat
            .iter()
            .zip(&deep)
            .skip(1)
            .all(|(flat, deep)| deep < flat);
        assert!(nearer, "{how}: {flat:?} {deep:?}");
    }
}
