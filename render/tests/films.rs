//! Films: decoded frame by frame, and compared with pictures of single maps.

use render::{Film, Pace, Range, Scale, Sheet, SpotMark, Style};
use survey::Map;

/// Sixteen by sixteen squares of 10 mm whose corners lie on the sheet's edge.
fn scene(pressed: [f64; 2], depth: f64) -> (Sheet, Map) {
    let mut sheet = Sheet {
        outline: vec![vec![[0.0, 0.0], [0.16, 0.0], [0.16, 0.16], [0.0, 0.16]]],
        electrodes: vec![[0.05, 0.0], [0.16, 0.05], [0.05, 0.16], [0.0, 0.05]],
        ..Sheet::default()
    };
    let mut values = Vec::new();
    for row in 0..16 {
        for column in 0..16 {
            let (x, y) = (f64::from(column) * 0.01, f64::from(row) * 0.01);
            let [a, b, c, d] = [[x, y], [x + 0.01, y], [x + 0.01, y + 0.01], [x, y + 0.01]];
            sheet.triangles.extend([[a, b, c], [a, c, d]]);
            let away = (x + 0.005 - pressed[0]).hypot(y + 0.005 - pressed[1]);
            values.extend([0.03 - depth * (-away * away / 0.0008).exp(); 2]);
        }
    }
    let map = Map::relative("m", values, "by hand");
    (sheet, map)
}

fn style(title: &str, pressed: [f64; 2]) -> Style {
    Style {
        title: title.into(),
        scale: Scale::Fixed(-0.6, 0.1),
        simulated: true,
        found: Some(pressed),
        hot_spots: Some(vec![SpotMark {
            number: 1,
            centre: pressed,
            area: 4e-4,
        }]),
        ..Style::default()
    }
}

/// A picture as a viewer composes it: red, green and blue of each pixel; and the delay in ms.
struct Shown {
    size: [u32; 2],
    pixels: Vec<u8>,
    delay_ms: f64,
}

/// Decodes a film and composes its pictures as specified for APNG; returns also the number of plays.
fn watched(bytes: &[u8]) -> (Vec<Shown>, u32) {
    let mut decoder = png::Decoder::new(std::io::Cursor::new(bytes));
    decoder.set_transformations(png::Transformations::EXPAND | png::Transformations::ALPHA);
    let mut reader = decoder.read_info().unwrap();
    let info = reader.info();
    let size = [info.width, info.height];
    let animation = *info.animation_control().unwrap();
    assert_eq!(info.color_type, png::ColorType::Indexed);
    let mut canvas = vec![0_u8; 3 * (size[0] * size[1]) as usize];
    let mut shown = Vec::new();
    for _ in 0..animation.num_frames {
        let mut part = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut part).unwrap();
        let control = *reader.info().frame_control().unwrap();
        for row in 0..control.height {
            for column in 0..control.width {
                let from = 4 * (row * control.width + column) as usize;
                let at = ((control.y_offset + row) * size[0] + control.x_offset + column) as usize;
                if part[from + 3] == 255 {
                    canvas[3 * at..3 * at + 3].copy_from_slice(&part[from..from + 3]);
                }
            }
        }
        shown.push(Shown {
            size,
            pixels: canvas.clone(),
            delay_ms: 1e3 * f64::from(control.delay_num) / f64::from(control.delay_den),
        });
    }
    (shown, animation.num_plays)
}

fn still(sheet: &Sheet, map: &Map, style: &Style) -> ([u32; 2], Vec<u8>) {
    let bytes = render::png(sheet, map, style).unwrap();
    let mut reader = png::Decoder::new(std::io::Cursor::new(&bytes))
        .read_info()
        .unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    ([info.width, info.height], pixels)
}

