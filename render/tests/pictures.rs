//! Content of pictures, and invalid input.

use render::{
    Grid, PictureError, Scale, Scales, Sheet, Style, TerminalColour, TerminalStyle, TruePlace,
};
use survey::{Doubt, Electrode, Map, MapQuality, MapUnit};

/// Ten by ten squares of 10 mm, four electrodes.
fn scene() -> (Sheet, Map) {
    let mut sheet = Sheet {
        outline: vec![vec![[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]]],
        electrodes: vec![[0.05, 0.0], [0.1, 0.05], [0.05, 0.1], [0.0, 0.05]],
        ..Sheet::default()
    };
    let mut values = Vec::new();
    for row in 0..10 {
        for column in 0..10 {
            let (x, y) = (f64::from(column) * 0.01, f64::from(row) * 0.01);
            let [a, b, c, d] = [[x, y], [x + 0.01, y], [x + 0.01, y + 0.01], [x, y + 0.01]];
            sheet.triangles.extend([[a, b, c], [a, c, d]]);
            let pressed = (2..4).contains(&column) && (6..8).contains(&row);
            values.extend([if pressed { -0.5 } else { 0.0 }; 2]);
        }
    }
    let map = Map {
        masked: 2,
        ..Map::relative("m", values, "by hand")
    };
    (sheet, map)
}

fn grid(columns: usize, title: &str) -> Grid<'_> {
    Grid {
        columns,
        title,
        scales: Scales::Common,
    }
}

fn style() -> Style {
    Style {
        title: "a press".into(),
        simulated: true,
        true_position: Some(TruePlace {
            centre: [0.03, 0.07],
            radius: 0.005,
        }),
        found: Some([0.031, 0.07]),
        ..Style::default()
    }
}

struct Pixels {
    width: usize,
    bytes: Vec<u8>,
}

fn decode(bytes: &[u8]) -> Pixels {
    let mut reader = png::Decoder::new(std::io::Cursor::new(bytes))
        .read_info()
        .unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    Pixels {
        width: info.width as usize,
        bytes: pixels,
    }
}

impl Pixels {
    fn count(&self, wanted: [u8; 3]) -> usize {
        let (pixels, _) = self.bytes.as_chunks::<3>();
        pixels.iter().filter(|pixel| **pixel == wanted).count()
    }
}

#[test]
fn an_svg_has_title_units_numbers_marks_and_simulated() {
    let (sheet, map) = scene();
    let svg = render::svg(&sheet, &map, &style()).unwrap();
    for words in [
        "a press",
        "by hand, 2 readings left out",
        "SIMULATED",
        "relative loss of conductance, %",
        "x, mm",
        "y, mm",
        "true place",
        "found",
        "\n50\n",
    ] {
        assert!(svg.contains(words), "{words}");
    }
    for number in 1..=4 {
        assert!(svg.contains(&format!("\n{number}\n")), "electrode {number}");
    }
    let measured = Style {
        simulated: false,
        ..style()
    };
    assert!(
        !render::svg(&sheet, &map, &measured)
            .unwrap()
            .contains("SIMULATED")
    );
}

/// Positions of a number in an SVG, in its units, x to the right and y downwards.
fn places(svg: &str, number: &str) -> Vec<[f64; 2]> {
    let value = |tag: &str, name: &str| -> f64 {
        let (_, rest) = tag.split_once(&format!(" {name}=\"")).unwrap();
        rest.split('"').next().unwrap().parse().unwrap()
    };
    let texts = svg.split("<text").skip(1);
    texts
        .filter(|text| text.contains(&format!("\n{number}\n</text>")))
        .map(|text| [value(text, "x"), value(text, "y")])
        .collect()
}

#[test]
fn larger_numbers_are_higher_on_the_colour_bar() {
    let (sheet, map) = scene();
    let pressure = Map {
        values: map.values.iter().map(|value| -100.0 * value).collect(),
        unit: MapUnit::Pressure,
        ..map.clone()
    };
    for map in [&map, &pressure] {
        let svg = render::svg(&sheet, map, &Style::default()).unwrap();
        // the bar is to the right of the numbers of all axes
        let rightmost = |number: &str| {
            let places = places(&svg, number);
            places
                .into_iter()
                .max_by(|a, b| a[0].total_cmp(&b[0]))
                .unwrap()
        };
        let ([x, low], [right, high]) = (rightmost("10"), rightmost("50"));
        assert_eq!(x, right, "{:?}", map.unit);
        assert!(high < low, "{:?}: 50 at {high}, 10 at {low}", map.unit);
    }
}

