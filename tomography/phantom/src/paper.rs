//! The loads of the paper's two tests. The paper gives masses but no losses, and shapes but few dimensions. The missing
//! values are choices of this project, and a scene can set all of them differently.

use crate::load::{Load, Shape, loss_of_pressure, pressure_kpa};

/// Columns of Test #1, mm.
pub const TEST1_X_MM: [f64; 4] = [40.0, 84.7, 129.3, 174.0];

/// Rows of Test #1, mm.
pub const TEST1_Y_MM: [f64; 4] = [44.0, 91.3, 138.7, 186.0];

/// The three positions of Test #2, mm.
pub const TEST2_MM: [[f64; 2]; 3] = [[70.0, 70.0], [107.0, 115.0], [144.0, 160.0]];

/// The pressure at which half of the conductance is lost, kPa: that of S1, 200 g on a disc of 10 mm.
pub const HALF_KPA: f64 = 25.0;

/// The 16 positions of Test #1, mm, from the lower left; x varies first.
pub fn test1_positions() -> [[f64; 2]; 16] {
    std::array::from_fn(|k| [TEST1_X_MM[k % 4], TEST1_Y_MM[k / 4]])
}

/// S1: a disc of 10 mm, 200 g, a loss of 50 %.
pub fn s1(centre_mm: [f64; 2]) -> Load {
    Load {
        name: "S1".to_owned(),
        ..Load::disc(centre_mm, 10.0, 0.5)
    }
}

/// S2: a rectangle of 50 x 30 mm, 500 g.
pub fn s2(centre_mm: [f64; 2]) -> Load {
    let shape = Shape::Rectangle {
        width_mm: 50.0,
        height_mm: 30.0,
    };
    pressed("S2", shape, centre_mm, 500.0)
}

/// S3: an equilateral triangle of side 60 mm, 1 kg.
pub fn s3(centre_mm: [f64; 2]) -> Load {
    pressed("S3", Shape::Triangle { side_mm: 60.0 }, centre_mm, 1000.0)
}

/// S4: a figure-eight of two discs of 50 mm, 45 mm apart, 4 kg.
pub fn s4(centre_mm: [f64; 2]) -> Load {
    let shape = Shape::FigureEight {
        diameter_mm: 50.0,
        distance_mm: 45.0,
    };
    pressed("S4", shape, centre_mm, 4000.0)
}

fn pressed(name: &str, shape: Shape, centre_mm: [f64; 2], mass_g: f64) -> Load {
    Load {
        name: name.to_owned(),
        centre_mm,
        turn_deg: 0.0,
        loss: loss_of_pressure(pressure_kpa(mass_g, shape.area()), HALF_KPA),
        shape,
    }
}
