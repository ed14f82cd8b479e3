//! The HTML page of the study.

use std::fmt::Write;

use super::Effort;
use super::panel::Panel;
use crate::html::{escaped, opening};

const STYLE: &str = "body{font:16px/1.5 sans-serif;max-width:68em;margin:2em auto;padding:0 1em;color:#222226}\
img{width:100%;max-width:60em;height:auto}figure{margin:1em 0}figcaption{color:#555}\
table{border-collapse:collapse;margin:1em 0;font-size:13px}th,td{border-bottom:1px solid #ddd;padding:.2em .7em;text-align:right}\
th:first-child,td:first-child,th:nth-child(2),td:nth-child(2){text-align:left}tr.front{font-weight:bold}summary{cursor:pointer}";

pub(crate) fn page(effort: &Effort, panels: &[Panel]) -> String {
    let title = "What accuracy costs in time";
    let mut html = opening(title, STYLE) + &format!("<h1>{title}</h1>\n");
    html += if effort.full {
        "<p>This is the full run.</p>\n"
    } else {
        "<p>This is the quick run: small meshes, few frames. It shows that all of it works; what it finds is not to be \
         quoted.</p>\n"
    };
    // writing to a string cannot fail
    let _ = writeln!(
        html,
        "<p>Error against time, both logarithmic. Ringed and joined by a dashed line: what nothing beats in both. Times are \
         medians of {} runs or more on this machine, bars are standard deviations over {} draws or more. Settings: \
         <code>{}</code>. Everything is simulated; judging data come from another, finer mesh than a method's, and from \
         other seeds than its training.</p>",
        Effort::RUNS,
        Effort::SEEDS,
        escaped(&effort.described().to_string())
    );
    for (number, panel) in panels.iter().enumerate() {
        one(&mut html, number + 1, panel);
    }
    html += "</body></html>\n";
    html
}

fn one(html: &mut String, number: usize, panel: &Panel) {
    let _ = writeln!(html, "<h2>{number}. {}</h2>", escaped(&panel.title));
    for group in panel.groups() {
        let _ = writeln!(
            html,
            "<figure><a href=\"{0}.svg\"><img src=\"{0}.png\" alt=\"{1} {group}\"></a></figure>",
            panel.picture(group),
            escaped(&panel.title)
        );
    }
    let _ = writeln!(
        html,
        "<p>{} {}</p>",
        escaped(&panel.shows),
        escaped(&panel.not_proved)
    );
    for what in &panel.not_built {
        let _ = writeln!(html, "<p>Not built: {}.</p>", escaped(what));
    }
    if panel.points.is_empty() {
        return;
    }
    let mut names: Vec<&String> = panel.points.iter().flat_map(|p| p.also.keys()).collect();
    names.sort();
    names.dedup();
    let _ = write!(
        html,
        "<details><summary>The table (<a href=\"{}.json\">for programs</a>)</summary><table><tr><th>line</th><th>setting</th>\
         <th>{}</th><th>{}</th><th>+-</th>",
        panel.panel,
        escaped(&panel.across),
        escaped(&panel.up)
    );
    for name in &names {
        let _ = write!(html, "<th>{}</th>", escaped(name));
    }
    html.push_str("</tr>\n");
    // thousands of rows are not useful on a page; the JSON table contains all of them
    let long = panel.points.len() > 200;
    for point in panel.points.iter().filter(|point| !long || point.front) {
        let class = if point.front { " class=\"front\"" } else { "" };
        let _ = write!(
            html,
            "<tr{class}><td>{} {}</td><td>{}</td><td>{:.3e}</td><td>{:.3e}</td><td>{:.1e}</td>",
            escaped(&point.group),
            escaped(&point.line),
            escaped(&point.setting),
            point.time,
            point.error,
            point.spread
        );
        for name in &names {
            let _ = match point.also.get(*name) {
                Some(value) => write!(html, "<td>{value:.3e}</td>"),
                None => write!(html, "<td>&ndash;</td>"),
            };
        }
        html.push_str("</tr>\n");
    }
    html.push_str("</table>");
    if long {
        let _ = write!(
            html,
            "<p>Only the front of {} settings.</p>",
            panel.points.len()
        );
    }
    html.push_str("</details>\n");
}
