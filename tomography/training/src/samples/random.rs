//! Random streams: one for each purpose and item, so that cases and copies are independent.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Purpose of a random stream; streams of different purposes do not overlap.
#[derive(Clone, Copy)]
pub(crate) enum Purpose {
    Case = 1,
    Jitter = 2,
    Pairs = 3,
    Order = 4,
}

/// The random stream of an item.
pub(crate) fn stream(seed: u64, purpose: Purpose, item: usize) -> ChaCha8Rng {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(((purpose as u64) << 48) | item as u64);
    random
}
