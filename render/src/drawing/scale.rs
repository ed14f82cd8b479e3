//! Range and ticks of a scale.

use survey::{Map, MapUnit};

use crate::drawing::colour::{colour, luminance};
use crate::{PictureError, Rgb, Scale, Style};

/// Range of a colour scale, in the map's unit; it includes zero.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Range {
    /// Lower end, at most 0.
    pub low: f64,
    /// Upper end, at least 0.
    pub high: f64,
    /// Whether there are values below the lower end, drawn in its colour.
    pub below: bool,
    /// Whether there are values above the upper end, drawn in its colour.
    pub above: bool,
    /// Unit of the values.
    pub unit: MapUnit,
    /// Whether values are drawn in grey, because they are noise.
    pub grey: bool,
}

/// Upper end of the scale for pressures that are noise, kPa.
const GREY_KPA: f64 = 100.0;

impl Range {
    /// The range for one or more maps. With [`Scale::Own`] and no value except 0: a loss of one per cent, or one
    /// displayed unit.
    ///
    /// # Errors
    /// Fixed ends that are not ascending or not finite; maps with different units.
    pub fn of<'a>(maps: impl IntoIterator<Item = (&'a Map, Scale)>) -> Result<Self, PictureError> {
        let (mut low, mut high) = (0.0_f64, 0.0_f64);
        let (mut least, mut most) = (0.0_f64, 0.0_f64);
        let mut unit = None;
        for (map, scale) in maps {
            if *unit.get_or_insert(map.unit) != map.unit {
                return Err(PictureError::Units);
            }
            let finite = map.values.iter().copied().filter(|value| value.is_finite());
            let (own_low, own_high) = finite.fold((0.0_f64, 0.0_f64), |(low, high), value| {
                (low.min(value), high.max(value))
            });
            least = least.min(own_low);
            most = most.max(own_high);
            let (from, to) = match scale {
                Scale::Own => (own_low, own_high),
                Scale::Fixed(from, to) if from < to && (to - from).is_finite() => (from, to),
                Scale::Fixed(low, high) => return Err(PictureError::Scale { low, high }),
            };
            low = low.min(from);
            high = high.max(to);
        }
        let unit = unit.unwrap_or(MapUnit::RelativeConductance);
        if low == 0.0 && high == 0.0 {
            let one = 1.0 / unit.shown().0.abs();
            match unit {
                MapUnit::Pressure => high = one,
                MapUnit::RelativeConductance | MapUnit::Conductance => low = -one,
            }
        }
        Ok(Self {
            low,
            high,
            below: least < low,
            above: most > high,
            unit,
            grey: false,
        })
    }

    /// The range of one map with this style: if nothing is above its noise, grey and from no loss to complete loss.
    ///
    /// # Errors
    /// As [`Range::of`].
    pub(crate) fn styled(map: &Map, style: &Style) -> Result<Self, PictureError> {
        let grey = style.nothing_above.is_some();
        let scale = match (style.scale, map.unit) {
            (Scale::Own, MapUnit::RelativeConductance) if grey => Scale::Fixed(-1.0, 0.0),
            (Scale::Own, MapUnit::Pressure) if grey => Scale::Fixed(0.0, GREY_KPA),
            (scale, _) => scale,
        };
        let range = Self::of([(map, scale)])?;
        Ok(Self { grey, ..range })
    }

    /// One range for the maps of a film: that of the maps that show something above their noise, or of the first map if
    /// none does.
    ///
    /// # Errors
    /// As [`Range::of`].
    pub fn of_film<'a>(
        maps: impl Iterator<Item = (&'a Map, &'a Style)> + Clone,
    ) -> Result<Self, PictureError> {
        let significant = |(_, style): &(&Map, &Style)| style.nothing_above.is_none();
        if let Some((map, style)) = maps.clone().next()
            && !maps.clone().any(|pair| significant(&pair))
        {
            let range = Self::styled(map, style)?;
            return Ok(Self {
                grey: false,
                ..range
            });
        }
        let chosen = maps.filter(significant);
        Self::of(chosen.map(|(map, style)| (map, style.scale)))
    }

    /// A value relative to the larger end: negative for loads.
    pub(crate) fn share(&self, value: f64) -> f64 {
        -self.unit.load(value) / self.low.abs().max(self.high)
    }

    /// The colour of a value: loads have the colours of losses, in maps of loss and of pressure.
    pub fn colour(&self, value: f64) -> Option<Rgb> {
        let colour = colour(self.share(value))?;
        Some(match self.grey {
            true => [(255.0 * luminance(colour).powf(1.0 / 2.2)).round() as u8; 3],
            false => colour,
        })
    }

    /// Positions of the ticks, ascending, with labels in the displayed unit (without its name).
    pub(crate) fn ticks(&self, most: usize) -> Vec<(f64, String)> {
        let (per, _) = self.unit.shown();
        let (step, decimals) = step(per.abs() * (self.high - self.low), most);
        let first = (per.abs() * self.low / step - 1e-9).ceil() as i64;
        let last = (per.abs() * self.high / step + 1e-9).floor() as i64;
        (first..=last)
            .map(|k| {
                let value = k as f64 * step / per.abs();
                (value, signed(per * value, decimals))
            })
            .collect()
    }

    /// The ends with ascending displayed numbers, and whether there are values beyond each: losses are displayed as
    /// positive.
    pub(crate) fn ends(&self) -> [(f64, bool); 2] {
        let ends = [(self.low, self.below), (self.high, self.above)];
        match self.unit.shown().0 < 0.0 {
            true => [ends[1], ends[0]],
            false => ends,
        }
    }

    /// A value in the displayed unit, with decimals suited to the range.
    pub(crate) fn words(&self, value: f64) -> String {
        let (per, unit) = self.unit.shown();
        let (_, decimals) = step(per.abs() * (self.high - self.low), 20);
        format!("{} {unit}", signed(per * value, decimals))
    }
}

