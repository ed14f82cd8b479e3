//! k-means. The bits of the result do not depend on the number of threads, because work is divided into fixed chunks
//! whose sums are added in order.

use eit::linear_algebra::{product, squared_distance};
use faer::MatRef;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Rows per task.
const CHUNK: usize = 1000;

/// Rows of equal length, stored one after another.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rows<'a> {
    pub(crate) values: &'a [f32],
    pub(crate) width: usize,
}

impl<'a> Rows<'a> {
    pub(crate) fn len(self) -> usize {
        self.values.len() / self.width
    }

    pub(crate) fn row(self, index: usize) -> &'a [f32] {
        &self.values[index * self.width..][..self.width]
    }

    fn chunks(self) -> rayon::slice::Chunks<'a, f32> {
        self.values.par_chunks(CHUNK * self.width)
    }
}

/// Centres of clusters, and statistics of the search.
#[derive(Debug, Clone)]
pub(crate) struct Clusters {
    /// One row per centre.
    pub(crate) centres: Vec<f64>,
    /// Number of rounds of assignment.
    pub(crate) rounds: usize,
    /// Number of clusters that became empty and were restarted at the farthest sample.
    pub(crate) reseeded: usize,
}

/// Cluster of a sample, with bounds on its distances that avoid recomputing them (Hamerly, 2010).
#[derive(Debug, Clone, Copy)]
struct Assignment {
    cluster: u32,
    /// Upper bound of the distance from the centre of its cluster.
    upper: f64,
    /// Lower bound of the distance from any other centre.
    lower: f64,
}

impl Assignment {
    /// Whether another centre may be nearer, allowing for rounding.
    fn doubtful(self) -> bool {
        self.upper * (1.0 + 1e-7) >= self.lower
    }
}

/// Lloyd's iterations from a k-means++ start, until no sample changes its cluster or `most_rounds` is reached.
/// Distances of a sample are recomputed only if the movement of the centres could have changed its cluster.
pub(crate) fn cluster(
    rows: Rows<'_>,
    count: usize,
    seed: u64,
    most_rounds: usize,
    progress: &(dyn Fn(usize) + Sync),
) -> Clusters {
    let mut centres = start(rows, count, seed);
    let unknown = Assignment {
        cluster: u32::MAX,
        upper: f64::INFINITY,
        lower: 0.0,
    };
    let mut places = vec![unknown; rows.len()];
    let mut reseeded = 0;
    let mut rounds = 0;
    while rounds < most_rounds {
        rounds += 1;
        progress(rounds);
        if !assign(rows, &centres, &mut places) {
            break;
        }
        let before = centres.clone();
        let (sums, sizes) = sums(rows, &places, count);
        let mut farthest = None;
        for cluster in 0..count {
            let centre = &mut centres[cluster * rows.width..][..rows.width];
            if sizes[cluster] > 0 {
                for (value, sum) in centre.iter_mut().zip(&sums[cluster * rows.width..]) {
                    *value = sum / sizes[cluster] as f64;
                }
                continue;
            }
            let order = farthest.get_or_insert_with(|| by_distance(rows, &before, &places));
            let Some((sample, distance)) = order.pop() else {
                continue;
            };
            if distance > 0.0 {
                reseeded += 1;
                for (value, sample) in centre.iter_mut().zip(rows.row(sample)) {
                    *value = f64::from(*sample);
                }
            }
        }
        let moved: Vec<f64> = centres
            .chunks(rows.width)
            .zip(before.chunks(rows.width))
            .map(|(now, before)| {
                let square: f64 = now.iter().zip(before).map(|(a, b)| (a - b).powi(2)).sum();
                square.sqrt()
            })
            .collect();
        let most = moved.iter().copied().fold(0.0, f64::max);
        for place in &mut places {
            place.upper += moved[place.cluster as usize];
            place.lower -= most;
        }
    }
    Clusters {
        centres,
        rounds,
        reseeded,
    }
}

