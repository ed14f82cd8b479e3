//! Detects a load that was on the sheet during a baseline. The baseline is mapped like a frame against the previous
//! baseline. In addition a place of low conductance is searched: for the preset sheet in the conductance fitted to the
//! baseline, for other geometries in a map against a uniform sheet.

use std::sync::Arc;

use drift::{DriftError, SheetFit};
use eit::metrics::median;
use eit::{Forward, Reconstructor};
use survey::{Baseline, Electrode, Reading, Volts};

use crate::noise::{against, factor};
use crate::{Conditions, Geometry, Model, map_noise};

/// Relative loss against the previous baseline below which creep and temperature explain it.
const LEAST_CHANGE: f64 = 0.03;
/// Relative loss against a uniform sheet below which uneven spraying and contacts explain it.
const LEAST_UNEVEN: f64 = 0.1;
/// Least relative loss against the fitted median, in standard deviations of the fitted conductance over the region. A
/// sheet that is uneven everywhere has places of more than [`LEAST_UNEVEN`] without a load.
const LEAST_DEVIATIONS: f64 = 4.0;
/// The remedy for a loss that this baseline shows. A loss of the previous baseline needs none: this one replaces it.
const TAKE_OFF: &str = ": if a load is on the sheet, take it off and record again";
/// Ratio of the standard deviation to the median absolute deviation of a normal distribution.
const OF_MEDIAN: f64 = 1.4826;

/// Warnings about a baseline, one sentence each: where it shows a loss against the previous baseline `before` or
/// against a uniform sheet, and whether it contradicts the depth of the tank, the order of the electrodes or their
/// contacts. Empty if nothing was found.
pub fn baseline_remarks(
    model: &Model,
    geometry: &Geometry,
    baseline: &Baseline,
    before: Option<&Baseline>,
) -> Vec<String> {
    let mut remarks = Vec::new();
    let per_frame = |baseline: &Baseline| 1.0 / baseline.frames.max(1) as f64;
    if let Some(before) = before {
        let noise = against(baseline) * (per_frame(baseline) + per_frame(before)).sqrt();
        let change = (before.readings.as_slice(), baseline.readings.as_slice());
        if let Some(seen) = loss_between(model, change, noise, LEAST_CHANGE)
            && mostly_loss(model, change)
        {
            remarks.push(format!(
                "against baseline {} it {seen}{TAKE_OFF}",
                before.id
            ));
        }
        // the reverse comparison: a load on the sheet during the previous baseline
        let reverse = (change.1, change.0);
        if let Some(seen) = loss_between(model, reverse, noise, LEAST_CHANGE)
            && mostly_loss(model, reverse)
        {
            remarks.push(format!(
                "the baseline before it, {}, {seen}: that one may have been recorded with a load",
                before.id
            ));
        }
    }
    let depth = geometry.depth_remark(model.reconstructor.protocol(), &baseline.readings);
    remarks.extend(
        depth
            .filter(|remark| remark.contradicted)
            .map(|remark| remark.text),
    );
    remarks.extend(geometry.ring_remark(model.reconstructor.protocol(), &baseline.readings));
    if !geometry.is_sheet() {
        let seen = against_uniform(model, geometry, baseline);
        remarks.extend(seen.map(|seen| format!("against a uniform sheet it {seen}{TAKE_OFF}")));
        return remarks;
    }
    match sheet_fit(model, geometry, baseline) {
        Ok(fit) => {
            let seen = uneven(&fit, geometry);
            remarks.extend(seen.map(|seen| format!("the sheet fitted to it {seen}{TAKE_OFF}")));
            remarks.extend(contacts(&fit));
        }
        Err(why) => remarks.push(format!(
            "whether a load was on the sheet is not known, because no sheet can be fitted to it: {why}"
        )),
    }
    remarks
}

/// Fits contacts and conductance of the preset sheet to a baseline.
fn sheet_fit(
    model: &Model,
    geometry: &Geometry,
    baseline: &Baseline,
) -> Result<SheetFit, DriftError> {
    let protocol = model.reconstructor.protocol();
    let conditions = Conditions::live(geometry, protocol, baseline.settings.current);
    let noise = against(baseline) / (baseline.frames.max(1) as f64).sqrt();
    crate::tracking::sheet_fit(&conditions, &baseline.readings, noise)
}

