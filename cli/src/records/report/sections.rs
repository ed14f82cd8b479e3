//! The tables of the page.

use imaging::quantities::{LoadUnit, Quantity};
use logbook::Event;

use super::html::{escape, table};
use super::{Facts, moments};
use crate::failure::{Failure, chain};
use crate::maps::session_settings;
use crate::options::duration::display_long;
use crate::output::time::local;
use crate::records::show;

/// Most events on the page; a month has more than is useful in print.
const EVENTS: usize = 400;

/// Summary of the session.
pub(super) fn summary(facts: &Facts<'_>) -> Result<String, Failure> {
    let mut rows: Vec<[String; 2]> = Vec::new();
    let mut push = |name: &str, text: String| rows.push([name.to_owned(), text]);
    let first = facts.session.frames().find_map(Result::ok);
    if let Some(first) = &first {
        let count = facts.verified.frames;
        let begin = local(first.frame.wall);
        let unknown = |why: &str| {
            format!(
                "{count} that can be read, from {begin}; the end is not known, because the last one cannot be read: {why}"
            )
        };
        let text = match facts.session.last() {
            Ok(Some(last)) => {
                let whole = (last.frame.wall - first.frame.wall).as_seconds_f64();
                let end = local(last.frame.wall);
                format!("{count} in {}, from {begin} to {end}", display_long(whole))
            }
            Ok(None) => unknown("its number is damaged"),
            Err(why) => unknown(&chain(&why)),
        };
        push("frames", text);
    }
    let gaps = &facts.verified.gaps;
    let unexplained = gaps.iter().filter(|gap| gap.explained.is_none()).count();
    let lost: f64 = gaps.iter().map(|gap| gap.seconds).sum();
    push(
        "gaps",
        match gaps.len() {
            0 => "none".to_owned(),
            count => format!(
                "{count}, together {}; {unexplained} of them without an explanation",
                display_long(lost)
            ),
        },
    );
    push(
        "alarms",
        match (facts.alarms().count(), facts.not_judged()) {
            (0, 0) => "none in this session".to_owned(),
            (count, 0) => format!("{count} times: see Alarms and events"),
            (count, unknown) => format!(
                "{count} times; an alarm could not be judged {unknown} times: see Alarms and events"
            ),
        },
    );
    match &facts.maps {
        Err(why) => push("maps", format!("none: {why}")),
        Ok(maps) => {
            if let Some(why) = &maps.rows.no_map {
                push("maps", format!("none: {why}"));
            }
            for quantity in [
                Quantity::Load,
                Quantity::Ppi,
                Quantity::Unrelieved,
                Quantity::Dose,
            ] {
                if let Some(row) = maps.rows.worst(quantity) {
                    push(
                        quantity.words(),
                        format!(
                            "at most {}, in the span from {}",
                            moments::value(row),
                            moments::begin(row)
                        ),
                    );
                }
            }
            let known = maps
                .rows
                .of_region(Quantity::Known, imaging::quantities::SHEET);
            let (frames, sum) = known.fold((0_u64, 0.0), |(frames, sum), row| {
                (frames + row.frames, sum + row.mean * row.frames as f64)
            });
            if frames > 0 {
                let share = sum / frames as f64;
                let rest = match share < 1.0 {
                    true => "; for the others it is not known how the sheet was loaded",
                    false => "",
                };
                push(
                    "map known",
                    format!("in {:.1} % of the frames{rest}", 100.0 * share),
                );
            }
            let unit = maps.rows.rows.first().map(|row| row.of);
            if unit == Some(LoadUnit::RelativeLoss) {
                let kept = session_settings::stored_config(facts.session.header()).ok();
                let why = match kept.and_then(|kept| kept.model.calibration) {
                    Some(file) => {
                        format!("the session's calibration {} is not used", file.display())
                    }
                    None => "the session has no calibration".to_owned(),
                };
                push(
                    "unit",
                    format!("relative loss of conductance: {why}, so that pressures are not known"),
                );
            }
        }
    }
    Ok(table(&["", ""], &rows))
}