#[test]
fn pressure_is_in_kilopascals_and_a_loss_never_is() {
    let (sheet, relative) = scene();
    let pressure = Map {
        values: relative.values.iter().map(|value| -60.0 * value).collect(),
        unit: MapUnit::Pressure,
        ..relative.clone()
    };
    let terminal = TerminalStyle {
        width: 50,
        height: None,
        colour: TerminalColour::Plain,
        style: style(),
    };
    for (map, says, never) in [
        (&pressure, ["pressure", "kPa"], ["conductance", " %"]),
        (
            &relative,
            ["relative loss of conductance", "%"],
            ["pressure", "kPa"],
        ),
    ] {
        for text in [
            render::svg(&sheet, map, &style()).unwrap(),
            render::terminal(&sheet, map, &terminal).unwrap(),
        ] {
            for words in says {
                assert!(text.contains(words), "{words}\n{text}");
            }
            for words in never {
                assert!(!text.contains(words), "{words}\n{text}");
            }
        }
    }
    let spots = render::hot_spots(&sheet, &pressure).unwrap();
    assert_eq!(spots[0].peak, 30.0, "kPa");
}

#[test]
fn a_png_shows_the_press_in_its_colour_and_leaves_gaps_bare() {
    let (sheet, mut map) = scene();
    let plain = Style {
        title: "bare".into(),
        ..Style::default()
    };
    let darkest = render::colour(-1.0).unwrap();
    let zero = render::colour(0.0).unwrap();
    let whole = decode(&render::png(&sheet, &map, &plain).unwrap());
    assert_eq!(whole.width, 720);
    // 4 of 100 squares are pressed.
    let (pressed, untouched) = (whole.count(darkest), whole.count(zero));
    assert!(
        (20..28).contains(&(untouched / pressed)),
        "{untouched} and {pressed}"
    );
    map.values[..100].fill(f64::NAN);
    let half = decode(&render::png(&sheet, &map, &plain).unwrap()).count(zero);
    assert!(half < untouched * 6 / 10, "{half} of {untouched}");
}

#[test]
fn the_same_map_gives_the_same_bytes() {
    let (sheet, map) = scene();
    let first = render::png(&sheet, &map, &style()).unwrap();
    assert_eq!(first, render::png(&sheet, &map, &style()).unwrap());
}

#[test]
fn a_grid_has_one_scale_for_all() {
    let (sheet, map) = scene();
    let mut weak = map.clone();
    weak.values.iter_mut().for_each(|value| *value *= 0.1);
    let named = |title: &str| Style {
        title: title.into(),
        ..Style::default()
    };
    let maps = [(map, named("strong")), (weak, named("weak"))];
    let svg = render::svg_grid(&sheet, &maps, &grid(4, "two presses")).unwrap();
    for words in ["two presses", "strong", "weak"] {
        assert!(svg.contains(words), "{words}");
    }
    let [r, g, b] = render::colour(-0.1).unwrap();
    assert!(svg.contains(&format!("fill=\"#{r:02x}{g:02x}{b:02x}\"")));
    assert!(
        !decode(&render::png_grid(&sheet, &maps, &grid(1, "")).unwrap())
            .bytes
            .is_empty()
    );
    assert_eq!(
        render::png_grid(&sheet, &[], &grid(4, "none")),
        Err(PictureError::EmptyGrid)
    );
    assert_eq!(
        render::png_grid(&sheet, &maps, &grid(0, "none")),
        Err(PictureError::EmptyGrid)
    );
}

