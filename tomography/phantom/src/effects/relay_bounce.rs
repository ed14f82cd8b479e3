//! Operate time and bounce of a relay: the path conducts only after its contact has closed and settled.
//!
//! The voltmeter sees no signal until `operate_ms` after the instrument reports that its relays have moved; during the
//! next `bounce_ms` the path conducts for a random share of the time; a reading is the mean over its integration.
//! Armature relays operate in 4 to 10 ms, reed relays in 0.5 to 1 ms, and both bounce for 0.5 to 3 ms (fact sheet,
//! section 2.2). The time counts from the report: the mainframe reports after its own settling time, a scan and the
//! multiplexer board immediately. A floating input reads zero. Leave it out with a delay of twice the operate time.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use survey::Volts;

use super::bounds::parameters;
use super::{Effect, Effects, OnReading, SheetResponse, stream};
use crate::scan::ReadingContext;

parameters! {
    /// Times of a relay.
    RelayBounceSettings {
        /// Time until the contact closes for the first time, ms.
        operate_ms = 0.7, in [0.0, 100.0], "ms";
        /// Time from then until the contact remains closed, ms.
        bounce_ms = 1.5, in [0.0, 100.0], "ms";
    }
}

impl RelayBounceSettings {
    /// Shares of the integration during which the contact bounces, and during which it remains closed.
    fn shares(&self, context: &ReadingContext) -> [f64; 2] {
        let [operate, bounce] = [self.operate_ms * 1e-3, self.bounce_ms * 1e-3];
        let begin = context.settled().as_secs_f64();
        let length = context.integration.as_secs_f64();
        let still = operate + bounce;
        if begin >= still {
            return [0.0, 1.0];
        }
        if length == 0.0 {
            return [f64::from(u8::from(begin >= operate)), 0.0];
        }
        let end = begin + length;
        let within = |from: f64, to: f64| (to.min(end) - from.max(begin)).max(0.0) / length;
        [within(operate, still), within(still, f64::INFINITY)]
    }
}

impl Effect for RelayBounceSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.rms(&|sight| {
            let [bouncing, closed] = self.shares(&sight.context);
            // the conducting share of the bounce is uniform between 0 and 1: mean 1/2, variance 1/12
            let missing = 1.0 - closed - 0.5 * bouncing;
            sight.exact * (missing * missing + bouncing * bouncing / 12.0).sqrt()
        })
    }

    fn add(&self, seed: u64, effects: &mut Effects) {
        effects.readings.push(Box::new(RelayBounce {
            settings: self.clone(),
            stream: stream(seed, "relay-bounce"),
        }));
    }
}

#[derive(Debug)]
struct RelayBounce {
    settings: RelayBounceSettings,
    stream: ChaCha8Rng,
}

impl OnReading for RelayBounce {
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts {
        // drawn even if the contact no longer bounces, so that the other readings get the same numbers
        let share: f64 = self.stream.random();
        let [bouncing, closed] = self.settings.shares(context);
        Volts(volts.0 * (share * bouncing + closed))
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::super::tests::context;
    use super::*;

    fn shares(settled_us: u64, nplc: f64) -> Vec<f64> {
        let mut effects = Effects::default();
        let relay = RelayBounceSettings {
            operate_ms: 4.0,
            bounce_ms: 2.0,
        };
        relay.add(1, &mut effects);
        let context = context(1.0, nplc);
        let since_change = context.integration + Duration::from_micros(settled_us);
        let context = ReadingContext {
            since_change,
            ..context
        };
        (0..4000)
            .map(|_| effects.reading(Volts(1.0), &context).0)
            .collect()
    }

    #[test]
    fn a_reading_is_the_mean_over_what_the_contact_conducts() {
        // 0.02 cycles are 0.4 ms: the reading is zero before the contact closes, and unchanged bit for bit after it has
        // settled
        assert!(shares(3_000, 0.02).iter().all(|share| *share == 0.0));
        assert!(shares(6_000, 0.02).iter().all(|share| *share == 1.0));
        // during the bounce, any value between
        let bouncing = shares(5_000, 0.02);
        let mean = bouncing.iter().sum::<f64>() / 4000.0;
        assert!((mean - 0.5).abs() < 0.02, "{mean}");
        // 20 ms from the start: closed for 14 ms, and bouncing for 2 ms, half of which conducts on average
        let long = shares(0, 1.0);
        let mean = long.iter().sum::<f64>() / 4000.0;
        assert!((mean - 0.75).abs() < 0.002, "{mean}");
        assert!(long.iter().all(|share| (0.7..=0.8).contains(share)));
    }
}
