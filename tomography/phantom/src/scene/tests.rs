use super::*;
use crate::paper;

fn refuse(text: &str) -> String {
    Scene::parse("scene.toml", text).unwrap_err().to_string()
}

#[test]
fn an_empty_text_is_the_quiet_sheet() {
    let scene = Scene::parse("empty.toml", "").unwrap();
    assert_eq!(
        scene,
        Scene {
            name: "unnamed".to_owned(),
            ..Scene::quiet()
        }
    );
}

#[test]
fn the_shipped_scenes_are_the_papers_tests() {
    let [quiet, test1, test2] =
        ["quiet", "paper-test1", "paper-test2"].map(|name| Scene::open(name).unwrap());
    assert_eq!(quiet, Scene::quiet());
    assert_eq!(test1.loads.len(), 16);
    for (timed, centre) in test1.loads.iter().zip(paper::test1_positions()) {
        assert_eq!(timed.load.centre_mm, centre);
        assert_eq!(timed.load.shape, paper::s1(centre).shape);
        assert_eq!(timed.load.loss, 0.5);
    }
    // the loads do not overlap in time
    for pair in test1.loads.windows(2) {
        assert!(pair[0].to.unwrap() <= pair[1].from);
    }
    let month = Scene::open("month").unwrap();
    assert_eq!(month.loads.len(), 1);
    let nights = month.loads[0].repeat.map(Repeat::times);
    assert_eq!(nights, Some(30));
    let last_morning = Duration::from_secs(29 * 86_400 + 72_000);
    assert_eq!(month.loads[0].end(), Some(last_morning));
    assert_eq!(test2.loads.len(), 9);
    let make = [paper::s2, paper::s3, paper::s4];
    for (k, timed) in test2.loads.iter().enumerate() {
        let wanted = make[k / 3](paper::TEST2_MM[k % 3]);
        assert_eq!(timed.load, wanted);
    }
}

#[test]
fn faults_have_a_place() {
    assert!(refuse("seeed = 1").starts_with("scene.toml:1:1: unknown field `seeed`"));
    let text = "[[load]]\nshape = \"disc\"\nx_mm = 1\ny_mm = 2\nloss_percent = 50\n";
    assert_eq!(
        refuse(text),
        "scene.toml:1:1: a load of this shape needs the key `diameter_mm`"
    );
    let text = format!("{text}diameter_mm = 10\nside_mm = 3\n");
    assert!(refuse(&text).starts_with("scene.toml:7:11: key `side_mm` does not belong"));
    assert!(refuse("\n[paper-sheet]\nwidth_cm = 2").starts_with("scene.toml:3:1:"));
    assert!(
        refuse("[effects]\nnoise = 2").starts_with("scene.toml:2:1: there is no effect `noise`")
    );
    assert_eq!(
        refuse("[effects.voltmeter-noise]\nuv = -2"),
        "scene.toml:2:6: effects.voltmeter-noise.uv is -2 uV, it must be 0 to 1000000 uV"
    );
    assert!(refuse("seed = \"x\"").starts_with("scene.toml:1:8:"));
    assert!(refuse("[paper-sheet]\n[disc-tank]\n").contains("not both"));
    assert!(refuse("[[fault]]\nat_s = -1\nwhat = \"x\"").starts_with("scene.toml:2:8: at_s is -1"));
    assert!(refuse("[[fault]]\nat_s = 1").starts_with("scene.toml:1:1: missing field"));
    let scene = Scene::parse("s.toml", "[[fault]]\nat_s = 1\nwhat = \"lost 6221\"").unwrap();
    assert_eq!(scene.faults[0].place, "s.toml:3:8");
    assert!(refuse("[mesh]\nfineness = 0").contains("mesh.fineness"));
    let timed = |from: f64, to: f64| {
        format!(
            "[[load]]\nshape = \"disc\"\ndiameter_mm = 10\nx_mm = 50\ny_mm = 50\nloss_percent = 50\nfrom_s = {from}\nto_s = {to}"
        )
    };
    assert!(refuse(&timed(5.0, 5.0)).starts_with("scene.toml:8:8: to_s must be later"));
    assert!(refuse(&timed(-1.0, 5.0)).starts_with("scene.toml:7:10: from_s is -1"));
}
