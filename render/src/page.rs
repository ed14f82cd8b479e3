//! Layout of a page with one map, or with many.

use plotters::coord::Shift;
use plotters::prelude::*;
use survey::Map;

use crate::chart::{Panel, RING, bar, caption, heading, small_title};
use crate::drawing::canvas::{FINER, failed};
use crate::drawing::pen::Pen;
use crate::marks::{Marked, legend, marks};
use crate::raster::check_size;
use crate::rim::Rim;
use crate::{Grid, PictureError, Range, Rgb, Scales, Sheet, Style};

/// One map on the page.
pub(crate) struct Drawn<'a> {
    pub(crate) panel: Panel,
    pub(crate) map: &'a Map,
    style: &'a Style,
    range: Range,
}

/// A colour bar: its range, upper left corner and size, text size, and whether it has a label.
struct Bar {
    range: Range,
    corner: [f64; 2],
    size: [f64; 2],
    words: f64,
    labelled: bool,
}

/// Layout of a page; all lengths in points.
pub(crate) struct Page<'a> {
    pub(crate) sheet: &'a Sheet,
    pub(crate) panels: Vec<Drawn<'a>>,
    title: &'a str,
    below: String,
    size: [f64; 2],
    bars: Vec<Bar>,
    single: bool,
    /// Whether the maps have different units, so that the title of each map names its unit.
    several_units: bool,
}

impl Drawn<'_> {
    pub(crate) fn colour(&self, value: f64) -> Option<Rgb> {
        Some(value)
            .filter(|value| value.is_finite())
            .and_then(|value| self.range.colour(value))
    }
}

/// Width of the colour bar next to a map of a grid.
const OWN_BAR: f64 = 58.0;

impl<'a> Page<'a> {
    pub(crate) fn single(
        sheet: &'a Sheet,
        map: &'a Map,
        style: &'a Style,
    ) -> Result<Self, PictureError> {
        let range = Range::styled(map, style)?;
        Self::with_range(sheet, map, style, range)
    }

    /// One map on a page, with the ends of its scale.
    pub(crate) fn with_range(
        sheet: &'a Sheet,
        map: &'a Map,
        style: &'a Style,
        range: Range,
    ) -> Result<Self, PictureError> {
        sheet.check(map)?;
        let extent = sheet.extent()?;
        let (width, left, right, top) = (720.0, 72.0, 116.0, 62.0);
        let bottom = match Marked::of([style].into_iter()).any() {
            true => 78.0,
            false => 52.0,
        };
        let per_metre =
            ((width - left - right - 2.0 * RING) / extent.width()).min(900.0 / extent.height());
        let panel = Panel {
            corner: [left + RING, top + RING],
            per_metre,
            extent,
            words: 14.0,
            numbered: [true, true],
        };
        let [across, down] = panel.size();
        let frame = down + 2.0 * RING;
        // Labels at the ends of the bar need space between frame and bar.
        let inset = if range.below || range.above {
            22.0
        } else {
            0.0
        };
        Ok(Self {
            sheet,
            title: &style.title,
            below: caption(map, style),
            size: [
                width.min(left + right + 2.0 * RING + across),
                top + frame + bottom,
            ],
            bars: vec![Bar {
                range,
                corner: [left + 2.0 * RING + across + 20.0, top + inset],
                size: [18.0, frame - 2.0 * inset],
                words: 14.0,
                labelled: true,
            }],
            panels: vec![Drawn {
                panel,
                map,
                style,
                range,
            }],
            single: true,
            several_units: false,
        })
    }

