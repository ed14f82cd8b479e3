//! A load in the text of a scene: shape, size, force distribution, times and path.

use std::ops::Range;
use std::time::Duration;

use eit::Preset;
use serde::Deserialize;
use toml::Spanned;

use super::{Fault, RepeatText, moment};
use crate::law::Law;
use crate::load::{Load, LoadError, Shape};
use crate::press::{Amount, Contact, TimedLoad, Waypoint, hertz_radius_mm};

#[derive(Deserialize, Clone, Copy, PartialEq, Debug)]
#[serde(rename_all = "kebab-case")]
enum ShapeName {
    Disc,
    Rectangle,
    Triangle,
    FigureEight,
    Polygon,
    Sphere,
}

#[derive(Deserialize, Clone, Copy, PartialEq, Debug)]
#[serde(rename_all = "kebab-case")]
enum ContactName {
    Even,
    Punch,
}

/// A point on a load's path; omitted values are unchanged.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WaypointText {
    at_s: Spanned<f64>,
    x_mm: Option<f64>,
    y_mm: Option<f64>,
    loss_percent: Option<Spanned<f64>>,
    mass_g: Option<Spanned<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LoadText {
    name: Option<String>,
    shape: ShapeName,
    x_mm: Spanned<f64>,
    y_mm: f64,
    #[serde(default)]
    turn_deg: f64,
    diameter_mm: Option<Spanned<f64>>,
    distance_mm: Option<Spanned<f64>>,
    width_mm: Option<Spanned<f64>>,
    height_mm: Option<Spanned<f64>>,
    side_mm: Option<Spanned<f64>>,
    points_mm: Option<Spanned<Vec<[f64; 2]>>>,
    loss_percent: Option<Spanned<f64>>,
    mass_g: Option<Spanned<f64>>,
    contact: Option<Spanned<ContactName>>,
    from_s: Option<Spanned<f64>>,
    to_s: Option<Spanned<f64>>,
    repeat: Option<Spanned<RepeatText>>,
    #[serde(default)]
    path: Vec<Spanned<WaypointText>>,
}