#[test]
fn pictures_of_a_film_are_those_of_single_maps() {
    let places = [[0.05, 0.05], [0.08, 0.11], [0.155, 0.12]];
    let scenes = places.map(|place| scene(place, 0.5));
    let styles: Vec<Style> = places
        .iter()
        .zip(["03:00:00", "03:10:00", "03:20:00"])
        .map(|(place, title)| style(title, *place))
        .collect();
    let sheet = &scenes[0].0;
    let maps = || scenes.iter().map(|(_, map)| map).zip(&styles);
    let range = Range::of_film(maps()).unwrap();
    let pace = Pace {
        pictures: 4,
        each_ms: 125,
    };
    let mut bytes = Vec::new();
    let mut film = Film::new(&mut bytes, sheet, range, &styles[0], pace).unwrap();
    for (map, style) in maps() {
        film.add(map, style).unwrap();
    }
    // the same picture again
    film.add(&scenes[2].1, &styles[2]).unwrap();
    film.finish().unwrap();
    let (shown, plays) = watched(&bytes);
    assert_eq!((shown.len(), plays), (4, 0));
    for (index, picture) in shown.iter().enumerate() {
        let of = index.min(2);
        let (size, pixels) = still(sheet, &scenes[of].1, &styles[of]);
        assert_eq!((picture.size, picture.delay_ms), (size, 125.0));
        let apart: Vec<u8> = std::iter::zip(&picture.pixels, &pixels)
            .map(|(a, b)| a.abs_diff(*b))
            .collect();
        let mean = apart.iter().map(|d| f64::from(*d)).sum::<f64>() / apart.len() as f64;
        let far = apart.iter().filter(|apart| **apart > 12).count() as f64 / apart.len() as f64;
        println!("picture {index}: mean {mean:.3}, above 12 levels: {far:.5}");
        // the tolerance covers 255 colours (see `each_colour_of_a_scale_is_near_one_of_the_palette`); blends of ink
        // with dark colours are farther away
        assert!(mean < 0.5 && far < 0.0015, "picture {index}: {mean} {far}");
    }
    assert_eq!(shown[2].pixels, shown[3].pixels);
}

#[test]
fn a_picture_without_values_shows_the_bare_sheet() {
    let (sheet, map) = scene([0.08, 0.08], 0.5);
    let nothing = Map {
        values: vec![f64::NAN; map.values.len()],
        method: "no frame at this time".into(),
        ..map.clone()
    };
    let style = Style {
        hot_spots: Some(Vec::new()),
        ..Style::default()
    };
    let range = Range::of_film([(&map, &style), (&nothing, &style)].into_iter()).unwrap();
    let mut bytes = Vec::new();
    let pace = Pace {
        pictures: 2,
        each_ms: 100,
    };
    let mut film = Film::new(&mut bytes, &sheet, range, &style, pace).unwrap();
    film.add(&map, &style).unwrap();
    film.add(&nothing, &style).unwrap();
    film.finish().unwrap();
    let (shown, _) = watched(&bytes);
    let middle = |picture: &Shown| {
        let [width, height] = picture.size.map(|side| side as usize);
        let at = 3 * (height / 2 * width + width / 2);
        [0, 1, 2].map(|channel| picture.pixels[at + channel])
    };
    let [pressed, bare] = [&shown[0], &shown[1]].map(middle);
    assert!(pressed[0] < 120, "{pressed:?}");
    assert!(bare.iter().all(|channel| *channel > 225), "{bare:?}");
}

#[test]
fn a_film_has_as_many_pictures_as_announced() {
    let (sheet, map) = scene([0.08, 0.08], 0.5);
    let style = style("one", [0.08, 0.08]);
    let range = Range::of_film([(&map, &style)].into_iter()).unwrap();
    let film = |pictures: u32| {
        let pace = Pace {
            pictures,
            each_ms: 100,
        };
        Film::new(Vec::new(), &sheet, range, &style, pace)
    };
    assert!(film(0).is_err());
    let mut long = film(2).unwrap();
    long.add(&map, &style).unwrap();
    assert!(long.finish().is_err(), "one is missing");
    let other = Map {
        values: vec![0.0; 3],
        ..map.clone()
    };
    assert!(film(1).unwrap().add(&other, &style).is_err());
}
