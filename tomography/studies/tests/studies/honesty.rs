//! The quality check reports nothing on healthy frames, and names faults. Frames are simulated on a finer mesh than the
//! model's.

use studies::honesty::{self, MapMethod, MapSettings, QualityRow, Settings, Stated, TargetKind};

fn rows(noise_uv: f64) -> Vec<QualityRow> {
    let settings = Settings {
        seed: 5,
        healthy: 60,
        faulty: 6,
        noises_uv: vec![noise_uv],
        maps: None,
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
        // allowed reasons: a linear map fails for strong wide loads, a load over an electrode looks like its contact,
        // and a load may be outside of the region
        let blamed = row.reasons.keys().filter(|kind| match kind.as_str() {
            "loss_above_one" | "outside_region" => false,
            "at_electrode" => !row.what.contains("electrode"),
            _ => true,
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
            maps: None,
        };
        pool.install(|| honesty::run(&settings).unwrap().text())
    };
    assert_eq!(settings(1), settings(4));
}

/// Maps with the true noise stated are as accurate as those without, and more accurate than those with one
/// hyper-parameter for all frames.
#[test]
fn a_stated_noise_does_not_harm() {
    let settings = Settings {
        seed: 5,
        healthy: 0,
        faulty: 0,
        noises_uv: vec![20.0],
        maps: Some(MapSettings {
            count: 8,
            kinds: vec![TargetKind::Press30, TargetKind::Ring],
            methods: vec![
                MapMethod::OneStep,
                MapMethod::OneStepLossOnly,
                MapMethod::Tv,
            ],
            unstated: true,
        }),
    };
    let report = honesty::run(&settings).unwrap();
    println!("{}", report.text());
    // 3 methods, 3 sets of loads (two kinds, and both together), 3 statements of the noise
    assert_eq!(report.maps.len(), 27);
    for rows in report.maps.chunks(3) {
        let [stated, nothing, alone] = rows else {
            unreachable!("chunks of three")
        };
        assert_eq!(
            [stated.stated, nothing.stated, alone.stated],
            [Stated::Noise, Stated::Nothing, Stated::NoiseAlone]
        );
        let allowed = f64::max(0.01, 2.0 * stated.error);
        assert!(
            stated.mean > nothing.mean - allowed,
            "{stated:?} {nothing:?}"
        );
        if stated.method != MapMethod::Tv {
            assert!(stated.mean > alone.mean, "{stated:?} {alone:?}");
        }
        assert!(stated.mean > 0.5, "{stated:?}");
    }
}
