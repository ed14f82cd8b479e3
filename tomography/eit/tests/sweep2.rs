use eit::*;
use std::path::Path;
use std::sync::Arc;
use survey::*;
fn rd(v: &[Option<f64>], s: f64) -> Vec<Reading> {
    v.iter()
        .map(|v| Reading::Ok(Volts(s * v.unwrap())))
        .collect()
}
#[test]
fn sweep() {
    let data = Path::new("/work/shared/data");
    let ktc = DiscTank {
        radius_mm: 115.0,
        electrodes: 16,
        arc_deg: 5.625,
        first_deg: 84.375,
        ..Default::default()
    };
    let mesh = Arc::new(ktc.mesh().unwrap());
    println!("ktc {}", mesh.triangles().len());
    let protocol = Protocol::sheffield(16).unwrap();
    let frames = read_frames(&data.join("ktc2023/adj16_frames.csv"), 208).unwrap();
    let pixel: Vec<Option<usize>> = (0..256 * 256)
        .map(|i| {
            let (r, c) = (i / 256, i % 256);
            let x = ((c as f64 + 0.5) / 128.0 - 1.0) * 0.115;
            let y = (1.0 - (r as f64 + 0.5) / 128.0) * 0.115;
            (0..mesh.triangles().len()).find(|&t| {
                let [a, b, c] = mesh.corners(t);
                let s = |p: [f64; 2], q: [f64; 2]| {
                    (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])
                };
                s(a, b) >= 0.0 && s(b, c) >= 0.0 && s(c, a) >= 0.0
            })
        })
        .collect();
    let truth: Vec<Vec<f64>> = (1..=4)
        .map(|k| {
            std::fs::read_to_string(data.join(format!("ktc2023/truth_train{k}.txt")))
                .unwrap()
                .chars()
                .filter_map(|c| match c {
                    '0' => Some(0.0),
                    '1' => Some(-1.0),
                    '2' => Some(1.0),
                    _ => None,
                })
                .collect()
        })
        .collect();
    let ott = DiscTank::default();
    let omesh = Arc::new(ott.mesh().unwrap());
    let of = read_frames(&data.join("uottawa2005/frames.csv"), 208).unwrap();
    for (name, prior) in [
        ("tik", Prior::Tikhonov),
        ("n.25", Prior::Noser { p: 0.25 }),
        ("n.5", Prior::Noser { p: 0.5 }),
        ("n.75", Prior::Noser { p: 0.75 }),
        ("lap", Prior::Laplace),
    ] {
        let l0 = OneStep::new(
            Arc::clone(&mesh),
            &ktc.contact_ohm_m(),
            &vec![1e-3; mesh.triangles().len()],
            &protocol,
            OneStepOptions {
                prior,
                ..Default::default()
            },
        )
        .unwrap()
        .lambda();
        for f in [0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0] {
            let one = OneStep::new(
                Arc::clone(&mesh),
                &ktc.contact_ohm_m(),
                &vec![1e-3; mesh.triangles().len()],
                &protocol,
                OneStepOptions {
                    prior,
                    hyper: Hyper::Lambda(f * l0),
                    ..Default::default()
                },
            )
            .unwrap();
            let c: Vec<f64> = (0..4)
                .map(|k| {
                    let m = one
                        .reconstruct(&rd(&frames[0], 1.0), &rd(&frames[k + 1], 1.0))
                        .unwrap();
                    let p: Vec<(f64, f64)> = pixel
                        .iter()
                        .zip(&truth[k])
                        .filter_map(|(t, y)| t.map(|t| (m.values[t], *y)))
                        .collect();
                    let n = p.len() as f64;
                    let (mx, my) = (
                        p.iter().map(|p| p.0).sum::<f64>() / n,
                        p.iter().map(|p| p.1).sum::<f64>() / n,
                    );
                    p.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum::<f64>()
                        / (p.iter().map(|p| (p.0 - mx).powi(2)).sum::<f64>()
                            * p.iter().map(|p| (p.1 - my).powi(2)).sum::<f64>())
                        .sqrt()
                })
                .collect();
            let one = OneStep::new(
                Arc::clone(&omesh),
                &ott.contact_ohm_m(),
                &vec![1e-3; omesh.triangles().len()],
                &protocol,
                OneStepOptions {
                    prior,
                    hyper: Hyper::Lambda(f * l0),
                    ..Default::default()
                },
            )
            .unwrap();
            let (ce, ar) = (omesh.region_centroids(), omesh.region_areas());
            let e: Vec<f64> = [(1, 0.0, 0.0), (2, 0.0, 0.07)]
                .iter()
                .map(|&(k, x, y)| {
                    let q = one
                        .reconstruct(&rd(&of[0], -1.0), &rd(&of[k], -1.0))
                        .unwrap()
                        .found(&ce, &ar)
                        .unwrap();
                    100.0 * (q[0] - x).hypot(q[1] - y)
                })
                .collect();
            println!(
                "{name} f={f} lambda={:.2e} ktc {:.3} {c:.2?} ottawa cm {e:.2?}",
                f * l0,
                c.iter().sum::<f64>() / 4.0
            );
        }
    }
}