    pub(crate) fn grid(
        sheet: &'a Sheet,
        maps: &'a [(Map, Style)],
        grid: &Grid<'a>,
    ) -> Result<Self, PictureError> {
        let Some((first, _)) = maps.first().filter(|_| grid.columns > 0) else {
            return Err(PictureError::EmptyGrid);
        };
        for (map, _) in maps {
            sheet.check(map)?;
        }
        let extent = sheet.extent()?;
        let common = match grid.scales {
            Scales::Each => None,
            Scales::Common => Some(Range::of(
                maps.iter().map(|(map, style)| (map, style.scale)),
            )?),
        };
        let each = common.is_none();
        let beside = if each { OWN_BAR } else { 0.0 };
        let columns = grid.columns.min(maps.len());
        let rows = maps.len().div_ceil(columns);
        let (left, top, heading) = (64.0, 62.0, 24.0);
        let right = if each { 20.0 } else { 116.0 };
        let bottom = match Marked::of(maps.iter().map(|(_, style)| style)).any() {
            true => 60.0,
            false => 36.0,
        };
        let cell = (1000.0 / columns as f64 - beside).clamp(170.0, 420.0);
        let gap = 14.0;
        let inner = cell - gap - 2.0 * RING;
        let per_metre = (inner / extent.width()).min(1.3 * inner / extent.height());
        let words = (cell / 20.0).clamp(10.0, 14.0);
        let mut size = [0.0; 2];
        let mut bars = Vec::new();
        let mut panels = Vec::with_capacity(maps.len());
        for (index, (map, style)) in maps.iter().enumerate() {
            let (row, column) = (index / columns, index % columns);
            let mut panel = Panel {
                corner: [0.0; 2],
                per_metre,
                extent,
                words,
                // A cell has numbers below if there is no map below it.
                numbered: [index + columns >= maps.len(), column == 0],
            };
            let [across, down] = panel.size();
            size = [
                across + 2.0 * RING + gap + beside,
                down + 2.0 * RING + gap + heading,
            ];
            panel.corner = [
                left + RING + column as f64 * size[0],
                top + heading + RING + row as f64 * size[1],
            ];
            let range = match common {
                None => Range::styled(map, style)?,
                Some(common) => common,
            };
            if each {
                bars.push(Bar {
                    range,
                    corner: [panel.corner[0] + across + RING + 4.0, panel.corner[1]],
                    size: [10.0, down],
                    words,
                    labelled: false,
                });
            }
            panels.push(Drawn {
                panel,
                map,
                style,
                range,
            });
        }
        let whole = [size[0] * columns as f64, size[1] * rows as f64];
        let full = whole[1] - heading - gap;
        let high = full.min(620.0);
        if let Some(range) = common {
            bars.push(Bar {
                range,
                corner: [left + whole[0] + 8.0, top + heading + (full - high) / 2.0],
                size: [18.0, high],
                words: 14.0,
                labelled: true,
            });
        }
        let methods_agree = maps.iter().all(|(map, _)| map.method == first.method);
        let masked: usize = maps.iter().map(|(map, _)| map.masked).sum();
        let mut below: Vec<String> = Vec::new();
        if methods_agree {
            below.push(first.method.clone());
        }
        if masked > 0 {
            below.push(format!("{masked} readings left out in all"));
        }
        if each {
            let mut units: Vec<String> = Vec::new();
            for (map, _) in maps {
                let (_, unit) = map.unit.shown();
                let unit = format!("{}, {unit}", map.unit.caption());
                if !units.contains(&unit) {
                    units.push(unit);
                }
            }
            below.push(format!("a colour bar for each map: {}", units.join("; ")));
        }
        let page = Self {
            sheet,
            panels,
            title: grid.title,
            below: below.join(", "),
            size: [
                (left + whole[0] + right).max(440.0),
                top + whole[1] + bottom,
            ],
            bars,
            single: false,
            several_units: maps.iter().any(|(map, _)| map.unit != first.unit),
        };
        check_size(page.pixels(FINER as f64)[0], page.pixels(FINER as f64)[1])?;
        Ok(page)
    }

    pub(crate) fn pixels(&self, scale: f64) -> [usize; 2] {
        self.size.map(|points| (points * scale).round() as usize)
    }

    /// The layer below the maps: paper and sheets.
    pub(crate) fn beneath<DB: DrawingBackend>(
        &self,
        area: &DrawingArea<DB, Shift>,
        (scale, sink): (f64, f64),
    ) -> Result<(), PictureError> {
        area.fill(&WHITE).map_err(failed)?;
        let pen = Pen::new(area, scale, sink);
        self.panels
            .iter()
            .try_for_each(|drawn| drawn.panel.ground(&pen, self.sheet))
    }

    /// The layer above the maps: texts, outlines, axes, scales, marks.
    pub(crate) fn above<DB: DrawingBackend>(&self, pen: &Pen<'_, DB>) -> Result<(), PictureError> {
        self.heading(pen)?;
        self.fixed(pen)?;
        self.marks(pen)
    }

    /// The title, the line below it, and the label of a simulation.
    pub(crate) fn heading<DB: DrawingBackend>(
        &self,
        pen: &Pen<'_, DB>,
    ) -> Result<(), PictureError> {
        let simulated = self.styles().any(|style| style.simulated);
        heading(pen, self.title, &self.below, simulated, self.size[0])
    }

    /// Everything that is the same for every map of a sheet on this page: outlines, axes, scales, the legend of the
    /// marks.
    pub(crate) fn fixed<DB: DrawingBackend>(&self, pen: &Pen<'_, DB>) -> Result<(), PictureError> {
        for Drawn {
            panel, map, style, ..
        } in &self.panels
        {
            panel.furniture(pen, self.sheet)?;
            if !self.single {
                let middle = panel.corner[0] + panel.size()[0] / 2.0;
                let at = [middle, panel.corner[1] - RING - panel.words * 0.9];
                let available = panel.size()[0] + 2.0 * RING;
                // the unit comes first, because the end of a long title is cut
                let unit = match self.several_units {
                    true => format!("{}: ", map.unit.shown().1),
                    false => String::new(),
                };
                let title = format!("{unit}{}", style.title);
                small_title(pen, &title, at, panel.words * 1.1, available)?;
            }
        }
        for drawn in &self.bars {
            let Bar {
                range,
                corner,
                size,
                words,
                labelled,
            } = drawn;
            bar(pen, range, *labelled, *corner, *size, *words)?;
        }
        let marked = Marked::of(self.styles());
        legend(pen, [16.0, self.size[1] - 16.0], marked)
    }

    pub(crate) fn marks<DB: DrawingBackend>(&self, pen: &Pen<'_, DB>) -> Result<(), PictureError> {
        for Drawn {
            panel, map, style, ..
        } in &self.panels
        {
            if let Some(rim) = Rim::loaded(self.sheet, map) {
                rim.hatch(pen, panel)?;
            }
            marks(pen, panel, style)?;
        }
        Ok(())
    }

    fn styles(&self) -> impl Iterator<Item = &Style> {
        self.panels.iter().map(|drawn| drawn.style)
    }
}
