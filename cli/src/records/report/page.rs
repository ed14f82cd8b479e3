//! The page: text, tables and drawings, without a script or another file.

use imaging::quantities::Quantity;
use render::{Grid, Scales};

use super::html::{escape, table};
use super::{Facts, MapFacts, charts, sections};
use crate::failure::Failure;

/// Dark text on white, and no information by colour alone; a printed page is 180 mm wide.
const STYLE: &str = "
@page { size: A4; margin: 14mm; }
* { box-sizing: border-box; }
body { font: 11pt/1.4 system-ui, 'DejaVu Sans', sans-serif; color: #222226; background: #fff; max-width: 186mm; margin: 8mm auto; padding: 0 4mm; }
h1 { font-size: 18pt; margin: 0 0 2mm; }
h2 { font-size: 13pt; margin: 7mm 0 2mm; border-bottom: 1px solid #78787e; break-after: avoid; }
p { margin: 2mm 0; }
.simulated { background: #b04000; color: #fff; font-weight: bold; padding: 1mm 3mm; display: inline-block; print-color-adjust: exact; -webkit-print-color-adjust: exact; }
.device { border: 1px solid #222226; padding: 1mm 3mm; display: inline-block; }
.note { color: #55555c; font-size: 9.5pt; }
table { border-collapse: collapse; width: 100%; font-size: 9.5pt; }
th, td { text-align: left; vertical-align: top; padding: 0.8mm 3mm 0.8mm 0; border-bottom: 1px solid #dcdce0; overflow-wrap: anywhere; }
td:first-child { white-space: nowrap; }
tr { break-inside: avoid; }
figure { margin: 3mm 0; break-inside: avoid; }
svg { max-width: 100%; height: auto; display: block; }
pre { font-size: 8pt; white-space: pre-wrap; overflow-wrap: anywhere; border: 1px solid #dcdce0; padding: 2mm; }
";

/// The whole page.
pub(super) fn html(facts: &Facts<'_>) -> Result<String, Failure> {
    let header = facts.session.header();
    let id = escape(header.session());
    let mut html = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" content=\"width=device-width\">\n\
         <title>Tactus: session {id}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<h1>Session {id}</h1>\n"
    );
    if header.simulated {
        html +=
            "<p class=\"simulated\">SIMULATED: the voltages are those of a simulated sheet</p>\n";
    }
    html += "<p class=\"device\">Tactus is a research instrument, not a medical device.</p>\n";
    if !header.note.is_empty() {
        html += &format!("<p>{}</p>\n", escape(&header.note));
    }
    let mut section = |title: &str, content: String| {
        html += &format!("<h2>{title}</h2>\n{content}\n");
    };
    section("Summary", sections::summary(facts)?);
    if let Ok(maps) = &facts.maps {
        section("Worst moments", moments(facts, maps)?);
        section("Course", course(facts, maps)?);
    }
    section("Alarms and events", sections::events(facts));
    section("Gaps", sections::gaps(facts));
    section("Health", sections::health(facts));
    section("Settings and origin", sections::provenance(facts)?);
    if !header.config_toml.is_empty() {
        let text = format!("<pre>{}</pre>", escape(&header.config_toml));
        section("Configuration of the daemon", text);
    }
    html += "</body>\n</html>\n";
    Ok(html)
}

/// Maps of the worst moments, with one scale.
fn moments(facts: &Facts<'_>, maps: &MapFacts<'_>) -> Result<String, Failure> {
    let moments = &maps.moments.shown;
    let left_out = match &maps.moments.left_out {
        Some(text) => format!("<p class=\"note\">{}</p>", escape(text)),
        None => String::new(),
    };
    if moments.is_empty() {
        let text = escape(&no_moments(maps));
        return Ok(format!("<p>{text}</p>{left_out}"));
    }
    let drawn: Vec<_> = moments
        .iter()
        .map(|moment| (moment.map.clone(), moment.style.clone()))
        .collect();
    let grid = Grid {
        columns: drawn.len().clamp(2, 3),
        title: facts.session.header().session(),
        scales: Scales::Common,
    };
    let svg = render::svg_grid(&maps.reconstruction.field.sheet, &drawn, &grid)
        .map_err(|error| Failure::failed("the maps cannot be drawn", &error))?;
    let rows: Vec<[String; 2]> = moments
        .iter()
        .map(|moment| [moment.style.title.clone(), moment.reason()])
        .collect();
    Ok(format!(
        "{}<figure>{svg}</figure>{left_out}",
        table(&["frame of", "why it is shown"], &rows)
    ))
}

/// The reason why no moment is shown.
fn no_moments(maps: &MapFacts<'_>) -> String {
    let rows = &maps.rows;
    if let Some(why) = &rows.no_map {
        return format!("There is no map to show: {why}.");
    }
    if maps.moments.left_out.is_some() {
        return "No frame of the worst moments has a map that can be used.".to_owned();
    }
    let frames = rows.frames(Quantity::Known);
    match frames.saturating_sub(rows.frames(Quantity::Load)) {
        0 => "No map shows a load above its noise.".to_owned(),
        unknown => format!(
            "No map that can be used shows a load above its noise; {unknown} of {frames} frames have none."
        ),
    }
}

fn course(facts: &Facts<'_>, maps: &MapFacts<'_>) -> Result<String, Failure> {
    let figures: String = charts::svgs(facts, maps)?
        .into_iter()
        .map(|svg| format!("<figure>{svg}</figure>\n"))
        .collect();
    let length = crate::options::duration::display_long(f64::from(maps.rows.span_s));
    let regions = maps.rows.regions().len();
    let names = match regions {
        0 | 1 => "Values are those of the whole sheet.",
        _ => {
            "\u{201c}sheet\u{201d} is the whole sheet; the other names are regions of the configuration."
        }
    };
    Ok(format!(
        "<p class=\"note\">Each line is the mean over {length}; the pale band reaches from the smallest to the largest value. Grey: nothing was \
         recorded. Triangle with a line: an alarm became active. Times are local. {names} {}</p>\n{figures}",
        escape(&maps.rows.origin)
    ))
}
