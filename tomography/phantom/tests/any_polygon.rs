//! Any polygon of a scene is either refused with its name or covers the expected part of the sheet.

use std::time::Duration;

use phantom::{Load, LoadError, Phantom, PhantomError, Scene, Shape};
use proptest::prelude::*;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]
    #[test]
    fn any_polygon(points in prop::collection::vec([-60.0..60.0_f64, -60.0..60.0_f64], 0..9), loss in 0.01..1.0_f64) {
        // the tank has no holes, so a polygon inside of it is covered completely
        let text = "[disc-tank]\nradius_mm = 100\n[mesh]\nfineness = 0.3";
        let mut phantom = Phantom::new(Scene::parse("tank.toml", text).unwrap()).unwrap();
        let load = Load {
            shape: Shape::Polygon { points_mm: points },
            ..Load::disc([5.0, -3.0], 1.0, loss)
        };
        let sheet = phantom.scene().sheet.conductance();
        match phantom.press(load.clone()) {
            Err(PhantomError::Load(LoadError::Corners { .. } | LoadError::Crossing { .. })) => {}
            Err(other) => prop_assert!(false, "{other:?}"),
            Ok(()) => {
                let lost: f64 = phantom
                    .conductance(Duration::ZERO)
                    .iter()
                    .enumerate()
                    .map(|(t, sigma)| (1.0 - sigma / sheet) * phantom.mesh().area(t))
                    .sum();
                let wanted = load.loss * load.shape.area();
                prop_assert!((lost - wanted).abs() < 1e-9 * 0.01, "{lost} against {wanted}");
            }
        }
    }
}
