//! Draws examples of all pictures into a folder: `cargo run -p tactus-render --example gallery -- FOLDER`. The maps are
//! artificial: smooth bumps on a grid of triangles, without tomography.

use std::path::PathBuf;

use render::{Grid, Scale, Scales, Sheet, Style, TerminalColour, TerminalStyle, TruePlace};
use survey::{Doubt, Electrode, Map, MapQuality};

fn grid(columns: usize, title: &str) -> Grid<'_> {
    Grid {
        columns,
        title,
        scales: Scales::Common,
    }
}

/// The paper's sheet with a region of 60 x 64 squares of two triangles.
fn sheet() -> Sheet {
    let (width, height) = (0.214, 0.230);
    let (low, high) = ([0.01824, 0.0196], [0.19576, 0.2104]);
    let (across, up) = (60, 64);
    let point = |i: usize, j: usize| {
        [
            low[0] + (high[0] - low[0]) * i as f64 / across as f64,
            low[1] + (high[1] - low[1]) * j as f64 / up as f64,
        ]
    };
    let mut sheet = Sheet {
        outline: vec![vec![
            [0.0, 0.0],
            [width, 0.0],
            [width, height],
            [0.0, height],
        ]],
        ..Sheet::default()
    };
    for j in 0..up {
        for i in 0..across {
            let [a, b, c, d] = [
                point(i, j),
                point(i + 1, j),
                point(i + 1, j + 1),
                point(i, j + 1),
            ];
            sheet.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    let inset = 0.008;
    let side = |k: usize, of: usize, length: f64| (k as f64 + 0.5) / of as f64 * length;
    for k in 0..6 {
        sheet.electrodes.push([side(k, 6, width), inset]);
    }
    for k in 0..7 {
        sheet.electrodes.push([width - inset, side(k, 7, height)]);
    }
    for k in 0..6 {
        sheet
            .electrodes
            .push([width - side(k, 6, width), height - inset]);
    }
    for k in 0..7 {
        sheet.electrodes.push([inset, height - side(k, 7, height)]);
    }
    for [x, y] in sheet.electrodes.clone() {
        let half = 0.003;
        sheet.outline.push(vec![
            [x - half, y - half],
            [x + half, y - half],
            [x + half, y + half],
            [x - half, y + half],
        ]);
    }
    sheet
}

fn disc() -> Sheet {
    let mut sheet = Sheet::default();
    let at = |r: f64, k: usize, of: usize| {
        let angle = k as f64 / of as f64 * std::f64::consts::TAU;
        [r * angle.cos(), r * angle.sin()]
    };
    let (rings, spokes, radius) = (24, 96, 0.15);
    for ring in 0..rings {
        let r = |k: usize| radius * k as f64 / rings as f64;
        for k in 0..spokes {
            let [a, b] = [at(r(ring), k, spokes), at(r(ring), k + 1, spokes)];
            let [c, d] = [at(r(ring + 1), k + 1, spokes), at(r(ring + 1), k, spokes)];
            if ring > 0 {
                sheet.triangles.push([a, b, c]);
            }
            sheet.triangles.push([a, c, d]);
        }
    }
    sheet.outline = vec![(0..spokes).map(|k| at(radius, k, spokes)).collect()];
    sheet.electrodes = (0..16).map(|k| at(radius, k, 16)).collect();
    sheet
}

/// A map of loss bumps with waves between them.
fn map(sheet: &Sheet, bumps: &[([f64; 2], f64, f64)], waves: f64) -> Map {
    let values = sheet.triangles.iter().map(|corners| {
        let middle = [0, 1].map(|axis| corners.iter().map(|c| c[axis]).sum::<f64>() / 3.0);
        let loss: f64 = bumps
            .iter()
            .map(|(place, width, loss)| {
                let away = (middle[0] - place[0]).hypot(middle[1] - place[1]);
                -loss * (-(away / width).powi(2)).exp()
            })
            .sum();
        loss + waves * (90.0 * middle[0]).sin() * (70.0 * middle[1]).cos()
    });
    Map::relative("made up", values.collect(), "made-up bumps")
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = PathBuf::from(std::env::args_os().nth(1).ok_or("name a folder")?);
    std::fs::create_dir_all(&folder)?;
    let sheet = sheet();
    let place = [0.0847, 0.1387];
    let mark = |place: [f64; 2], title: &str| Style {
        title: title.into(),
        simulated: true,
        true_position: Some(TruePlace {
            centre: place,
            radius: 0.005,
        }),
        found: Some([place[0] + 0.002, place[1] - 0.001]),
        ..Style::default()
    };
    let one = map(&sheet, &[(place, 0.012, 0.43)], 0.02);
    std::fs::write(
        folder.join("one.png"),
        render::png(&sheet, &one, &mark(place, "Test 1, position 6"))?,
    )?;
    std::fs::write(
        folder.join("one.svg"),
        render::svg(&sheet, &one, &mark(place, "Test 1, position 6"))?,
    )?;

    let mut gaps = map(
        &sheet,
        &[(place, 0.03, 0.6), ([0.15, 0.06], 0.02, 0.5)],
        0.0,
    );
    gaps.values[2000..2400].fill(f64::NAN);
    gaps.masked = 3;
    let measured = Style {
        title: "Night of the 14th, frame 1204".into(),
        scale: Scale::Fixed(-0.5, 0.1),
        ..Style::default()
    };
    std::fs::write(
        folder.join("gaps.png"),
        render::png(&sheet, &gaps, &measured)?,
    )?;

    let outside = Map {
        quality: Some(MapQuality::of(&[Doubt::OutsideRegion {
            electrode: Electrode(8),
            lost_mm2: 120.0,
        }])),
        ..map(&sheet, &[([0.19, 0.08], 0.02, 0.2)], 0.01)
    };
    let style = Style {
        title: "A load beside the region".into(),
        ..Style::default()
    };
    std::fs::write(
        folder.join("outside.png"),
        render::png(&sheet, &outside, &style)?,
    )?;

    let tank = disc();
    let ball = map(
        &tank,
        &[([0.05, 0.04], 0.03, 0.08), ([-0.05, -0.06], 0.03, -0.03)],
        0.0,
    );
    let style = Style {
        title: "A tank of 16 electrodes".into(),
        found: Some([0.05, 0.04]),
        ..Style::default()
    };
    std::fs::write(folder.join("tank.png"), render::png(&tank, &ball, &style)?)?;

    let mut maps = Vec::new();
    for (index, y) in [0.044, 0.0913, 0.1387, 0.186].into_iter().enumerate() {
        for (column, x) in [0.040, 0.0847, 0.1293, 0.174].into_iter().enumerate() {
            let loss = 0.2 + 0.02 * (index * 4 + column) as f64;
            let title = format!("{} off by 2.2 mm", index * 4 + column + 1);
            maps.push((
                map(&sheet, &[([x, y], 0.012, loss)], 0.01),
                mark([x, y], &title),
            ));
        }
    }
    let title = "Test 1, sixteen positions";
    std::fs::write(
        folder.join("grid.png"),
        render::png_grid(&sheet, &maps, &grid(4, title))?,
    )?;
    std::fs::write(
        folder.join("grid.svg"),
        render::svg_grid(&sheet, &maps, &grid(4, title))?,
    )?;
    std::fs::write(
        folder.join("three.png"),
        render::png_grid(&sheet, &maps[4..7], &grid(3, "Three methods, one press"))?,
    )?;

    for colour in [
        TerminalColour::TrueColour,
        TerminalColour::Ansi256,
        TerminalColour::Plain,
    ] {
        let style = TerminalStyle {
            width: 60,
            height: None,
            colour,
            style: mark(place, "Test 1, position 6"),
        };
        println!("{}", render::terminal(&sheet, &one, &style)?);
    }
    let style = TerminalStyle {
        width: 48,
        height: None,
        colour: TerminalColour::Plain,
        style,
    };
    println!("{}", render::terminal(&tank, &ball, &style)?);
    println!("written to {}", folder.display());
    Ok(())
}
