//! Archives a week of many machines into one PostgreSQL database and one folder, and measures it:
//! `cargo run --release -p tactus-archive --example many_machines -- [MACHINES] [DAYS] [PERIOD_S]`, by default 100
//! machines, 7 days, a frame of 598 readings every 10 s.
//! Each day has 20 events, 4 of them of alarms. From the measured bytes of a row it extrapolates the growth of the
//! tables for 10,000 machines. All machines have the same frames: their files are links, so that the disk holds the
//! record once and the store once for each machine (3 GB).

#[expect(dead_code, reason = "the rest is for other measurements")]
#[path = "../../logbook/tests/example_frames/noisy.rs"]
mod noisy;
#[expect(dead_code, reason = "the rest is for the tests")]
#[path = "../tests/postgres/server.rs"]
mod server;

use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use chrono::{DateTime, Utc};
use logbook::{SessionHeader, SessionWriter, append_quantities};
use noisy::{Digits, Rig};
use server::{DATABASE, OWNER, PASSWORD, Server};

type Fault = Box<dyn std::error::Error>;

/// An argument that makes this executable run `tactus-archive`.
const PROGRAM: &str = "program";
const DAY: u64 = 86_400;
const SITES: usize = 10;
/// Number of simultaneous pushes.
const WORKERS: usize = 2;
/// Events that each machine reports, a fifth of them of alarms.
const EVENTS_A_DAY: u64 = 20;
/// Number of machines of the extrapolation.
const MANY: f64 = 10_000.0;
/// Number of passes of the service that are measured, a second apart.
const PASSES: u64 = 60;

fn at(second: u64) -> DateTime<Utc> {
    DateTime::from_timestamp(1_800_000_000 + second as i64, 0).unwrap_or_default()
}

fn main() -> ExitCode {
    let words: Vec<_> = std::env::args_os().skip(1).collect();
    if words.first().is_some_and(|word| word == PROGRAM) {
        return archive::run(words);
    }
    let number = |index: usize, default: u64| {
        let given = words
            .get(index)
            .and_then(|word| word.to_str()?.parse().ok());
        given.unwrap_or(default)
    };
    match measure(number(0, 100) as usize, number(1, 7), number(2, 10)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(fault) => {
            eprintln!("{fault}");
            ExitCode::FAILURE
        }
    }
}

fn measure(machines: usize, days: u64, period: u64) -> Result<(), Fault> {
    let Some(server) = Server::start() else {
        return Err("there is no PostgreSQL".into());
    };
    let folder = tempfile::tempdir()?;
    let began = Instant::now();
    let template = folder.path().join("template");
    std::fs::create_dir_all(folder.path().join("store"))?;
    let frames = record(&template, days, period)?;
    println!(
        "one record: {frames} frames in {days} parts, made in {:.0} s",
        began.elapsed().as_secs_f64()
    );
    let configs = prepare(&server, folder.path(), &template, machines)?;
    let began = Instant::now();
    push_all(&configs)?;
    let took = began.elapsed().as_secs_f64();
    let bytes: f64 = server.sql("SELECT sum(bytes) FROM tactus.part").parse()?;
    let virtual_s = (days * DAY) as f64;
    println!(
        "{machines} machines, {days} days, a frame every {period} s: pushed in {took:.1} s, {:.0} times real time; {:.2} GB, {:.1} MB/s",
        virtual_s / took,
        bytes / 1e9,
        bytes / 1e6 / took
    );
    let total = machines as u64;
    let expected =
        [total * days, total * frames, total * days * DAY / 60].map(|count| count.to_string());
    let counts = "SELECT (SELECT count(*) FROM tactus.part), (SELECT sum(frames) FROM tactus.part), (SELECT count(*) FROM tactus.quantity)";
    let found = server.sql(counts);
    println!(
        "parts, frames, minutes: {found}; complete: {}",
        found == expected.join("|")
    );
    let began = Instant::now();
    // the first machines belong to different sites
    let sites = configs.iter().take(SITES);
    let whole = sites
        .map(|config| Ok(program(config, &["verify"]).output()?.status.success()))
        .collect::<Result<Vec<bool>, Fault>>()?;
    println!(
        "hashes of all parts of {} sites verified: {} in {:.1} s",
        whole.len(),
        whole.iter().all(|whole| *whole),
        began.elapsed().as_secs_f64()
    );
    on_paper(&server, machines as f64 * days as f64)?;
    one_machine(&configs[0], &folder.path().join("0"), days)
}

