//! `tactus-lab tradeoff` and `advise`: reuse of tables, drawing, and advice.

use crate::program::{done, lab, words};

fn message(output: &std::process::Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn table_is_made_once_drawn_and_used_for_advice() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("tradeoff");
    let line = "tradeoff --quick --only acquisition --only uncertainty --out {}";
    done(&words(line, &[&out]));
    for file in [
        "acquisition.json",
        "acquisition.png",
        "acquisition.svg",
        "uncertainty.json",
    ] {
        assert!(out.join(file).is_file(), "{file}");
    }
    // coverage: fractions of the accepted fits whose region contains the truth, next to the stated probabilities
    let coverage: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("uncertainty.json")).unwrap()).unwrap();
    let points = coverage["points"].as_array().unwrap();
    assert!(out.join("uncertainty-month.png").is_file());
    for approach in ["projection", "evidence", "tracker"] {
        let of = |point: &&serde_json::Value| {
            let line = point["line"].as_str().unwrap();
            line.starts_with(approach) && point["time"] == 0.99
        };
        let shares: Vec<f64> = points
            .iter()
            .filter(of)
            .map(|point| point["error"].as_f64().unwrap())
            .collect();
        assert!(
            shares.len() == 2 && shares.iter().all(|share| *share > 0.6),
            "{approach}: {shares:?}"
        );
    }
    let table = out.join("acquisition.json");
    let value: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(&table).unwrap()).unwrap();
    let points = value["points"].as_array().unwrap();
    assert!(points.len() >= 8);
    for point in points {
        // no unbiased method beats the bound; the bias of the one-step method is too small here to matter
        let (error, bound) = (
            point["error"].as_f64().unwrap(),
            point["also"]["bound, mm"].as_f64().unwrap(),
        );
        assert!(error > 0.5 * bound && bound > 0.0, "{point}");
    }
    assert!(points.iter().any(|point| point["front"] == true));

    // the table is reused: a manual change in it is kept
    let marked =
        std::fs::read_to_string(&table)
            .unwrap()
            .replacen("34924A pairs, reed", "by hand", 1);
    std::fs::write(&table, &marked).unwrap();
    let again = lab(&words(&format!("{line} --json"), &[&out]));
    assert!(again.status.success(), "{}", message(&again));
    assert!(String::from_utf8_lossy(&again.stdout).contains("by hand"));
    // with another seed the table is computed again
    done(&words(&format!("{line} --seed 2"), &[&out]));
    assert!(!std::fs::read_to_string(&table).unwrap().contains("by hand"));

    let requested = lab(&words(
        "advise --error-mm 3 --max-seconds 20 --electrodes 26 --json --table {}",
        &[&table],
    ));
    assert!(requested.status.success(), "{}", message(&requested));
    let advice: serde_json::Value = serde_json::from_slice(&requested.stdout).unwrap();
    assert!(advice["error"].as_f64().unwrap() <= 3.0 && advice["time"].as_f64().unwrap() <= 20.0);
    assert_eq!(advice["also"]["electrodes"], 26.0);
    // a table without bound and noise
    let mut bare: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(&table).unwrap()).unwrap();
    for point in bare["points"].as_array_mut().unwrap() {
        let also = point["also"].as_object_mut().unwrap();
        also.retain(|name, _| !(name.starts_with("bound") || name.starts_with("noise")));
    }
    let other = out.join("bare.json");
    std::fs::write(&other, bare.to_string()).unwrap();
    let advice = lab(&words(
        "advise --error-mm 3 --max-seconds 20 --electrodes 26 --table {}",
        &[&other],
    ));
    let text = String::from_utf8_lossy(&advice.stdout);
    assert_eq!(text.matches("not known").count(), 2, "{text}");
    assert!(!text.contains("NaN"), "{text}");
    let too_much = lab(&words(
        "advise --error-mm 1e-6 --max-seconds 0.001 --table {}",
        &[&table],
    ));
    assert_eq!(too_much.status.code(), Some(1));
    assert!(
        message(&too_much).contains("No setting of the table is good enough"),
        "{}",
        message(&too_much)
    );
    let nonsense = lab(&words("advise --error-mm -1 --max-seconds 1", &[]));
    assert_eq!(nonsense.status.code(), Some(2));

    std::fs::write(&table, "{\"panel\": ").unwrap();
    let damaged = lab(&words(&format!("{line} --seed 2"), &[&out]));
    assert!(!damaged.status.success());
    assert!(
        message(&damaged).contains("acquisition.json is damaged"),
        "{}",
        message(&damaged)
    );
}
