//! The presets have the documented properties.

use eit::{DiscTank, Mesh, MeshError, PaperSheet, Preset, SheetElectrode};

fn show(name: &str, mesh: &Mesh) {
    let q = mesh.quality();
    println!(
        "{name}: {} nodes, {} triangles, {} in the region, angles {:.2} to {:.2} degrees, {} edges an electrode at least, area {:.12} m2",
        q.nodes,
        q.triangles,
        q.region,
        q.smallest_angle,
        q.largest_angle,
        q.fewest_electrode_edges,
        q.area
    );
}

#[test]
fn the_papers_sheet() {
    let mesh = PaperSheet::default().mesh().unwrap();
    show("paper sheet", &mesh);
    let quality = mesh.quality();
    // the paper's counts: 9,716 and 3,690
    assert!((quality.triangles as f64 / 9716.0 - 1.0).abs() < 0.02);
    assert!((quality.region as f64 / 3690.0 - 1.0).abs() < 0.02);
    assert!(quality.smallest_angle > 30.0);
    assert_eq!(quality.fewest_electrode_edges, 16);
    let exact = 0.214 * 0.230 - 26.0 * 0.006 * 0.006;
    assert!((quality.area / exact - 1.0).abs() < 1e-12);
    let centres = mesh.electrode_centres();
    for (centre, wanted) in [
        (centres[0], [214.0 / 12.0, 8.0]),
        (centres[6], [206.0, 230.0 / 14.0]),
        (centres[13], [214.0 * 11.0 / 12.0, 222.0]),
        (centres[25], [8.0, 230.0 / 14.0]),
    ] {
        for axis in 0..2 {
            assert!((centre[axis] * 1e3 - wanted[axis]).abs() < 1e-9);
        }
    }
    // the rim and 26 holes
    assert_eq!(mesh.outline().len(), 27);
}

#[test]
fn the_papers_sheet_is_symmetric_and_always_the_same() {
    let mesh = PaperSheet::default().mesh().unwrap();
    assert_eq!(mesh.hash(), PaperSheet::default().mesh().unwrap().hash());
    let key = |[x, y]: [f64; 2]| ((x * 1e10).round() as i64, (y * 1e10).round() as i64);
    let nodes: std::collections::BTreeSet<_> = mesh.nodes().iter().map(|p| key(*p)).collect();
    assert_eq!(nodes.len(), mesh.nodes().len());
    for &[x, y] in mesh.nodes() {
        assert!(nodes.contains(&key([0.214 - x, y])));
        assert!(nodes.contains(&key([x, 0.230 - y])));
    }
}

#[test]
fn a_finer_sheet_is_not_a_refinement() {
    let coarse = PaperSheet::default();
    let fine = Preset::default().remeshed(1.5, 1).mesh().unwrap();
    show("finer sheet", &fine);
    assert!(fine.quality().smallest_angle > 28.0);
    let coarse = coarse.mesh().unwrap();
    assert!(fine.triangles().len() > 17 * coarse.triangles().len() / 10);
    let shared = coarse.nodes().iter().filter(|p| fine.nodes().contains(p));
    // only corners and sides of voids have fixed positions
    assert!(shared.count() < 400);
}

#[test]
fn sheets_of_other_shapes() {
    for (nx, ny, fineness) in [(5, 4, 0.7), (3, 3, 1.0), (1, 2, 0.5), (6, 7, 2.0)] {
        let sheet = PaperSheet {
            electrodes_per_width: nx,
            electrodes_per_height: ny,
            fineness,
            ..PaperSheet::default()
        };
        let mesh = sheet.mesh().unwrap();
        show(&format!("{nx} x {ny}, fineness {fineness}"), &mesh);
        assert_eq!(mesh.electrodes(), sheet.electrodes());
        assert!(mesh.quality().coarse_electrodes.is_empty());
        assert!(mesh.quality().smallest_angle > 20.0);
    }
}

/// Electrodes as parts of the edge: nothing is cut out, and each has its own part.
#[test]
fn a_sheet_with_electrodes_on_its_edge() {
    for (nx, ny) in [(6, 7), (5, 4), (3, 3)] {
        let sheet = PaperSheet {
            electrode: SheetElectrode::Edge,
            electrodes_per_width: nx,
            electrodes_per_height: ny,
            ..PaperSheet::default()
        };
        let mesh = sheet.mesh().unwrap();
        show(&format!("{nx} x {ny} on the edge"), &mesh);
        let quality = mesh.quality();
        assert_eq!(mesh.electrodes(), 2 * (nx + ny));
        assert!((quality.area / (0.214 * 0.230) - 1.0).abs() < 1e-12);
        assert!(quality.smallest_angle > 25.0);
        assert_eq!(quality.fewest_electrode_edges, 4);
        assert_eq!(mesh.outline().len(), 1);
        for (k, centre) in mesh.electrode_centres().into_iter().enumerate() {
            let wanted = sheet.centres_mm()[k];
            for axis in 0..2 {
                assert!((centre[axis] * 1e3 - wanted[axis]).abs() < 1e-9, "{k}");
            }
            let length = mesh.electrode_length(k);
            assert!((length * 1e3 - sheet.void_mm).abs() < 1e-9, "{k}: {length}");
        }
        // the contact resistance is that of the void
        let lengths = sheet.contact_ohm_m()[0] / (sheet.void_mm * 1e-3);
        assert!((lengths - sheet.contact_ohm).abs() < 1e-9);
    }
}