impl LoadText {
    pub(super) fn load(
        self,
        index: usize,
        span: Range<usize>,
        law: &Law,
        sheet: &Preset,
    ) -> Result<TimedLoad, Fault> {
        let missing = |key: &str| {
            Fault(
                span.clone(),
                format!("a load of this shape needs the key `{key}`"),
            )
        };
        let (used, shape) = {
            let need = |value: &Option<Spanned<f64>>, key: &str| {
                value
                    .as_ref()
                    .map(|value| *value.get_ref())
                    .ok_or_else(|| missing(key))
            };
            match self.shape {
                // the contact of a sphere is a disc, whose diameter depends on the force
                ShapeName::Disc | ShapeName::Sphere => (
                    &["diameter_mm"][..],
                    Shape::Disc {
                        diameter_mm: need(&self.diameter_mm, "diameter_mm")?,
                    },
                ),
                ShapeName::Rectangle => (
                    &["width_mm", "height_mm"][..],
                    Shape::Rectangle {
                        width_mm: need(&self.width_mm, "width_mm")?,
                        height_mm: need(&self.height_mm, "height_mm")?,
                    },
                ),
                ShapeName::Triangle => (
                    &["side_mm"][..],
                    Shape::Triangle {
                        side_mm: need(&self.side_mm, "side_mm")?,
                    },
                ),
                ShapeName::FigureEight => (
                    &["diameter_mm", "distance_mm"][..],
                    Shape::FigureEight {
                        diameter_mm: need(&self.diameter_mm, "diameter_mm")?,
                        distance_mm: need(&self.distance_mm, "distance_mm")?,
                    },
                ),
                ShapeName::Polygon => (
                    &["points_mm"][..],
                    Shape::Polygon {
                        points_mm: self
                            .points_mm
                            .as_ref()
                            .map(|points| points.get_ref().clone())
                            .ok_or_else(|| missing("points_mm"))?,
                    },
                ),
            }
        };
        let measures = [
            ("diameter_mm", self.diameter_mm.as_ref().map(Spanned::span)),
            ("distance_mm", self.distance_mm.as_ref().map(Spanned::span)),
            ("width_mm", self.width_mm.as_ref().map(Spanned::span)),
            ("height_mm", self.height_mm.as_ref().map(Spanned::span)),
            ("side_mm", self.side_mm.as_ref().map(Spanned::span)),
            ("points_mm", self.points_mm.as_ref().map(Spanned::span)),
        ];
        for (key, at) in measures {
            if let Some(at) = at
                && !used.contains(&key)
            {
                return Err(Fault(
                    at,
                    format!(
                        "key `{key}` does not belong to this shape ({})",
                        used.join(", ")
                    ),
                ));
            }
        }
        let amount = match (&self.loss_percent, &self.mass_g) {
            (Some(percent), None) => Amount::Loss(percent.get_ref() / 100.0),
            (None, Some(mass)) => {
                let grams = *mass.get_ref();
                if !(grams > 0.0 && grams.is_finite()) {
                    return Err(Fault(
                        mass.span(),
                        format!("mass_g is {grams}, it must be a positive number"),
                    ));
                }
                Amount::Mass(grams)
            }
            (Some(_), Some(mass)) => {
                return Err(Fault(
                    mass.span(),
                    "a load has either loss_percent or mass_g, not both".to_owned(),
                ));
            }
            (None, None) => return Err(missing("loss_percent` or `mass_g")),
        };
        let from = moment(self.from_s.as_ref(), "from_s")?.unwrap_or_default();
        let to = moment(self.to_s.as_ref(), "to_s")?;
        if let (Some(to), Some(at)) = (to, &self.to_s)
            && to <= from
        {
            return Err(Fault(
                at.span(),
                "to_s must be later than from_s".to_owned(),
            ));
        }
        let repeat = match self.repeat {
            None => None,
            Some(repeat) => {
                let lies = to.map(|to| to - from).ok_or_else(|| {
                    let why = "a repeated load needs to_s: it is removed before it is placed again";
                    Fault(repeat.span(), why.to_owned())
                })?;
                Some(repeat.into_inner().repeat(lies, "the load lies there")?)
            }
        };
        let load = Load {
            name: self.name.unwrap_or_else(|| format!("load {}", index + 1)),
            shape,
            centre_mm: [*self.x_mm.get_ref(), self.y_mm],
            turn_deg: self.turn_deg,
            // computed below, with the sphere's contact area
            loss: 0.0,
        };
        load.check()
            .map_err(|fault| Fault(span.clone(), fault.to_string()))?;
        let contact = contact(self.shape, self.contact.as_ref(), &load, amount, &span)?;
        let mut timed = TimedLoad {
            load,
            from,
            to,
            repeat,
            amount,
            path: Vec::new(),
            contact,
        };
        let mut before = (from, timed.load.centre_mm, amount);
        for waypoint in self.path {
            let place = waypoint.span();
            let waypoint = waypoint.into_inner().after(before, to)?;
            before = (waypoint.at, waypoint.centre_mm, waypoint.amount);
            timed.path.push(waypoint);
            timed
                .sinks(waypoint.amount, law)
                .map_err(|why| Fault(place.clone(), why))?;
            let there = Load {
                centre_mm: waypoint.centre_mm,
                ..timed.load.clone()
            };
            there
                .check_outline()
                .and_then(|()| on_the_sheet(&there, sheet))
                .map_err(|fault| Fault(place, fault.to_string()))?;
        }
        timed
            .sinks(amount, law)
            .map_err(|why| Fault(span.clone(), why))?;
        timed.load = timed.momentary_start(law);
        if matches!(amount, Amount::Loss(_)) {
            timed
                .load
                .check()
                .map_err(|fault| Fault(span, fault.to_string()))?;
        }
        on_the_sheet(&timed.load, sheet)
            .map_err(|fault| Fault(self.x_mm.span(), fault.to_string()))?;
        Ok(timed)
    }
}

impl WaypointText {
    /// The waypoint after another one.
    fn after(
        self,
        (then, [x, y], amount): (Duration, [f64; 2], Amount),
        to: Option<Duration>,
    ) -> Result<Waypoint, Fault> {
        let at = moment(Some(&self.at_s), "at_s")?.unwrap_or_default();
        if at <= then || to.is_some_and(|to| at > to) {
            let until = to.map_or(String::new(), |to| {
                format!(", and no later than {} s", to.as_secs_f64())
            });
            let why = format!(
                "at_s is {}, it must be later than {} s{until}",
                self.at_s.get_ref(),
                then.as_secs_f64()
            );
            return Err(Fault(self.at_s.span(), why));
        }
        let centre_mm = [self.x_mm.unwrap_or(x), self.y_mm.unwrap_or(y)];
        let other = |given: &Spanned<f64>, key: &str, load: &str| {
            let why = format!("{key} on the path of a load with {load}: a load has one of them");
            Err(Fault(given.span(), why))
        };
        let amount = match (amount, &self.loss_percent, &self.mass_g) {
            (Amount::Loss(_), _, Some(mass)) => return other(mass, "mass_g", "loss_percent"),
            (Amount::Mass(_), Some(percent), _) => {
                return other(percent, "loss_percent", "mass_g");
            }
            (Amount::Loss(_), Some(percent), None) => {
                let given = *percent.get_ref();
                if !(0.0..=100.0).contains(&given) {
                    let why = format!("loss_percent is {given}, it must be 0 to 100");
                    return Err(Fault(percent.span(), why));
                }
                Amount::Loss(given / 100.0)
            }
            (Amount::Mass(_), None, Some(mass)) => {
                let given = *mass.get_ref();
                if !(given >= 0.0 && given.is_finite()) {
                    let why = format!("mass_g is {given}, it must be zero or more");
                    return Err(Fault(mass.span(), why));
                }
                Amount::Mass(given)
            }
            (before, None, None) => before,
        };
        Ok(Waypoint {
            at,
            centre_mm,
            amount,
        })
    }
}

