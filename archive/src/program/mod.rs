//! The commands of `tactus-archive`.

mod failure;
mod output;
mod service;

use std::ffi::OsString;
use std::path::Path;
use std::process::ExitCode;

use clap::CommandFactory;
use tokio::runtime::Runtime;

use crate::args::{AddSite, Arguments, Command, Filter, Pull, Task};
use crate::catalogue::Catalogue;
use crate::reader;
use crate::retrieval::{self, Holding};
use crate::settings::Settings;
use crate::store::name_fault;
use crate::upload::{Status, Step, Uploader};

pub use failure::Failure;
use output::Printer;

/// The definition of the command line: every command and option, for reference pages and completions.
pub fn command() -> clap::Command {
    help_examples::with_examples(Arguments::command(), include_str!("../examples.txt"))
}

/// Runs the program; `words` are the arguments, starting with the program's name.
pub fn run(words: impl IntoIterator<Item = OsString>) -> ExitCode {
    let words: Vec<OsString> = words.into_iter().collect();
    let json = survey::asks_for_json(&words);
    let refused = |text| Failure::Usage(text).report(json);
    let parsed = help_examples::parsed::<Arguments>(&command(), &words, json, refused);
    let arguments = match parsed {
        Ok((_, arguments)) => arguments,
        Err(code) => return code,
    };
    let done = runtime().and_then(|runtime| runtime.block_on(perform(&arguments)));
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(json),
    }
}

async fn perform(arguments: &Arguments) -> Result<(), Failure> {
    let config = &arguments.config;
    let settings = match &arguments.command {
        Command::Task(task) => read_settings(config, task)?,
        _ => Settings::read(config)?,
    };
    let mut printer = Printer::new(arguments.json);
    match &arguments.command {
        Command::Task(task) => carry_out(&settings, task, &mut printer).await,
        Command::Run => service::run(&settings, &mut printer).await,
        Command::Migrate => migrate(&settings, &mut printer).await,
        Command::AddSite(requested) => add_site(&settings, requested).await,
    }
}

/// Runs a task for another program; prints on standard output.
///
/// # Errors
/// Those of the commands of `tactus-archive`.
pub fn perform_task(config: &Path, json: bool, task: &Task) -> Result<(), Failure> {
    let runtime = runtime()?;
    let settings = read_settings(config, task)?;
    runtime.block_on(carry_out(&settings, task, &mut Printer::new(json)))
}

fn runtime() -> Result<Runtime, Failure> {
    crate::runtime::runtime().map_err(|error| Failure::Failed(error.to_string()))
}

/// Requires a site only for tasks that concern the record of this machine.
fn read_settings(config: &Path, task: &Task) -> Result<Settings, Failure> {
    Ok(match task {
        Task::Push | Task::Status => Settings::read(config)?,
        Task::Pull(_) | Task::Verify(_) => Settings::read_for_reader(config)?,
    })
}

async fn carry_out(settings: &Settings, task: &Task, printer: &mut Printer) -> Result<(), Failure> {
    match task {
        Task::Push => push(settings, printer).await,
        Task::Status => status(settings, printer).await,
        Task::Pull(requested) => pull(settings, requested, printer).await,
        Task::Verify(filter) => verify(settings, filter, printer).await,
    }
}

async fn push(settings: &Settings, printer: &mut Printer) -> Result<(), Failure> {
    let mut catalogue = Catalogue::connect(&settings.access).await?;
    catalogue.check(&settings.owner.site).await?;
    let store = settings.store.open()?;
    let mut uploader = Uploader::new(&settings.record, settings.owner.clone());
    let mut problems = 0;
    let mut refused = Ok(());
    let mut report = |step: Step| {
        problems += usize::from(matches!(step, Step::Problem { .. }));
        let printed = printer.line(&step, output::step);
        if refused.is_ok() {
            refused = printed;
        }
    };
    uploader.pass(&*store, &mut catalogue, &mut report).await?;
    refused?;
    match problems {
        0 => Ok(()),
        count => Err(Failure::Failed(format!(
            "{count} problems: see above; everything else is archived"
        ))),
    }
}

async fn status(settings: &Settings, printer: &mut Printer) -> Result<(), Failure> {
    let catalogue = Catalogue::connect(&settings.access).await?;
    catalogue.check(&settings.owner.site).await?;
    let mut uploader = Uploader::new(&settings.record, settings.owner.clone());
    let mut problems = Vec::new();
    let found: Status = uploader
        .status(&catalogue, &mut |step| problems.push(step))
        .await
        .map_err(Failure::from)?;
    printer.line(&found, output::status)?;
    for problem in &problems {
        printer.line(problem, output::step)?;
    }
    match (found.missing.len(), problems.len()) {
        (0, 0) => Ok(()),
        (0, count) => Err(Failure::Failed(format!("{count} problems: see above"))),
        (count, _) => Err(Failure::Failed(format!(
            "{count} closed parts are not archived; `tactus-archive push` archives them"
        ))),
    }
}

async fn pull(settings: &Settings, requested: &Pull, printer: &mut Printer) -> Result<(), Failure> {
    if !requested.into.is_dir() {
        let folder = requested.into.display();
        return Err(Failure::Usage(format!(
            "--into: {folder} is not a folder: create it first"
        )));
    }
    let catalogue = Catalogue::connect(&settings.access).await?;
    catalogue.check_version().await?;
    let wanted = requested
        .session
        .clone()
        .within(requested.of.site.as_deref(), requested.of.daq.as_deref());
    let session = reader::found(&catalogue, &wanted).await?;
    let parts = catalogue.parts_of(&session).await?;
    let store = settings.store.open()?;
    for part in &parts {
        let path = retrieval::pull(&*store, part, &requested.into)?;
        let line = output::Pulled { part, path };
        printer.line(&line, output::pulled)?;
    }
    Ok(())
}

async fn verify(
    settings: &Settings,
    filter: &Filter,
    printer: &mut Printer,
) -> Result<(), Failure> {
    let catalogue = Catalogue::connect(&settings.access).await?;
    catalogue.check_version().await?;
    let store = settings.store.open()?;
    let (site, daq) = (filter.site.as_deref(), filter.daq.as_deref());
    let parts = catalogue.parts(site, daq, None).await?;
    let mut bad = 0;
    for part in &parts {
        let holding = retrieval::verify(&*store, part)?;
        bad += usize::from(holding != Holding::Intact);
        let line = output::Verified {
            part,
            holding: &holding,
        };
        printer.line(&line, output::verified)?;
    }
    match bad {
        0 => Ok(()),
        bad => Err(Failure::Failed(format!(
            "{bad} of {} parts are damaged or missing in {}: push them again from where they were recorded",
            parts.len(),
            store.place()
        ))),
    }
}

async fn migrate(settings: &Settings, printer: &mut Printer) -> Result<(), Failure> {
    let mut catalogue = Catalogue::connect(&settings.access).await?;
    let migration = catalogue.migrate().await?;
    printer.line(&migration, output::migrated)
}

async fn add_site(settings: &Settings, requested: &AddSite) -> Result<(), Failure> {
    if let Some(fault) = name_fault(&requested.site) {
        return Err(Failure::Usage(format!("SITE: {fault}")));
    }
    let mut catalogue = Catalogue::connect(&settings.access).await?;
    Ok(catalogue.add_site(&requested.site, &requested.role).await?)
}
