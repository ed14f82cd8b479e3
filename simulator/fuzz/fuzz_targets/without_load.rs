//! The target rig: instruments without load in instant time, one rig for all inputs of a thread.

use std::cell::OnceCell;

use simulator::{LoadNetwork, Pace, Profile, Scene, SimulatedRig};
use tokio::runtime::Runtime;

pub struct RigWithoutLoad {
    pub runtime: Runtime,
    pub rig: SimulatedRig,
}

thread_local! {
    pub static RIG: OnceCell<RigWithoutLoad> = const { OnceCell::new() };
}

pub fn rig_without_load() -> RigWithoutLoad {
    let mut builder = tokio::runtime::Builder::new_current_thread();
    let runtime = builder
        .enable_time()
        .start_paused(true)
        .build()
        .expect("a runtime");
    let profile = Profile {
        load: LoadNetwork::Nothing,
        ..Profile::default().at_pace(Pace::Instant)
    };
    let rig = {
        let _inside = runtime.enter();
        // the sheet is not connected to anything: a coarse mesh is faster to make
        let scene = Scene::parse("coarse", "[mesh]\nfineness = 0.25\n").expect("a scene");
        SimulatedRig::new(&profile, scene).expect("an empty rig_without_load")
    };
    RigWithoutLoad { runtime, rig }
}