/// A number with a minus sign (U+2212), and no sign before a zero.
fn signed(value: f64, decimals: usize) -> String {
    let text = format!("{:.decimals$}", value.abs());
    let zero = text.bytes().all(|c| matches!(c, b'0' | b'.'));
    if value < 0.0 && !zero {
        format!("\u{2212}{text}")
    } else {
        text
    }
}

/// The smallest of 1, 2, 5 times a power of ten that gives at most this number of steps, and its decimals.
pub(crate) fn step(span: f64, most: usize) -> (f64, usize) {
    let least = (span / most.max(1) as f64).max(f64::MIN_POSITIVE);
    let power = least.log10().floor();
    let decade = 10.0_f64.powf(power);
    let (factor, carried) = [(1.0, 0.0), (2.0, 0.0), (5.0, 0.0), (10.0, 1.0)]
        .into_iter()
        .find(|(factor, _)| factor * decade >= least * (1.0 - 1e-9))
        .unwrap_or((10.0, 1.0));
    let decimals = (-(power + carried)).clamp(0.0, 12.0) as usize;
    (factor * decade, decimals)
}

#[cfg(test)]
mod tests {
    use crate::drawing::scale::*;

    fn map(values: Vec<f64>) -> Map {
        Map::relative("m", values, "test")
    }

    #[test]
    fn ticks_are_round_and_include_zero() {
        let range = Range::of([(&map(vec![-0.43, 0.06]), Scale::Own)]).unwrap();
        let written: Vec<String> = range.ticks(6).into_iter().map(|(_, text)| text).collect();
        assert_eq!(
            written,
            ["40", "30", "20", "10", "0"],
            "losses are positive numbers"
        );
        assert_eq!(range.colour(0.0), colour(0.0));
    }

    #[test]
    fn tiny_ranges_keep_their_decimals() {
        assert_eq!(step(0.0123, 6), (0.005, 3));
        assert_eq!(step(9.0, 10).1, 0);
        let range = Range::of([(&map(vec![-1.2e-5]), Scale::Own)]).unwrap();
        assert!(range.ticks(6).len() >= 3);
    }

    #[test]
    fn fixed_ends_mark_values_beyond_them() {
        let range = Range::of([(&map(vec![-0.9, 0.0]), Scale::Fixed(-0.5, 0.0))]).unwrap();
        assert!(range.below && !range.above);
        assert_eq!(range.colour(-0.9), range.colour(-0.5));
        let siemens = Map {
            unit: MapUnit::Conductance,
            ..map(vec![-1e-4])
        };
        let shown = Range::of([(&siemens, Scale::Own)]).unwrap();
        assert_eq!(shown.words(-1e-4), "\u{2212}100 \u{b5}S per square");
        assert_eq!(
            Range::of([(&siemens, Scale::Own), (&map(vec![-0.9]), Scale::Own)]),
            Err(PictureError::Units)
        );
        for (low, high) in [
            (0.0, 0.0),
            (1.0, -1.0),
            (f64::NAN, 1.0),
            (f64::NEG_INFINITY, 0.0),
        ] {
            assert!(Range::of([(&map(vec![0.0]), Scale::Fixed(low, high))]).is_err());
        }
    }

    #[test]
    fn pressure_is_in_kilopascals_and_coloured_as_a_loss_is() {
        let pressure = Map {
            unit: MapUnit::Pressure,
            ..map(vec![0.0, 30.0])
        };
        let range = Range::of([(&pressure, Scale::Own)]).unwrap();
        assert_eq!((range.low, range.high), (0.0, 30.0));
        assert_eq!(range.words(30.0), "30 kPa");
        assert_eq!(range.ticks(3).last().unwrap().1, "30");
        let loss = Range::of([(&map(vec![-0.5]), Scale::Own)]).unwrap();
        assert_eq!(range.colour(30.0), loss.colour(-0.5));
        let nothing = Map {
            values: vec![0.0; 2],
            ..pressure
        };
        let range = Range::of([(&nothing, Scale::Own)]).unwrap();
        assert_eq!((range.low, range.high), (0.0, 1.0));
    }

    #[test]
    fn nothing_but_gaps_still_has_a_scale() {
        let range = Range::of([(&map(vec![f64::NAN, f64::INFINITY]), Scale::Own)]).unwrap();
        assert_eq!((range.low, range.high), (-0.01, 0.0));
        assert_eq!(range.colour(f64::NAN), None);
    }
}
