//! A panic anywhere in the daemon is heard, and answered by switching the source off.
//!
//! Acquisition sees to its own panics; whatever else fails (the recorder, a call from the bus) ends the session that
//! runs, and the source is verified off at once, not at the end of the frame.

use std::sync::{Arc, LazyLock, Once};

use tokio::sync::watch;

use crate::keeper::Keeper;

static HEARD: LazyLock<watch::Sender<String>> = LazyLock::new(watch::Sender::default);
static INSTALLED: Once = Once::new();

/// Installs the hook, before the one that prints.
pub(crate) fn install() {
    INSTALLED.call_once(|| {
        let prints = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            let place = panic
                .location()
                .map_or_else(|| "nowhere".to_owned(), ToString::to_string);
            HEARD.send_replace(place);
            prints(panic);
        }));
    });
}

/// Hears of panics from now on.
pub(crate) fn listen() -> watch::Receiver<String> {
    HEARD.subscribe()
}

/// Answers every panic, as long as the daemon lives.
pub(crate) async fn keep(keeper: Arc<Keeper>, mut heard: watch::Receiver<String>) {
    while heard.changed().await.is_ok() {
        let place = heard.borrow_and_update().clone();
        let why = format!("a fault of the daemon's own code ({place}); please report it");
        if let Some(live) = keeper.active() {
            live.fail(&why);
            live.ended().await;
        }
        match keeper.make_safe().await {
            Ok(()) => {
                let text =
                    format!("the source is off and the relays are open, verified, after {why}");
                keeper.tell(None, "fault", &text).await;
            }
            Err(error) => {
                let text = format!("after {why}: {error}");
                keeper.tell(None, "alarm", &text).await;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use bus::Options;
    use rig::{SystemClock, Tape};

    use super::*;
    use crate::prepare::{FramesFrom, prepare};
    use crate::rig_assembly::{Closed, assemble};

    const CONFIG: &str = "[rig]\nkind = \"simulated\"\n[geometry]\npreset = \"disc-tank\"\n[geometry.disc-tank]\n\
                          electrodes = 16\n[survey]\nelectrodes = 16\n[record]\ndirectory = \"state\"\n[bus]\n\
                          peer_path = \"peer\"\n";

    #[tokio::test(flavor = "multi_thread")]
    async fn a_panic_on_any_thread_ends_the_session_and_the_source_is_off() {
        install();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.toml");
        // in real time a frame of this lasts seconds: the panic comes in the middle of it
        std::fs::write(
            folder.path().join("scene.toml"),
            "[disc-tank]\nelectrodes = 16\n",
        )
        .unwrap();
        let scene = "kind = \"simulated\"\nscene = \"scene.toml\"";
        std::fs::write(&path, CONFIG.replace("kind = \"simulated\"", scene)).unwrap();
        let prepared = prepare(&path).unwrap_or_else(|problems| panic!("{problems:?}"));
        let bench = crate::bench_of(&prepared).unwrap();
        let tape = Tape::new(2);
        let FramesFrom::Rig(plan) = &prepared.frames else {
            panic!("it is a rig");
        };
        let assembled = assemble(plan, &bench, &tape, Closed::Refuse, None)
            .await
            .unwrap();
        let sheet = bench.clone().unwrap();
        let keeper = Keeper::new(prepared, bench, Some(assembled), tape, SystemClock::new());
        tokio::spawn(keep(Arc::clone(&keeper), listen()));
        let within = |future| tokio::time::timeout(Duration::from_secs(120), future);

        let options = Options::new().with("frames", 100_u64);
        let live = keeper.record_baseline(&options).await.unwrap();
        while !sheet.source_output().0 {
            tokio::task::yield_now().await;
        }
        std::thread::spawn(|| panic!("a test of the guard"))
            .join()
            .unwrap_err();
        let ending = within(live.ended()).await.unwrap();
        assert!(
            ending.faulted && ending.reason.contains("guard.rs"),
            "{ending:?}"
        );
        assert!(!sheet.source_output().0);
        assert_eq!(keeper.state().word(), "faulted");
    }
}
