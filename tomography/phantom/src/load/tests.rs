use super::*;

#[test]
fn areas_of_the_papers_loads() {
    let disc = Shape::Disc { diameter_mm: 10.0 };
    assert!((disc.area() / (TAU / 2.0 * 25e-6) - 1.0).abs() < 1e-12);
    // 200 g on a disc of 10 mm are the 25.0 kPa of the paper
    assert!((pressure_kpa(200.0, disc.area()) - 25.0).abs() < 0.05);
    assert!((loss_of_pressure(25.0, 25.0) - 0.5).abs() < 1e-15);
    let triangle = Shape::Triangle { side_mm: 60.0 };
    assert!((triangle.area() - 3.0_f64.sqrt() / 4.0 * 3600e-6).abs() < 1e-12);
    let eight = Shape::FigureEight {
        diameter_mm: 50.0,
        distance_mm: 45.0,
    };
    let lens = 1250.0 * 0.9_f64.acos() - 22.5 * (2500.0_f64 - 2025.0).sqrt();
    let exact = 2.0 * TAU / 2.0 * 625.0 - lens;
    assert!((eight.area() * 1e6 / exact - 1.0).abs() < 1e-4);
    let [low, high] = bounding_box(eight.outline_mm());
    assert!((high[0] - low[0] - 95.0).abs() < 0.01);
}

#[test]
fn what_is_cut_out_adds_up() {
    let mesh = eit::PaperSheet::default().mesh().unwrap();
    let bent = vec![
        [-20.0, -20.0],
        [20.0, -20.0],
        [20.0, 20.0],
        [0.0, -5.0],
        [-20.0, 20.0],
    ];
    for shape in [
        Shape::Disc { diameter_mm: 10.0 },
        Shape::Polygon { points_mm: bent },
        Shape::FigureEight {
            diameter_mm: 50.0,
            distance_mm: 45.0,
        },
    ] {
        let load = Load {
            turn_deg: 33.0,
            shape,
            ..Load::disc([101.3, 120.7], 1.0, 0.5)
        };
        let covered: f64 = load
            .coverage(&mesh)
            .unwrap()
            .iter()
            .map(|(t, share)| share * mesh.area(*t))
            .sum();
        assert!((covered / load.shape.area() - 1.0).abs() < 1e-9, "{load:?}");
    }
}

#[test]
fn faults_are_named() {
    let refuse = |change: &dyn Fn(&mut Load)| {
        let mut load = Load::disc([107.0, 115.0], 10.0, 0.5);
        change(&mut load);
        load.check().unwrap_err().to_string()
    };
    assert!(refuse(&|l| l.loss = 1.5).contains("150 %"));
    assert!(refuse(&|l| l.shape = Shape::Disc { diameter_mm: 0.0 }).contains("diameter_mm"));
    assert!(refuse(&|l| l.centre_mm[1] = f64::NAN).contains("y_mm"));
    let polygon = |points: Vec<[f64; 2]>| {
        refuse(&move |l| {
            l.shape = Shape::Polygon {
                points_mm: points.clone(),
            }
        })
    };
    assert!(polygon(vec![[0.0, 0.0], [1.0, 0.0]]).contains("2 corners"));
    assert!(
        polygon(vec![[0.0, 0.0], [2.0, 2.0], [3.0, 0.0], [0.0, 3.0]]).contains("sides 0 and 2")
    );
    let beside = Load::disc([-50.0, 0.0], 10.0, 0.5);
    let mesh = eit::DiscTank::default().mesh().unwrap();
    assert!(beside.coverage(&mesh).is_ok());
    let mesh = eit::PaperSheet::default().mesh().unwrap();
    assert!(matches!(
        beside.coverage(&mesh),
        Err(LoadError::Beside { .. })
    ));
}
