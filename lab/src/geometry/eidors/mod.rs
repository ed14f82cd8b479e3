//! Reads a forward model of EIDORS with its voltages from a MAT-file, as a case with frames.
//!
//! `fmdl`: nodes (m), elems (triangles), electrode (nodes, z_contact in ohm m) and stimulation (stim_pattern,
//! meas_pattern), as `mk_stim_patterns` makes it. `vv`: voltages, a column a frame, or a structure with `meas`.
//! Baseline: `v_homogeneous` or `vh`. Unloaded conductance: `conductance`. EIDORS counts nodes from 1, this crate
//! counts them from 0. `tactus_eit.eidors` reads the same variables in Python, from the structures of other readers.

mod mat;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use eit::{Case, Mesh};
use imaging::recorded::{BaselineRule, FrameTable, LabelledReadings, Unloaded};
use studies::Failure;
use survey::{Dipole, Electrode, Measurement, Protocol, Reading, Volts};

use mat::Value;

type Fields = BTreeMap<String, Value>;

/// Largest relative difference of currents and gains that is ascribed to rounding.
const ROUNDING: f64 = 1e-9;

/// Variable names of the frames and of the baseline; the first existing one is used.
const FRAMES: [&str; 2] = ["vv", "vi"];
const BASELINES: [&str; 2] = ["v_homogeneous", "vh"];

/// Whether a case is given as a MAT-file.
pub(crate) fn is_mat(path: &Path) -> bool {
    path.extension()
        .is_some_and(|ending| ending.eq_ignore_ascii_case("mat"))
}

/// Reads the case of a MAT-file.
pub(crate) fn case(path: &Path) -> Result<Case, Failure> {
    let file = variables(path)?;
    of_model(&file).map_err(|why| refused(path, &why))
}

/// Reads the frames of a MAT-file. `baseline`: replaces the file's own baseline.
pub(crate) fn frames(
    path: &Path,
    baseline: Option<&BaselineRule>,
    readings: usize,
    negate: bool,
) -> Result<FrameTable, Failure> {
    let file = variables(path)?;
    let table = || {
        let frames = voltages(&file, &FRAMES, readings, negate)?
            .ok_or("it has no variable vv, the voltages, a column a frame")?;
        let own = voltages(&file, &BASELINES, readings, negate)?;
        let (name, empty) = match (baseline, own) {
            (Some(BaselineRule::First(count)), _) => {
                let first = frames.get(..*count).ok_or_else(|| {
                    format!(
                        "it has {} frames, --baseline requests first:{count}",
                        frames.len()
                    )
                })?;
                (format!("first:{count}"), first.to_vec())
            }
            (Some(BaselineRule::File(_)), _) => {
                return Err("--baseline FILE is for case folders; with a MAT-file first:N, or its variable v_homogeneous".into());
            }
            (None, Some(own)) => ("v_homogeneous".to_owned(), own),
            (None, None) => ("first:1".to_owned(), frames[..1].to_vec()),
        };
        let empty: Vec<&[Reading]> = empty.iter().map(Vec::as_slice).collect();
        let labelled = frames.iter().enumerate();
        Ok(FrameTable {
            numbers: (1..=frames.len() as u64).collect(),
            unloaded: Unloaded::mean(&empty),
            baseline_name: name,
            provenance: None,
            frames: labelled
                .map(|(column, frame)| -> LabelledReadings {
                    (format!("f{}", column + 1), frame.clone())
                })
                .collect(),
        })
    };
    table().map_err(|why: String| refused(path, &why))
}

fn refused(path: &Path, why: &str) -> Failure {
    Failure::because(format!("{}: {why}", path.display()))
}

fn variables(path: &Path) -> Result<Fields, Failure> {
    let bytes =
        std::fs::read(path).map_err(|fault| Failure::of(&path.display().to_string(), &fault))?;
    mat::variables(&bytes).map_err(|fault| Failure::of(&path.display().to_string(), &fault))
}

/// Voltages, a frame a column; NaN in the file is a missing reading.
fn voltages(
    file: &Fields,
    names: &[&str],
    readings: usize,
    negate: bool,
) -> Result<Option<Vec<Vec<Reading>>>, String> {
    let Some((name, value)) = names
        .iter()
        .find_map(|name| Some((*name, file.get(*name)?)))
    else {
        return Ok(None);
    };
    let value = match value {
        Value::Structs(structs) if structs.len() == 1 => field(&structs[0], "meas", name)?,
        other => other,
    };
    let Value::Numbers {
        rows,
        columns,
        values,
    } = value
    else {
        return Err(format!(
            "{name} is {}, not a matrix of voltages",
            value.kind()
        ));
    };
    if *rows != readings || *columns == 0 {
        let turned = if *columns == readings {
            ": transpose it"
        } else {
            ""
        };
        return Err(format!(
            "{name} is {}; {readings} x frames is expected, the readings of fmdl.stimulation in order{turned}",
            value.kind()
        ));
    }
    let sign = if negate { -1.0 } else { 1.0 };
    let reading = |volts: &f64| match volts.is_finite() {
        true => Reading::Ok(Volts(sign * volts)),
        false => Reading::NotMeasured,
    };
    let frames = values.chunks_exact(readings);
    Ok(Some(
        frames
            .map(|frame| frame.iter().map(reading).collect())
            .collect(),
    ))
}