/// The distribution of a load's force, if shape and amount allow it.
fn contact(
    shape: ShapeName,
    named: Option<&Spanned<ContactName>>,
    load: &Load,
    amount: Amount,
    span: &Range<usize>,
) -> Result<Contact, Fault> {
    let by_mass = matches!(amount, Amount::Mass(_));
    match (shape, named) {
        (ShapeName::Sphere, Some(named)) => Err(Fault(
            named.span(),
            "a sphere has its own contact: delete the key, it is for the other shapes".to_owned(),
        )),
        (ShapeName::Sphere, None) if !by_mass => Err(Fault(
            span.clone(),
            "the contact of a sphere is computed from its force: give mass_g instead of loss_percent".to_owned(),
        )),
        (ShapeName::Sphere, None) => match load.shape {
            Shape::Disc { diameter_mm } => Ok(Contact::Sphere {
                radius_mm: 0.5 * diameter_mm,
            }),
            _ => Ok(Contact::Even),
        },
        (_, Some(named)) if *named.get_ref() == ContactName::Punch => {
            if shape == ShapeName::Disc && by_mass {
                return Ok(Contact::Punch);
            }
            let why = "contact \"punch\" is only for a disc with mass_g";
            Err(Fault(named.span(), why.to_owned()))
        }
        _ => Ok(Contact::Even),
    }
}

impl TimedLoad {
    /// Refuses a contact that is wider than its sphere, because Hertz's law holds for small contacts.
    fn sinks(&self, amount: Amount, law: &Law) -> Result<(), String> {
        if let (Contact::Sphere { radius_mm }, Amount::Mass(mass_g)) = (self.contact, amount) {
            let modulus = law.pressure.modulus_kpa;
            let contact = hertz_radius_mm(radius_mm, mass_g, modulus);
            if contact > radius_mm {
                return Err(format!(
                    "{mass_g} g press a sphere of {radius_mm} mm radius into foam of {modulus} kPa beyond its middle \
                     (contact radius {contact:.1} mm): give a larger diameter_mm, a smaller mass_g or a larger \
                     pressure.modulus_kpa"
                ));
            }
        }
        Ok(())
    }
}

/// Refuses a load outside the sheet.
fn on_the_sheet(load: &Load, sheet: &Preset) -> Result<(), LoadError> {
    let outline = load.outline();
    let beside = match sheet {
        Preset::PaperSheet(sheet) => {
            let size = [sheet.width_mm * 1e-3, sheet.height_mm * 1e-3];
            (0..2).any(|axis| {
                let along = || outline.iter().map(|point| point[axis]);
                along().all(|at| at <= 0.0) || along().all(|at| at >= size[axis])
            })
        }
        Preset::DiscTank(tank) => !reaches(&outline, tank.radius_mm * 1e-3),
    };
    if beside {
        return Err(LoadError::Beside {
            load: load.name.clone(),
            x_mm: load.centre_mm[0],
            y_mm: load.centre_mm[1],
        });
    }
    Ok(())
}

/// Whether a polygon contains the origin or its distance from the origin is less than a radius.
fn reaches(outline: &[[f64; 2]], radius: f64) -> bool {
    let count = outline.len();
    let mut turns = 0.0;
    for k in 0..count {
        let ([ax, ay], [bx, by]) = (outline[k], outline[(k + 1) % count]);
        let (dx, dy) = (bx - ax, by - ay);
        let long = dx * dx + dy * dy;
        let share = if long > 0.0 {
            (-(ax * dx + ay * dy) / long).clamp(0.0, 1.0)
        } else {
            0.0
        };
        if (ax + share * dx).hypot(ay + share * dy) < radius {
            return true;
        }
        turns += (ax * by - ay * bx).atan2(ax * bx + ay * by);
    }
    turns.abs() > 1.0
}
