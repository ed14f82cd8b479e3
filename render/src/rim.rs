//! The rim: the part of the sheet outside of the region that a map shows. If the quality of a map reports a load there,
//! the part of the rim nearest to the named electrode is hatched. The rim has no colour, because the map has no value
//! there.

use plotters::prelude::DrawingBackend;
use survey::Map;

use crate::chart::Panel;
use crate::drawing::pen::{INK, Pen};
use crate::{PictureError, Sheet};

/// [`survey::Doubt::kind`] of a load outside of the region.
const OUTSIDE: &str = "outside_region";
/// Distance of the hatching lines, and of the tested points along them, points.
const SPACING: f64 = 5.0;
const STEP: f64 = 1.0;

/// A part of the rim.
pub(crate) struct Rim<'a> {
    sheet: &'a Sheet,
    /// The electrode to which the part is nearest, counted from 0.
    electrode: usize,
}

impl<'a> Rim<'a> {
    /// The part where a load is; `None` if the quality of the map reports none.
    pub(crate) fn loaded(sheet: &'a Sheet, map: &Map) -> Option<Self> {
        let mut reasons = map.quality.iter().flat_map(|quality| &quality.reasons);
        let reason = reasons.find(|reason| reason.kind == OUTSIDE)?;
        let electrode = reason.electrode?.checked_sub(1)?;
        (electrode < sheet.electrodes.len()).then_some(Self { sheet, electrode })
    }

    /// Whether a position (m) belongs to this part.
    pub(crate) fn contains(&self, at: [f64; 2]) -> bool {
        let away = |electrode: &[f64; 2]| (electrode[0] - at[0]).hypot(electrode[1] - at[1]);
        let own = away(&self.sheet.electrodes[self.electrode]);
        let nearest = self.sheet.electrodes.iter().all(|other| away(other) >= own);
        nearest && on_sheet(self.sheet, at) && !shown(self.sheet, at)
    }

    /// Hatching lines over this part, from the lower left to the upper right.
    pub(crate) fn hatch<DB: DrawingBackend>(
        &self,
        pen: &Pen<'_, DB>,
        panel: &Panel,
    ) -> Result<(), PictureError> {
        let [width, height] = panel.size();
        let lines = ((width + height) / SPACING) as usize;
        for line in 0..=lines {
            // x + y is constant along a line; y is downwards
            let sum = line as f64 * SPACING;
            let first = (sum - height).max(0.0);
            let steps = ((sum.min(width) - first) / STEP).max(0.0) as usize;
            let place = |step: usize| {
                let x = first + step as f64 * STEP;
                [panel.corner[0] + x, panel.corner[1] + sum - x]
            };
            let inside = |step: &usize| self.contains(panel.at(place(*step)));
            let mut step = 0;
            while step <= steps {
                let begun = step;
                while step <= steps && inside(&step) {
                    step += 1;
                }
                if step > begun + 1 {
                    pen.line([place(begun), place(step - 1)], INK, 0.8)?;
                }
                step += 1;
            }
        }
        Ok(())
    }
}

/// Whether a position is within the outer edge and in no hole.
fn on_sheet(sheet: &Sheet, [x, y]: [f64; 2]) -> bool {
    let crossings = sheet.outline.iter().map(|edge| {
        let next = edge.iter().cycle().skip(1);
        let crossed = edge.iter().zip(next).filter(|(a, b)| {
            (a[1] > y) != (b[1] > y) && x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
        });
        crossed.count()
    });
    crossings.sum::<usize>() % 2 == 1
}

/// Whether a position is in a triangle of the region.
fn shown(sheet: &Sheet, at: [f64; 2]) -> bool {
    sheet.triangles.iter().any(|[a, b, c]| {
        let side = |p: &[f64; 2], q: &[f64; 2]| {
            (q[0] - p[0]) * (at[1] - p[1]) - (q[1] - p[1]) * (at[0] - p[0])
        };
        let sides = [side(a, b), side(b, c), side(c, a)];
        sides.iter().all(|side| *side >= 0.0) || sides.iter().all(|side| *side <= 0.0)
    })
}
