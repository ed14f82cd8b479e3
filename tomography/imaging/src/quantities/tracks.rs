//! Tracking of hot spots from frame to frame: each keeps its number while it moves.

use drift::bits;
use serde::{Deserialize, Serialize};
use survey::HotSpot;

use super::quantity::LoadUnit;

/// Longest distance that a hot spot moves between two frames, in addition to its radius, m.
const LONGEST_STEP_M: f64 = 0.02;
/// Distance from the last reported position at which a hot spot is reported as moved, m.
const MOVED_M: f64 = 0.01;
/// An existing hot spot ends only below this share of the threshold (hysteresis), so that noise at the threshold does
/// not end and begin it with every frame.
pub(super) const STAYS: f64 = 0.8;

/// A hot spot with its history.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SpotTrack {
    /// Its number, from 1 in order of appearance.
    pub number: u64,
    /// Centre, mm.
    pub centre_mm: [f64; 2],
    /// The largest value.
    pub peak: f64,
    /// Area with at least half of the peak value, mm2.
    pub area_mm2: f64,
    /// Load of that area, N; without a calibration mm2 of lost conductance.
    pub load: f64,
    /// Uncertainty of centre and load by noise; `None` if it is not computed or not known.
    pub uncertainty: Option<SpotUncertainty>,
    /// Time since it appeared, s; `None` if frames have no times.
    pub age_s: Option<f64>,
    /// Speed of its centre since the previous frame, mm/s; `None` in its first frame, and if frames have no times.
    pub speed_mm_s: Option<f64>,
}

/// 95 % ellipse of a hot spot's centre and 95 % interval of its load; noise is the only error considered.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SpotUncertainty {
    /// Half axes of the ellipse about the centre, mm, the longer first.
    pub half_axes_mm: [f64; 2],
    /// Angle of the longer half axis from the x axis, degrees, counter-clockwise.
    pub angle_deg: f64,
    /// The load's interval, in its unit.
    pub load_interval: [f64; 2],
}

/// Change of a hot spot with a frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "change")]
pub enum SpotChange {
    /// It is new.
    Appeared {
        /// Its number.
        number: u64,
    },
    /// It is at least 10 mm from its last reported position.
    Moved {
        /// Its number.
        number: u64,
        /// Distance from that position, mm.
        distance_mm: f64,
    },
    /// It is now part of another one.
    Merged {
        /// Its number.
        number: u64,
        /// Number of the other one.
        into: u64,
    },
    /// It has ended.
    Gone {
        /// Its number.
        number: u64,
    },
}

/// All hot spots that are on the sheet.
#[derive(Debug, Clone, Default)]
pub(super) struct Tracks {
    current: Vec<Track>,
    numbered: u64,
    last_s: f64,
}

#[derive(Debug, Clone)]
struct Track {
    number: u64,
    spot: HotSpot,
    since_s: f64,
    speed: Option<f64>,
    reported: [f64; 2],
}

/// Stored form of all hot spots.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TracksState {
    numbers: Vec<u64>,
    /// Nine values for each hot spot: centre (2), peak, area, load, time of appearance, reported position (2), and
    /// speed (NaN in its first frame).
    #[serde(with = "bits")]
    values: Vec<f64>,
    numbered: u64,
    #[serde(with = "bits::number")]
    last_s: f64,
}

impl Tracks {
    pub(super) fn state(&self) -> TracksState {
        let values = self.current.iter().flat_map(|track| {
            let spot = &track.spot;
            let [x, y] = track.reported;
            let speed = track.speed.unwrap_or(f64::NAN);
            [
                spot.centre[0],
                spot.centre[1],
                spot.peak,
                spot.area,
                spot.load,
                track.since_s,
                x,
                y,
                speed,
            ]
        });
        TracksState {
            numbers: self.current.iter().map(|track| track.number).collect(),
            values: values.collect(),
            numbered: self.numbered,
            last_s: self.last_s,
        }
    }

