//! Hard cases 5 to 8, 10 and 11: contacts of any size, the floating potential, units, and the ends of electrodes.

use std::sync::Arc;

use eit::{ENOUGH_EDGES, Forward, ForwardError, Mesh, PaperSheet, SheetElectrode};
use nalgebra::DMatrix;
use qd::Quad;
use survey::{Dipole, Electrode, Measurement, Protocol};

use crate::failure::{Attempt, Failure};
use crate::stability::outcome::{Check, Naive, Outcome, apart, naive, worst};
use crate::stability::solvers::bordered::{Bordered, Ground, middle, read};
use crate::stability::solvers::conjugate::{self, Until};
use crate::stability::solvers::tank::{Tank, refused};

const RS: f64 = 1e3;

/// 5: contacts of vanishing impedance.
pub(crate) fn vanishing_contact() -> Result<Outcome, Failure> {
    let tank = Tank::small()?;
    let of = |ohm: f64| vec![ohm * tank.length(); tank.contact.len()];
    let (mut ours, mut textbook) = (0.0, 0.0);
    for ohm in [1e-2, 1e-6, 1e-9, 1e-12, 1e-15] {
        let exact = tank.exact(&of(ohm), &tank.sigma);
        ours = worst(ours, apart(&tank.ours(&of(ohm), &tank.sigma)?, &exact));
        let f64s = tank.textbook::<f64>(&of(ohm), &tank.sigma, Ground::Node);
        textbook = worst(textbook, apart(&f64s, &exact));
    }
    let shunt = tank.exact(&of(0.0), &tank.sigma);
    let at_zero = tank.ours(&of(0.0), &tank.sigma)?;
    // the textbook's form contains 1/z, so 0 is replaced by the smallest positive number
    let divided = tank.textbook::<f64>(&of(f64::MIN_POSITIVE), &tank.sigma, Ground::Node);
    let distance = |ohm: f64| -> Result<f64, Failure> {
        Ok(apart(&tank.ours(&of(ohm), &tank.sigma)?, &shunt))
    };
    let mut curved = 0.0;
    for ohm in [1e-1, 1e-3, 1e-5] {
        let order = (distance(ohm)? / distance(0.1 * ohm)?).log10();
        curved = worst(curved, (order - 1.0).abs());
    }
    Ok(Outcome::of([
        Check::at_most(
            "V at 1e-2 to 1e-15 ohm against extended precision",
            naive(textbook, "0/0 in the bordered matrix"),
            ours,
            1e-12,
        ),
        Check::at_most(
            "V at 0 ohm against the shunt",
            naive(apart(&divided, &shunt), "divides by z = 0"),
            apart(&at_zero, &shunt),
            1e-12,
        ),
        Check::at_most(
            "|order in z of CEM - shunt, less 1|",
            naive(apart(&divided, &shunt), "has no shunt to compare with"),
            curved,
            0.05,
        ),
    ]))
}

/// 6: contacts that open.
pub(crate) fn open_contact() -> Result<Outcome, Failure> {
    let tank = Tank::small()?;
    let of = |ohm: f64| vec![ohm * tank.length(); tank.contact.len()];
    let limit = tank.exact(&of(1e14), &tank.sigma);
    let (mut ours, mut textbook, mut rounding) = (0.0, 0.0, 0.0);
    for ohm in [1e6, 1e9, 1e12, 1e15] {
        let beyond = |found: &[f64]| (apart(found, &limit) - 0.02 * RS / ohm).max(0.0);
        let found = tank.ours(&of(ohm), &tank.sigma)?;
        ours = worst(ours, beyond(&found));
        let f64s = tank.textbook::<f64>(&of(ohm), &tank.sigma, Ground::Electrode(0));
        textbook = worst(textbook, beyond(&f64s));
        rounding = worst(rounding, apart(&found, &tank.exact(&of(ohm), &tank.sigma)));
    }
    // the driven pair of a detached electrode
    let mut contact = tank.contact.clone();
    contact[3] = 1e9 * tank.length();
    let drive = Dipole::adjacent(3, 8);
    let volts = own(&tank.forward(&contact)?, &tank.sigma, drive)?;
    Ok(Outcome::of([
        Check::at_most(
            "V - limit - 0.02 Rs/Rc, 1e6 to 1e15 ohm",
            Naive::Error(textbook),
            ours,
            1e-12,
        ),
        Check::at_most(
            "V against extended precision",
            Naive::Error(textbook),
            rounding,
            1e-12,
        ),
        Check::at_least(
                        "V at 1 mA across a driven contact of 1e9 ohm",
            Naive::Absent("every form of the contact has it".into()),
            1e-3 * volts,
            105.0,
        ),
    ])
    .noted(
        "the naive form grounds an electrode. 105 V is the most that the source gives: it clamps, and the frame names the \
         electrode (simulator: nothing_connected_is_compliance_and_no_current)",
    ))
}

