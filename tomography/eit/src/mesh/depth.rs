//! The depth of a tank's liquid, and where its electrodes are in it: the third dimension of a 2.5-D model.

use std::f64::consts::PI;

use super::MeshError;

/// Weights below this are rounding of modes that the electrode does not drive.
const NO_WEIGHT: f64 = 1e-12;

/// Liquid between a flat, insulating bottom and its surface, and the band of the wall that the electrodes cover.
///
/// The conductivity is the same at every depth. A change also extends from the bottom to the surface; only derivatives
/// can be limited to a layer about the electrodes' centres ([`Depth::with_target_height`]). The sheet conductance of
/// the mesh is conductivity times depth, so without a depth the model equals that of electrodes as high as the liquid.
///
/// The potential is a sum of modes, u(x, y, z) = sum over k of u_k(x, y) cos(k pi z / H), none of which has a flux
/// through bottom and surface. Mode 0 is the flat model with its contacts. In the other modes the current leaves an
/// electrode evenly over its face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Depth {
    depth_m: f64,
    electrode_height_m: f64,
    electrode_centre_m: f64,
    modes: usize,
    target_height_m: f64,
}

/// A mode above the flat one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Mode {
    /// (k pi / H)^2, 1/m2.
    pub(crate) decay: f64,
    /// Mean of the cosine over the electrode.
    pub(crate) weight: f64,
}

impl Mode {
    /// Share of the mode's impedance in the readings.
    pub(crate) fn share(self) -> f64 {
        2.0 * self.weight * self.weight
    }
}

impl Depth {
    /// Default number of modes.
    pub const MODES: usize = 60;
    /// The largest number of modes.
    pub const MOST_MODES: usize = 400;

    /// `depth_m`: depth of the liquid; `electrode_height_m`: height of each electrode's contact; `electrode_centre_m`:
    /// height of the electrodes' centres above the bottom; `modes`: number of cosines without the constant one.
    ///
    /// # Errors
    /// A length that is not positive, an electrode that is not in the liquid, or a number of modes out of range.
    pub fn new(
        depth_m: f64,
        electrode_height_m: f64,
        electrode_centre_m: f64,
        modes: usize,
    ) -> Result<Self, MeshError> {
        let refuse = |fault: String| Err(MeshError::Depth { fault });
        for (name, value) in [
            ("depth", depth_m),
            ("height of an electrode", electrode_height_m),
            ("height of the electrodes' centre", electrode_centre_m),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                return refuse(format!("the {name} is {value} m, it must be above 0"));
            }
        }
        within(
            depth_m,
            electrode_centre_m,
            electrode_height_m,
            "the electrodes",
        )?;
        if !(1..=Self::MOST_MODES).contains(&modes) {
            return refuse(format!(
                "the number of modes is {modes}, it must be 1 to {}",
                Self::MOST_MODES
            ));
        }
        Ok(Self {
            depth_m,
            electrode_height_m,
            electrode_centre_m,
            modes,
            target_height_m: depth_m,
        })
    }

    /// The same depth with changes limited to a layer of this height about the electrodes' centres, m. Only derivatives
    /// describe the layer; solutions for a changed conductance describe a change at every depth, so methods that need
    /// such solutions refuse a layer.
    ///
    /// # Errors
    /// A layer that is not in the liquid.
    pub fn with_target_height(self, target_height_m: f64) -> Result<Self, MeshError> {
        within(
            self.depth_m,
            self.electrode_centre_m,
            target_height_m,
            "targets",
        )?;
        Ok(Self {
            target_height_m,
            ..self
        })
    }

    /// Height of the layer that changes fill, m; equal to the depth if they extend from the bottom to the surface.
    pub fn target_height_m(&self) -> f64 {
        self.target_height_m
    }

    /// Whether changes fill a layer only.
    pub fn has_layer(&self) -> bool {
        self.target_height_m < self.depth_m
    }

    /// Heights (m) in the layer and the share of the depth of each, for sums over the layer (Gauss-Legendre); `None`
    /// without a layer.
    pub(crate) fn planes(&self) -> Option<Vec<[f64; 2]>> {
        let share = self.target_height_m / self.depth_m;
        // products of two cosines have up to twice the waves of the last mode
        let count = 8 + (2.0 * self.modes as f64 * share).ceil() as usize;
        self.has_layer().then(|| {
            (0..count)
                .map(|point| {
                    let [x, weight] = gauss_legendre(point, count);
                    [
                        self.electrode_centre_m + 0.5 * self.target_height_m * x,
                        0.5 * weight * share,
                    ]
                })
                .collect()
        })
    }

    /// Depth of the liquid, m.
    pub fn depth_m(&self) -> f64 {
        self.depth_m
    }

    /// Height of an electrode's contact, m.
    pub fn electrode_height_m(&self) -> f64 {
        self.electrode_height_m
    }

    /// Height of the electrodes' centres above the bottom, m.
    pub fn electrode_centre_m(&self) -> f64 {
        self.electrode_centre_m
    }

    /// Number of cosines without the constant one.
    pub fn modes(&self) -> usize {
        self.modes
    }

    /// The modes that the electrodes drive, without the constant one.
    pub(crate) fn driven(&self) -> Vec<Mode> {
        (1..=self.modes)
            .filter_map(|k| {
                let wave = k as f64 * PI / self.depth_m;
                let half = 0.5 * wave * self.electrode_height_m;
                let weight = (wave * self.electrode_centre_m).cos() * half.sin() / half;
                (weight.abs() > NO_WEIGHT).then_some(Mode {
                    decay: wave * wave,
                    weight,
                })
            })
            .collect()
    }

    /// The numbers in the order of a case folder's `depth.csv`.
    pub(crate) fn numbers(&self) -> [f64; 5] {
        [
            self.depth_m,
            self.electrode_height_m,
            self.electrode_centre_m,
            self.modes as f64,
            self.target_height_m,
        ]
    }

    /// From the numbers of [`Depth::numbers`].
    pub(crate) fn of_numbers(numbers: [f64; 5]) -> Result<Self, MeshError> {
        let [depth, height, centre, modes, target] = numbers;
        if modes.fract() != 0.0 || !(0.0..=1e6).contains(&modes) {
            return Err(MeshError::Depth {
                fault: format!("the number of modes is {modes}, it must be a whole number"),
            });
        }
        let whole = Self::new(depth, height, centre, modes as usize)?;
        if target == depth {
            return Ok(whole);
        }
        whole.with_target_height(target)
    }
}

