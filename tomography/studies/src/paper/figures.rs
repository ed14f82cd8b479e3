//! The figures, each as PNG and SVG.

use eit::Case;
use phantom::paper;
use render::{Axis, Curve, Curves, Grid, Scale, Scales, Sheet, Style, TruePlace};
use survey::{Map, MapUnit};

use super::experiments::{Experiments, FIGURES_AT, Outcome};
use super::plan::{DEEP, RBF, TV};
use super::sweeps::Sweep;
use crate::artifact_cache::ArtifactCache;
use crate::evaluation::average;
use crate::failure::Failure;

/// A figure written to disk.
pub(super) struct Figure {
    /// The `.png`; the `.svg` has the same stem.
    pub(super) file: String,
    pub(super) title: String,
    /// Caption, which states what the figure shows and what it does not prove.
    pub(super) words: String,
}

/// The paper's Figure 3A.
pub(super) fn mesh(place: &ArtifactCache<'_>, case: &Case) -> Result<Figure, Failure> {
    let mesh = &case.mesh;
    let all: Vec<_> = (0..mesh.triangles().len())
        .map(|t| mesh.corners(t))
        .collect();
    let title = "Mesh, region of interest and electrodes (the paper's Figure 3A)";
    let sheet = sheet(case);
    let png = render::mesh_png(&sheet, &all, title);
    let svg = render::mesh_svg(&sheet, &all, title);
    put(place, "figure-3", png, svg)?;
    Ok(Figure {
        file: "figure-3.png".to_owned(),
        title: title.to_owned(),
        words: format!(
            "Our mesh has {} triangles, {} of them in the region; the paper's has 9,716 and 3,690. Electrodes are voids with \
             the complete electrode model on their rims, as the paper says; their places are read from its figure. Axes: mm from \
             the sheet's lower left corner; numbers at the rim are electrodes.",
            mesh.triangles().len(),
            mesh.region().len()
        ),
    })
}

/// The paper's Figures 4 to 7, or one of them; each with a common scale and with a scale for each map.
pub(super) fn tests(
    place: &ArtifactCache<'_>,
    case: &Case,
    experiments: &Experiments,
    wanted: &dyn Fn(u8) -> bool,
) -> Result<Vec<Figure>, Failure> {
    let mut figures = Vec::new();
    for (number, method) in [(4, TV), (5, DEEP), (6, RBF)] {
        let Some(outcome) = experiments
            .of(method, 1, FIGURES_AT)
            .filter(|_| wanted(number))
        else {
            continue;
        };
        let maps: Vec<(Map, Style)> = outcome
            .maps
            .iter()
            .enumerate()
            .map(|(k, frame)| {
                let style = Style {
                    title: format!("position {}", k + 1),
                    simulated: true,
                    true_position: frame.place.map(|centre| TruePlace {
                        centre,
                        radius: 5e-3,
                    }),
                    ..Style::default()
                };
                (in_siemens(&frame.map, case), style)
            })
            .collect();
        let title =
            format!("Test #1, S1 (10 mm) at 16 places: {method} (the paper's Figure {number})");
        figures.extend(both(
            place,
            &format!("figure-{number}"),
            &title,
            case,
            &maps,
            4,
        )?);
    }
    if wanted(7) {
        let outcomes: Vec<&Outcome> = [TV, DEEP, RBF]
            .into_iter()
            .filter_map(|method| experiments.of(method, 2, FIGURES_AT))
            .collect();
        // the middle of the three positions
        let at = paper::TEST2_MM[1];
        let loads = [paper::s2(at), paper::s3(at), paper::s4(at)];
        let mut maps = Vec::new();
        for (row, load) in loads.iter().enumerate() {
            for outcome in &outcomes {
                let Some(frame) = outcome.maps.get(3 * row + 1) else {
                    continue;
                };
                let style = Style {
                    title: format!("{}, {}", load.name, outcome.method),
                    simulated: true,
                    scale: Scale::Own,
                    true_outline: load.outline(),
                    ..Style::default()
                };
                maps.push((in_siemens(&frame.map, case), style));
            }
        }
        if !outcomes.is_empty() {
            let title = "Test #2: S2, S3 and S4 by three methods (the paper's Figure 7)";
            figures.extend(both(place, "figure-7", title, case, &maps, 3)?);
        }
    }
    Ok(figures)
}

