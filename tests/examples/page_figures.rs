//! Measures the live page in a real browser on this machine: time to the first picture, time from the last reading of
//! a frame to its pixels, drawings a second, the frame period with ten pages open, and the memory of a page.
//!
//! ```text
//! cargo run -p tactus-tests --example page_figures [-- FRAMES [MINUTES]]
//! ```
//!
//! 200 frames and 10 minutes by default. Needs chromium and chromium-driver (Debian).
//!
//! Time of the pixels: measured by the page's script at the start of the next animation frame after drawing the map,
//! when the browser has composed the drawn frame. Time of the last reading: from the frame's time and duration in the
//! record, by the same clock. Memory: the script's heap after a garbage collection, and the resident memory of the
//! browser process that draws the page.

#[allow(dead_code, reason = "the stories use all of it")]
#[path = "../stories/browser/driver.rs"]
mod driver;

use std::collections::HashMap;
use std::io::{BufRead, BufReader};
use std::process::{Child, ExitCode, Stdio};
use std::time::{Duration, Instant};

use chrono::{DateTime, Utc};
use driver::Browser;
use serde_json::{Value, json};
use tactus_tests::{SIMULATED, Stage, TWO_MICROVOLTS, act_as};

type Failure = Box<dyn std::error::Error>;

/// Runs before the page's own scripts: measures the time from the request of the page to the first picture, ms. Until
/// those scripts run, `map` is the canvas with this id.
const FIRST: &str = "(() => { const look = () => { let drawn = false; try { drawn = map.values instanceof Float32Array && Boolean(map.raster); } catch {} \
    if (drawn) requestAnimationFrame(() => { window.firstPicture = performance.now(); }); else requestAnimationFrame(look); }; look(); })()";
/// Records `[sequence, ms since 1970]` of each drawn map.
const FOLLOW: &str = "(() => { window.drawn = []; const draw = map.draw.bind(map); let last = null; map.draw = () => { draw(); \
    const sequence = map.frame && map.frame.sequence; if (sequence === last) return; last = sequence; \
    requestAnimationFrame(() => drawn.push([sequence, performance.timeOrigin + performance.now()])); }; return 0; })()";
/// Draws another map at each animation frame for five seconds: `[drawings a second, mean ms of a drawing]`.
const DRAWINGS: &str = "const done = arguments[0]; const maps = [0, 1].map(k => map.values.map((value, t) => value + ((t + k) % 7) / 100)); \
    let count = 0, spent = 0; const begin = performance.now(); const tick = () => { const before = performance.now(); \
    map.setMap(maps[count % 2], map.frame, map.top); map.draw(); spent += performance.now() - before; count += 1; \
    if (before - begin < 5000) requestAnimationFrame(tick); else done([1000 * count / (before - begin), spent / count]); }; tick();";

/// Instruments of the rig as slow as real ones.
const REAL_TIME: &str = "time = \"real\"\n[slots]\n1 = \"34924A\"\n";

fn main() -> ExitCode {
    if let Some(code) = act_as(std::env::args_os()) {
        return code;
    }
    let mut numbers = std::env::args().skip(1).map(|word| word.parse::<u64>());
    let asked = (
        numbers.next().unwrap_or(Ok(200)),
        numbers.next().unwrap_or(Ok(10)),
    );
    let (Ok(frames), Ok(minutes)) = asked else {
        eprintln!("page_figures [FRAMES [MINUTES]]");
        return ExitCode::from(2);
    };
    match measure(frames.max(20), minutes) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("page_figures: {failure}");
            ExitCode::FAILURE
        }
    }
}

/// `tactus web`, ended when dropped.
struct Page(Child, String);