    /// Continues from a stored state; `None` if it is inconsistent.
    pub(super) fn restored(state: &TracksState) -> Option<Self> {
        let (each, rest) = state.values.as_chunks::<9>();
        if each.len() != state.numbers.len() || !rest.is_empty() {
            return None;
        }
        let track = |(number, values): (&u64, &[f64; 9])| {
            let [cx, cy, peak, area, load, since_s, x, y, speed] = *values;
            Track {
                number: *number,
                spot: HotSpot {
                    centre: [cx, cy],
                    peak,
                    area,
                    load,
                },
                since_s,
                speed: Some(speed).filter(|speed| !speed.is_nan()),
                reported: [x, y],
            }
        };
        Some(Self {
            current: state.numbers.iter().zip(each).map(track).collect(),
            numbered: state.numbered,
            last_s: state.last_s,
        })
    }

    /// Adds the hot spots of the next frame and returns the changes. `threshold`: the least peak of a new hot spot;
    /// `spots` contains those down to [`STAYS`] of it.
    pub(super) fn take(&mut self, at_s: f64, spots: &[HotSpot], threshold: f64) -> Vec<SpotChange> {
        let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
        for (old, track) in self.current.iter().enumerate() {
            for (new, spot) in spots.iter().enumerate() {
                let apart = distance(track.spot.centre, spot.centre);
                if apart <= LONGEST_STEP_M + radius(&track.spot).max(radius(spot)) {
                    pairs.push((apart, old, new));
                }
            }
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        let mut track_of: Vec<Option<usize>> = vec![None; spots.len()];
        let mut kept = vec![false; self.current.len()];
        for (_, old, new) in pairs {
            if track_of[new].is_none() && !kept[old] {
                (track_of[new], kept[old]) = (Some(old), true);
            }
        }
        let mut changes = Vec::new();
        let step = at_s - self.last_s;
        let mut before = std::mem::take(&mut self.current);
        if step < 0.0 {
            // the clock was set back: keep their ages
            for track in &mut before {
                track.since_s += step;
            }
        }
        for (spot, old) in spots.iter().zip(&track_of) {
            let track = match old {
                Some(old) => before[*old].followed(spot, step),
                None if spot.peak < threshold => continue,
                None => {
                    self.numbered += 1;
                    changes.push(SpotChange::Appeared {
                        number: self.numbered,
                    });
                    Track {
                        number: self.numbered,
                        spot: spot.clone(),
                        since_s: at_s,
                        speed: None,
                        reported: spot.centre,
                    }
                }
            };
            self.current.push(track);
        }
        for track in &mut self.current {
            let moved = distance(track.reported, track.spot.centre);
            if moved >= MOVED_M {
                track.reported = track.spot.centre;
                changes.push(SpotChange::Moved {
                    number: track.number,
                    distance_mm: 1e3 * moved,
                });
            }
        }
        for (track, _) in before.iter().zip(&kept).filter(|(_, kept)| !**kept) {
            let into = self.current.iter().find(|other| {
                distance(track.spot.centre, other.spot.centre) <= radius(&other.spot)
            });
            changes.push(match into {
                Some(other) => SpotChange::Merged {
                    number: track.number,
                    into: other.number,
                },
                None => SpotChange::Gone {
                    number: track.number,
                },
            });
        }
        self.last_s = at_s;
        changes
    }

    /// The hot spots of the last frame, in the order of [`Tracks::list`].
    pub(super) fn spots(&self) -> impl Iterator<Item = &HotSpot> {
        self.current.iter().map(|track| &track.spot)
    }

    /// The hot spots of the last frame, the highest first. `uncertain` has one for each, or none at all.
    pub(super) fn list(
        &self,
        unit: LoadUnit,
        uncertain: &[Option<SpotUncertainty>],
    ) -> Vec<SpotTrack> {
        self.current
            .iter()
            .enumerate()
            .map(|(index, track)| SpotTrack {
                number: track.number,
                centre_mm: track.spot.centre.map(|metres| 1e3 * metres),
                peak: track.spot.peak,
                area_mm2: 1e6 * track.spot.area,
                load: unit.load_factor() * track.spot.load,
                uncertainty: uncertain.get(index).copied().flatten(),
                age_s: Some(self.last_s - track.since_s),
                speed_mm_s: track.speed,
            })
            .collect()
    }
}

impl Track {
    fn followed(&self, spot: &HotSpot, step: f64) -> Self {
        let way = 1e3 * distance(self.spot.centre, spot.centre);
        Self {
            spot: spot.clone(),
            speed: Some(way / step).filter(|_| step > 0.0),
            ..*self
        }
    }
}

pub(super) fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Radius of the circle with the spot's area, m.
pub(super) fn radius(spot: &HotSpot) -> f64 {
    (spot.area / std::f64::consts::PI).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spot(x_mm: f64, area_mm2: f64) -> HotSpot {
        HotSpot {
            centre: [1e-3 * x_mm, 0.0],
            peak: 1.0,
            area: 1e-6 * area_mm2,
            load: 1e-6 * area_mm2,
        }
    }

    #[test]
    fn a_spot_keeps_its_number_while_it_moves() {
        let mut tracks = Tracks::default();
        assert_eq!(
            tracks.take(0.0, &[spot(10.0, 300.0)], 0.5),
            [SpotChange::Appeared { number: 1 }]
        );
        assert_eq!(tracks.take(1.0, &[spot(16.0, 300.0)], 0.5), []);
        let moved = tracks.take(2.0, &[spot(22.0, 300.0), spot(90.0, 300.0)], 0.5);
        assert_eq!(moved[0], SpotChange::Appeared { number: 2 });
        assert!(
            matches!(moved[1], SpotChange::Moved { number: 1, distance_mm } if (distance_mm - 12.0).abs() < 1e-9)
        );
        let list = tracks.list(LoadUnit::RelativeLoss, &[]);
        assert_eq!((list[0].number, list[0].age_s), (1, Some(2.0)));
        assert!((list[0].speed_mm_s.unwrap() - 6.0).abs() < 1e-9);
        assert_eq!(list[1].speed_mm_s, None);
    }

    #[test]
    fn a_covered_spot_has_merged_and_one_that_ends_is_gone() {
        let mut tracks = Tracks::default();
        tracks.take(
            0.0,
            &[spot(10.0, 300.0), spot(41.0, 300.0), spot(200.0, 300.0)],
            0.5,
        );
        let changes = tracks.take(1.0, &[spot(25.0, 2800.0)], 0.5);
        assert!(
            matches!(changes[0], SpotChange::Moved { number: 1, .. }),
            "{changes:?}"
        );
        let ended = [
            SpotChange::Merged { number: 2, into: 1 },
            SpotChange::Gone { number: 3 },
        ];
        assert_eq!(changes[1..], ended);
        // numbers are not reused
        assert_eq!(
            tracks.take(2.0, &[spot(25.0, 2800.0), spot(200.0, 300.0)], 0.5),
            [SpotChange::Appeared { number: 4 }]
        );
    }

    #[test]
    fn spot_keeps_its_age_where_the_clock_is_set_back() {
        let mut tracks = Tracks::default();
        for second in [1000.0, 1020.0, 400.0, 410.0] {
            tracks.take(second, &[spot(10.0, 300.0)], 0.5);
        }
        let list = tracks.list(LoadUnit::RelativeLoss, &[]);
        assert_eq!((list[0].number, list[0].age_s), (1, Some(30.0)));
    }

    #[test]
    fn a_spot_at_the_threshold_neither_ends_nor_begins_anew() {
        let weak = |peak| HotSpot {
            peak,
            ..spot(10.0, 300.0)
        };
        let mut tracks = Tracks::default();
        assert_eq!(tracks.take(0.0, &[weak(0.49)], 0.5), []);
        assert_eq!(
            tracks.take(1.0, &[weak(0.5)], 0.5),
            [SpotChange::Appeared { number: 1 }]
        );
        for (second, peak) in [(2.0, 0.499), (3.0, 0.501), (4.0, 0.41)] {
            assert_eq!(tracks.take(second, &[weak(peak)], 0.5), []);
        }
        assert_eq!(tracks.list(LoadUnit::RelativeLoss, &[]).len(), 1);
        assert_eq!(tracks.take(5.0, &[], 0.5), [SpotChange::Gone { number: 1 }]);
    }
}
