//! Checks the rules of `[[alarm]]`: valid names, existing regions, suitable units, and limits that a value can exceed
//! and return from.

use std::collections::BTreeSet;

use config::{AlarmSettings, Config, Limit, Watched};
use imaging::Model;
use imaging::quantities::{LoadUnit, Quantifier, Quantity, RegionSettings, SHEET, is_name};

use crate::monitoring::built_in;
use crate::preparation::Findings;
use config::numbers::too_long;

/// Reports the problems of each rule at their positions in the file. `regions`: the regions of the configuration;
/// `None` if some of them are invalid.
pub(super) fn check<'a>(
    rules: impl Iterator<Item = (usize, &'a AlarmSettings)>,
    regions: Option<&[RegionSettings]>,
    config: &Config,
    model: Option<&Model>,
    findings: &mut Findings<'_>,
) {
    let mut names = BTreeSet::new();
    for (index, rule) in rules {
        let key = |part: &str| format!("alarm.{index}.{part}");
        if let Some(why) = name_problem(&rule.name) {
            findings.add(&key("name"), why);
        } else if !names.insert(&rule.name) {
            findings.add(
                &key("name"),
                format!("alarm '{}' is defined twice", rule.name),
            );
        }
        if let Some(why) = too_long(&rule.guidance) {
            findings.add(&key("guidance"), why);
        }
        if let Some(why) = region_problem(rule, regions) {
            findings.add(&key("region"), why);
            continue;
        }
        // an invalid method is taken as calibrated, so that only its own problem is reported
        let calibrated = model.is_none_or(|model| model.calibration.is_some());
        let unit = match unit(rule, calibrated) {
            Ok(unit) => unit,
            Err(why) => {
                findings.add(&key("unit"), why);
                continue;
            }
        };
        let Some(limit) = rule.limit() else {
            let why = "a rule has either above = LIMIT or below = LIMIT";
            findings.add(&key("above"), why);
            continue;
        };
        let range = range(rule, config, model, unit);
        if let Some((part, why)) = limit_problem(rule, limit, range) {
            findings.add(&key(part), why);
        }
    }
}

fn name_problem(name: &str) -> Option<String> {
    if !is_name(name) {
        return Some(format!(
            "'{name}': a name has letters, digits, '-' and '_', 32 at most"
        ));
    }
    built_in::has(name)
        .then(|| format!("'{name}' is an alarm that every daemon has; choose another name"))
}

fn region_problem(rule: &AlarmSettings, regions: Option<&[RegionSettings]>) -> Option<String> {
    let region = rule.region.as_deref()?;
    if let Watched::Health(watched) = rule.quantity {
        return Some(format!(
            "{} belongs to no region; delete this key",
            watched.name()
        ));
    }
    let names = regions?.iter().map(|region| region.name.as_str());
    let known: Vec<&str> = std::iter::once(SHEET).chain(names).collect();
    (!known.contains(&region)).then(|| {
        format!(
            "there is no region '{region}'; there are: {}",
            known.join(", ")
        )
    })
}

/// The unit of the rule's values; `calibrated`: whether the configured method gives kPa.
fn unit(rule: &AlarmSettings, calibrated: bool) -> Result<LoadUnit, String> {
    let units = rule.quantity.units();
    let name = rule.quantity.name();
    let [pressure, loss] = units;
    match rule.unit.as_deref() {
        None if pressure != loss => Err(format!(
            "the limit of {name} needs a unit: unit = \"{pressure}\" (with a calibration) or \"{loss}\""
        )),
        Some(unit) if unit == pressure && pressure != loss && !calibrated => Err(format!(
            "{name} in {pressure} needs a calibration: model.calibration; without one the unit is \"{loss}\""
        )),
        Some(unit) if unit == pressure => Ok(LoadUnit::Pressure),
        Some(unit) if unit == loss => Ok(LoadUnit::RelativeLoss),
        None => Ok(LoadUnit::Pressure),
        Some(unit) if pressure == loss => Err(format!(
            "the unit of {name} is \"{pressure}\", and not \"{unit}\""
        )),
        Some(unit) => Err(format!(
            "the unit of {name} is \"{pressure}\" (with a calibration) or \"{loss}\", and not \"{unit}\""
        )),
    }
}

