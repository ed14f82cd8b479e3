//! Diagram 6: accuracy against the number of cases and epochs.

use crate::artifact_cache::ArtifactCache;
use crate::evaluation::{average, maps, of_frames};
use crate::failure::Failure;
use crate::tradeoff::Effort;
use crate::tradeoff::panel::{Panel, Point};
use crate::tradeoff::trained::{Trained, judged_sets};

pub(crate) fn panel(effort: &Effort, place: &ArtifactCache<'_>) -> Result<Panel, Failure> {
    let cases: &[usize] = effort.of(&[2000][..], &[2000, 5000, 15_000]);
    let epochs: &[usize] = effort.of(&[1][..], &[2, 5, 15]);
    let width = effort.of(64, 256);
    let sets = judged_sets(effort, place, "polygons", effort.of(2, 8))?;
    let mut points = Vec::new();
    for &count in cases {
        let common = format!("--profile matched --cases {count} --seed {}", effort.seed);
        let mut all = vec![
            ("linear".to_owned(), format!("linear {common}")),
            ("RBF network".to_owned(), format!("rbf {common}")),
        ];
        for epochs in epochs {
            all.push((
                format!("deep network, {epochs} epochs"),
                format!("dnn {common} --epochs {epochs} --set width={width} --repeats 2"),
            ));
        }
        for (line, arguments) in all {
            let trained = Trained::new(place, &arguments)?;
            let mut errors = Vec::new();
            for set in &sets {
                let frames = of_frames(&maps(set, &line, &trained.words())?)?;
                errors.push(average(frames.iter().map(|frame| 1.0 - frame.correlation)));
            }
            points.push(Point::new(
                line,
                format!("{count} cases"),
                trained.seconds,
                &errors,
            ));
        }
    }
    Ok(Panel {
        panel: "training".to_owned(),
        title: "Training: cases and epochs against held-out error".to_owned(),
        across: "training, wall time, s".to_owned(),
        up: "1 - correlation".to_owned(),
        shows: format!(
            "Cases of Algorithm 1 with 2 uV of noise, five sets of them kept back (finer mesh, other seeds): one minus the mean \
             correlation of a map with the truth, against the wall time of the whole training command, the making of its cases \
             included; the deep network here has four layers of {width}."
        ),
        not_proved: "The paper's own size (2,048 wide, 75,000 samples, 30 epochs) is judged by `tactus-lab paper`, not here; other \
                     learning rates for short trainings were not sought, so the deep network's line is an upper bound."
            .to_owned(),
        not_built: Vec::new(),
        costs: true,
        points,
    })
}
