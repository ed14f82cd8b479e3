//! Diagram 7: stated against observed coverage.

use crate::failure::Failure;
use crate::months::LongScene;
use crate::months::course::{Approach, Outcome, Request, Sample, samples};
use crate::tradeoff::Effort;
use crate::tradeoff::panel::{Panel, Point};

/// Stated probabilities that the region contains the true position.
const LEVELS: [f64; 5] = [0.5, 0.8, 0.9, 0.95, 0.99];

pub(crate) fn panel(effort: &Effort) -> Result<Panel, Failure> {
    let request = Request {
        scenes: effort.of(
            &[LongScene::Month][..],
            &[
                LongScene::Month,
                LongScene::HoldOut,
                LongScene::HoldOutContacts,
                LongScene::HoldOutSpray,
            ],
        ),
        days: effort.of(&[0.05, 0.1][..], &[0.2, 1.0, 3.0, 7.0]),
        every_s: 3600.0,
        presses: effort.of(4, 40),
        seed: effort.seed.wrapping_mul(100).wrapping_add(50),
    };
    let samples = samples(&request)?;
    let mut points = Vec::new();
    for &scene in request.scenes {
        for level in LEVELS {
            let stated = Point::new("as stated", format!("{level}"), level, &[level]);
            points.push(stated.of(scene.name()));
        }
        for approach in [Approach::Projection, Approach::Evidence, Approach::Tracked] {
            for diameter in [10.0, 30.0] {
                let line = format!("{}, {diameter} mm", approach.name());
                let of = |sample: &Sample| match sample.result {
                    Outcome::Press {
                        diameter_mm, disc, ..
                    } if (sample.scene, sample.approach) == (scene, approach) => {
                        disc.filter(|_| diameter_mm == diameter)
                    }
                    _ => None,
                };
                let discs: Vec<(bool, f64)> = samples.iter().filter_map(of).collect();
                let accepted: Vec<f64> = discs
                    .iter()
                    .filter_map(|(accepted, distance)| accepted.then_some(*distance))
                    .collect();
                if accepted.is_empty() {
                    continue;
                }
                for level in LEVELS {
                    // quantile of chi squared with two degrees of freedom
                    let bound = -2.0 * (1.0 - level).ln();
                    let inside = accepted
                        .iter()
                        .filter(|distance| **distance <= bound)
                        .count();
                    let share = inside as f64 / accepted.len() as f64;
                    let point = Point::new(line.clone(), format!("{level}"), level, &[share])
                        .of(scene.name())
                        .with(
                            "accepted, share",
                            accepted.len() as f64 / discs.len() as f64,
                        )
                        .with("accepted", accepted.len() as f64);
                    points.push(point);
                }
            }
        }
    }
    Ok(Panel {
        panel: "uncertainty".to_owned(),
        title: "Uncertainty: stated against found coverage".to_owned(),
        across: "stated probability".to_owned(),
        up: "share of truths inside".to_owned(),
        shows: "Share of presses (10 and 30 mm, half the conductance) whose true place is in the region that is stated beside the \
                found one, of those fits that are accepted: by one frame with gain and contacts projected out, by one frame with \
                sizes from evidence, and by the tracked baseline, on a sheet that drifts for up to a week. Above the line: the \
                regions are too wide; below: too narrow."
            .to_owned(),
        not_proved: "The regions are those of a disc; a load of another shape has no region that holds. The other methods of this \
                     page state no place with a region."
            .to_owned(),
        not_built: Vec::new(),
        costs: false,
        points,
    })
}