/// The possible values, in the unit of the rule: smallest and largest.
fn range(
    rule: &AlarmSettings,
    config: &Config,
    model: Option<&Model>,
    unit: LoadUnit,
) -> (f64, f64) {
    let any = (f64::NEG_INFINITY, f64::INFINITY);
    let from_zero = (0.0, f64::INFINITY);
    let quantity = match rule.quantity {
        Watched::Health(_) => return from_zero,
        Watched::Quantity(quantity) => quantity,
    };
    let area = || {
        let quantifier = Quantifier::new(model?, &config.quantities, &config.region).ok()?;
        let area = quantifier
            .surface()
            .area(rule.region.as_deref().unwrap_or(SHEET))?;
        Some((0.0, 1e6 * area))
    };
    let extent = |axis: usize| {
        let corners = model?.reconstructor.mesh().nodes().iter();
        Some(
            corners
                .map(|corner| 1e3 * corner[axis])
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), at| {
                    (low.min(at), high.max(at))
                }),
        )
    };
    let loss = unit == LoadUnit::RelativeLoss;
    match quantity {
        Quantity::Contact | Quantity::UnrelievedArea => area().unwrap_or(from_zero),
        Quantity::Load if loss => area().unwrap_or(from_zero),
        Quantity::Mean | Quantity::Peak | Quantity::Ppi if loss => (0.0, 1.0),
        Quantity::Dispersion => (0.0, 100.0),
        Quantity::Known => (0.0, 1.0),
        Quantity::CentreX => extent(0).unwrap_or(any),
        Quantity::CentreY => extent(1).unwrap_or(any),
        _ => from_zero,
    }
}

/// The key of the rule, and why its limit can never be exceeded or never be returned from; `None` if both are possible.
fn limit_problem(
    rule: &AlarmSettings,
    limit: Limit,
    (low, high): (f64, f64),
) -> Option<(&'static str, String)> {
    let name = rule.quantity.name();
    let values = match high.is_finite() {
        true => format!("its values lie between {low:.0} and {high:.0}"),
        false => format!("its values are {low:.0} or more"),
    };
    let (part, possible, ends) = match limit {
        Limit::Above(limit) => ("above", limit < high, limit - rule.deadband >= low),
        Limit::Below(limit) => ("below", limit > low, limit + rule.deadband <= high),
    };
    if !possible {
        return Some((
            part,
            format!("{name} can never be beyond this limit; {values}"),
        ));
    }
    (!ends).then(|| {
        let why = format!("{name} can never return far enough for the alarm to end; {values}");
        (
            if rule.deadband > 0.0 {
                "deadband"
            } else {
                part
            },
            why,
        )
    })
}

#[cfg(test)]
mod tests {
    use crate::preparation::prepare;