#[test]
fn a_plain_terminal_gets_ascii_with_scale_numbers_and_marks() {
    let (sheet, map) = scene();
    let mut wanted = TerminalStyle {
        width: 50,
        height: None,
        colour: TerminalColour::Plain,
        style: style(),
    };
    let text = render::terminal(&sheet, &map, &wanted).unwrap();
    assert!(text.is_ascii(), "{text}");
    assert!(text.lines().all(|line| line.len() <= 50), "{text}");
    for words in [
        "a press  [SIMULATED]",
        "50 %",
        "relative loss of conductance",
        "1 hot spot  x 30.0 y 70.0 mm, 50 %, 4.0 cm2",
        "o true      x 30.0 y 70.0 mm, 1.0 mm from found",
    ] {
        assert!(text.contains(words), "{words}\n{text}");
    }
    let rows: Vec<&str> = text.lines().collect();
    assert_eq!(rows[2].trim(), "3", "electrode 3 is on top\n{text}");
    assert!(
        rows.iter()
            .any(|row| row.starts_with("  4 .") && row.ends_with(". 2")),
        "{text}"
    );
    wanted.width = 19;
    assert!(render::terminal(&sheet, &map, &wanted).is_err());
}

#[test]
fn a_picture_fits_the_height_of_a_terminal() {
    let (sheet, map) = scene();
    for (height, spots) in [(40, true), (22, true), (19, false), (12, false)] {
        let wanted = TerminalStyle {
            width: 80,
            height: Some(height),
            colour: TerminalColour::Plain,
            style: style(),
        };
        let text = render::terminal(&sheet, &map, &wanted).unwrap();
        assert!(text.lines().count() <= height, "{height} lines:\n{text}");
        assert!(text.starts_with("a press  [SIMULATED]"), "{text}");
        assert_eq!(text.contains("hot spot"), spots, "{height} lines:\n{text}");
        assert!(text.contains("x found"), "{text}");
    }
}

#[test]
fn a_colour_terminal_is_left_as_it_was_found() {
    let (sheet, map) = scene();
    for (colour, code) in [
        (TerminalColour::TrueColour, "\u{1b}[48;2;250;250;246m"),
        (TerminalColour::Ansi256, "\u{1b}[48;5;231m"),
    ] {
        let wanted = TerminalStyle {
            width: 60,
            height: None,
            colour,
            style: Style::default(),
        };
        let text = render::terminal(&sheet, &map, &wanted).unwrap();
        assert!(text.contains(code), "{text:?}");
        for line in text.lines().filter(|line| line.contains('\u{1b}')) {
            let (_, after) = line.rsplit_once("\u{1b}[").unwrap();
            assert!(after.starts_with("0m"), "{line:?}");
        }
    }
}

#[test]
fn text_from_outside_cannot_act_on_the_terminal() {
    let (sheet, map) = scene();
    let map = Map {
        method: "\u{1b}[31mmodel".into(),
        ..map
    };
    let wanted = TerminalStyle {
        colour: TerminalColour::Plain,
        style: Style {
            title: "frame \u{1b}[2J\r\u{202e}".into(),
            ..style()
        },
        ..TerminalStyle::default()
    };
    let text = render::terminal(&sheet, &map, &wanted).unwrap();
    assert!(
        text.is_ascii() && !text.contains(['\u{1b}', '\r']),
        "{text:?}"
    );
    assert!(
        text.starts_with("frame \\u{1b}[2J\\r\\u{202e}  [SIM"),
        "{text}"
    );
    assert!(text.contains("\\u{1b}[31mmodel"), "{text}");
}

#[test]
fn a_map_of_another_sheet_and_a_scale_that_is_none_are_refused() {
    let (sheet, map) = scene();
    let mut short = map.clone();
    short.values.pop();
    assert_eq!(
        render::png(&sheet, &short, &style()),
        Err(PictureError::OtherSheet {
            map: 199,
            sheet: 200
        })
    );
    let backwards = Style {
        scale: Scale::Fixed(0.5, -0.5),
        ..style()
    };
    assert!(matches!(
        render::svg(&sheet, &map, &backwards),
        Err(PictureError::Scale { .. })
    ));
    let line = Sheet {
        triangles: Vec::new(),
        outline: vec![vec![[0.0, 0.0], [1.0, 0.0]]],
        electrodes: Vec::new(),
    };
    let empty = Map {
        values: Vec::new(),
        ..map
    };
    assert!(matches!(
        render::png(&line, &empty, &style()),
        Err(PictureError::Sheet(_))
    ));
}

