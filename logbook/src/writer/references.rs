//! The reference of the next frame's differences: the baseline, or the mean of sixteen frames, which makes the
//! differences smaller. A mean is written as a row of its own when the saving exceeds its size.

use survey::{Reading, Volts};

use crate::codec::{EncodeError, Reference, encode};

/// Number of frames averaged for a reference: its noise adds a thirtieth of a bit to each reading of a frame.
const AVERAGED: u32 = 16;
/// A reference is written if the saving on this many frames exceeds its size.
const PAYS_WITHIN: usize = 64;
/// Maximum number of frames that depend on one reference, and are lost if it is damaged.
const MOST_FRAMES: u32 = 1024;

/// Cheap to clone: the old value is restored if a transaction fails.
#[derive(Debug, Clone, Default)]
pub(super) struct References {
    baseline: Option<Reference>,
    /// The last one written: its number, its readings, and the number of frames since.
    kept: Option<(i64, Reference, u32)>,
    last_number: i64,
    recent: Recent,
}

/// Packed frames, ready to be written.
pub(super) struct Packed {
    /// `None` for nothing, 0 for the baseline, else the number of a reference.
    pub(super) reference: Option<i64>,
    pub(super) blob: Vec<u8>,
    /// A new reference, to be written with the frames.
    pub(super) written: Option<NewReference>,
}

pub(super) struct NewReference {
    pub(super) id: i64,
    pub(super) against_baseline: bool,
    pub(super) blob: Vec<u8>,
}

impl References {
    pub(super) fn set_baseline(&mut self, readings: &[Reading]) {
        self.baseline = Some(Reference::new(readings));
    }

    /// Continues the numbers after those in the file; the old references are not used again.
    pub(super) fn resume_after(&mut self, last_number: i64) {
        self.last_number = last_number;
    }

    /// Packs the next frames together, and adds them to the running mean.
    pub(super) fn pack(&mut self, frames: &[&[Reading]]) -> Result<Packed, EncodeError> {
        if let Some((_, _, age)) = &mut self.kept {
            *age += frames.len() as u32;
        }
        self.kept = self.kept.take().filter(|(_, _, age)| *age < MOST_FRAMES);
        let baseline = self.baseline.as_ref().map(|baseline| (Some(0), baseline));
        let kept = self.kept.as_ref().map(|(id, kept, _)| (Some(*id), kept));
        let mut best: Option<(Option<i64>, Vec<u8>)> = None;
        for (number, against) in baseline.into_iter().chain(kept) {
            let blob = encode(frames, against)?;
            if best
                .as_ref()
                .is_none_or(|(_, least)| blob.len() < least.len())
            {
                best = Some((number, blob));
            }
        }
        let (reference, blob) = match best {
            Some(best) => best,
            None => (None, encode(frames, &Reference::NONE)?),
        };
        let mut packed = Packed {
            reference,
            blob,
            written: None,
        };
        let mut mean = None;
        for readings in frames {
            mean = self.recent.add(readings).or(mean);
        }
        if let Some(mean) = mean {
            self.renew(&mean, frames, &mut packed)?;
        }
        Ok(packed)
    }

    fn renew(
        &mut self,
        mean: &[Reading],
        frames: &[&[Reading]],
        packed: &mut Packed,
    ) -> Result<(), EncodeError> {
        let reference = Reference::new(mean);
        let blob = encode(frames, &reference)?;
        let gain = packed.blob.len().saturating_sub(blob.len());
        let alone = encode(&[mean], &Reference::NONE)?;
        let (against_baseline, price) = match &self.baseline {
            Some(baseline) => {
                let near = encode(&[mean], baseline)?;
                if near.len() < alone.len() {
                    (true, near)
                } else {
                    (false, alone)
                }
            }
            None => (false, alone),
        };
        if gain * PAYS_WITHIN <= price.len() * frames.len() {
            return Ok(());
        }
        let id = self.last_number + 1;
        self.last_number = id;
        self.kept = Some((id, reference, 0));
        *packed = Packed {
            reference: Some(id),
            blob,
            written: Some(NewReference {
                id,
                against_baseline,
                blob: price,
            }),
        };
        Ok(())
    }
}

/// Sums of the frames since the last mean.
#[derive(Debug, Clone, Default)]
struct Recent {
    frames: u32,
    sums: Vec<(f64, u32)>,
}

impl Recent {
    /// Returns the mean of the last sixteen frames after every sixteenth one. A reading that was valid in none of
    /// them is marked as not measured.
    fn add(&mut self, readings: &[Reading]) -> Option<Vec<Reading>> {
        self.sums.resize(readings.len(), (0.0, 0));
        for ((sum, count), reading) in self.sums.iter_mut().zip(readings) {
            if let Some(Volts(volts)) = reading.volts() {
                *sum += volts;
                *count += 1;
            }
        }
        self.frames += 1;
        if self.frames < AVERAGED {
            return None;
        }
        let mean = self.sums.iter().map(|(sum, count)| match count {
            0 => Reading::NotMeasured,
            _ => Reading::Ok(Volts(nine_digits(sum / f64::from(*count)))),
        });
        let mean = mean.collect();
        *self = Self::default();
        Some(mean)
    }
}

fn nine_digits(volts: f64) -> f64 {
    format!("{volts:.8e}").parse().unwrap_or(volts)
}