impl Page {
    fn serve(stage: &Stage) -> Result<Self, Failure> {
        let bus = format!("unix:{}", stage.peer_path().display());
        let mut command = stage.command("tactus");
        command.args(["--json", "--bus", &bus, "web", "--no-browser"]);
        let mut process = command.stdout(Stdio::piped()).spawn()?;
        let output = process.stdout.take().ok_or("no output")?;
        let mut line = String::new();
        BufReader::new(output).read_line(&mut line)?;
        let line: Value = serde_json::from_str(&line)?;
        let url = line["url"].as_str().ok_or("no address")?.to_owned();
        Ok(Self(process, url))
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn measure(frames: u64, minutes: u64) -> Result<(), Failure> {
    let stage = Stage::with_program(SIMULATED, std::env::current_exe()?)?;
    std::fs::write(stage.path().join("scene.toml"), TWO_MICROVOLTS)?;
    let profile = stage.path().join("browser");
    let browser =
        Browser::start(&profile, 1500, 1000).ok_or("chromium and chromedriver are needed")?;
    let daemon = stage.start_daemon()?;
    let tactus = |args: &[&str]| -> Result<Vec<Value>, Failure> {
        let all = [args, &["--json"]].concat();
        Ok(stage.tactus(&all)?.succeeded()?.json())
    };
    tactus(&["baseline", "record", "--frames", "10"])?;
    let session = tactus(&["start", "--every", "250ms"])?;
    let id = session[0]["session"]
        .as_str()
        .ok_or("no session")?
        .to_owned();
    let page = Page::serve(&stage)?;
    browser.open(&page.1);
    browser.until("typeof map !== 'undefined' && map.values !== null");

    let source = json!({"source": FIRST});
    browser.command("Page.addScriptToEvaluateOnNewDocument", &source);
    let mut first = Vec::new();
    for _ in 0..20 {
        browser.open("about:blank");
        browser.open(&page.1);
        browser.until("window.firstPicture !== undefined");
        first.push(
            browser
                .value("window.firstPicture")
                .as_f64()
                .ok_or("no time")?,
        );
    }
    report("first picture after the page was asked for", "ms", &first);

    let drawings = browser.asynchronous(DRAWINGS);
    println!(
        "drawings of another map: {:.1} a second, {:.2} ms each",
        number(&drawings[0]),
        number(&drawings[1])
    );

    browser.value(FOLLOW);
    wait_for(&browser, frames)?;
    let drawn = browser.value("drawn");
    tactus(&["stop"])?;
    let ends = ends(&stage, &id)?;
    let mut delays = Vec::new();
    for pair in drawn.as_array().ok_or("no maps")? {
        let sequence = pair[0].as_u64().ok_or("no number")?;
        let end = ends
            .get(&sequence)
            .ok_or("a drawn frame is not in the record")?;
        delays.push(number(&pair[1]) - end);
    }
    report("last reading to pixels, 4 frames a second", "ms", &delays);

    memory(&stage, &browser, &page, minutes)?;
    ten_pages(&browser, frames)?;
    drop(page);
    drop(browser);
    daemon.stop()?;
    Ok(())
}

/// Waits until the page has drawn this number of maps.
fn wait_for(browser: &Browser, maps: u64) -> Result<(), Failure> {
    for count in (10..=maps).step_by(10) {
        browser.until(&format!("drawn.length >= {count}"));
    }
    Ok(())
}

/// The time of the last reading of each frame, ms since 1970.
fn ends(stage: &Stage, id: &str) -> Result<HashMap<u64, f64>, Failure> {
    let csv = stage.path().join(format!("{id}.csv"));
    let out = csv.display().to_string();
    let args = ["export", id, "--format", "csv", "--force", "--out", &out];
    stage.tactus(&args)?.succeeded()?;
    let text = std::fs::read_to_string(csv)?;
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let head: Vec<&str> = lines.next().ok_or("an empty table")?.split(',').collect();
    let column = |name: &str| {
        head.iter()
            .position(|column| *column == name)
            .ok_or("no such column")
    };
    let (number, wall, long) = (
        column("sequence")?,
        column("wall_utc")?,
        column("duration_s")?,
    );
    let mut ends = HashMap::new();
    for line in lines {
        let cells: Vec<&str> = line.split(',').collect();
        let wall: DateTime<Utc> = cells[wall].parse()?;
        let end = 1e-3 * wall.timestamp_micros() as f64 + 1e3 * cells[long].parse::<f64>()?;
        ends.insert(cells[number].parse()?, end);
    }
    Ok(ends)
}

/// Mean frame period, alternately without and with ten pages. Instruments are as slow as real ones, and there is no
/// pause between frames.
fn ten_pages(browser: &Browser, frames: u64) -> Result<(), Failure> {
    let config = SIMULATED.replace("nplc = 1.0", "nplc = 0.02");
    let stage = Stage::with_program(&config, std::env::current_exe()?)?;
    std::fs::write(stage.path().join("scene.toml"), TWO_MICROVOLTS)?;
    std::fs::write(stage.path().join("profile.toml"), REAL_TIME)?;
    let daemon = stage.start_daemon()?;
    let recorded = stage.tactus(&["baseline", "record", "--frames", "4"])?;
    recorded.succeeded()?;
    let page = Page::serve(&stage)?;
    let frames = frames / 10;
    let periods = |count: u64| -> Result<Vec<f64>, Failure> {
        let args = ["--json", "start", "--count", &count.to_string(), "--wait"];
        let lines = stage.tactus(&args)?.succeeded()?.json();
        let id = lines[0]["session"].as_str().ok_or("no session")?;
        let ends = ends(&stage, id)?;
        let mut ends: Vec<f64> = ends.into_values().collect();
        ends.sort_by(f64::total_cmp);
        Ok(ends.windows(2).map(|pair| pair[1] - pair[0]).collect())
    };
    let first = browser.of_session("GET", "/window", None);
    let (mut without, mut with) = (Vec::new(), Vec::new());
    // processor time of the daemon and of the page's server, without and with pages, s
    let mut spent = [[0.0; 2]; 2];
    let processes = [daemon.id(), page.0.id()];
    let measured = |spent: &mut [f64; 2]| -> Result<Vec<f64>, Failure> {
        let before = processes.map(processor_s);
        let found = periods(frames)?;
        for (index, id) in processes.into_iter().enumerate() {
            spent[index] += processor_s(id) - before[index];
        }
        Ok(found)
    };
    for _ in 0..3 {
        browser.open("about:blank");
        without.extend(measured(&mut spent[0])?);
        browser.open(&page.1);
        let mut opened = Vec::new();
        for _ in 1..10 {
            let window =
                browser.of_session("POST", "/window/new", Some(&json!({"type": "window"})));
            browser.of_session(
                "POST",
                "/window",
                Some(&json!({"handle": window["handle"]})),
            );
            browser.open(&page.1);
            browser.until("typeof latest !== 'undefined' && latest !== null");
            opened.push(window);
        }
        with.extend(measured(&mut spent[1])?);
        for window in opened {
            browser.of_session(
                "POST",
                "/window",
                Some(&json!({"handle": window["handle"]})),
            );
            browser.of_session("DELETE", "/window", None);
        }
        browser.of_session("POST", "/window", Some(&json!({"handle": first})));
    }
    report("frame period without a page", "ms", &without);
    report("frame period with ten pages", "ms", &with);
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    println!(
        "change of the mean period by ten pages: {:+.2} %",
        1e2 * (mean(&with) / mean(&without) - 1.0)
    );
    for (program, index) in [("tactusd", 0), ("tactus web", 1)] {
        let each = [0, 1].map(|pages| 1e3 * spent[pages][index] / (3 * frames) as f64);
        println!(
            "processor time of {program} for a frame: {:.2} ms without a page, {:.2} ms with ten",
            each[0], each[1]
        );
    }
    drop(page);
    daemon.stop()?;
    Ok(())
}

/// Memory of one page while frames arrive and the uncertainty is shown.
fn memory(stage: &Stage, browser: &Browser, page: &Page, minutes: u64) -> Result<(), Failure> {
    stage.tactus(&["start", "--every", "100ms"])?.succeeded()?;
    browser.open(&page.1);
    browser.until("typeof map !== 'undefined' && map.values !== null");
    browser.value("byId('uncertainty').click(), 0");
    let begin = Instant::now();
    for minute in 0..=minutes {
        // a sample each minute
        std::thread::sleep(
            (begin + Duration::from_secs(60 * minute)).saturating_duration_since(Instant::now()),
        );
        browser.command("HeapProfiler.collectGarbage", &json!({}));
        let used = browser.command("Runtime.getHeapUsage", &json!({}));
        let frame = browser.value("latest.frame.sequence");
        let heap = 1e-6 * number(&used["usedSize"]);
        let counted = browser.command("Memory.getDOMCounters", &json!({}));
        println!(
            "memory after {minute} min, frame {frame}: script {heap:.2} MB, {} DOM nodes, {} listeners, renderer {:.1} MB resident",
            counted["nodes"],
            counted["jsEventListeners"],
            renderer_mb(stage)?
        );
    }
    stage.tactus(&["stop"])?.succeeded()?;
    Ok(())
}

/// Resident memory of the largest process of this example's browser that draws pages, MB.
fn renderer_mb(stage: &Stage) -> Result<f64, Failure> {
    let profile = stage.path().join("browser").display().to_string();
    let mut largest = f64::NAN;
    for process in std::fs::read_dir("/proc")?.filter_map(Result::ok) {
        let read =
            |file: &str| std::fs::read_to_string(process.path().join(file)).unwrap_or_default();
        let line = read("cmdline");
        if !(line.contains("--type=renderer") && line.contains(&profile)) {
            continue;
        }
        let status = read("status");
        let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
        let kb = resident.and_then(|text| text.split_whitespace().next()?.parse::<f64>().ok());
        largest = largest.max(1e-3 * kb.unwrap_or(0.0));
    }
    Ok(largest)
}

/// Processor time of a process, s; zero if it has ended.
fn processor_s(id: u32) -> f64 {
    let read = std::fs::read_to_string(format!("/proc/{id}/stat")).unwrap_or_default();
    // after the name in parentheses: the 12th and 13th field, in the kernel's hundredths of a second
    let fields = read.rsplit(')').next().unwrap_or_default();
    let times = fields.split_whitespace().skip(11).take(2);
    times
        .filter_map(|field| field.parse::<f64>().ok())
        .sum::<f64>()
        * 0.01
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

fn report(what: &str, unit: &str, values: &[f64]) {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = |share: f64| sorted[((sorted.len() - 1) as f64 * share).round() as usize];
    println!(
        "{what}, {} times: p50 {:.1}, p99 {:.1}, largest {:.1} {unit}",
        sorted.len(),
        at(0.5),
        at(0.99),
        at(1.0)
    );
}
