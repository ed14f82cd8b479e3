use eit::*;
use rand::SeedableRng;
use rand_distr::Distribution;
use std::sync::Arc;
use survey::*;

#[test]
fn sweep() {
    let sheet = PaperSheet::default();
    let mesh = Arc::new(sheet.mesh().unwrap());
    let fine = Arc::new(sheet.finer().mesh().unwrap());
    println!(
        "{} {} {}",
        mesh.triangles().len(),
        mesh.region().len(),
        fine.triangles().len()
    );
    let protocol = Protocol::sheffield(26).unwrap();
    let forward = Forward::new(Arc::clone(&fine), &sheet.contact_ohm_m()).unwrap();
    let s0 = vec![1e-3; fine.triangles().len()];
    let v0 = forward.readings(&s0, &protocol).unwrap();
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let normal = rand_distr::Normal::new(0.0, 2e-6).unwrap();
    let mut noisy = |v: &nalgebra::DVector<f64>| -> Vec<Reading> {
        v.iter()
            .map(|v| Reading::Ok(Volts(v * 1e-3 + normal.sample(&mut rng))))
            .collect()
    };
    let baseline = noisy(&v0);
    let mut presses = vec![];
    for y in [44.0, 91.3, 138.7, 186.0] {
        for x in [40.0, 84.7, 129.3, 174.0] {
            let mut s = s0.clone();
            for t in 0..s.len() {
                // share of the triangle inside, by 100 sub-points
                let [a, b, c] = fine.corners(t);
                let n = 12;
                let mut inside = 0;
                let mut all = 0;
                for i in 0..n {
                    for j in 0..n - i {
                        for k in 0..(if i + j < n - 1 { 2 } else { 1 }) {
                            let d = if k == 0 { 1.0 / 3.0 } else { 2.0 / 3.0 };
                            let (p, q) = ((i as f64 + d) / n as f64, (j as f64 + d) / n as f64);
                            let px = a[0] + p * (b[0] - a[0]) + q * (c[0] - a[0]);
                            let py = a[1] + p * (b[1] - a[1]) + q * (c[1] - a[1]);
                            all += 1;
                            if (px - x * 1e-3).hypot(py - y * 1e-3) <= 5e-3 {
                                inside += 1;
                            }
                        }
                    }
                }
                s[t] *= 1.0 - 0.5 * inside as f64 / all as f64;
            }
            presses.push((
                [x * 1e-3, y * 1e-3],
                noisy(&forward.readings(&s, &protocol).unwrap()),
            ));
        }
    }
    let sigma0 = vec![1e-3; mesh.triangles().len()];
    let (c, a) = (mesh.region_centroids(), mesh.region_areas());
    for loss_only in [false, true] {
        for (name, prior) in [
            ("tik", Prior::Tikhonov),
            ("n.25", Prior::Noser { p: 0.25 }),
            ("noser.5", Prior::Noser { p: 0.5 }),
            ("n.75", Prior::Noser { p: 0.75 }),
            ("n1", Prior::Noser { p: 1.0 }),
            ("lap", Prior::Laplace),
        ] {
            if loss_only && name == "lap" {
                continue;
            }
            let l0 = OneStep::new(
                Arc::clone(&mesh),
                &sheet.contact_ohm_m(),
                &sigma0,
                &protocol,
                OneStepOptions {
                    prior,
                    ..Default::default()
                },
            )
            .unwrap()
            .lambda();
            let exps: &[f64] = if loss_only {
                &[0.1, 1.0, 10.0]
            } else {
                &[0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0]
            };
            for f in exps {
                let t = std::time::Instant::now();
                let one = OneStep::new(
                    Arc::clone(&mesh),
                    &sheet.contact_ohm_m(),
                    &sigma0,
                    &protocol,
                    OneStepOptions {
                        prior,
                        hyper: Hyper::Lambda(l0 * f),
                        loss_only,
                        ..Default::default()
                    },
                )
                .unwrap();
                let prep = t.elapsed();
                let t = std::time::Instant::now();
                let e: Vec<f64> = presses
                    .iter()
                    .map(|(p, frame)| {
                        let m = one.reconstruct(&baseline, frame).unwrap();
                        let f = m.found(&c, &a).unwrap();
                        1e3 * (f[0] - p[0]).hypot(f[1] - p[1])
                    })
                    .collect();
                let depth: Vec<f64> = presses
                    .iter()
                    .map(|(_, frame)| {
                        one.reconstruct(&baseline, frame)
                            .unwrap()
                            .largest_loss()
                            .unwrap()
                            .1
                    })
                    .collect();
                // noise map
                let noise =
                    (one.matrix().norm_squared() / mesh.region().len() as f64).sqrt() * 2.83e-3;
                println!(
                    "{name} {loss_only} f={f} lambda={:.3e} mean {:.2} worst {:.2} | depth {:.2}-{:.2} noise {noise:.4} {prep:?} {:?}",
                    l0 * f,
                    e.iter().sum::<f64>() / 16.0,
                    e.iter().copied().fold(0.0, f64::max),
                    depth.iter().copied().fold(9.0, f64::min),
                    depth.iter().copied().fold(0.0, f64::max),
                    t.elapsed() / 32
                );
            }
        }
    }
}