/// One chart for each varied parameter.
pub(super) fn sweeps(place: &ArtifactCache<'_>, sweeps: &[Sweep]) -> Result<Vec<Figure>, Failure> {
    sweeps
        .iter()
        .map(|sweep| {
            let mut curves: Vec<Curve> = Vec::new();
            for point in &sweep.points {
                let at = [point.across, point.up, point.spread];
                match curves.iter_mut().find(|curve| curve.name == point.curve) {
                    Some(curve) => curve.points.push(at),
                    None => curves.push(Curve {
                        name: point.curve.clone(),
                        points: vec![at],
                    }),
                }
            }
            let chart = Curves {
                title: sweep.title,
                across: sweep.across,
                up: sweep.up,
                axes: [
                    if sweep.log { Axis::Log } else { Axis::Linear },
                    Axis::Linear,
                ],
                marks: sweep.mark.into_iter().collect(),
                curves,
                front: Vec::new(),
            };
            put(
                place,
                sweep.file,
                render::curves_png(&chart),
                render::curves_svg(&chart),
            )?;
            Ok(Figure {
                file: format!("{}.png", sweep.file),
                title: sweep.title.to_owned(),
                words: format!(
                    "{} Across: {}{}; up: {}.",
                    sweep.words,
                    sweep.across,
                    if sweep.log { " (logarithmic)" } else { "" },
                    sweep.up
                ),
            })
        })
        .collect()
}

fn both(
    place: &ArtifactCache<'_>,
    stem: &str,
    title: &str,
    case: &Case,
    maps: &[(Map, Style)],
    columns: usize,
) -> Result<Vec<Figure>, Failure> {
    let sheet = sheet(case);
    let mut figures = Vec::new();
    for (scales, end, words) in [
        (
            Scales::Common,
            "",
            "One colour scale for all maps: amounts can be compared, faint maps look empty.",
        ),
        (
            Scales::Each,
            "-each",
            "The same maps with a colour scale each, as the paper draws them: shapes can be compared, amounts cannot.",
        ),
    ] {
        let grid = Grid {
            columns,
            title,
            scales,
        };
        let stem = format!("{stem}{end}");
        put(
            place,
            &stem,
            render::png_grid(&sheet, maps, &grid),
            render::svg_grid(&sheet, maps, &grid),
        )?;
        figures.push(Figure {
            file: format!("{stem}.png"),
            title: title.to_owned(),
            words: format!(
                "{words} Axes: mm from the sheet's lower left corner; numbers at the rim are electrodes. Colours: change of \
                 conductance in \u{b5}S per square, the sheet's own being {:.0}; blue is lost, pale brown is gained. Dashed: the true \
                 place and size.",
                1e6 * average(case.unloaded_conductance().into_iter())
            ),
        });
    }
    Ok(figures)
}

fn put(
    place: &ArtifactCache<'_>,
    stem: &str,
    png: Result<Vec<u8>, render::PictureError>,
    svg: Result<String, render::PictureError>,
) -> Result<(), Failure> {
    let failed = |fault| Failure::of(&format!("cannot draw {stem}"), &fault);
    place.write_bytes(&format!("{stem}.png"), &png.map_err(failed)?)?;
    place.write_bytes(&format!("{stem}.svg"), svg.map_err(failed)?.as_bytes())
}

/// The relative map times the unloaded conductance, S per square.
fn in_siemens(map: &Map, case: &Case) -> Map {
    let sigma0 = case.unloaded_conductance();
    Map {
        values: case
            .mesh
            .region()
            .iter()
            .zip(&map.values)
            .map(|(&t, value)| sigma0[t] * value)
            .collect(),
        unit: MapUnit::Conductance,
        ..map.clone()
    }
}

/// The sheet on which maps of a case are drawn.
fn sheet(case: &Case) -> Sheet {
    let mesh = &case.mesh;
    Sheet {
        triangles: mesh.region().iter().map(|&t| mesh.corners(t)).collect(),
        outline: mesh.outline(),
        electrodes: mesh.electrode_centres(),
    }
}