#[test]
fn disc_tanks() {
    let ktc = DiscTank {
        radius_mm: 115.0,
        electrodes: 32,
        arc_deg: 5.625,
        first_deg: 84.375,
        ..DiscTank::default()
    };
    for tank in [DiscTank::default(), ktc] {
        let mesh = tank.mesh().unwrap();
        show("disc tank", &mesh);
        let quality = mesh.quality();
        assert!(quality.smallest_angle > 25.0);
        assert!(quality.fewest_electrode_edges >= 8);
        let radius = tank.radius_mm * 1e-3;
        let disc = std::f64::consts::PI * radius * radius;
        assert!(quality.area < disc && quality.area > 0.998 * disc);
        for (k, [x, y]) in mesh.electrode_centres().into_iter().enumerate() {
            let wanted = tank.first_deg + 360.0 * k as f64 / tank.electrodes as f64;
            let turned = (y.atan2(x).to_degrees() - wanted).rem_euclid(360.0);
            assert!(turned.min(360.0 - turned) < 1e-6, "electrode {k}");
        }
    }
}

#[test]
fn measures_that_do_not_fit_are_refused_by_key() {
    let refusals = [
        PaperSheet {
            void_mm: 40.0,
            ..PaperSheet::default()
        }
        .mesh(),
        PaperSheet {
            inset_mm: 2.0,
            ..PaperSheet::default()
        }
        .mesh(),
        PaperSheet {
            fineness: f64::NAN,
            ..PaperSheet::default()
        }
        .mesh(),
        PaperSheet {
            electrodes_per_width: 0,
            ..PaperSheet::default()
        }
        .mesh(),
        PaperSheet {
            width_mm: 5000.0,
            ..PaperSheet::default()
        }
        .mesh(),
        DiscTank {
            arc_deg: 22.5,
            ..DiscTank::default()
        }
        .mesh(),
        DiscTank {
            electrodes: 1,
            ..DiscTank::default()
        }
        .mesh(),
    ];
    let keys = [
        "inset_mm",
        "inset_mm",
        "fineness",
        "electrodes_per_width",
        "height_mm 230, one may be at most 20 times the other",
        "arc_deg",
        "electrodes",
    ];
    for (refusal, key) in refusals.into_iter().zip(keys) {
        match refusal {
            Err(MeshError::Preset { fault, .. }) => assert!(fault.contains(key), "{fault}"),
            other => panic!("{key}: {other:?}"),
        }
    }
}

/// Size and grading are configurable, and no choice gives an electrode with fewer than four edges.
#[test]
fn size_and_grading_are_a_choice() {
    let default = PaperSheet::default().mesh().unwrap().triangles().len();
    let mesh = |edge_mm: f64, largest_mm: f64, growth: f64| {
        let sheet = PaperSheet {
            edge_mm,
            largest_mm,
            growth,
            ..PaperSheet::default()
        };
        let mesh = sheet.mesh().unwrap();
        let quality = mesh.quality();
        assert!(quality.coarse_electrodes.is_empty());
        assert!(quality.smallest_angle > 20.0, "{}", quality.smallest_angle);
        mesh.triangles().len()
    };
    assert!(mesh(3.0, 5.4, 0.14) < default);
    assert!(mesh(3.0, 20.0, 0.3) < default / 2);
    assert!(mesh(1.5, 4.0, 0.14) > default);
    for (electrode_edges, fineness) in [(1, 0.25), (4, 0.5), (16, 1.0)] {
        let tank = DiscTank {
            electrode_edges,
            fineness,
            largest_share: 0.1,
            growth: 0.4,
            ..DiscTank::default()
        };
        assert!(tank.mesh().unwrap().quality().coarse_electrodes.is_empty());
    }
    for (key, value) in [
        ("edge_mm", 0.001),
        ("edge_mm", 500.0),
        ("largest_mm", f64::NAN),
    ] {
        let mut sheet = PaperSheet::default();
        *(if key == "edge_mm" {
            &mut sheet.edge_mm
        } else {
            &mut sheet.largest_mm
        }) = value;
        let refusal = sheet.mesh().unwrap_err().to_string();
        assert!(refusal.contains(key), "{refusal}");
    }
}
