//! The check of maps: silent on healthy frames, and faults are found and named. Data from a mesh that is finer than the
//! model's.

use studies::honesty::{self, QualityRow, Settings};

fn rows(noise_uv: f64) -> Vec<QualityRow> {
    let settings = Settings {
        seed: 5,
        healthy: 60,
        faulty: 6,
        noises_uv: vec![noise_uv],
    };
    let report = honesty::run(&settings).unwrap();
    println!("{}", report.text());
    report.quality
}

fn check(noise_uv: f64) {
    let rows = rows(noise_uv);
    let (healthy, faulty): (Vec<_>, Vec<_>) = rows.iter().partition(|row| row.healthy);
    assert_eq!(healthy.iter().map(|row| row.frames).sum::<usize>(), 60);
    for row in healthy {
        // strong wide loads are beyond a linear map, and a load over an electrode looks like its contact
        let blamed = row.reasons.keys().filter(|kind| {
            *kind != "loss_above_one"
                && !(*kind == "at_electrode" && row.what.contains("electrode"))
        });
        assert_eq!(blamed.count(), 0, "{row:?}");
    }
    assert_eq!(faulty.len(), 7);
    for row in faulty {
        assert_eq!((row.frames, row.not_sound), (6, 6), "{row:?}");
        assert!(row.named.is_none_or(|named| named == 6), "{row:?}");
    }
}

#[test]
fn faults_are_found_and_healthy_frames_are_not_blamed_at_2_uv() {
    check(2.0);
}

#[test]
fn faults_are_found_and_healthy_frames_are_not_blamed_at_20_uv() {
    check(20.0);
}

#[test]
fn same_seed_gives_the_same_verdicts() {
    let settings = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let settings = Settings {
            seed: 5,
            healthy: 12,
            faulty: 1,
            noises_uv: vec![2.0],
        };
        pool.install(|| honesty::run(&settings).unwrap().text())
    };
    assert_eq!(settings(1), settings(4));
}