/// The voltage across a driven pair at 1 A, V.
fn own(forward: &Forward, sigma: &[f64], pair: Dipole) -> Result<f64, Failure> {
    let question = Measurement {
        drive: pair,
        sense: pair,
    };
    let protocol =
        Protocol::new(forward.mesh().electrodes(), vec![question]).attempt("the protocol")?;
    Ok(forward.readings(sigma, &protocol).map_err(refused)?[0])
}

/// 7: readings depend on differences of potentials only.
pub(crate) fn floating() -> Result<Outcome, Failure> {
    let tank = Tank::small()?;
    let ours = tank.ours(&tank.contact, &tank.sigma)?;
    let mut moved = 0.0;
    for ground in [
        Ground::NodeAt(0),
        Ground::NodeAt(middle(&tank.mesh)),
        Ground::Electrode(5),
    ] {
        let exact = tank.textbook::<Quad>(&tank.contact, &tank.sigma, ground);
        moved = worst(moved, apart(&ours, &exact));
    }
    let textbook = |ground| tank.textbook::<f64>(&tank.contact, &tank.sigma, ground);
    let penalised = textbook(Ground::Everywhere(1e-8));
    let mut currents = DMatrix::zeros(8, 1);
    currents[(0, 0)] = 1.0;
    let refused_sum = matches!(
        tank.forward(&tank.contact)?
            .solve_currents(&tank.sigma, &currents),
        Err(ForwardError::CurrentSum { .. })
    );
    // with a grounded node the textbook's form accepts currents whose sum is not zero
    let matrix = Bordered::<f64>::new(&tank.mesh, &tank.contact, &tank.sigma, &[], Ground::Node);
    let mut right = vec![0.0; matrix.size];
    right[matrix.electrode[0]] = 1.0;
    let taken = matrix.factored().solve(right).iter().all(|u| u.is_finite());
    Ok(Outcome::of([
        Check::at_most(
            "V against grounds at two nodes and an electrode",
            Naive::Error(apart(&penalised, &ours)),
            moved,
            1e-11,
        ),
        Check::at_most(
            "currents that do not sum to zero, accepted",
            Naive::Error(f64::from(u8::from(taken))),
            f64::from(u8::from(!refused_sum)),
            0.0,
        ),
    ])
    .noted(format!(
        "the naive form has a conductance of 1e-8 from each node to ground; without any ground the last pivot is a \
         rounding error, and the error of V was {:.0e} here",
        apart(&textbook(Ground::Nothing), &ours)
    )))
}

/// 8: the same sheet in other units.
pub(crate) fn units() -> Result<Outcome, Failure> {
    let tank = Tank::small()?;
    let before = tank.ours(&tank.contact, &tank.sigma)?;
    let (mut ours, mut stopped) = (0.0, 0.0);
    for c in [1e-9, 1e-3, 1e3, 1e9] {
        let contact: Vec<f64> = tank.contact.iter().map(|z| z / c).collect();
        let sigma: Vec<f64> = tank.sigma.iter().map(|s| s * c).collect();
        let back = |volts: &[f64]| -> Vec<f64> { volts.iter().map(|v| v * c).collect() };
        ours = worst(ours, apart(&back(&tank.ours(&contact, &sigma)?), &before));
        let matrix = Bordered::<f64>::new(&tank.mesh, &contact, &sigma, &[], Ground::Node);
        let iterated = read(&tank.protocol, &matrix.electrode, |pair| {
            conjugate::solve(&matrix, &matrix.drive(pair), Until::Step(1e-9), 5_000)
        });
        stopped = worst(stopped, apart(&back(&iterated), &before));
    }
    Ok(Outcome::of([Check::at_most(
        "V c at sigma c and z / c, c = 1e-9 to 1e9",
        Naive::Error(stopped),
        ours,
        1e-12,
    )])
    .noted("the naive form iterates until no voltage changes by more than 1e-9 V"))
}

/// One electrode in the middle of each side of the paper's sheet, on its edge.
fn four(width_mm: f64, edge_mm: f64, largest_mm: f64, growth: f64) -> PaperSheet {
    PaperSheet {
        electrode: SheetElectrode::Edge,
        electrodes_per_width: 1,
        electrodes_per_height: 1,
        void_mm: width_mm,
        edge_mm,
        largest_mm,
        growth,
        ..PaperSheet::default()
    }
}

/// The pair from the bottom electrode to the top one.
const ACROSS: Dipole = Dipole {
    plus: Electrode(0),
    minus: Electrode(2),
};

