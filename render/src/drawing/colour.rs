//! The common colour scale: zero almost white, loss to blue, gain to a pale grey-brown. A load never raises the
//! conductance, so that a gain is an artefact of the reconstruction.

/// Red, green, blue, 0 to 255 (sRGB).
pub type Rgb = [u8; 3];

const LOSS: [Rgb; 7] = [
    [250, 250, 246],
    [205, 232, 222],
    [139, 203, 207],
    [74, 163, 196],
    [40, 114, 176],
    [37, 66, 138],
    [26, 26, 82],
];

const GAIN: [Rgb; 5] = [
    [250, 250, 246],
    [238, 231, 221],
    [225, 214, 200],
    [209, 194, 176],
    [188, 170, 149],
];

/// The colour of a share of the scale: 0 is zero, -1 the largest loss, 1 the largest gain; values beyond an end have
/// its colour. `None` for NaN.
pub fn colour(share: f64) -> Option<Rgb> {
    if share.is_nan() {
        return None;
    }
    let stops: &[Rgb] = if share <= 0.0 { &LOSS } else { &GAIN };
    let place = share.abs().min(1.0) * (stops.len() - 1) as f64;
    let below = (place.floor() as usize).min(stops.len() - 2);
    let part = place - below as f64;
    Some(std::array::from_fn(|channel| {
        let (from, to) = (stops[below][channel], stops[below + 1][channel]);
        (f64::from(from) + part * (f64::from(to) - f64::from(from))).round() as u8
    }))
}

/// Relative luminance, 0 to 1: the brightness in a grey print.
pub(crate) fn luminance(colour: Rgb) -> f64 {
    let linear = colour.map(|channel| (f64::from(channel) / 255.0).powf(2.2));
    0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
}

#[cfg(test)]
mod tests {
    use crate::drawing::colour::*;

    #[test]
    fn the_more_the_darker_on_both_sides() {
        for side in [-1.0, 1.0] {
            let greys: Vec<f64> = (0..=40)
                .map(|step| luminance(colour(side * f64::from(step) / 40.0).unwrap()))
                .collect();
            assert!(greys.windows(2).all(|pair| pair[1] < pair[0]));
        }
    }

    #[test]
    fn gains_are_paler_than_losses_of_the_same_size() {
        let strength = |share: f64| {
            let [r, g, b] = colour(share).unwrap();
            r.max(g).max(b) - r.min(g).min(b)
        };
        for step in 1..=10 {
            let share = f64::from(step) / 10.0;
            assert!(luminance(colour(share).unwrap()) > luminance(colour(-share).unwrap()));
            assert!(strength(share) < 50, "{share}: {}", strength(share));
        }
    }

    #[test]
    fn what_is_not_a_number_has_no_colour() {
        assert_eq!(colour(f64::NAN), None);
        assert_eq!(colour(-0.0), colour(0.0));
        assert_eq!(colour(-9.0), colour(-1.0));
        assert_eq!(colour(f64::INFINITY), colour(1.0));
    }
}