/// k-means++: each next centre is a sample drawn with probability proportional to its squared distance from the
/// existing centres.
fn start(rows: Rows<'_>, count: usize, seed: u64) -> Vec<f64> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut centres = Vec::with_capacity(count * rows.width);
    let mut distance = vec![f64::INFINITY; rows.len()];
    let mut next = random.random_range(0..rows.len());
    for _ in 0..count {
        let from = centres.len();
        centres.extend(rows.row(next).iter().map(|value| f64::from(*value)));
        let centre = &centres[from..];
        distance
            .par_chunks_mut(CHUNK)
            .zip(rows.chunks())
            .for_each(|(distance, values)| {
                for (distance, row) in distance.iter_mut().zip(values.chunks(rows.width)) {
                    *distance = distance.min(squared_distance(row, centre));
                }
            });
        let total: f64 = distance.iter().sum();
        let mut left = random.random::<f64>() * total;
        next = if total > 0.0 {
            distance
                .iter()
                .position(|distance| {
                    left -= distance;
                    left < 0.0
                })
                .unwrap_or(rows.len() - 1)
        } else {
            random.random_range(0..rows.len())
        };
    }
    centres
}

/// Finds the nearest and second nearest centre of every doubtful row, by |x|^2 - 2 x c + |c|^2 in double precision,
/// clamped at 0. Returns whether any row has changed its cluster.
fn assign(rows: Rows<'_>, centres: &[f64], places: &mut [Assignment]) -> bool {
    let count = centres.len() / rows.width;
    let by_row = MatRef::from_row_major_slice(centres, count, rows.width);
    let squares: Vec<f64> = centres
        .chunks(rows.width)
        .map(|centre| centre.iter().map(|value| value * value).sum())
        .collect();
    let changes = rows
        .chunks()
        .zip(places.par_chunks_mut(CHUNK))
        .map(|(values, places)| {
            let mut doubtful = Vec::new();
            let mut wide: Vec<f64> = Vec::new();
            for (index, (row, place)) in values.chunks(rows.width).zip(&mut *places).enumerate() {
                if !place.doubtful() {
                    continue;
                }
                if let Some(own) = centres.chunks(rows.width).nth(place.cluster as usize) {
                    place.upper = squared_distance(row, own).sqrt();
                    if !place.doubtful() {
                        continue;
                    }
                }
                doubtful.push(index);
                wide.extend(row.iter().map(|value| f64::from(*value)));
            }
            if doubtful.is_empty() {
                return false;
            }
            let samples = MatRef::from_row_major_slice(&wide, doubtful.len(), rows.width);
            // centres x samples: a column per sample
            let products = product(by_row, samples.transpose());
            let mut changed = false;
            for ((products, row), index) in products
                .column_iter()
                .zip(wide.chunks(rows.width))
                .zip(doubtful)
            {
                let own: f64 = row.iter().map(|value| value * value).sum();
                let mut nearest = (u32::MAX, f64::INFINITY);
                let mut second = f64::INFINITY;
                for (cluster, (product, square)) in products.iter().zip(&squares).enumerate() {
                    let distance = (own - 2.0 * product + square).max(0.0);
                    if distance < nearest.1 {
                        second = nearest.1;
                        nearest = (cluster as u32, distance);
                    } else {
                        second = second.min(distance);
                    }
                }
                changed |= places[index].cluster != nearest.0;
                places[index] = Assignment {
                    cluster: nearest.0,
                    upper: nearest.1.sqrt(),
                    lower: second.sqrt(),
                };
            }
            changed
        });
    // without short-circuit: every chunk must be processed
    changes.reduce(|| false, |a, b| a | b)
}