    /// The problems of a configuration with these lines after the simulated rig.
    fn problems(lines: &str) -> Vec<String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c.toml");
        let region = "[[region]]\nname = \"hip\"\nrectangle_mm = [60.0, 60.0, 130.0, 130.0]\n";
        std::fs::write(
            &path,
            format!("[record]\ndirectory = \"state\"\n{region}{lines}"),
        )
        .unwrap();
        match prepare(&path) {
            Ok(_) => Vec::new(),
            Err(problems) => problems
                .iter()
                .map(|problem| {
                    problem
                        .to_string()
                        .split_once("c.toml:")
                        .unwrap()
                        .1
                        .to_owned()
                })
                .collect(),
        }
    }

    #[test]
    fn every_rule_that_cannot_work_is_named_with_its_place() {
        let good = "[[alarm]]\nname = \"heel\"\nquantity = \"ppi\"\nregion = \"hip\"\nabove = 0.3\nunit = \"lost share\"\n";
        assert_eq!(problems(good), Vec::<String>::new());
        for (lines, wanted) in [
            (
                "name = \"a b\"\nquantity = \"known\"\nbelow = 0.5\n",
                "7:8: alarm.0.name: 'a b': a name has",
            ),
            (
                "name = \"no-frame\"\nquantity = \"known\"\nbelow = 0.5\n",
                "every daemon has",
            ),
            (
                "name = \"a\"\nquantity = \"known\"\n",
                "above = LIMIT or below = LIMIT",
            ),
            (
                "name = \"a\"\nquantity = \"known\"\nbelow = 0.5\nabove = 0.5\n",
                "above = LIMIT or below = LIMIT",
            ),
            (
                "name = \"a\"\nquantity = \"ppi\"\nabove = 0.3\n",
                "needs a unit: unit = \"kPa\"",
            ),
            (
                "name = \"a\"\nquantity = \"ppi\"\nabove = 0.3\nunit = \"kPa\"\n",
                "10:8: alarm.0.unit: ppi in kPa needs a calibration",
            ),
            (
                "name = \"a\"\nquantity = \"ppi\"\nabove = 0.3\nunit = \"psi\"\n",
                "and not \"psi\"",
            ),
            (
                "name = \"a\"\nquantity = \"contact\"\nabove = 3.0\nunit = \"cm2\"\n",
                "the unit of contact is \"mm2\"",
            ),
            (
                "name = \"a\"\nquantity = \"ppi\"\nabove = 1.0\nunit = \"lost share\"\n",
                "9:9: alarm.0.above: ppi can never be beyond this limit; its values lie between 0 and 1",
            ),
            (
                "name = \"a\"\nquantity = \"contact\"\nabove = 1e6\n",
                "can never be beyond this limit",
            ),
            (
                "name = \"a\"\nquantity = \"contact\"\nregion = \"hip\"\nabove = 5000.0\n",
                "can never be beyond this limit",
            ),
            (
                "name = \"a\"\nquantity = \"load\"\nbelow = 0.0\nunit = \"mm2 lost\"\n",
                "can never be beyond this limit; its values lie between",
            ),
            (
                "name = \"a\"\nquantity = \"contact\"\nabove = 10.0\ndeadband = 20.0\n",
                "10:12: alarm.0.deadband: contact can never return",
            ),
            (
                "name = \"a\"\nquantity = \"contact\"\nregion = \"hop\"\nabove = 10.0\n",
                "9:10: alarm.0.region: there is no region 'hop'; there are: sheet, hip",
            ),
            (
                "name = \"a\"\nquantity = \"disk-days\"\nregion = \"hip\"\nbelow = 10.0\n",
                "belongs to no region",
            ),
            (
                "name = \"a\"\nquantity = \"disk-days\"\nbelow = 1.0\n[[alarm]]\nname = \"a\"\nquantity = \"disk-days\"\nbelow = 10.0\n",
                "11:8: alarm.1.name: alarm 'a' is defined twice",
            ),
        ] {
            let found = problems(&format!("[[alarm]]\n{lines}"));
            assert!(
                found.len() == 1 && found[0].contains(wanted),
                "{wanted}\n{found:#?}"
            );
        }
    }

    #[test]
    fn faults_of_regions_and_rules_are_all_found_at_once() {
        let entries = "[[region]]\nname = \"a b\"\nrectangle_mm = [60.0, 60.0, 130.0, 130.0]\n\
            [[region]]\nname = \"far\"\nrectangle_mm = [6000.0, 6000.0, 6100.0, 6100.0]\n\
            [[alarm]]\nname = \"a\"\nquantity = \"contact\"\nregion = \"hop\"\nabove = 10.0\n\
            [[alarm]]\nname = \"b\"\nquantity = \"QUANTITY\"\nabove = 10.0\n\
            [[alarm]]\nname = \"c\"\nquantity = \"contact\"\n";
        let wanted = |lines: &str, wanted: &[&str]| {
            let found = problems(lines);
            assert_eq!(found.len(), wanted.len(), "{found:#?}");
            for wanted in wanted {
                let named = found.iter().any(|text| text.contains(wanted));
                assert!(named, "{wanted}\n{found:#?}");
            }
        };
        let of_entries = [
            "region.1: ",
            "alarm.0.region: there is no region 'hop'",
            "alarm.2.above: ",
        ];
        let beside = "region.2: region 'far' does not touch";
        let of_entries = [&of_entries[..], &[beside]].concat();
        wanted(&entries.replace("QUANTITY", "contact"), &of_entries);
        let typo = entries.replace("QUANTITY", "pii");
        let of_type = [
            &of_entries[..],
            &["alarm.1.quantity: unknown quantity 'pii'"],
        ]
        .concat();
        wanted(&typo, &of_type);
        // without a geometry, the check that regions lie on the sheet is skipped
        let unbuilt = format!("{typo}[geometry]\npreset = \"circle\"\n");
        let unbuilt_wanted = [&of_type[..3], &of_type[4..], &["geometry.preset: "]].concat();
        wanted(&unbuilt, &unbuilt_wanted);
    }
}