/// Refuses a layer about a centre that is not in the liquid.
fn within(depth_m: f64, centre_m: f64, height_m: f64, what: &str) -> Result<(), MeshError> {
    let (low, high) = (centre_m - 0.5 * height_m, centre_m + 0.5 * height_m);
    let rounding = 1e-9 * depth_m;
    if height_m > 0.0 && low >= -rounding && high <= depth_m + rounding {
        return Ok(());
    }
    Err(MeshError::Depth {
        fault: format!(
            "{what} reach from {:.2} to {:.2} mm above the bottom, the liquid from 0 to {:.2} mm",
            1e3 * low,
            1e3 * high,
            1e3 * depth_m
        ),
    })
}

/// A point of the Gauss-Legendre rule on [-1, 1] with `count` points, and its weight.
fn gauss_legendre(point: usize, count: usize) -> [f64; 2] {
    let n = count as f64;
    let mut x = (PI * (point as f64 + 0.75) / (n + 0.5)).cos();
    let mut slope = 1.0;
    for _ in 0..100 {
        let (mut p, mut before) = (1.0, 0.0);
        for k in 1..=count {
            let k = k as f64;
            (p, before) = (((2.0 * k - 1.0) * x * p - (k - 1.0) * before) / k, p);
        }
        slope = n * (x * p - before) / (x * x - 1.0);
        let step = p / slope;
        x -= step;
        if step.abs() < 1e-15 {
            break;
        }
    }
    [x, 2.0 / ((1.0 - x * x) * slope * slope)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn electrodes_as_high_as_the_liquid_drive_no_mode() {
        assert_eq!(Depth::new(0.05, 0.05, 0.025, 60).unwrap().driven(), []);
    }

    #[test]
    fn electrodes_at_half_depth_drive_even_modes_only() {
        let driven = Depth::new(0.26, 0.01, 0.13, 60).unwrap().driven();
        // mode 52 has a whole wave over the electrode
        assert_eq!(driven.len(), 29);
        let second = 2.0 * PI / 0.26;
        assert!((driven[0].decay / (second * second) - 1.0).abs() < 1e-12);
        assert!((1.9..2.0).contains(&driven[0].share()));
    }

    #[test]
    fn planes_of_a_layer_integrate_cosines() {
        let depth = Depth::new(0.26, 0.01, 0.13, 60).unwrap();
        assert_eq!(depth.planes(), None);
        let planes = depth.with_target_height(0.04).unwrap().planes().unwrap();
        let sum =
            |of: &dyn Fn(f64) -> f64| planes.iter().map(|[z, share]| share * of(*z)).sum::<f64>();
        assert!((sum(&|_| 1.0) - 0.04 / 0.26).abs() < 1e-12);
        let wave = 120.0 * PI / 0.26;
        let exact = 2.0 * (0.02 * wave).sin() / wave / 0.26;
        assert!((sum(&|z| (wave * z).cos()) - exact).abs() < 1e-9);
        let above = depth.with_target_height(0.3).unwrap_err().to_string();
        assert!(above.contains("from -20.00 to 280.00 mm"), "{above}");
    }

    #[test]
    fn faults_are_named_with_their_numbers() {
        let text = |depth: Result<Depth, MeshError>| depth.unwrap_err().to_string();
        let outside = text(Depth::new(0.26, 0.02, 0.255, 60));
        assert!(
            outside.contains("from 245.00 to 265.00 mm above the bottom"),
            "{outside}"
        );
        assert!(text(Depth::new(0.0, 0.01, 0.1, 60)).contains("depth is 0 m"));
        assert!(text(Depth::new(0.2, f64::NAN, 0.1, 60)).contains("NaN"));
        assert!(text(Depth::new(0.2, 0.01, 0.1, 0)).contains("1 to 400"));
    }
}