/// Sum of the rows of each cluster, and their number.
fn sums(rows: Rows<'_>, places: &[Assignment], count: usize) -> (Vec<f64>, Vec<usize>) {
    let parts: Vec<(Vec<f64>, Vec<usize>)> = rows
        .chunks()
        .zip(places.par_chunks(CHUNK))
        .map(|(values, places)| {
            let mut sums = vec![0.0; count * rows.width];
            let mut sizes = vec![0; count];
            for (row, place) in values.chunks(rows.width).zip(places) {
                let cluster = place.cluster as usize;
                sizes[cluster] += 1;
                for (sum, value) in sums[cluster * rows.width..].iter_mut().zip(row) {
                    *sum += f64::from(*value);
                }
            }
            (sums, sizes)
        })
        .collect();
    let mut total = (vec![0.0; count * rows.width], vec![0; count]);
    for (sums, sizes) in parts {
        for (total, sum) in total.0.iter_mut().zip(sums) {
            *total += sum;
        }
        for (total, size) in total.1.iter_mut().zip(sizes) {
            *total += size;
        }
    }
    total
}

/// Samples with their squared distances from their centres, the farthest last.
fn by_distance(rows: Rows<'_>, centres: &[f64], places: &[Assignment]) -> Vec<(usize, f64)> {
    let mut order: Vec<(usize, f64)> = places
        .iter()
        .enumerate()
        .map(|(sample, place)| {
            let own = &centres[place.cluster as usize * rows.width..][..rows.width];
            (sample, squared_distance(rows.row(sample), own))
        })
        .collect();
    order.sort_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)));
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_heaps_are_found() {
        let values: Vec<f32> = (0..3000)
            .flat_map(|i| {
                let heap = (i % 3) as f32;
                [10.0 * heap + (i as f32 * 0.37).sin(), -5.0 * heap]
            })
            .collect();
        let clusters = cluster(
            Rows {
                values: &values,
                width: 2,
            },
            3,
            1,
            50,
            &|_| {},
        );
        let mut seconds: Vec<f64> = clusters.centres.chunks(2).map(|centre| centre[1]).collect();
        seconds.sort_by(f64::total_cmp);
        assert_eq!(seconds, [-10.0, -5.0, 0.0]);
    }

    #[test]
    fn copies_of_one_sample_end_in_one_round_more() {
        let values = [0.5_f32; 100 * 7];
        let rows = Rows {
            values: &values,
            width: 7,
        };
        let clusters = cluster(rows, 10, 3, 50, &|_| {});
        assert!(clusters.rounds <= 2);
        assert!(clusters.centres.iter().all(|value| *value == 0.5));
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bits() {
        let values: Vec<f32> = (0..5000 * 9)
            .map(|i| ((i * 7919 % 10007) as f32 * 0.013).sin())
            .collect();
        let rows = Rows {
            values: &values,
            width: 9,
        };
        let bits = |threads| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            let clusters = pool.install(|| cluster(rows, 12, 5, 20, &|_| {}));
            clusters
                .centres
                .iter()
                .map(|value| value.to_bits())
                .collect::<Vec<_>>()
        };
        assert_eq!(bits(1), bits(3));
    }

    #[test]
    fn the_bounds_leave_every_sample_at_its_nearest_centre() {
        let values: Vec<f32> = (0..4000 * 6)
            .map(|i| ((i * 7919 % 10007) as f32 * 0.013).sin())
            .collect();
        let rows = Rows {
            values: &values,
            width: 6,
        };
        let unknown = Assignment {
            cluster: u32::MAX,
            upper: f64::INFINITY,
            lower: 0.0,
        };
        for rounds in [2, 5, 30] {
            let clusters = cluster(rows, 15, 5, rounds, &|_| {});
            // compared with one more plain iteration of Lloyd without bounds
            let next = cluster(rows, 15, 5, rounds + 1, &|_| {});
            let mut places = vec![unknown; rows.len()];
            assign(rows, &clusters.centres, &mut places);
            let (sums, sizes) = sums(rows, &places, 15);
            for (cluster, centre) in next.centres.chunks(6).enumerate() {
                for (value, sum) in centre.iter().zip(&sums[cluster * 6..]) {
                    assert!((value - sum / sizes[cluster] as f64).abs() < 1e-9);
                }
            }
        }
    }
}