fn resistance(sheet: &PaperSheet, contact: f64) -> Result<f64, Failure> {
    across(&meshed(sheet)?, contact)
}

fn meshed(sheet: &PaperSheet) -> Result<Arc<Mesh>, Failure> {
    let mesh = sheet.mesh().attempt("the sheet")?;
    Ok(Arc::new(mesh))
}

fn across(mesh: &Arc<Mesh>, contact: f64) -> Result<f64, Failure> {
    let sigma = vec![1.0 / RS; mesh.triangles().len()];
    let forward = Forward::new(Arc::clone(mesh), &[contact; 4]).map_err(refused)?;
    own(&forward, &sigma, ACROSS)
}

/// 10: electrodes narrower than the mesh.
pub(crate) fn narrow_electrode() -> Result<Outcome, Failure> {
    let slope = 2.0 * RS / std::f64::consts::PI;
    let (mut ours, mut clipped) = (0.0, 0.0);
    let mut before: Option<[f64; 2]> = None;
    for width in [3.2, 1.6, 0.8, 0.4, 0.2, 0.1] {
        let graded = resistance(&four(width, width / 8.0, 5.4, 0.2), 0.0)?;
        // on a mesh of 2 mm an electrode is as wide as the edges that it touches
        let touched = 2.0 * (width / 2.0).ceil();
        let coarse = resistance(&four(touched, 2.0, 2.0, 0.2), 0.0)?;
        if let Some([graded_before, coarse_before]) = before {
            let off = |now: f64, before: f64| ((now - before) / (slope * 2.0_f64.ln()) - 1.0).abs();
            ours = worst(ours, off(graded, graded_before));
            clipped = worst(clipped, off(coarse, coarse_before));
        }
        before = Some([graded, coarse]);
    }
    let mesh = four(2.0, 1.0, 4.0, 0.2).mesh().attempt("the sheet")?;
    let quality = mesh.quality();
    let unreported = 4 - quality.coarse_electrodes.len();
    Ok(Outcome::of([
        Check::at_most(
            "growth of R over 2 Rs/pi an e-fold, w = 3.2 to 0.1 mm",
            Naive::Error(clipped),
            ours,
            0.03,
        ),
        Check::at_most(
            TOO_FEW,
            Naive::Absent("a mesh of triangles alone names no electrode".into()),
            unreported as f64,
            0.0,
        ),
    ])
    .noted(format!(
        "the naive form gives an electrode the edges of a 2 mm mesh that it touches; a mesh with fewer than {ENOUGH_EDGES} \
         edges an electrode is named by its quality"
    )))
}

const TOO_FEW: &str = "electrodes with too few edges, not named";

/// 11: the error by the singularity at an electrode's ends.
pub(crate) fn singular_ends() -> Result<Outcome, Failure> {
    let mesh = |graded: bool, fineness: f64| {
        let [edge, growth] = if graded { [1.0, 0.3] } else { [8.0, 1.0] };
        meshed(&PaperSheet {
            fineness,
            ..four(16.0, edge, 8.0, growth)
        })
    };
    // edges of 16 and 4 mm: uniform, or graded down to 2 and 0.5 mm at the electrodes
    let reference = mesh(true, 8.0)?;
    let uniform = [mesh(false, 0.5)?, mesh(false, 2.0)?];
    let graded = [mesh(true, 0.5)?, mesh(true, 2.0)?];
    let order = |contact_ohm: f64, by_ends: bool| -> Result<[f64; 2], Failure> {
        let contact = contact_ohm * 16e-3;
        let exact = across(&reference, contact)?;
        let meshes = if by_ends { &graded } else { &uniform };
        let error = |mesh: &Arc<Mesh>| -> Result<f64, Failure> {
            Ok((across(mesh, contact)? / exact - 1.0).abs())
        };
        let [coarse, fine] = [error(&meshes[0])?, error(&meshes[1])?];
        Ok([0.5 * (coarse / fine).log2(), fine])
    };
    let [ours, ours_error] = order(10.0, true)?;
    let [naive_order, naive_error] = order(10.0, false)?;
    let [shunt, _] = order(1e-3, true)?;
    let [naive_shunt, _] = order(1e-3, false)?;
    Ok(Outcome::of([
        Check::at_least("order of R at 10 ohm", Naive::Error(naive_order), ours, 1.3),
        Check::at_least(
            "order of R at 1 mohm",
            Naive::Error(naive_shunt),
            shunt,
            1.3,
        ),
        Check::at_most(
            "error of R at 10 ohm, h = 4 mm",
            Naive::Error(naive_error),
            ours_error,
            0.015,
        ),
    ])
    .noted("naive: edges of one length everywhere"))
}
