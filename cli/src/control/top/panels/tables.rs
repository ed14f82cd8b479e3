//! Tables: quantities of the sheet and its regions, and hot spots.

use imaging::quantities::{
    FrameQuantities, LoadUnit, Quantity, RegionQuantities, SpotTrack, rounded,
};
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::Modifier;
use ratatui::text::Line;
use ratatui::widgets::Paragraph;
use survey::printable_within;

use crate::control::top::dashboard::Dashboard;
use crate::control::top::panels::titled;
use crate::options::duration::display_long;

/// Width of the column of quantities' names.
const NAME: usize = 15;
/// Width of the column of a region's values.
const VALUE: usize = 10;
/// Width of the column of units, with the space before it.
const UNIT: usize = 14;

pub(crate) fn quantities(frame: &mut Frame<'_>, area: Rect, shown: &Dashboard) {
    let rows = usize::from(area.height).saturating_sub(2);
    let all = Quantity::ALL.len();
    let first = shown.first_quantity.min(all.saturating_sub(1));
    let last = (first + rows).min(all);
    let title = format!("Quantities {} to {last} of {all}", first + 1);
    let area = titled(frame, area, &title);
    let Some(seen) = shown.quantities() else {
        frame.render_widget("no map yet", area);
        return;
    };
    let fitting = (usize::from(area.width).saturating_sub(NAME + UNIT) / (VALUE + 1)).max(1);
    let hidden = seen.regions.len().saturating_sub(fitting);
    let first_region = shown.first_region.min(hidden);
    let regions = seen.regions.iter().skip(first_region).take(fitting);
    let names = regions.clone().map(|region| {
        let name = printable_within(&region.name, VALUE);
        format!(" {name:>VALUE$}")
    });
    let names: String = names.collect();
    let more = if hidden > 0 { "Left Right" } else { "" };
    let mut lines = vec![Line::styled(
        format!("{more:<NAME$}{names}"),
        Modifier::BOLD,
    )];
    for quantity in &Quantity::ALL[first..last] {
        let values = regions
            .clone()
            .map(|region| format!(" {:>VALUE$}", value(region, *quantity)));
        let values: String = values.collect();
        let unit = quantity.unit(seen.unit);
        lines.push(Line::from(format!(
            "{:<NAME$}{values} {unit}",
            quantity.name()
        )));
    }
    frame.render_widget(Paragraph::new(lines), area);
}

/// A value with its standard deviation due to noise; `-` if it is unknown.
fn value(region: &RegionQuantities, quantity: Quantity) -> String {
    let Some(value) = region.values.get(quantity) else {
        return "-".to_owned();
    };
    let exact = matches!(quantity, Quantity::HotSpots | Quantity::Known);
    let text = if exact {
        format!("{value:.0}")
    } else {
        rounded(value)
    };
    let both = region.deviations.get(quantity).map(|deviation| {
        // as many decimals as the value has, if the deviation then has a significant digit
        let decimals = text.split_once('.').map_or(0, |(_, after)| after.len());
        let alike = format!("{deviation:.decimals$}");
        match alike.bytes().any(|digit| matches!(digit, b'1'..=b'9')) {
            true => format!("{text}\u{b1}{alike}"),
            false => format!("{text}\u{b1}{}", rounded(deviation)),
        }
    });
    both.filter(|both| both.chars().count() <= VALUE)
        .unwrap_or(text)
}

pub(crate) fn hot_spots(frame: &mut Frame<'_>, area: Rect, shown: &Dashboard) {
    let seen = shown.quantities();
    let spots = seen.map_or(&[][..], |seen| &seen.spots);
    let rows = usize::from(area.height).saturating_sub(1);
    let title = match spots.len() {
        count if count > rows => format!("Hot spots (mm), {rows} of {count}"),
        _ => "Hot spots (mm)".to_owned(),
    };
    let area = titled(frame, area, &title);
    let lines: Vec<Line<'_>> = match seen {
        Some(seen) if !spots.is_empty() => spots
            .iter()
            .take(rows)
            .map(|spot| Line::from(hot_spot(seen, spot, usize::from(area.width))))
            .collect(),
        Some(seen) if seen.known => vec!["none".into()],
        Some(_) => vec!["not known".into()],
        None => vec!["no map yet".into()],
    };
    frame.render_widget(Paragraph::new(lines), area);
}

/// A hot spot on one line of at most `columns` if possible; with the 95 % ellipse of its position if that fits.
fn hot_spot(seen: &FrameQuantities, spot: &SpotTrack, columns: usize) -> String {
    let [x, y] = spot.centre_mm;
    let peak = match seen.unit {
        LoadUnit::Pressure => format!("{} kPa", rounded(spot.peak)),
        LoadUnit::RelativeLoss => format!("{} %", rounded(100.0 * spot.peak)),
    };
    let area = rounded(1e-2 * spot.area_mm2);
    let text = format!(
        "{:>2} ({x:.0}, {y:.0}) {peak} {area} cm2 {}",
        spot.number,
        spot.age_s.map_or_else(|| "-".to_owned(), display_long)
    );
    let wider = spot.uncertainty.map(|uncertainty| {
        let [half, _] = uncertainty.half_axes_mm;
        format!("{text}, within {} mm", rounded(half))
    });
    let wider = wider.filter(|wider| wider.chars().count() <= columns);
    wider.unwrap_or(text)
}
