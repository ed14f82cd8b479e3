//! Checks the positions of the electrodes against a baseline: their order, the direction in which they are counted, and
//! the angle of the ring.

use std::sync::Arc;

use eit::Forward;
use survey::{Electrode, Protocol, Reading};

use super::Geometry;
use super::depth::misfit;

/// Another numbering contradicts the geometry if its misfit is less than this share of the geometry's. Contacts and
/// uneven spraying add the same misfit to all numberings.
const CONTRADICTION: f64 = 0.5;
/// Least misfit of the geometry for a remark, as a share of the baseline's rms.
const LEAST: f64 = 0.02;

/// A numbering: electrode e of the baseline is at the position of electrode `first` + e of the geometry, or `first` - e
/// if `reversed`.
#[derive(Debug, Clone, Copy)]
struct Numbering {
    first: usize,
    reversed: bool,
}

impl Numbering {
    fn of(self, electrode: Electrode, electrodes: usize) -> usize {
        match self.reversed {
            false => (self.first + electrode.0) % electrodes,
            true => (electrodes + self.first - electrode.0) % electrodes,
        }
    }
}

impl Geometry {
    /// A sentence about the numbering of the electrodes that fits a baseline much better than the geometry's; `None` if
    /// there is none. A round tank with evenly spaced electrodes has the same readings at any angle of the ring, so a
    /// wrong angle is not detected.
    pub fn ring_remark(&self, protocol: &Protocol, baseline: &[Reading]) -> Option<String> {
        let forward = Forward::new(Arc::clone(&self.mesh), &self.contact_ohm_m).ok()?;
        let impedance = forward.transfer_impedance(&self.sigma0).ok()?;
        let electrodes = self.electrodes();
        let of = |numbering: Numbering| {
            let model = readings(
                |row, column| impedance[(row, column)],
                protocol,
                |e| numbering.of(e, electrodes),
            );
            misfit(&model, baseline)
        };
        let own = of(Numbering {
            first: 0,
            reversed: false,
        })?;
        let all = (0..2 * electrodes).map(|k| Numbering {
            first: k / 2,
            reversed: k % 2 == 1,
        });
        let (best, left) = all
            .filter_map(|numbering| Some((numbering, of(numbering)?)))
            .min_by(|a, b| a.1.total_cmp(&b.1))?;
        if own < LEAST || left > CONTRADICTION * own {
            return None;
        }
        let direction = match best.reversed {
            false => "in the same direction",
            true => "in the opposite direction",
        };
        Some(format!(
            "the baseline differs by {:.1} % (rms) from the model with the electrodes as the geometry places them, by {:.1} % with its \
             electrode 1 at the place of electrode {} and the others counted {direction}: the data contradict the angle or the order \
             of the electrodes; check the wiring and the geometry",
            100.0 * own,
            100.0 * left,
            best.first + 1
        ))
    }
}

/// Readings at 1 A, ohm, with each electrode at the position that `place` returns.
fn readings(
    impedance: impl Fn(usize, usize) -> f64,
    protocol: &Protocol,
    place: impl Fn(Electrode) -> usize,
) -> Vec<f64> {
    let measurements = protocol.measurements().iter();
    measurements
        .map(|measurement| {
            let [plus, minus, high, low] = measurement.electrodes().map(&place);
            impedance(high, plus) - impedance(high, minus) - impedance(low, plus)
                + impedance(low, minus)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use eit::{DiscTank, PaperSheet, Preset};
    use survey::Volts;

    fn sheet() -> Geometry {
        let sheet = PaperSheet {
            fineness: 0.5,
            ..PaperSheet::default()
        };
        Geometry::from_preset(&Preset::PaperSheet(sheet)).unwrap()
    }

    fn tank(first_deg: f64) -> Geometry {
        let tank = DiscTank {
            fineness: 0.5,
            first_deg,
            ..DiscTank::default()
        };
        Geometry::from_preset(&Preset::DiscTank(tank)).unwrap()
    }

    /// A baseline of the geometry, recorded with another numbering of the electrodes.
    fn baseline(geometry: &Geometry, protocol: &Protocol, numbering: Numbering) -> Vec<Reading> {
        let forward = Forward::new(Arc::clone(&geometry.mesh), &geometry.contact_ohm_m).unwrap();
        let impedance = forward.transfer_impedance(&geometry.sigma0).unwrap();
        let electrodes = geometry.electrodes();
        let model = readings(
            |row, column| impedance[(row, column)],
            protocol,
            |e| numbering.of(e, electrodes),
        );
        let volts = model.iter().map(|ohms| Reading::Ok(Volts(1e-3 * ohms)));
        volts.collect()
    }

    #[test]
    fn a_turned_or_reversed_ring_of_a_sheet_is_named() {
        let (sheet, protocol) = (sheet(), Protocol::sheffield(26).unwrap());
        let remark = |first, reversed| {
            let readings = baseline(&sheet, &protocol, Numbering { first, reversed });
            sheet.ring_remark(&protocol, &readings)
        };
        assert_eq!(remark(0, false), None);
        // a rectangle is symmetric: half a turn or a mirror image cannot be detected
        assert_eq!(remark(13, false), None);
        for (first, reversed, direction) in [(3, false, "same"), (2, true, "opposite")] {
            let text = remark(first, reversed).unwrap();
            assert!(text.contains("contradict the angle"), "{text}");
            assert!(text.contains(direction), "{text}");
            assert!(text.contains("by 0.0 %"), "{text}");
        }
    }

    #[test]
    fn readings_of_a_round_tank_do_not_show_its_angle() {
        let protocol = Protocol::sheffield(16).unwrap();
        let own = Numbering {
            first: 0,
            reversed: false,
        };
        let turned = baseline(&tank(4.0), &protocol, own);
        let straight = tank(0.0);
        assert_eq!(straight.ring_remark(&protocol, &turned), None);
        let ohms = baseline(&straight, &protocol, own);
        let model: Vec<f64> = ohms.iter().map(|r| r.volts().unwrap().0).collect();
        // two meshes of this size differ by 0.0026
        let left = misfit(&model, &turned).unwrap();
        assert!(left < 4e-3, "{left}");
    }
}
