//! What the targets speak to: an empty bench in instant time, one for all inputs of a thread.

use std::cell::OnceCell;

use simulator::{Hanging, Pace, Profile, Scene, SimulatedRig};
use tokio::runtime::Runtime;

pub struct Bench {
    pub runtime: Runtime,
    pub rig: SimulatedRig,
}

thread_local! {
    pub static BENCH: OnceCell<Bench> = const { OnceCell::new() };
}

pub fn bench() -> Bench {
    let mut builder = tokio::runtime::Builder::new_current_thread();
    let runtime = builder.enable_time().start_paused(true).build().expect("a runtime");
    let profile = Profile {
        load: Hanging::Nothing,
        ..Profile::default().at_pace(Pace::Instant)
    };
    let rig = {
        let _inside = runtime.enter();
        // the sheet is not joined to anything here: a coarse one is made sooner
        let scene = Scene::parse("coarse", "[mesh]\nfineness = 0.25\n").expect("a scene");
        SimulatedRig::new(&profile, scene).expect("an empty bench")
    };
    Bench { runtime, rig }
}