#[test]
fn a_long_title_keeps_clear_of_the_mark_of_a_simulation() {
    let (sheet, map) = scene();
    let long = Style {
        title: "m20260101t000000_000, frame 128, 2026-01-01 00:00:00, a remark that goes on and on and on, \
                and then on a little more than any page is wide, however large a screen may be"
            .into(),
        ..style()
    };
    let short = render::svg(&sheet, &map, &style()).unwrap();
    let svg = render::svg(&sheet, &map, &long).unwrap();
    assert!(svg.contains("m20260101t000000_000, frame 128") && svg.contains('\u{2026}'));
    assert_eq!(svg.matches("SIMULATED").count(), 1);
    assert_eq!(short.matches('\u{2026}').count(), 0);
    let grid = render::svg_grid(
        &sheet,
        &[(map.clone(), long), (map, style())],
        &grid(2, "both"),
    )
    .unwrap();
    assert_eq!(grid.matches('\u{2026}').count(), 1);
}

#[test]
fn maps_of_a_grid_can_have_a_scale_each() {
    let (sheet, map) = scene();
    let faint = Map {
        values: map.values.iter().map(|value| 0.01 * value).collect(),
        ..map.clone()
    };
    let maps = [(map, style()), (faint, style())];
    let drawn = |scales| {
        let both = Grid {
            scales,
            ..grid(2, "loud and faint")
        };
        render::svg_grid(&sheet, &maps, &both).unwrap()
    };
    let full = format!("fill=\"#{}\"", {
        let [r, g, b] = render::colour(-1.0).unwrap();
        format!("{r:02x}{g:02x}{b:02x}")
    });
    // the darkest colour fills triangles of one map on a common scale, of both on separate scales
    let dark = |svg: &str| {
        svg.lines()
            .filter(|line| line.starts_with("<path") && line.contains(&full))
            .count()
    };
    assert_eq!(dark(&drawn(Scales::Common)), 1);
    let each = drawn(Scales::Each);
    assert_eq!(dark(&each), 2);
    assert!(each.contains("a colour bar for each map"));
}

#[test]
fn maps_of_a_grid_with_a_scale_each_may_differ_in_unit() {
    let (sheet, map) = scene();
    let pressure = Map {
        values: map.values.iter().map(|value| -20.0 * value).collect(),
        unit: MapUnit::Pressure,
        ..map.clone()
    };
    let maps = [(map, style()), (pressure, style())];
    let each = Grid {
        scales: Scales::Each,
        ..grid(2, "loss and pressure")
    };
    let drawn = render::svg_grid(&sheet, &maps, &each).unwrap();
    for text in [
        "each map: relative loss of conductance, %; pressure, kPa",
        "%: a press",
        "kPa: a press",
    ] {
        assert!(drawn.contains(text), "{text}");
    }
    assert!(render::svg_grid(&sheet, &maps, &grid(2, "one scale")).is_err());
}

#[test]
fn a_load_that_is_no_disc_has_its_outline_dashed() {
    let (sheet, map) = scene();
    let lines = |style: &Style| {
        let svg = render::svg(&sheet, &map, style).unwrap();
        svg.matches("<polyline").count()
    };
    let bare = Style {
        true_position: None,
        ..style()
    };
    let outlined = Style {
        true_outline: vec![[0.02, 0.06], [0.04, 0.06], [0.04, 0.08], [0.02, 0.08]],
        ..bare.clone()
    };
    assert!(lines(&outlined) > lines(&bare) + 20);
}

