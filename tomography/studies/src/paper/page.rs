//! The HTML page of the study.

use std::fmt::Write;

use super::claims::Claim;
use super::experiments::Experiments;
use super::figures::Figure;
use super::plan::{Method, Plan};
use crate::html;

const STYLE: &str = "body{font:16px/1.5 sans-serif;max-width:68em;margin:2em auto;padding:0 1em;color:#222226}\
img{width:100%;height:auto}figure{margin:2em 0}figcaption{color:#555}\
table{border-collapse:collapse;margin:1em 0;font-size:14px}th,td{border-bottom:1px solid #ddd;padding:.3em .7em;text-align:right}\
th:first-child,td:first-child,.words td,.words th{text-align:left}.words td{vertical-align:top}code{font-size:13px}";

pub(super) fn page(
    plan: &Plan,
    methods: &[Method],
    experiments: &Experiments,
    claims: &[Claim],
    figures: &[Figure],
) -> String {
    let mut html = html::opening("The paper, run again", STYLE);
    opening(&mut html, plan);
    html += "<h2>The paper says, we find</h2>\n<table class=\"words\"><tr><th>section</th><th>the paper says</th><th>we find</th>\
             <th></th></tr>\n";
    for claim in claims {
        row(
            &mut html,
            &[
                claim.section,
                claim.paper,
                &claim.ours,
                claim.verdict.name(),
            ],
        );
    }
    html += "</table>\n";
    html += "<h2>Figures</h2>\n";
    for figure in figures {
        let vector = figure.file.replace(".png", ".svg");
        // writing to a string cannot fail
        let _ = writeln!(
            html,
            "<figure><a href=\"{vector}\"><img src=\"{}\" alt=\"{}\"></a><figcaption><b>{}.</b> {}</figcaption></figure>",
            figure.file,
            escaped(&figure.title),
            escaped(&figure.title),
            escaped(&figure.words)
        );
    }
    tables(&mut html, plan, methods, experiments);
    trained(&mut html, methods);
    html += "</body></html>\n";
    html
}

fn opening(html: &mut String, plan: &Plan) {
    let scale = if plan.name == "full" {
        "This is the full run, with the paper's own sizes of training set and networks."
    } else {
        "This is the quick run: small networks, few cases. It shows that all of it works; what it finds is not to be quoted."
    };
    let _ = writeln!(
        html,
        "<h1>The paper, run again</h1>\n<p>Quqa, Shu, Li, Loh, <i>Pressure Mapping Using Nanocomposite-Enhanced Foam and Machine \
         Learning</i>, Front. Mater. 9:862796 (2022): its two tests on a simulated sheet, its three methods and those that it \
         leaves out. {scale} Seed {}.</p>\n\
         <p>Voltages come from a finer, different mesh than any method's, at 1 mA, with white noise on baseline and frame; the seeds \
         of judging data are not those of training. Positions, measures and losses of the loads are our reading of a text that \
         gives few numbers; masses become losses by p / (p + 25 kPa). Nothing here was measured on a real sheet.</p>",
        plan.seed
    );
}

fn tables(html: &mut String, plan: &Plan, methods: &[Method], experiments: &Experiments) {
    html.push_str("<h2>Tables</h2>\n");
    for test in [1, 2] {
        for &noise in plan.noises {
            let _ = writeln!(
                html,
                "<h3>Test #{test}, {noise} &micro;V</h3>\n<table><tr><th>method</th><th>location error, mm</th><th>worst</th>\
                 <th>correlation</th><th>relative error</th><th>Dice</th><th>SSIM</th><th>resolution</th><th>ringing</th>\
                 <th>ms a frame</th></tr>"
            );
            for method in methods {
                let Some(outcome) = experiments.of(method.name, test, noise) else {
                    continue;
                };
                let f = &outcome.figures;
                let numbers = [
                    number(f.error_mm, 2),
                    number(f.worst_mm, 2),
                    number(f.correlation, 3),
                    number(f.relative_error, 3),
                    number(f.dice, 3),
                    number(f.ssim, 3),
                    number(f.greit[2], 3),
                    number(f.greit[4], 3),
                    number(f.ms, 3),
                ];
                let cells: Vec<&str> = [method.name]
                    .into_iter()
                    .chain(numbers.iter().map(String::as_str))
                    .collect();
                row(html, &cells);
            }
            html.push_str("</table>\n");
        }
    }
}

fn trained(html: &mut String, methods: &[Method]) {
    html.push_str(
        "<h2>Trained models</h2>\n<table class=\"words\"><tr><th>method</th><th>command</th><th>weights</th><th>bytes</th>\
         <th>sha256</th></tr>\n",
    );
    for method in methods {
        let Some(model) = &method.model else { continue };
        let file = model
            .file
            .file_name()
            .map(|name| name.to_string_lossy().into_owned());
        let name = format!("{} ({})", method.name, file.unwrap_or_default());
        row(
            html,
            &[
                &name,
                &model.command,
                &model.weights.to_string(),
                &model.bytes.to_string(),
                &model.hash,
            ],
        );
    }
    html.push_str("</table>\n");
}

/// A number, or a dash if it is not finite.
fn number(value: f64, decimals: usize) -> String {
    match value.is_finite() {
        true => format!("{value:.decimals$}"),
        false => "&ndash;".to_owned(),
    }
}

fn row(html: &mut String, cells: &[&str]) {
    html.push_str("<tr>");
    for cell in cells {
        let _ = write!(html, "<td>{}</td>", escaped(cell));
    }
    html.push_str("</tr>\n");
}

/// Escapes text, except the `&ndash;` of [`number`].
fn escaped(text: &str) -> String {
    if text == "&ndash;" {
        return text.to_owned();
    }
    html::escaped(text)
}
