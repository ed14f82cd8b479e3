//! The ready-made geometries are what they claim to be.

use eit::{DiscTank, Mesh, PaperSheet};

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
    show("finer", &PaperSheet::default().finer().mesh().unwrap());
}

#[test]
fn a_disc_tank() {
    show("disc 16", &DiscTank::default().mesh().unwrap());
    let ktc = DiscTank {
        radius_mm: 115.0,
        electrodes: 32,
        arc_deg: 5.625,
        first_deg: 84.375,
        ..DiscTank::default()
    };
    show("ktc", &ktc.mesh().unwrap());
}