#[test]
fn a_map_of_noise_is_grey_on_a_fixed_scale_with_a_note() {
    let (sheet, mut map) = scene();
    map.values.iter_mut().for_each(|value| *value *= 0.004);
    let style = TerminalStyle {
        colour: TerminalColour::Plain,
        style: Style {
            nothing_above: Some(0.003),
            ..Style::default()
        },
        ..TerminalStyle::default()
    };
    let text = render::terminal(&sheet, &map, &style).unwrap();
    assert!(text.contains("nothing above the noise (0.3"), "{text}");
    assert!(!text.contains("hot spot"), "{text}");
    assert!(text.contains("100 %"), "{text}");
    let grey = render::terminal(
        &sheet,
        &map,
        &TerminalStyle {
            colour: TerminalColour::TrueColour,
            ..style
        },
    )
    .unwrap();
    let colours: Vec<&str> = grey
        .split("\u{1b}[38;2;")
        .skip(1)
        .filter_map(|rest| rest.split('m').next())
        .collect();
    assert!(!colours.is_empty());
    for colour in colours {
        let channels: Vec<&str> = colour.split(';').collect();
        assert!(
            channels.iter().all(|channel| *channel == channels[0]),
            "{colour}"
        );
    }
}

#[test]
fn cells_fill_their_area_and_keep_the_shape_of_the_sheet() {
    let (sheet, map) = scene();
    let marks = [([0.03, 0.07], "12".to_owned())];
    for (area, sheet_cells) in [([42, 40], [34, 17]), ([80, 13], [22, 11]), ([3, 1], [1, 1])] {
        let cells = render::terminal_map(
            &sheet,
            &map,
            area,
            &marks,
            TerminalColour::TrueColour,
            &Style::default(),
        )
        .unwrap();
        let [columns, rows] = sheet_cells;
        assert_eq!(cells.rows.len(), rows + 2, "{area:?}");
        assert!(
            cells.rows.iter().all(|row| row.len() == columns + 8),
            "{area:?}"
        );
    }
    let cells = render::terminal_map(
        &sheet,
        &map,
        [80, 13],
        &marks,
        TerminalColour::Ansi256,
        &Style::default(),
    )
    .unwrap();
    // 11 rows, 22 columns: x 30 mm of 100 is column 6, y 70 mm from below is row 3
    let marked: String = cells.rows[1 + 3][4 + 5..4 + 7]
        .iter()
        .map(|cell| cell.sign)
        .collect();
    assert_eq!(marked, "12");
    assert!(cells.rows[1 + 3][4 + 5].bold);
    assert_eq!(
        (cells.scale.low.as_str(), cells.scale.high.as_str()),
        ("0 %", "50 %")
    );
}

#[test]
fn the_rim_is_hatched_where_a_load_lies_outside() {
    let (mut sheet, mut map) = scene();
    // 10 mm of sheet round the region, one void in it
    sheet.outline = vec![
        vec![[-0.01, -0.01], [0.11, -0.01], [0.11, 0.11], [-0.01, 0.11]],
        vec![
            [0.102, 0.045],
            [0.108, 0.045],
            [0.108, 0.055],
            [0.102, 0.055],
        ],
    ];
    let hatched = |map: &Map| {
        let svg = render::svg(&sheet, map, &Style::default()).unwrap();
        let cells = TerminalStyle {
            colour: TerminalColour::Plain,
            ..TerminalStyle::default()
        };
        let terminal = render::terminal(&sheet, map, &cells).unwrap();
        let strokes: Vec<Vec<usize>> = terminal
            .lines()
            .filter(|line| line.contains('/'))
            .map(|line| line.match_indices('/').map(|(at, _)| at).collect())
            .collect();
        (svg.matches("<polyline").count(), strokes)
    };
    let (lines, strokes) = hatched(&map);
    assert!(strokes.is_empty());
    let outside = Doubt::OutsideRegion {
        electrode: Electrode(1),
        lost_mm2: 120.0,
    };
    map.quality = Some(MapQuality::of(&[outside]));
    let (more, strokes) = hatched(&map);
    // a line every 5 points over some 60 of the sheet's 600 points of height; the void can cut each in two
    assert!((lines + 20..lines + 200).contains(&more), "{lines} {more}");
    // hatched only in the middle rows of the right side, where electrode 2 is nearest
    assert!(strokes.len() > 3, "{strokes:?}");
    let rightmost = strokes.iter().flatten().min().unwrap();
    assert!(*rightmost > 50, "{strokes:?}");
    map.values[0] = f64::NAN;
    let without_value = hatched(&map).1;
    assert_eq!(without_value, strokes, "a missing value is not the rim");
}
