//! Relay wear: closures counted, compared with the rating, and projected.

use std::time::Duration;

use keysight_34980a::{Model, Module};
use survey::Relay;

/// Wear data of one relay.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Wear {
    pub relay: Relay,
    /// Purpose of the relay, for people.
    pub purpose: String,
    /// Closures so far.
    pub cycles: u64,
    /// Rated closures; `None` if nothing moves (a FET).
    pub rated: Option<u64>,
    /// Used fraction of its life.
    pub used: Option<f64>,
    /// Time of continuous measurement until the rating is reached.
    pub left: Option<Duration>,
}

/// Default rating of a module's relays at the small currents used here. The fact sheets give no numbers: these are the
/// usual order of magnitude of armature and reed relays.
fn rated(model: Model) -> Option<u64> {
    match model {
        Model::M34925A => None,
        Model::M34923A | Model::M34924A | Model::M34933A | Model::M34934A => Some(100_000_000),
        Model::M34921A | Model::M34922A | Model::M34931A | Model::M34932A => Some(10_000_000),
    }
}

/// Projects the wear of one relay, which closes `closures` times for each frame; `period` is the time between frames,
/// and `life` overrides the rating.
pub(crate) fn wear(
    relay: Relay,
    purpose: String,
    cycles: u64,
    module: Option<Module>,
    life: Option<u64>,
    closures: f64,
    period: Duration,
) -> Wear {
    let moves = module.is_none_or(|module| rated(module.model()).is_some());
    let of_model = module.and_then(|module| rated(module.model()));
    let rated = life.or(of_model).filter(|_| moves);
    let left = rated.filter(|_| closures > 0.0).and_then(|rated| {
        let frames = rated.saturating_sub(cycles) as f64 / closures;
        Duration::try_from_secs_f64(frames * period.as_secs_f64()).ok()
    });
    Wear {
        relay,
        purpose,
        cycles,
        used: rated.map(|rated| cycles as f64 / rated as f64),
        rated,
        left,
    }
}

#[cfg(test)]
mod tests {
    use crate::instruments::relay_wear::*;

    #[test]
    fn a_life_is_projected_from_what_a_frame_costs() {
        let reed: Module = "34924A".parse().unwrap();
        let period = Duration::from_secs(10);
        let of = |cycles, life, closures| {
            wear(
                Relay(1036),
                String::new(),
                cycles,
                Some(reed),
                life,
                closures,
                period,
            )
        };
        let half = of(500_000, Some(1_000_000), 2.0);
        assert_eq!(half.used, Some(0.5));
        assert_eq!(half.left, Some(Duration::from_secs(2_500_000)));
        assert_eq!(
            of(2_000_000, Some(1_000_000), 2.0).left,
            Some(Duration::ZERO)
        );
        assert_eq!(of(0, None, 1.0).rated, Some(100_000_000));
        assert_eq!(of(0, None, 0.0).left, None);
        let fet = wear(
            Relay(1001),
            String::new(),
            0,
            Some("34925A".parse().unwrap()),
            None,
            1.0,
            period,
        );
        assert_eq!((fet.rated, fet.used, fet.left), (None, None, None));
    }
}