pub(super) fn events(facts: &Facts<'_>) -> String {
    if facts.events.is_empty() {
        return "<p>None.</p>".to_owned();
    }
    // alarms first, so that the limit does not hide them
    let mut shown: Vec<&Event> = facts
        .events
        .iter()
        .filter(|event| event.kind.starts_with("alarm"))
        .collect();
    let others = facts
        .events
        .iter()
        .filter(|event| !event.kind.starts_with("alarm"));
    shown.extend(others);
    shown.truncate(EVENTS);
    shown.sort_by_key(|event| event.at);
    let rows: Vec<[String; 3]> = shown
        .iter()
        .map(|event| [local(event.at), event.kind.clone(), event.text.clone()])
        .collect();
    let left = facts.events.len() - rows.len();
    let more = match left {
        0 => String::new(),
        _ => format!(
            "<p>{left} more are not shown; <code>tactus events {}</code> lists all.</p>",
            escape(&facts.session.header().id)
        ),
    };
    table(&["time", "kind", "what happened"], &rows) + &more
}

pub(super) fn gaps(facts: &Facts<'_>) -> String {
    if facts.verified.gaps.is_empty() {
        return "<p>None: no two frames are further apart than usual in this session.</p>"
            .to_owned();
    }
    let rows: Vec<[String; 3]> = facts
        .verified
        .gaps
        .iter()
        .map(|gap| {
            let before = facts.session.frame(gap.after).ok();
            [
                before.map_or_else(
                    || format!("after frame {}", gap.after),
                    |record| local(record.frame.wall),
                ),
                display_long(gap.seconds),
                gap.explained
                    .clone()
                    .unwrap_or_else(|| "no event explains it".to_owned()),
            ]
        })
        .collect();
    table(&["last frame before", "length", "explanation"], &rows)
}

pub(super) fn health(facts: &Facts<'_>) -> String {
    let health = &facts.health;
    let share = |count: u64| {
        format!(
            "{count} ({:.2} %)",
            100.0 * count as f64 / health.frames as f64
        )
    };
    let mut rows = vec![["frames without a fault".to_owned(), share(health.sound)]];
    for (fault, count) in &health.faults {
        rows.push([(*fault).to_owned(), share(*count)]);
    }
    let mut html = match health.frames {
        0 => "<p>The session has no readable frame.</p>".to_owned(),
        _ => table(&["readings of the frames", "frames"], &rows),
    };
    let findings: Vec<[String; 2]> = facts
        .verified
        .findings
        .iter()
        .map(|finding| [finding.kind.to_owned(), finding.text.clone()])
        .collect();
    html += &match findings.is_empty() {
        true => {
            "<p>The record is complete and undamaged: checksums, order and parts were verified.</p>"
                .to_owned()
        }
        false => table(&["defect of the record", ""], &findings),
    };
    html
}

/// Settings, instruments and origin, as in the list of `tactus sessions show`.
pub(super) fn provenance(facts: &Facts<'_>) -> Result<String, Failure> {
    let mut rows = show::entries(facts.session)?;
    let header = facts.session.header();
    let mut push = |name: &str, text: &str| {
        if !text.is_empty() {
            rows.push((name.to_owned(), text.to_owned()));
        }
    };
    push("protocol", &header.protocol.hash());
    push(
        "geometry",
        header.geometry_hash.as_deref().unwrap_or_default(),
    );
    push("configuration", &header.config_hash);
    if let Ok(maps) = &facts.maps {
        push("maps of this report", maps.reconstruction.method());
        for remark in &maps.reconstruction.remarks {
            push("", remark);
        }
    }
    push("report by", concat!("tactus ", env!("CARGO_PKG_VERSION")));
    let rows: Vec<[String; 2]> = rows.into_iter().map(|(name, text)| [name, text]).collect();
    Ok(table(&["", ""], &rows))
}