fn of_model(file: &Fields) -> Result<Case, String> {
    let model = file
        .get("fmdl")
        .ok_or("it has no variable fmdl, a forward model of EIDORS")?;
    let [model] = structures(model, "fmdl")? else {
        return Err("fmdl is an array of structures; one is expected".to_owned());
    };
    let nodes = matrix::<2>(model, "nodes", "nodes x 2 (volumes are not supported)")?;
    let elems = matrix::<3>(model, "elems", "triangles x 3")?;
    let mut triangles = Vec::with_capacity(elems.len());
    for corners in elems {
        let [a, b, c] = from_one(&corners, nodes.len(), "fmdl.elems")?[..] else {
            return Err("fmdl.elems has no triangles".to_owned());
        };
        let [p, q, r] = [a, b, c].map(|node| nodes[node]);
        let area = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
        triangles.push(if area < 0.0 { [c, b, a] } else { [a, b, c] });
    }
    // EIDORS keeps nodes that belong to no triangle: they are left out, and the others keep their order
    let mut used = vec![false; nodes.len()];
    triangles
        .iter()
        .flatten()
        .for_each(|node| used[*node] = true);
    let mut count = 0;
    let place: Vec<usize> = used
        .iter()
        .map(|used| {
            count += usize::from(*used);
            count.saturating_sub(1)
        })
        .collect();
    let kept = nodes.iter().zip(&used).filter(|(_, used)| **used);
    let kept = kept.map(|(position, _)| *position).collect();
    let outline = outline(&triangles);
    let mut edges = Vec::new();
    let mut contact_ohm_m = Vec::new();
    let electrodes = structures(field(model, "electrode", "fmdl")?, "fmdl.electrode")?;
    for (number, electrode) in electrodes.iter().enumerate() {
        let name = format!("fmdl.electrode({})", number + 1);
        let own = numbers(electrode, "nodes", &name)?.2;
        let own = from_one(own, nodes.len(), &format!("{name}.nodes"))?;
        let covered: Vec<[usize; 2]> = outline
            .iter()
            .filter(|edge| edge.iter().all(|node| own.contains(node)))
            .map(|edge| edge.map(|node| place[node]))
            .collect();
        if covered.is_empty() {
            return Err(format!(
                "{name} covers no edge of the outline with its {} nodes; an electrode of the complete electrode model is expected, \
                 with two neighbouring nodes or more",
                own.len()
            ));
        }
        edges.push(covered);
        let contact = match numbers(electrode, "z_contact", &name)?.2 {
            [contact] if *contact >= 0.0 && contact.is_finite() => *contact,
            _ => {
                return Err(format!(
                    "{name}.z_contact is not one number, 0 or more, in ohm m"
                ));
            }
        };
        contact_ohm_m.push(contact);
    }
    let triangles = triangles
        .iter()
        .map(|nodes| nodes.map(|node| place[node]))
        .collect();
    let mesh = Mesh::new(kept, triangles, edges, None)
        .map_err(|fault| format!("fmdl: {}", survey::error_chain(&fault)))?;
    let (protocol, currents) = protocol(model, contact_ohm_m.len())?;
    let mut sigma = BTreeMap::new();
    if let Some(value) = file.get("conductance") {
        let Value::Numbers { values, .. } = value else {
            return Err(format!("conductance is {}, not numbers", value.kind()));
        };
        if values.len() != mesh.triangles().len()
            || values.iter().any(|one| !(*one > 0.0 && one.is_finite()))
        {
            return Err(format!(
                "conductance is {}; a number above 0 is expected for each of the {} triangles",
                value.kind(),
                mesh.triangles().len()
            ));
        }
        sigma.insert("homog".to_owned(), values.clone());
    }
    Ok(Case {
        mesh: Arc::new(mesh),
        contact_ohm_m,
        protocol,
        currents,
        sigma,
        has_region: false,
    })
}

/// The edges that belong to one triangle only, each as two nodes.
fn outline(triangles: &[[usize; 3]]) -> Vec<[usize; 2]> {
    let mut edges = BTreeMap::new();
    for &[a, b, c] in triangles {
        for [from, to] in [[a, b], [b, c], [c, a]] {
            let place = edges.entry([from.min(to), from.max(to)]);
            place.or_insert_with(Vec::new).push([from, to]);
        }
    }
    let single = edges.into_values().filter(|edges| edges.len() == 1);
    single.flatten().collect()
}