/// Prints the rows and bytes of each table as measured, after `machine_days` days of one machine, and for many
/// machines a day.
fn on_paper(server: &Server, machine_days: f64) -> Result<(), Fault> {
    server.sql("VACUUM ANALYZE");
    let sizes = "SELECT c.relname, s.n_live_tup, pg_table_size(c.oid), pg_indexes_size(c.oid)
        FROM pg_class c JOIN pg_stat_user_tables s ON s.relid = c.oid
        WHERE c.relname IN ('session', 'part', 'event', 'alarm', 'quantity') ORDER BY 1";
    println!(
        "table: rows here | bytes a row, of its indexes || {MANY} machines: rows a day | GB a day, of indexes | GB a year"
    );
    for line in server.sql(sizes).lines() {
        let fields: Vec<&str> = line.split('|').collect();
        let [table, rows, bytes, indexes] = fields[..] else {
            return Err(format!("unexpected: {line}").into());
        };
        let (rows, bytes, indexes): (f64, f64, f64) =
            (rows.parse()?, bytes.parse()?, indexes.parse()?);
        // a machine begins a session a week
        let a_day = rows / machine_days * MANY;
        let gigabytes = |bytes: f64| bytes / rows * a_day / 1e9;
        println!(
            "{table}: {rows} | {:.0} {:.0} || {a_day:.0} | {:.3} {:.3} | {:.1}",
            bytes / rows,
            indexes / rows,
            gigabytes(bytes),
            gigabytes(indexes),
            365.0 * gigabytes(bytes + indexes)
        );
    }
    Ok(())
}

/// Records a session in daily parts with a row of quantities a minute; returns its number of frames.
fn record(folder: &Path, days: u64, period: u64) -> Result<u64, Fault> {
    let mut rig = Rig::new(Digits::Tenths, 1);
    std::fs::create_dir(folder)?;
    let header = SessionHeader::new("week", at(0), rig.protocol().clone());
    let mut writer = SessionWriter::create(folder, &header)?;
    let a_day = DAY / period;
    for day in 0..days {
        if day > 0 {
            writer.roll(at(day * DAY))?;
        }
        for group in 0..a_day.div_ceil(64) {
            let numbers =
                day * a_day + 64 * group + 1..=day * a_day + (64 * (group + 1)).min(a_day);
            let frames: Vec<_> = numbers.map(|number| rig.frame(number)).collect();
            writer.append_all(frames.iter().map(|frame| (frame, None)))?;
        }
        for number in 0..EVENTS_A_DAY {
            let (kind, text) = match number % 5 {
                0 => ("alarm-active", "heel: ppi is 9.1 kPa, above 8 kPa"),
                _ => ("note", "the rig was cleaned and the sheet was looked at"),
            };
            writer.event(at(day * DAY + 3600 * number), kind, text)?;
        }
    }
    writer.close(at(days * DAY), "asked to stop")?;
    for minute in 0..days * DAY / 60 {
        minute_of(folder, minute)?;
    }
    Ok(days * a_day)
}

/// A row of twelve quantities.
fn minute_of(folder: &Path, minute: u64) -> Result<(), Fault> {
    let values: Vec<String> = (0..12)
        .map(|number| {
            format!(
                "\"q{number}\":[{}.25,{}.5,{}.75,6,6]",
                minute % 7,
                minute % 11,
                minute % 13
            )
        })
        .collect();
    let begin = 1_800_000_000 + 60 * minute;
    let json = format!(
        "{{\"begin_s\":{begin},\"of\":\"kpa\",\"regions\":[{{\"name\":\"sheet\",\"values\":{{{}}}}}]}}",
        values.join(",")
    );
    Ok(append_quantities(folder, "week", &json)?)
}

