//! Simulated frames of a drifting sheet on the phantom's finer mesh, and the information that methods have about the
//! rig.

use drift::{DriftModel, FitOptions, Noise};
use eit::{Mesh, Preset};
use imaging::Geometry;
use phantom::{FINER, Load, Phantom, Scan, Scene};
use rand::{RngExt as _, SeedableRng};
use rand_chacha::ChaCha8Rng;
use survey::Reading;

use crate::evaluation::test_set;
use crate::failure::Attempt;
use crate::sheet::protocol;
use crate::{Failure, add_noise, measured};

/// Current of every injection, A.
pub(crate) const CURRENT_A: f64 = 1e-3;
/// White noise of one reading, V.
pub(crate) const NOISE_V: f64 = 2e-6;
/// Thermal voltage of a sensing pair assumed by the methods, V.
const EMF_V: f64 = 0.9e-6;
/// Centre of the sheet, and half width and half height of the area of presses, mm.
const MIDDLE_MM: [f64; 2] = [107.0, 115.0];
const HALF_MM: [f64; 2] = [70.0, 77.0];

/// Gain and contacts of the scene `month`.
const GAIN_AND_CONTACTS: &str = "[effects.temperature]\npercent_per_c = -0.2\nroom_c = 1.5\n\
    [effects.humidity]\npercent_per_10_rh = -0.5\nroom_rh = 10.0\n\
    [effects.long-drift]\nwander_percent = 0.3\nwalk_percent = 0.05\nrunning_in_percent = 3.0\n\
    [effects.contact-spread]\nstd = 0.3\n[effects.thermal-emf]\nuv = 0.9\n";

/// A kind of drift.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Family {
    /// Gain and contacts of the scene month
    GainContacts,
    /// Contacts that drift by 5 %
    Bedside,
    /// Contacts that drift by 30 % within a day
    Contacts30,
    /// Gain and contacts, on a sheet sprayed unevenly by 10 %
    Spray,
    /// Gain and contacts, electrodes misplaced by up to 0.5 mm
    Misplaced,
    /// The crack of the scene month, gain and contacts
    Month,
    /// A crack across the middle within a week, gain and contacts
    Crack,
}

impl Family {
    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::GainContacts => "gain, contacts",
            Self::Bedside => "contacts 5 %",
            Self::Contacts30 => "contacts 30 %",
            Self::Spray => "spray 10 %",
            Self::Misplaced => "misplaced",
            Self::Month => "month's crack",
            Self::Crack => "crack, middle",
        }
    }

    /// The effects as text of a scene.
    pub(super) fn effects(self) -> String {
        let contacts = |percent: u32, hours: u32| {
            format!("[effects.contact-drift]\npercent = {percent}.0\ntau_h = {hours}.0\n")
        };
        let month = contacts(10, 48);
        let own = match self {
            Self::GainContacts => month,
            Self::Bedside => contacts(5, 24),
            Self::Contacts30 => contacts(30, 24),
            Self::Spray => month + "[effects.spray]\nstd = 0.1\n",
            Self::Misplaced => month + "[effects.electrode-placement]\n",
            Self::Month => {
                month
                    + "[effects.crack]\nfrom_mm = [150.0, 30.0]\nto_mm = [185.0, 60.0]\ndays = 30.0\n"
            }
            Self::Crack => {
                month + "[effects.crack]\nfrom_mm = [60.0, 60.0]\nto_mm = [150.0, 160.0]\n"
            }
        };
        GAIN_AND_CONTACTS.to_owned() + &own
    }
}

/// A drifting sheet with its acquisition.
pub(crate) struct Simulated {
    phantom: Phantom,
    scan: Scan,
    random: ChaCha8Rng,
}

impl Simulated {
    /// A sheet with the drift of a family. The phantom's mesh is [`phantom::FINER`] times finer than the model's.
    pub(super) fn new(family: Family, seed: u64) -> Result<Self, Failure> {
        Self::of(family.name(), &family.effects(), seed)
    }

    /// A sheet with the effects and loads of the text of a scene.
    pub(crate) fn of(name: &str, text: &str, seed: u64) -> Result<Self, Failure> {
        let scene = Scene::parse(name, text).attempt("the scene")?;
        let scene = Scene {
            seed,
            sheet: Preset::default().remeshed(FINER, 1),
            ..scene
        };
        let phantom = Phantom::new(scene).attempt("the sheet")?;
        let scan = Scan::usual(phantom.electrodes()).attempt("the protocol")?;
        Ok(Self {
            phantom,
            scan,
            random: ChaCha8Rng::seed_from_u64(seed ^ 0x6d6f_6e74_6873),
        })
    }

    /// A frame that starts at `at_s` (s, not before the last frame), with these loads in addition to the scene's.
    pub(crate) fn frame(
        &mut self,
        at_s: f64,
        loads: impl IntoIterator<Item = Load>,
    ) -> Result<Vec<Reading>, Failure> {
        let failed = |fault| Failure::of("the sheet", &fault);
        self.phantom.release();
        for load in loads {
            self.phantom.press(load).map_err(failed)?;
        }
        let begin = survey::duration(at_s);
        let volts = self.scan.frame(&mut self.phantom, begin).map_err(failed)?;
        let mut volts: Vec<f64> = volts.iter().map(|volts| volts.0).collect();
        add_noise(&mut volts, NOISE_V, &mut self.random);
        Ok(measured(&volts))
    }

    /// Polygons of Algorithm 1 on the region of this mesh.
    pub(super) fn polygons(&mut self, mesh: &Mesh) -> Vec<Load> {
        test_set::polygons(mesh, &mut self.random).loads
    }

    /// A random position of a press, mm.
    pub(super) fn place(&mut self) -> [f64; 2] {
        [0, 1].map(|axis| MIDDLE_MM[axis] + self.random.random_range(-HALF_MM[axis]..HALF_MM[axis]))
    }
}

/// The drift model fitted to a baseline, given the nominal sheet on the methods' mesh, the current and the noise.
pub(crate) fn model(geometry: &Geometry, baseline: &[Reading]) -> Result<DriftModel, Failure> {
    let noise = Noise {
        reading_v: NOISE_V,
        emf_v: EMF_V,
    };
    let options = FitOptions {
        current_a: CURRENT_A,
        ..FitOptions::default()
    };
    DriftModel::new(
        &geometry.mesh,
        &geometry.contact_ohm_m,
        &geometry.sigma0,
        &protocol(26)?,
        baseline,
        noise,
        &options,
    )
    .attempt("the sheet's fit")
}

/// Distance of a found position (m) from the true one (mm), mm.
pub(crate) fn away_mm(found: [f64; 2], press_mm: [f64; 2]) -> f64 {
    (1e3 * found[0] - press_mm[0]).hypot(1e3 * found[1] - press_mm[1])
}
