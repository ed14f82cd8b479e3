//! Plots of errors against contrast, contact resistance and sliver angle: naive implementations and ours.

use std::path::Path;

use outfile::Existing;
use render::{Axis, Curve, Curves};

use super::cases::contrast::{CENTRE, RADIUS};
use super::cases::meshes::sliver_errors;
use super::outcome::apart;
use crate::failure::Failure;
use crate::stability::solvers::bordered::Ground;
use crate::stability::solvers::tank::Tank;

/// Smaller values are drawn at this value, because a logarithmic axis has no 0.
const LEAST: f64 = 1e-17;
/// A result that is not finite is drawn at this value.
const MOST: f64 = 1e3;

/// Draws the three plots, each as PNG and SVG.
pub(crate) fn draw(folder: &Path, existing: Existing) -> Result<(), Failure> {
    let tank = Tank::small()?;
    put(
        folder,
        existing,
        "contrast",
        &Curves {
            title: "Error of V against the contrast of a patch",
            across: "conductance of the patch over that of the sheet",
            up: "error over the largest reading",
            axes: [Axis::Log, Axis::Log],
            marks: Vec::new(),
            front: Vec::new(),
            curves: contrast(&tank)?,
        },
    )?;
    put(
        folder,
        existing,
        "contact",
        &Curves {
            title: "Error of V against contact resistance",
            across: "resistance of every contact, ohm",
            up: "error over the largest reading",
            axes: [Axis::Log, Axis::Log],
            marks: vec![(1e3, "sheet")],
            front: Vec::new(),
            curves: contact(&tank)?,
        },
    )?;
    put(
        folder,
        existing,
        "sliver",
        &Curves {
            title: "Change of V by one sliver against its angle",
            across: "smallest angle, degrees",
            up: "change over the largest reading",
            axes: [Axis::Log, Axis::Log],
            marks: Vec::new(),
            front: Vec::new(),
            curves: sliver(&tank)?,
        },
    )
}

fn put(folder: &Path, existing: Existing, name: &str, curves: &Curves<'_>) -> Result<(), Failure> {
    let undrawn = |fault| Failure::of(&format!("cannot draw {name}"), &fault);
    let png = render::curves_png(curves).map_err(undrawn)?;
    let svg = render::curves_svg(curves).map_err(undrawn)?;
    for (ending, bytes) in [("png", png.as_slice()), ("svg", svg.as_bytes())] {
        let path = folder.join(format!("{name}.{ending}"));
        outfile::write(&path, existing, bytes)?;
    }
    Ok(())
}

/// Curves with these names over common abscissas; each point has an abscissa and one error for each curve.
fn curves(names: &[&str], points: &[(f64, Vec<f64>)]) -> Vec<Curve> {
    let shown = |error: f64| {
        if error.is_finite() {
            error.clamp(LEAST, MOST)
        } else {
            MOST
        }
    };
    names
        .iter()
        .enumerate()
        .map(|(k, name)| Curve {
            name: (*name).to_owned(),
            points: points
                .iter()
                .map(|(at, errors)| [*at, shown(errors[k]), 0.0])
                .collect(),
        })
        .collect()
}

fn contrast(tank: &Tank) -> Result<Vec<Curve>, Failure> {
    let patch = tank.patch(CENTRE, RADIUS);
    let mut points = Vec::new();
    for decade in (-16..=12).step_by(2) {
        let contrast = 10_f64.powi(decade);
        let sigma = tank.with(&patch, contrast);
        let exact = tank.exact(&tank.contact, &sigma);
        let textbook = tank.textbook::<f64>(&tank.contact, &sigma, Ground::Node);
        let single = tank.textbook::<f32>(&tank.contact, &sigma, Ground::Node);
        let ours = tank.ours(&tank.contact, &sigma)?;
        points.push((
            contrast,
            [&single, &textbook, &ours]
                .map(|v| apart(v, &exact))
                .to_vec(),
        ));
    }
    Ok(curves(&["textbook, f32", "textbook, f64", "ours"], &points))
}

fn contact(tank: &Tank) -> Result<Vec<Curve>, Failure> {
    let mut points = Vec::new();
    for decade in (-15..=15).step_by(2) {
        let ohm = 10_f64.powi(decade);
        let contact = vec![ohm * tank.length(); tank.contact.len()];
        let exact = tank.exact(&contact, &tank.sigma);
        let textbook = |ground| tank.textbook::<f64>(&contact, &tank.sigma, ground);
        let (node, electrode) = (textbook(Ground::Node), textbook(Ground::Electrode(0)));
        let ours = tank.ours(&contact, &tank.sigma)?;
        points.push((
            ohm,
            [&node, &electrode, &ours]
                .map(|v| apart(v, &exact))
                .to_vec(),
        ));
    }
    let names = ["textbook, node held", "textbook, electrode held", "ours"];
    Ok(curves(&names, &points))
}

fn sliver(tank: &Tank) -> Result<Vec<Curve>, Failure> {
    let before = tank.exact(&tank.contact, &tank.sigma);
    let mut points = Vec::new();
    for degrees in [10.0, 3.0, 1.0, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001] {
        let [ours, single] = sliver_errors(tank, &before, degrees)?;
        points.push((degrees, vec![single, ours]));
    }
    Ok(curves(&["textbook, f32", "ours"], &points))
}