/// Creates sites, roles, and a record and a configuration for each machine.
fn prepare(
    server: &Server,
    folder: &Path,
    template: &Path,
    machines: usize,
) -> Result<Vec<PathBuf>, Fault> {
    use std::os::unix::fs::PermissionsExt;
    let password = folder.join("password");
    std::fs::write(&password, PASSWORD)?;
    std::fs::set_permissions(&password, std::fs::Permissions::from_mode(0o600))?;
    let config = |name: &str,
                  site: &str,
                  daq: &str,
                  role: &str,
                  record: &str|
     -> Result<PathBuf, Fault> {
        let path = folder.join(format!("{name}.toml"));
        let text = format!(
            "[record]\ndirectory = \"{record}\"\n[archive]\nsite = \"{site}\"\ndaq = \"{daq}\"\nstore = \"store\"\n\
             dsn = \"host={} port={} dbname={DATABASE} user={role}\"\npassword_file = \"password\"\nevery_s = 1.0\n",
            server.socket().display(),
            server.port()
        );
        std::fs::write(&path, text)?;
        Ok(path)
    };
    let owner = config("owner", "owner", "owner", OWNER, "none")?;
    done(program(&owner, &["migrate"]))?;
    for site in 0..SITES {
        let name = format!("site{site}");
        server.add_role(&name);
        done(program(&owner, &["add-site", &name, "--role", &name]))?;
    }
    let mut configs = Vec::new();
    for machine in 0..machines {
        let record = folder.join(machine.to_string());
        std::fs::create_dir(&record)?;
        for entry in std::fs::read_dir(template)? {
            let path = entry?.path();
            let to = record.join(path.file_name().unwrap_or_default());
            match path.extension().is_some_and(|end| end == "tactus") {
                true => std::fs::hard_link(&path, to)?,
                false => drop(std::fs::copy(&path, to)?),
            }
        }
        let site = format!("site{}", machine % SITES);
        let (name, daq) = (machine.to_string(), format!("m{machine}"));
        configs.push(config(&name, &site, &daq, &site, &name)?);
    }
    Ok(configs)
}

fn program(config: &Path, words: &[&str]) -> Command {
    let mut command = Command::new(std::env::current_exe().unwrap_or_default());
    command
        .arg(PROGRAM)
        .args(words)
        .arg("--config")
        .arg(config)
        .stdout(Stdio::null());
    command
}

fn done(mut command: Command) -> Result<(), Fault> {
    match command.status()?.success() {
        true => Ok(()),
        false => Err(format!("{command:?} failed").into()),
    }
}

fn push_all(configs: &[PathBuf]) -> Result<(), Fault> {
    let waiting = Mutex::new(configs.iter());
    let worker = || -> Result<(), String> {
        loop {
            let next = waiting.lock().map_err(|fault| fault.to_string())?.next();
            let Some(config) = next else {
                return Ok(());
            };
            done(program(config, &["push"])).map_err(|fault| fault.to_string())?;
        }
    };
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..WORKERS).map(|_| scope.spawn(worker)).collect();
        for worker in workers {
            worker.join().map_err(|_| "a worker ended")??;
        }
        Ok(())
    })
}

/// Processor time, s, and largest memory, bytes, of a running process.
fn used(child: &Child) -> Result<(f64, u64), Fault> {
    let of = |file: &str| std::fs::read_to_string(format!("/proc/{}/{file}", child.id()));
    let stat = of("stat")?;
    let (_, fields) = stat.rsplit_once(") ").ok_or("no fields")?;
    // user and system time, in hundredths of a second
    let ticks: u64 = fields
        .split(' ')
        .skip(11)
        .take(2)
        .filter_map(|field| field.parse::<u64>().ok())
        .sum();
    let status = of("status")?;
    let peak = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))
        .ok_or("no VmHWM")?;
    let kilobytes: u64 = peak.trim().trim_end_matches(" kB").parse()?;
    Ok((ticks as f64 / 100.0, 1024 * kilobytes))
}

/// Measures the service on one machine whose record grows by a row of quantities between two passes.
fn one_machine(config: &Path, record: &Path, days: u64) -> Result<(), Fault> {
    let mut service = program(config, &["run"]).spawn()?;
    std::thread::sleep(Duration::from_secs(5));
    let (begin, _) = used(&service)?;
    for pass in 0..PASSES {
        minute_of(record, days * DAY / 60 + pass)?;
        std::thread::sleep(Duration::from_secs(1));
    }
    let (end, peak) = used(&service)?;
    service.kill()?;
    service.wait()?;
    let a_pass = (end - begin) / PASSES as f64;
    println!(
        "one machine: {:.1} ms of processor time a pass, with a pass each minute {:.3} % of a core; {:.1} MB at most",
        1e3 * a_pass,
        100.0 * a_pass / 60.0,
        peak as f64 / 1e6
    );
    Ok(())
}
