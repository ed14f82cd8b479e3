//! The rig accepts the same scenes as `tactus-lab`, by name and by file.

use simulator::{Pace, Profile, Scene, SimulatedRig};

#[tokio::test]
async fn every_shipped_scene_starts_on_the_rig_with_its_faults() {
    let profile = Profile::default().at_pace(Pace::Instant);
    for (name, _) in Scene::shipped() {
        let scene = Scene::open(name).unwrap_or_else(|fault| panic!("{fault}"));
        let coarse = Scene {
            sheet: scene.sheet.clone().remeshed(0.2, 0),
            ..scene.clone()
        };
        let rig =
            SimulatedRig::new(&profile, coarse).unwrap_or_else(|fault| panic!("{name}: {fault}"));
        let effects = rig.with_phantom(|phantom| phantom.scene().effects.clone());
        assert_eq!(effects, scene.effects, "{name}");
    }
}

#[test]
fn a_file_is_the_scene_of_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mine.toml");
    for (name, text) in Scene::shipped() {
        std::fs::write(&path, text).unwrap();
        let read = Scene::open(path.to_str().unwrap()).unwrap();
        let known = Scene::open(name).unwrap();
        // Faults contain the name of their file.
        assert_eq!((&read.loads, &read.effects), (&known.loads, &known.effects));
        assert_eq!(read.faults.len(), known.faults.len());
    }
}