/// Electrodes whose contact is implausible.
fn contacts(fit: &SheetFit) -> Option<String> {
    let named: Vec<String> = fit
        .implausible
        .iter()
        .map(|&electrode| {
            let times = fit.contacts[electrode].exp();
            let electrode = Electrode(electrode);
            format!("{electrode} ({times:.1} times the nominal impedance)")
        })
        .collect();
    (!named.is_empty()).then(|| {
        format!(
            "the contact of electrode {} is implausible: check it. A fitted contact absorbs everything that the model \
             leaves out; it is not a measured contact",
            named.join(", ")
        )
    })
}

/// Where in the region the fitted conductance is lowest, if it is much below the median. A map of the readings would
/// show contacts and errors of the mesh as loads; the fit excludes both. Triangles outside of the region are ignored,
/// because errors of the contacts appear there as conductance.
fn uneven(fit: &SheetFit, geometry: &Geometry) -> Option<String> {
    let mesh = &geometry.mesh;
    let relative = |triangle: usize| fit.sigma[triangle] / geometry.sigma0[triangle];
    let each: Vec<f64> = mesh
        .region()
        .iter()
        .map(|&triangle| relative(triangle))
        .collect();
    let middle = median(&mut each.clone());
    let mut away: Vec<f64> = each.iter().map(|value| (value - middle).abs()).collect();
    let deviation = OF_MEDIAN * median(&mut away);
    let (place, lowest) = each.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1))?;
    let loss = 1.0 - lowest / middle;
    let least = LEAST_UNEVEN.max(LEAST_DEVIATIONS * deviation / middle);
    (loss > least).then(|| loss_at(loss, mesh.centroid(mesh.region()[place])))
}

/// Where a baseline of another sheet shows a loss against a uniform one.
fn against_uniform(model: &Model, geometry: &Geometry, baseline: &Baseline) -> Option<String> {
    let (uniform, scaled, gain) = uniform(model.reconstructor.as_ref(), geometry, baseline)?;
    let noise = against(baseline) / (baseline.frames.max(1) as f64).sqrt() / gain;
    loss_between(model, (&uniform, &scaled), noise, LEAST_UNEVEN)
}

/// Readings of a uniform sheet at 1 A, the baseline scaled to them, and the scale factor.
fn uniform(
    reconstructor: &dyn Reconstructor,
    geometry: &Geometry,
    baseline: &Baseline,
) -> Option<(Vec<Reading>, Vec<Reading>, f64)> {
    let forward = Forward::new(Arc::clone(&geometry.mesh), &geometry.contact_ohm_m).ok()?;
    let protocol = reconstructor.protocol();
    let uniform = forward.readings(&geometry.sigma0, protocol).ok()?;
    let gain = factor(uniform.iter().copied(), &baseline.readings)?;
    let scaled = baseline.readings.iter().map(|reading| match reading {
        Reading::Ok(volts) => Reading::Ok(Volts(volts.0 / gain)),
        other => *other,
    });
    let uniform = Reading::of_volts(uniform.iter().copied());
    Some((uniform, scaled.collect(), gain))
}

/// Whether the largest loss between two baselines exceeds the largest gain. Beside a change, a map shows one of the
/// other sign: where a load of 10 to 95 % was taken off, a loss of up to 0.43 (one-step) or 0.86 (total variation) of
/// the gain. Maps that are bounded to losses explain such a gain by losses elsewhere, so the linear method without
/// bounds decides if the model has one. A model bounded to losses without one shows no gain: then every loss counts (the
/// loss of the reverse comparison is no yardstick, it can exceed that of a real load). A load that is smaller than the
/// one that was taken off is not found.
fn mostly_loss(model: &Model, (before, now): (&[Reading], &[Reading])) -> bool {
    let unbounded = model.fixed_strength.as_ref();
    let reconstructor = unbounded.unwrap_or(&model.reconstructor);
    reconstructor.reconstruct(before, now).is_ok_and(|map| {
        let gain = map.values.iter().copied().fold(0.0, f64::max);
        map.largest_loss().is_some_and(|(_, loss)| loss > gain)
    })
}

