//! A checksum of a map's values from which the distance to another map can be estimated.

use crate::Map;

impl Map {
    /// The sum of the map's values with pseudo-random signs drawn from `seed`.
    ///
    /// The squared difference of two maps' sums, averaged over seeds, is the squared length of the maps' difference, so
    /// one sum estimates their distance as one sample estimates a standard deviation. Each map of a session has
    /// different signs, so that no difference is missed by all of them.
    ///
    /// ```
    /// let map = |values: [f64; 3]| survey::Map {
    ///     mesh_hash: "m".into(),
    ///     values: values.into(),
    ///     unit: survey::MapUnit::RelativeConductance,
    ///     method: "one-step".into(),
    ///     masked: 0,
    ///     evidence: None,
    ///     quality: None,
    /// };
    /// let kept = map([-0.1, -0.2, 0.3]).signed_sum(7);
    /// assert_eq!(map([-0.1, -0.2, 0.3]).distance(kept, 7), 0.0);
    /// assert!(map([-0.1, -0.2, 0.4]).distance(kept, 7) > 0.1);
    /// ```
    pub fn signed_sum(&self, seed: u32) -> f64 {
        let of_seed = u64::from(seed) << 32;
        // one draw gives the signs of 64 triangles
        let draws = self.values.chunks(64).zip(of_seed..);
        let sums = draws.map(|(values, draw)| {
            let bits = mixed(draw);
            let signed = values.iter().enumerate().map(|(at, value)| {
                let negative = bits >> at & 1 == 1;
                if negative { -value } else { *value }
            });
            signed.sum::<f64>()
        });
        sums.sum()
    }

    /// Estimated distance of this map from the one whose [`Map::signed_sum`] is `kept`, relative to this map's length:
    /// 0 if they are the same, infinite if this map is all zeros and the other is not.
    pub fn distance(&self, kept: f64, seed: u32) -> f64 {
        let apart = (self.signed_sum(seed) - kept).abs();
        let squares = self.values.iter().map(|value| value * value);
        if apart == 0.0 {
            0.0
        } else {
            apart / squares.sum::<f64>().sqrt()
        }
    }
}

/// The finaliser of SplitMix64 (Steele, Lea and Flood, OOPSLA 2014).
fn mixed(number: u64) -> u64 {
    let mut z = number.wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(values: impl IntoIterator<Item = f64>) -> Map {
        Map::relative("m", values.into_iter().collect(), "test")
    }

    /// Pseudo-random numbers between -1 and 1.
    fn noise(seed: u64) -> Vec<f64> {
        let of = |k: u64| mixed(!(seed << 32) - k) as f64;
        (0..1000)
            .map(|k| of(k) / u64::MAX as f64 * 2.0 - 1.0)
            .collect()
    }

    #[test]
    fn distances_are_those_of_a_normal_distribution() {
        let length = |values: &[f64]| values.iter().map(|value| value * value).sum::<f64>().sqrt();
        let seeds = 2000;
        for size in [1e-5, 1e-3, 0.1] {
            let here = noise(1);
            let there: Vec<f64> = here
                .iter()
                .zip(noise(2))
                .map(|(here, error)| here + size * error)
                .collect();
            let truth = size * length(&noise(2)) / length(&there);
            let (here, there) = (map(here), map(there));
            let distances: Vec<f64> = (0..seeds)
                .map(|seed| there.distance(here.signed_sum(seed), seed) / truth)
                .collect();
            let within = |most: f64| {
                distances
                    .iter()
                    .filter(|distance| **distance < most)
                    .count() as f64
            };
            // 68.3, 8.0 and 99.73 per cent, and three standard deviations of 2,000 draws
            let part = |most: f64| within(most) / f64::from(seeds);
            assert!((0.65..0.715).contains(&part(1.0)), "{}", part(1.0));
            assert!((0.06..0.10).contains(&part(0.1)), "{}", part(0.1));
            assert!(part(3.0) > 0.99, "{}", part(3.0));
        }
    }

    #[test]
    fn distance_depends_on_each_triangle_and_on_their_order() {
        let here = noise(7);
        let kept = map(here.clone()).signed_sum(3);
        assert_eq!(map(here.clone()).distance(kept, 3), 0.0);
        let mut one = here.clone();
        one[321] += 0.01;
        assert!(map(one).distance(kept, 3) > 1e-4);
        let mut turned = here;
        turned.reverse();
        assert!(map(turned).distance(kept, 3) > 0.01);
        let still = map([0.0; 5]);
        assert_eq!(still.distance(still.signed_sum(3), 3), 0.0);
        assert_eq!(
            still.distance(map([0.5; 5]).signed_sum(3), 3),
            f64::INFINITY
        );
    }
}
