//! How the rules of `[[alarm]]` judge quantities of maps and numbers of the daemon's health.

use alarms::Judgement;
use config::{AlarmSettings, HealthValue, Limit, Watched};
use imaging::quantities::{FrameQuantities, Quantity, SHEET, rounded};

use crate::monitoring::health::{Health, Running};

/// The judgement of a rule by the quantities of a frame; `None` for a rule on the daemon's health.
pub(super) fn by_frame(rule: &AlarmSettings, found: &FrameQuantities) -> Option<Judgement> {
    let Watched::Quantity(quantity) = rule.quantity else {
        return None;
    };
    let region = rule.region.as_deref().unwrap_or(SHEET);
    let unit = quantity.unit(found.unit);
    if let Some(wanted) = rule.unit.as_deref().filter(|wanted| *wanted != unit) {
        let why = format!(
            "its limit is in {wanted}, and the session has no calibration for that: its maps give {unit}"
        );
        return Some(Judgement::Unknown(why));
    }
    let Some(values) = found.regions.iter().find(|one| one.name == region) else {
        let why = format!("the session was started without the region '{region}'");
        return Some(Judgement::Unknown(why));
    };
    if quantity != Quantity::Known && !found.known {
        let why = found
            .reason
            .as_deref()
            .unwrap_or("the map is not known to be true");
        return Some(Judgement::Unknown(why.to_owned()));
    }
    Some(match values.values.get(quantity) {
        Some(value) => by_value(rule, value, unit, Some(region)),
        None if needs_load(quantity) => Judgement::Within,
        None => Judgement::Unknown(format!("{} is not known yet", quantity.words())),
    })
}

/// Whether a quantity is defined only where there is a load.
fn needs_load(quantity: Quantity) -> bool {
    use Quantity::{CentreX, CentreY, Dispersion, Mean, Speed, Variation};
    matches!(
        quantity,
        Mean | Variation | Dispersion | CentreX | CentreY | Speed
    )
}

/// The judgement of a rule between frames; `None` if the judgement by the last frame remains valid. `quiet_s`: time
/// since the last frame with quantities, or since the session began.
pub(super) fn by_health(
    rule: &AlarmSettings,
    health: &Health,
    quiet_s: Option<f64>,
) -> Option<Judgement> {
    let watched = match rule.quantity {
        Watched::Health(watched) => watched,
        Watched::Quantity(_) => return without_frame(health.session.as_ref(), quiet_s),
    };
    let days = |seconds: f64| seconds / 86_400.0;
    let session = health.session.as_ref();
    let (value, missing) = match watched {
        HealthValue::FrameAge => (
            session
                .and_then(|session| session.quiet)
                .map(|quiet| quiet.as_secs_f64()),
            "no frame is expected",
        ),
        HealthValue::DiskDays => (
            health.space.days(),
            "the growth of the record is not known yet",
        ),
        HealthValue::RelayUsed => (
            health.relays.as_ref().map(|life| 100.0 * life.used),
            "the wear of the relays has not been read",
        ),
        HealthValue::BaselineAge => (
            health
                .baseline
                .as_ref()
                .map(|(_, age)| days(age.as_secs_f64())),
            "there is no baseline",
        ),
    };
    Some(match value {
        Some(value) => by_value(rule, value, watched.unit(), None),
        None => Judgement::Suppressed(missing.to_owned()),
    })
}

/// The judgement of a rule on a quantity without a new frame; `None` if the judgement by the last frame remains valid.
fn without_frame(session: Option<&Running>, quiet_s: Option<f64>) -> Option<Judgement> {
    let suppressed = |why: &str| Some(Judgement::Suppressed(why.to_owned()));
    let session = match session {
        None => return suppressed("no measurement runs"),
        Some(session) if session.kind != logbook::SessionKind::Measurement.as_str() => {
            return suppressed("a baseline is recorded");
        }
        Some(session) => session,
    };
    if session.quiet.is_none() {
        return suppressed("the session is suspended");
    }
    let quiet_s = quiet_s?;
    Some(Judgement::Unknown(format!(
        "no map has come for {quiet_s:.0} s"
    )))
}

