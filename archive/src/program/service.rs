//! The service: runs one pass after the other.

use std::time::Duration;

use survey::error_chain;

use super::failure::Failure;
use super::output::{self, Printer};
use crate::catalogue::Catalogue;
use crate::live;
use crate::settings::Settings;
use crate::store::Store;
use crate::upload::{Step, UploadError, Uploader};

/// Longest wait after failures.
const LONGEST: Duration = Duration::from_secs(600);
/// Number of passes after which problems of parts are reported again.
const AGAIN: u32 = 60;

/// Runs passes until the process is ended, which is safe at any time. Returns only if the configuration is wrong.
pub(super) async fn run(settings: &Settings, printer: &mut Printer) -> Result<(), Failure> {
    let store = settings.store.open()?;
    if let Some(live) = settings.live.clone() {
        live::start(live).map_err(Failure::Configuration)?;
    }
    let mut uploader = Uploader::new(&settings.record, settings.owner.clone());
    let mut catalogue = None;
    let mut reported: Vec<Step> = Vec::new();
    let (mut failures, mut passes) = (0_u32, 0_u32);
    loop {
        if passes.is_multiple_of(AGAIN) {
            reported.clear();
        }
        passes = passes.wrapping_add(1);
        let outcome = pass(
            settings,
            &*store,
            &mut uploader,
            &mut catalogue,
            &mut |step| {
                let known = matches!(step, Step::Problem { .. }) && reported.contains(&step);
                if !known {
                    // a service continues without its output
                    let _ = printer.line(&step, output::step);
                    if matches!(step, Step::Problem { .. }) {
                        reported.push(step);
                    }
                }
            },
        )
        .await;
        let wait = match outcome {
            Ok(()) => {
                failures = 0;
                settings.every
            }
            Err(error) => {
                // the connection may be in the middle of a transaction
                catalogue = None;
                let text = error_chain(&error);
                let failure = Failure::from(error);
                if let Failure::Configuration(_) = failure {
                    return Err(failure);
                }
                failures += 1;
                let wait = backed_off(settings.every, failures);
                eprintln!(
                    "tactus-archive: {}; again in {} s",
                    survey::printable_lines(&text),
                    wait.as_secs()
                );
                wait
            }
        };
        tokio::time::sleep(wait).await;
    }
}

async fn pass(
    settings: &Settings,
    store: &dyn Store,
    uploader: &mut Uploader,
    connected: &mut Option<Catalogue>,
    report: &mut dyn FnMut(Step),
) -> Result<(), UploadError> {
    let catalogue = match connected {
        Some(catalogue) => catalogue,
        None => {
            let catalogue = Catalogue::connect(&settings.access).await?;
            catalogue.check(&settings.owner.site).await?;
            connected.insert(catalogue)
        }
    };
    uploader.pass(store, catalogue, report).await
}

/// The wait after this many failures in a row: doubled each time, up to ten minutes.
fn backed_off(every: Duration, failures: u32) -> Duration {
    let doubled = every.saturating_mul(1 << failures.saturating_sub(1).min(16));
    doubled.min(LONGEST.max(every))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wait_doubles_up_to_ten_minutes() {
        let waits = [1, 2, 3, 4, 5, 99]
            .map(|failures| backed_off(Duration::from_secs(60), failures).as_secs());
        assert_eq!(waits, [60, 120, 240, 480, 600, 600]);
        assert_eq!(backed_off(Duration::from_secs(3600), 5).as_secs(), 3600);
    }
}
