//! Diagram 8: location error, and maps of empty frames, over months, for four approaches to drift of the baseline.

use crate::failure::Failure;
use crate::months::LongScene;
use crate::months::course::{Approach, Outcome, Request, samples};
use crate::tradeoff::Effort;
use crate::tradeoff::panel::{Panel, Point};

pub(crate) fn panel(effort: &Effort) -> Result<Panel, Failure> {
    let request = Request {
        scenes: effort.of(
            &[LongScene::Month, LongScene::HoldOut][..],
            &[
                LongScene::Month,
                LongScene::HoldOut,
                LongScene::Bedside,
                LongScene::HoldOutContacts,
                LongScene::HoldOutSpray,
            ],
        ),
        days: effort.of(
            &[0.05, 0.2, 1.0][..],
            &[0.01, 0.04, 0.2, 1.0, 3.0, 7.0, 14.0, 20.0, 30.0, 60.0, 90.0],
        ),
        every_s: 3600.0,
        presses: effort.of(1, 8),
        seed: effort.seed.wrapping_mul(100),
    };
    let samples = samples(&request)?;
    let mut points = Vec::new();
    for &scene in request.scenes {
        for approach in Approach::ALL {
            for &day in request.days {
                let at = |sample: &&crate::months::course::Sample| {
                    (sample.scene, sample.approach, sample.day) == (scene, approach, day)
                };
                let found = || samples.iter().filter(at).map(|sample| sample.result);
                let mut add = |line: String, values: Vec<f64>| {
                    if !values.is_empty() {
                        let setting = format!("{day} days");
                        points.push(Point::new(line, setting, day, &values).of(scene.name()));
                    }
                };
                let zeros = found().filter_map(|result| match result {
                    Outcome::Zero(percent) => Some(percent),
                    Outcome::Press { .. } => None,
                });
                add(format!("zero, %, {}", approach.name()), zeros.collect());
                for diameter in [10.0, 30.0] {
                    let errors = found().filter_map(|result| match result {
                        Outcome::Press {
                            diameter_mm,
                            error_mm,
                            ..
                        } if diameter_mm == diameter => Some(error_mm),
                        _ => None,
                    });
                    let line = format!("place of {diameter} mm, mm, {}", approach.name());
                    add(line, errors.collect());
                }
            }
        }
    }
    Ok(Panel {
        panel: "months".to_owned(),
        title: "Months: a frame against the past".to_owned(),
        across: "days since the baseline".to_owned(),
        up: "zero, % of conductance; place, mm".to_owned(),
        shows: "Root mean square of the map of an untouched sheet, and location error of presses of 10 and 30 mm that take half \
                the conductance (mean; bars: standard deviation), with a load every night: one-step with the baseline of day 0 (no \
                tracking); gain and contacts projected out of one frame; the sizes of the drift found in one frame (evidence); the \
                tracked baseline, which follows a frame an hour. A press that is not seen counts as 157 mm. `hold-out`, `contacts` \
                and `spray` drift by laws and rates that no method knows, for twenty days."
            .to_owned(),
        not_proved: "Simulated drift, not a measured sheet's. The zeros of projection and evidence are those of a map that shrinks \
                     towards zero, and compare with each other alone; those of the other two are the product's own maps, \
                     which are almost nothing where a frame agrees with its baseline within the noise."
            .to_owned(),
        not_built: Vec::new(),
        costs: false,
        points,
    })
}