fn by_value(rule: &AlarmSettings, value: f64, unit: &str, region: Option<&str>) -> Judgement {
    // a rule without a limit does not pass the check of the configuration
    let Some(limit) = rule.limit() else {
        return Judgement::Unknown("the rule has no limit".to_owned());
    };
    match limit.beyond(value, rule.deadband) {
        Some(true) => {
            let (word, limit) = match limit {
                Limit::Above(limit) => ("above", limit),
                Limit::Below(limit) => ("below", limit),
            };
            let place = region.map_or(String::new(), |region| format!(" of {region}"));
            let unit = if unit == "1" {
                String::new()
            } else {
                format!(" {unit}")
            };
            let (name, value) = (rule.quantity.name(), rounded(value));
            Judgement::Beyond(format!("{name}{place} {value}{unit}, {word} {limit}{unit}"))
        }
        Some(false) => Judgement::Within,
        None => Judgement::Deadband,
    }
}

#[cfg(test)]
mod tests {
    use imaging::quantities::{LoadUnit, RegionQuantities, Values};

    use crate::alarms::judged::*;

    fn rule(text: &str) -> AlarmSettings {
        toml::from_str(&format!("name = \"heel\"\n{text}")).unwrap()
    }

    fn frame(known: bool, values: &[(Quantity, f64)]) -> FrameQuantities {
        let values: std::collections::BTreeMap<Quantity, f64> = values.iter().copied().collect();
        let region = RegionQuantities {
            name: SHEET.to_owned(),
            values: Values::from(values),
            deviations: Values::default(),
            peak_mm: None,
            ppi_mm: None,
            dose_mm: None,
            unrelieved_mm: None,
        };
        FrameQuantities {
            known,
            reason: (!known).then(|| "drift cannot be told from a load".to_owned()),
            unit: LoadUnit::RelativeLoss,
            regions: vec![region],
            spots: Vec::new(),
            changes: Vec::new(),
        }
    }

    fn judged(rule_text: &str, found: &FrameQuantities) -> Judgement {
        by_frame(&rule(rule_text), found).unwrap()
    }

    #[test]
    fn a_frame_is_judged_by_value_unit_region_and_knowledge() {
        let loaded = frame(true, &[(Quantity::Ppi, 0.31), (Quantity::Known, 1.0)]);
        let ppi = "quantity = \"ppi\"\nabove = 0.3\ndeadband = 0.1\n";
        let text = "ppi of sheet 0.310 lost share, above 0.3 lost share";
        assert_eq!(judged(ppi, &loaded), Judgement::Beyond(text.to_owned()));
        let less = frame(true, &[(Quantity::Ppi, 0.25)]);
        assert_eq!(judged(ppi, &less), Judgement::Deadband);
        let least = frame(true, &[(Quantity::Ppi, 0.15)]);
        assert_eq!(judged(ppi, &least), Judgement::Within);
        let unknown = |text: &str, found: &FrameQuantities| match judged(text, found) {
            Judgement::Unknown(why) => why,
            other => panic!("{other:?}"),
        };
        // a value that may be wrong is not judged
        let doubtful = frame(false, &[(Quantity::Ppi, 0.15), (Quantity::Known, 0.0)]);
        assert!(unknown(ppi, &doubtful).contains("drift"));
        assert!(unknown(&format!("{ppi}unit = \"kPa\"\n"), &loaded).contains("calibration"));
        assert!(unknown(&format!("{ppi}region = \"hip\"\n"), &loaded).contains("'hip'"));
        // the quantity `known` itself can always be judged
        let known = judged("quantity = \"known\"\nbelow = 0.5\n", &doubtful);
        assert_eq!(
            known,
            Judgement::Beyond("known of sheet 0, below 0.5".to_owned())
        );
        let empty = frame(true, &[]);
        assert_eq!(
            judged("quantity = \"speed\"\nabove = 3.0\n", &empty),
            Judgement::Within
        );
        assert!(
            unknown("quantity = \"unrelieved-area\"\nabove = 3.0\n", &empty)
                .contains("not known yet")
        );
    }
}
