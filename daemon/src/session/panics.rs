//! A panic anywhere in the daemon switches the source off.
//!
//! Acquisition handles its own panics. Any other panic (of the recorder, of an acting call) ends the running session,
//! and the source is verified off immediately, not at the end of the frame. If the daemon's main task panics, the
//! instruments are switched off over new connections ([`crate::instruments::last_resort`]). A panic of a task that only
//! replies to a client ends only that reply ([`crate::panics::containment`]).

use std::sync::Arc;

use crate::events::kind::EventKind;
use tokio::sync::watch;

use crate::session::controller::Controller;

/// Ends the session and makes the rig safe after every panic that is not contained.
pub(crate) async fn follow_panics(
    controller: Arc<Controller>,
    mut received: watch::Receiver<String>,
) {
    while received.changed().await.is_ok() {
        let place = received.borrow_and_update().clone();
        let why = format!("a fault of the daemon's own code ({place}); please report it");
        controller.no_session_begins().await;
        if let Some(status) = controller.active() {
            status.fail(&why);
            status.ended().await;
        }
        match controller.make_safe().await {
            Ok(()) => {
                let text =
                    format!("the source is off and the relays are open, verified, after {why}");
                controller.report(None, EventKind::Fault, &text).await;
            }
            Err(error) => {
                let text = format!("after {why}: {error}");
                controller.report(None, EventKind::Alarm, &text).await;
            }
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::path::Path;
    use std::time::{Duration, Instant};

    use dbus::Options;
    use rig::{RingTranscript, Stop, SystemClock};
    use simulator::{Instrument, Pace, Profile, Scene, ServeOptions, SimulatedRig};
    use tokio::runtime::Builder;

    use crate::instruments::assembly::{OnClosedRelays, assemble};
    use crate::instruments::last_resort;
    use crate::panics::hook::{install, listen};
    use crate::preparation::{FramesFrom, prepare};
    use crate::recording::records::Records;
    use crate::session::panics::*;

    pub(crate) const DEADLINE: Duration = Duration::from_secs(120);
    /// Accepted time until the source is off. 100 ms are promised, but a busy machine takes a multiple; the tests print
    /// the time.
    const BUSY: Duration = Duration::from_secs(5);
    /// Locked by each test that panics: a process has one panic hook, and a panic must not reach the handler of another
    /// test.
    static ALONE: tokio::sync::Mutex<()> = tokio::sync::Mutex::const_new(());

    /// While this is held, no other test panics or waits for a panic.
    pub(crate) async fn alone() -> tokio::sync::MutexGuard<'static, ()> {
        ALONE.lock().await
    }

    pub(crate) async fn current_flows(sheet: &SimulatedRig) {
        let flows = async {
            while !sheet.source_output().0 {
                tokio::task::yield_now().await;
            }
        };
        tokio::time::timeout(DEADLINE, flows)
            .await
            .expect("a frame has begun");
    }

    const CONFIG: &str = "[rig]\nkind = \"simulated\"\n[geometry]\npreset = \"disc-tank\"\n[geometry.disc-tank]\n\
                          electrodes = 16\n[survey]\nelectrodes = 16\n[record]\ndirectory = \"state\"\n[bus]\n\
                          peer_path = \"peer\"\n";

    /// A controller of a simulated rig in real time. A frame lasts seconds, so that a panic occurs during a frame.
    pub(crate) async fn in_real_time(folder: &Path) -> (Arc<Controller>, SimulatedRig) {
        std::fs::write(folder.join("scene.toml"), "[disc-tank]\nelectrodes = 16\n").unwrap();
        let scene = "kind = \"simulated\"\nscene = \"scene.toml\"";
        let path = folder.join("config.toml");
        std::fs::write(&path, CONFIG.replace("kind = \"simulated\"", scene)).unwrap();
        let prepared = prepare(&path).unwrap_or_else(|problems| panic!("{problems:?}"));
        let simulated_rig = prepared.simulated_rig().unwrap();
        let records = Records::of(&prepared.setup.record_directory);
        let transcript = RingTranscript::new(2);
        let FramesFrom::Rig(plan) = &prepared.frames else {
            panic!("it is a rig");
        };
        let assembled = assemble(
            plan,
            &simulated_rig,
            &transcript,
            OnClosedRelays::Refuse,
            None,
        )
        .await
        .unwrap();
        let sheet = simulated_rig.clone().unwrap();
        let clock = SystemClock::new();
        let controller = Controller::new(
            prepared,
            simulated_rig,
            Some(assembled),
            records,
            transcript,
            clock,
        );
        (controller, sheet)
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_panic_on_any_thread_ends_the_session_and_the_source_is_off() {
        let _alone = ALONE.lock().await;
        install();
        let folder = tempfile::tempdir().unwrap();
        let (controller, sheet) = in_real_time(folder.path()).await;
        tokio::spawn(follow_panics(Arc::clone(&controller), listen()));
        let within = |future| tokio::time::timeout(DEADLINE, future);

        let options = Options::new().with("frames", 100_u64);
        let status = controller.record_baseline(&options).await.unwrap();
        current_flows(&sheet).await;
        std::thread::spawn(|| panic!("a test of the panic handler"))
            .join()
            .unwrap_err();
        let panicked = Instant::now();
        let off = async {
            while sheet.source_output().0 {
                tokio::task::yield_now().await;
            }
            panicked.elapsed()
        };
        let took = tokio::time::timeout(DEADLINE, off).await.unwrap();
        println!(
            "source off {:.1} ms after a panic",
            1e3 * took.as_secs_f64()
        );
        assert!(took < BUSY, "{took:?}");
        let end = within(status.ended()).await.unwrap();
        assert!(end.faulted && end.reason.contains(file!()), "{end:?}");
        assert!(!sheet.source_output().0);
        assert_eq!(controller.state().word(), "faulted");
    }

    /// A frame is being measured on instruments on TCP when the daemon's main task panics.
    #[test]
    fn failed_controller_leaves_the_source_off() {
        let _alone = ALONE.blocking_lock();
        let folder = tempfile::tempdir().unwrap();
        let others = Builder::new_multi_thread().enable_all().build().unwrap();
        let profile = Profile::load("pairs-34924a").unwrap();
        let scene = Scene::parse("scene", "[disc-tank]\nelectrodes = 16\n").unwrap();
        // in real time, with readings of 2 power-line cycles, a frame lasts seconds
        let sheet = SimulatedRig::new(&profile.at_pace(Pace::Real), scene).unwrap();
        let options = ServeOptions {
            port_6221: 0,
            port_34980a: 0,
            ..ServeOptions::default()
        };
        let server = others
            .block_on(simulator::serve(sheet.clone(), &options))
            .unwrap();
        let (source, mainframe) = (&server.ready().source, &server.ready().mainframe);
        let config = CONFIG
            .replace("\"simulated\"", "\"instruments\"")
            .replace("[survey]\n", "[survey]\nnplc = 2\n")
            + &format!(
                "[source]\naddress = \"tcp:{source}\"\n[switch]\naddress = \"tcp:{mainframe}\"\n"
            );
        let path = folder.path().join("config.toml");
        std::fs::write(&path, config).unwrap();
        let prepared = prepare(&path).unwrap_or_else(|problems| panic!("{problems:?}"));
        let FramesFrom::Rig(plan) = &prepared.frames else {
            panic!("it is a rig");
        };

        let mut failed_at = None;
        let runtime = Builder::new_multi_thread().enable_all().build().unwrap();
        let ended: Option<()> = last_resort::run(runtime, Some(plan), async {
            let assembled = assemble(
                plan,
                &None,
                &RingTranscript::new(2),
                OnClosedRelays::Refuse,
                None,
            )
            .await
            .unwrap();
            let own = Arc::clone(plan);
            tokio::spawn(async move {
                let (clock, not_resumed) = (SystemClock::new(), Stop::never());
                let (plan, meter) = (&own.plan, own.meter);
                rig::acquire(&assembled.rig, plan, meter, clock, &not_resumed).await
            });
            current_flows(&sheet).await;
            sheet.keep_transcript();
            failed_at = Some(Instant::now());
            panic!("a test of the last resort");
        });
        let took = failed_at.unwrap().elapsed();
        println!(
            "off, verified, and relays open over new connections {:.1} ms after the head failed",
            1e3 * took.as_secs_f64()
        );
        assert!(took < BUSY, "{took:?}");
        assert!(ended.is_none());
        assert!(!sheet.source_output().0 && sheet.closed().is_empty());
        let transcript = sheet.transcript();
        let last = |instrument: Instrument| {
            let mut received = transcript
                .iter()
                .filter(|line| line.instrument == instrument);
            received
                .next_back()
                .unwrap_or_else(|| panic!("{transcript:#?}"))
        };
        // the last setting and the query that reads it back are one message
        let off = last(Instrument::Source);
        let states = off.answered.as_deref().unwrap_or_default();
        assert!(
            off.received.contains("CLE") && off.received.contains("OUTP?"),
            "{off:?}"
        );
        assert!(states.contains("0.000000E+00;0"), "{off:?}");
        let open = last(Instrument::Mainframe);
        assert!(
            open.received.contains("OPEN (") && open.received.contains("CLOS? ("),
            "{open:?}"
        );
        let states = open.answered.as_deref().unwrap_or_default();
        assert!(states.starts_with("0,0,0,"), "{open:?}");
        others.block_on(server.stop());
    }
}