/// Where the second readings show a loss against the first, in words; `None` if the loss is within their noise
/// (standard deviation of one reading) or below `least`.
fn loss_between(
    model: &Model,
    (before, now): (&[Reading], &[Reading]),
    noise: f64,
    least: f64,
) -> Option<String> {
    let reconstructor = model.reconstructor.as_ref();
    let map = reconstructor.reconstruct(before, now).ok()?;
    let (_, loss) = map.largest_loss()?;
    if loss <= least || loss <= map_noise(model, before, noise)? {
        return None;
    }
    let mesh = reconstructor.mesh();
    let found = map.found(&mesh.region_centroids(), &mesh.region_areas())?;
    Some(loss_at(loss, found))
}

fn loss_at(loss: f64, [x, y]: [f64; 2]) -> String {
    format!(
        "shows a loss of {:.0} % at ({:.0}, {:.0}) mm",
        100.0 * loss,
        1e3 * x,
        1e3 * y
    )
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use eit::DiscTank;
    use survey::{Amps, Precautions, Protocol, Settings};

    use super::*;
    use crate::{GeometrySettings, Method, PresetName, ReconstructionSettings, build};

    const CURRENT: Amps = Amps(1e-3);

    /// A baseline of a tank; `loss`: of the conductance on a disc, 0 for an empty tank.
    fn baseline(id: &str, geometry: &Geometry, protocol: &Protocol, loss: f64) -> Baseline {
        let mut sigma = geometry.sigma0.clone();
        for (triangle, sigma) in sigma.iter_mut().enumerate() {
            let [x, y] = geometry.mesh.centroid(triangle);
            if (x - 0.06).hypot(y) < 0.03 {
                *sigma *= 1.0 - loss;
            }
        }
        let forward = Forward::new(Arc::clone(&geometry.mesh), &geometry.contact_ohm_m).unwrap();
        let ohms = forward.readings(&sigma, protocol).unwrap();
        let readings = Reading::of_volts(ohms.iter().map(|ohms| CURRENT.0 * ohms));
        Baseline {
            id: id.to_owned(),
            deviation: vec![Some(1e-6); readings.len()],
            readings,
            frames: 4,
            wall: chrono::DateTime::UNIX_EPOCH,
            settings: Settings {
                protocol_hash: protocol.hash(),
                current: CURRENT,
                range: Volts(1.0),
                nplc: 1.0,
                settle: Duration::ZERO,
                wiring: "simulated".into(),
                precautions: Precautions::default(),
            },
            simulated: true,
        }
    }

    #[test]
    fn only_a_load_on_this_baseline_is_to_be_taken_off() {
        let geometry = GeometrySettings {
            preset: Some(PresetName::DiscTank),
            disc_tank: Some(DiscTank {
                fineness: 0.25,
                ..DiscTank::default()
            }),
            ..GeometrySettings::default()
        }
        .geometry(None)
        .unwrap();
        let protocol = Protocol::sheffield(geometry.electrodes()).unwrap();
        let conditions = Conditions::live(&geometry, &protocol, CURRENT);
        let empty = baseline("empty", &geometry, &protocol, 0.0);
        for method in [Method::OneStep, Method::Best] {
            let settings = ReconstructionSettings {
                method: Some(method),
                noise_uv: Some(1.0),
                ..ReconstructionSettings::default()
            };
            let model = build(&settings, &conditions).unwrap();
            for loss in [0.1, 0.3, 0.5, 0.8, 0.95] {
                let loaded = baseline("loaded", &geometry, &protocol, loss);
                let remarked = |of: &Baseline, before: &Baseline, wanted: &str, not: &str| {
                    let remarks = baseline_remarks(&model, &geometry, of, Some(before));
                    let message = format!("{method:?}, {loss}: {remarks:?}");
                    let begins =
                        |begin: &str| remarks.iter().find(|remark| remark.starts_with(begin));
                    assert!(begins(not).is_none(), "{message}");
                    begins(wanted).expect(&message).ends_with(TAKE_OFF)
                };
                let this = "against baseline empty it shows a loss of";
                assert!(remarked(&loaded, &empty, this, "the baseline before"));
                let before = "the baseline before it, loaded, shows a loss of";
                assert!(!remarked(&empty, &loaded, before, "against"));
            }
        }
    }
}