/// The measurements, and the current of each, A.
fn protocol(model: &Fields, electrodes: usize) -> Result<(Protocol, Vec<f64>), String> {
    let stimulations = structures(field(model, "stimulation", "fmdl")?, "fmdl.stimulation")?;
    let (mut measurements, mut currents) = (Vec::new(), Vec::new());
    for (number, stimulation) in stimulations.iter().enumerate() {
        let name = format!("fmdl.stimulation({})", number + 1);
        let scale = match stimulation.get("stimulation") {
            None => 1.0,
            Some(Value::Text(unit)) => match unit.to_ascii_lowercase().as_str() {
                "amp" | "a" => 1.0,
                "ma" => 1e-3,
                _ => {
                    return Err(format!(
                        "{name}.stimulation is '{unit}'; 'Amp' or 'mA' is expected"
                    ));
                }
            },
            Some(other) => {
                return Err(format!(
                    "{name}.stimulation is {}; 'Amp' is expected",
                    other.kind()
                ));
            }
        };
        let (rows, columns, driven) = numbers(stimulation, "stim_pattern", &name)?;
        if rows * columns != electrodes {
            return Err(format!(
                "{name}.stim_pattern is {rows} x {columns}; {electrodes} x 1 is expected"
            ));
        }
        let (drive, current) = pair(driven, &format!("{name}.stim_pattern"))?;
        let (rows, columns, patterns) = numbers(stimulation, "meas_pattern", &name)?;
        if columns != electrodes {
            return Err(format!(
                "{name}.meas_pattern is {rows} x {columns}; readings x {electrodes} is expected"
            ));
        }
        for row in 0..rows {
            let pattern: Vec<f64> = patterns.iter().skip(row).step_by(rows).copied().collect();
            let (sense, gain) = pair(&pattern, &format!("{name}.meas_pattern, row {}", row + 1))?;
            if (gain - 1.0).abs() > ROUNDING {
                return Err(format!(
                    "{name}.meas_pattern has a gain of {gain}; 1 and -1 are expected"
                ));
            }
            measurements.push(Measurement { drive, sense });
            currents.push(scale * current);
        }
    }
    let protocol = Protocol::new(electrodes, measurements)
        .map_err(|fault| format!("fmdl.stimulation: {}", survey::error_chain(&fault)))?;
    Ok((protocol, currents))
}

/// Plus and minus of a pattern with two entries that cancel, and the absolute value of the entries.
fn pair(pattern: &[f64], name: &str) -> Result<(Dipole, f64), String> {
    let entries: Vec<(usize, f64)> = pattern
        .iter()
        .copied()
        .enumerate()
        .filter(|(_, value)| *value != 0.0)
        .collect();
    match entries[..] {
        [(a, x), (b, y)] if (x + y).abs() <= ROUNDING * x.abs() && x.is_finite() => {
            let (plus, minus) = if x > 0.0 { (a, b) } else { (b, a) };
            Ok((
                Dipole {
                    plus: Electrode(plus),
                    minus: Electrode(minus),
                },
                x.abs(),
            ))
        }
        _ => Err(format!(
            "{name} names {} electrodes; two are expected, with opposite values",
            entries.len()
        )),
    }
}

fn field<'a>(fields: &'a Fields, name: &str, of: &str) -> Result<&'a Value, String> {
    fields
        .get(name)
        .ok_or_else(|| format!("{of} has no field {name}"))
}

fn structures<'a>(value: &'a Value, name: &str) -> Result<&'a [Fields], String> {
    match value {
        Value::Structs(structs) => Ok(structs),
        other => Err(format!(
            "{name} is {}, not an array of structures",
            other.kind()
        )),
    }
}

/// Rows, columns and values of a field.
fn numbers<'a>(
    fields: &'a Fields,
    name: &str,
    of: &str,
) -> Result<(usize, usize, &'a [f64]), String> {
    match field(fields, name, of)? {
        Value::Numbers {
            rows,
            columns,
            values,
        } => Ok((*rows, *columns, values)),
        other => Err(format!("{of}.{name} is {}, not numbers", other.kind())),
    }
}

/// The rows of a matrix of finite numbers.
fn matrix<const N: usize>(
    model: &Fields,
    name: &str,
    expected: &str,
) -> Result<Vec<[f64; N]>, String> {
    let (rows, columns, values) = numbers(model, name, "fmdl")?;
    if columns != N {
        return Err(format!("fmdl.{name} is {rows} x {columns}; {expected}"));
    }
    if values.iter().any(|value| !value.is_finite()) {
        return Err(format!(
            "fmdl.{name} has values that are not finite numbers"
        ));
    }
    let row = |row| std::array::from_fn(|column| values[column * rows + row]);
    Ok((0..rows).map(row).collect())
}

fn from_one(numbers: &[f64], count: usize, name: &str) -> Result<Vec<usize>, String> {
    let index =
        |number: &f64| match *number >= 1.0 && *number <= count as f64 && number.fract() == 0.0 {
            true => Ok(*number as usize - 1),
            false => Err(format!(
                "{name} names node {number}; whole numbers from 1 to {count} are expected"
            )),
        };
    numbers.iter().map(index).collect()
}
