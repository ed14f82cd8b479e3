//! Limits of noise, memory and loss that a training must satisfy for its case and this machine.

use eit::{Case, Forward};
use studies::Failure;
use survey::{Bounds, Volts};

/// Noise of one reading above which a training needs `--yes`, V: ten times that of the voltmeter at 0.02
/// power-line cycles on its 1 V range.
const PLAUSIBLE_NOISE_V: f64 = 1e-3;

/// Loss relative to that of empty maps above which a training has learnt nothing.
const NOTHING_LEARNT: f64 = 0.99;

/// The largest reading of a case, V.
///
/// # Errors
/// A case that cannot be solved.
pub(super) fn largest_reading(case: &Case) -> Result<f64, Failure> {
    let failed = |fault| Failure::of("the case cannot be solved", &fault);
    let forward =
        Forward::new(std::sync::Arc::clone(&case.mesh), &case.contact_ohm_m).map_err(failed)?;
    let ohms = forward
        .readings(&case.unloaded_conductance(), &case.protocol)
        .map_err(failed)?;
    let readings = ohms.iter().zip(&case.currents);
    Ok(readings.fold(0.0, |largest, (ohms, amps)| {
        largest.max((ohms * amps).abs())
    }))
}

/// Refuses noise that is not below the largest reading (V), and implausible noise unless it is confirmed.
///
/// # Errors
/// The level and its bound.
pub(super) fn check_noise(largest: f64, levels: &[f64], confirmed: bool) -> Result<(), Failure> {
    for level in levels {
        Bounds::Between(0.0, largest).check(*level).map_err(|_| {
            Failure::usage(format!(
                "--noise-v {level}: the largest reading of the case is {largest:.2e} V, so nothing is above this noise; is it in \
                 volts? 2 uV are 2e-6"
            ))
        })?;
        if *level > PLAUSIBLE_NOISE_V && !confirmed {
            return Err(Failure::usage(format!(
                "--noise-v {level}: {:.3} of noise in one reading is more than {}; is it in volts? 2 uV are 2e-6. --yes trains for it nevertheless",
                Volts(*level),
                Volts(PLAUSIBLE_NOISE_V)
            )));
        }
    }
    Ok(())
}

/// Refuses a training whose loss stays at that of empty maps, unless it is confirmed.
///
/// # Errors
/// Both losses, and what to change.
pub(super) fn check_learnt(loss: f64, empty: f64, confirmed: bool) -> Result<(), Failure> {
    if confirmed || loss < NOTHING_LEARNT * empty || (loss == 0.0 && empty == 0.0) {
        return Ok(());
    }
    Err(Failure::because(format!(
        "the training has learnt nothing, and no model is written: its loss on held-out cases is {loss:.4}, that of empty maps is \
         {empty:.4}. Give it more cases or epochs, or less noise; check that frames and places of a recorded set belong together. --yes \
         writes the model nevertheless"
    )))
}

/// Reports how much memory the cases of a training take, and refuses more than the machine has free.
///
/// # Errors
/// Both sizes, and what to do.
pub(super) fn check_memory(cases: usize, readings: usize, copies: usize) -> Result<(), Failure> {
    // single precision; while the cases are collected there are two copies of them
    let bytes = 4.0 * readings as f64 * cases as f64 * (2.0 + copies as f64);
    let needs = format!(
        "{cases} cases of {readings} readings take about {} of memory",
        size(bytes)
    );
    match free_bytes() {
        Some(free) if bytes > free => Err(Failure::usage(format!(
            "{needs}, and {} are free; take fewer --cases or --repeats, or `train linear`, which keeps no cases",
            size(free)
        ))),
        _ => {
            eprintln!("tactus-lab: {needs}");
            Ok(())
        }
    }
}

fn size(bytes: f64) -> String {
    match bytes {
        bytes if bytes >= 1e9 => format!("{:.1} GB", bytes * 1e-9),
        bytes => format!("{:.0} MB", (bytes * 1e-6).ceil()),
    }
}

/// Memory that is available on this machine, bytes; `None` if it is not known.
fn free_bytes() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text
        .lines()
        .find_map(|line| line.strip_prefix("MemAvailable:"))?;
    let kibibytes: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(1024.0 * kibibytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_memory_than_there_is_is_refused() {
        let error = check_memory(1_000_000_000_000, 598, 5)
            .unwrap_err()
            .to_string();
        assert!(error.contains("GB") && error.contains("--cases"), "{error}");
        assert!(check_memory(100, 598, 5).is_ok());
    }

    #[test]
    fn a_loss_of_empty_maps_is_refused_with_both_losses() {
        let refused = |loss| check_learnt(loss, 2.0, false).map_err(|fault| fault.to_string());
        let error = refused(1.99).unwrap_err();
        assert!(
            error.contains("1.9900") && error.contains("2.0000"),
            "{error}"
        );
        assert!(refused(f64::NAN).is_err());
        assert!(refused(1.97).is_ok());
        assert!(check_learnt(2.5, 2.0, true).is_ok());
        // there are too few cases to hold any out
        assert!(check_learnt(0.0, 0.0, false).is_ok());
    }
}
