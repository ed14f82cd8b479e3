//! The colours of a film: those of its scale, of grey text and of the label of a simulation.

use crate::chart::ALARM;
use crate::{Range, Rgb};

/// The index of a pixel that keeps the colour of the previous picture: 0, because runs of 0 compress best.
pub(crate) const TRANSPARENT: u8 = 0;
/// Number of colours of losses, of gains, of greys and of the label.
const LOSSES: usize = 144;
const GAINS: usize = 40;
const GREYS: usize = 52;
const LABELS: usize = 19;
/// Bits of a channel in the table of nearest colours.
const BITS: u32 = 6;

pub(crate) struct Palette {
    /// The first is that of [`TRANSPARENT`].
    colours: Vec<Rgb>,
    /// The index of the nearest colour of each cell of the colour cube.
    nearest: Vec<u8>,
}

impl Palette {
    /// The colours of a scale.
    pub(crate) fn new(range: &Range) -> Self {
        let mut colours: Vec<Rgb> = vec![[255; 3]];
        let steps = |count: usize| (0..count).map(move |k| k as f64 / (count - 1) as f64);
        // the colour depends only on the value relative to the larger end
        let largest = range.low.abs().max(range.high) * range.unit.load(1.0).signum();
        let scale = |share: f64| {
            Range {
                grey: false,
                ..*range
            }
            .colour(share * largest)
        };
        colours.extend(steps(LOSSES).filter_map(scale));
        colours.extend(steps(GAINS).filter_map(|share| scale(-share)));
        colours.extend(steps(GREYS).map(|share| [(255.0 * share).round() as u8; 3]));
        let label = [ALARM.0, ALARM.1, ALARM.2];
        let paler = |share: f64| {
            label.map(|channel| {
                (f64::from(channel) + share * (255.0 - f64::from(channel))).round() as u8
            })
        };
        colours.extend(steps(LABELS).map(paler));
        let cells = 0..1_usize << (3 * BITS);
        let nearest = cells
            .map(|cell| {
                let channel = |place: u32| {
                    let part = (cell >> (place * BITS)) & ((1 << BITS) - 1);
                    // so that the darkest cell is black and the lightest white
                    (part * 255 / ((1 << BITS) - 1)) as i32
                };
                let centre = [channel(2), channel(1), channel(0)];
                let distance = |colour: &Rgb| -> i32 {
                    (0..3)
                        .map(|axis| (i32::from(colour[axis]) - centre[axis]).pow(2))
                        .sum()
                };
                let best = (1..colours.len()).min_by_key(|index| distance(&colours[*index]));
                best.unwrap_or(0) as u8
            })
            .collect();
        Self { colours, nearest }
    }

    /// The palette indices of pixels, each red, green and blue.
    pub(crate) fn indices(&self, pixels: &[u8]) -> Vec<u8> {
        let (pixels, _) = pixels.as_chunks::<3>();
        pixels.iter().map(|pixel| self.index(*pixel)).collect()
    }

    /// The index of the nearest colour.
    fn index(&self, colour: Rgb) -> u8 {
        let cell = colour.into_iter().fold(0_usize, |cell, channel| {
            (cell << BITS) | usize::from(channel >> (8 - BITS))
        });
        self.nearest[cell]
    }

    /// Red, green and blue of each colour.
    pub(crate) fn bytes(&self) -> Vec<u8> {
        self.colours.concat()
    }

    /// The opacities of the first palette entries; all others are opaque.
    pub(crate) fn opacities(&self) -> Vec<u8> {
        vec![0]
    }
}

#[cfg(test)]
mod tests {
    use survey::MapUnit;

    use super::*;

    #[test]
    fn each_colour_of_a_scale_is_near_one_of_the_palette() {
        for (low, high, unit) in [
            (-0.5, 0.1, MapUnit::RelativeConductance),
            (0.0, 30.0, MapUnit::Pressure),
        ] {
            let range = Range {
                low,
                high,
                below: false,
                above: false,
                unit,
                grey: false,
            };
            let palette = Palette::new(&range);
            assert_eq!(palette.colours.len(), 256);
            for step in 0..=1000 {
                let value = low + (high - low) * f64::from(step) / 1000.0;
                let wanted = range.colour(value).unwrap();
                let found = palette.colours[usize::from(palette.index(wanted))];
                for (wanted, found) in wanted.into_iter().zip(found) {
                    assert!(wanted.abs_diff(found) <= 5, "{value}: {wanted} {found}");
                }
            }
        }
    }

    #[test]
    fn paper_ink_and_transparency_have_their_places() {
        let range = Range {
            low: -1.0,
            high: 0.0,
            below: false,
            above: false,
            unit: MapUnit::RelativeConductance,
            grey: false,
        };
        let palette = Palette::new(&range);
        let of = |colour| palette.colours[usize::from(palette.index(colour))];
        assert_eq!(of([255; 3]), [255; 3]);
        assert_eq!(of([0; 3]), [0; 3]);
        assert_eq!(palette.bytes().len(), 3 * 256);
        assert!(!palette.nearest.contains(&TRANSPARENT));
        assert_eq!(palette.opacities(), [0]);
    }
}
