//! Films, read back by the crate `png`.

use std::path::Path;

use super::refusals::left;
use crate::scene::{done, lines, refused, session, session_with_alarms};

const METHOD: [&str; 4] = ["--preset", "disc-tank", "--noise-v", "2e-6"];
const SCALE: [&str; 2] = ["--scale", "0,70"];

struct Watched {
    size: [u32; 2],
    /// Red, green and blue of the first picture.
    first: Vec<u8>,
    /// Delay of each picture, ms.
    delays: Vec<u16>,
}

fn watched(path: &Path) -> Watched {
    let bytes = std::fs::read(path).unwrap();
    let mut decoder = png::Decoder::new(std::io::Cursor::new(&bytes));
    decoder.set_transformations(png::Transformations::EXPAND | png::Transformations::ALPHA);
    let mut reader = decoder.read_info().unwrap();
    let size = [reader.info().width, reader.info().height];
    let count = reader.info().animation_control().unwrap().num_frames;
    let (mut first, mut delays) = (Vec::new(), Vec::new());
    for _ in 0..count {
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        let control = reader.info().frame_control().unwrap();
        assert_eq!(control.delay_den, 1000);
        delays.push(control.delay_num);
        if first.is_empty() {
            first = pixels
                .chunks(4)
                .flat_map(|pixel| pixel[..3].to_vec())
                .collect();
        }
    }
    Watched {
        size,
        first,
        delays,
    }
}

fn film(folder: &Path, more: &[&str]) -> (Watched, serde_json::Value) {
    let export = [
        "export", "last", "--json", "--force", "--format", "apng", "-o", "out.png",
    ];
    let printed = done(folder, &[&export[..], &METHOD, &SCALE, more].concat());
    (watched(&folder.join("out.png")), lines(&printed)[0].clone())
}

#[test]
fn a_film_begins_with_the_picture_of_its_first_frame() {
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    let (film, line) = film(folder.path(), &[]);
    assert_eq!(film.delays, [100; 3]);
    assert_eq!(line["what"], "apng");
    assert_eq!((&line["pictures"], &line["frames"]), (&3.into(), &3.into()));
    assert_eq!(
        (&line["every_s"], &line["speed"]),
        (&1.0.into(), &10.0.into())
    );
    assert_eq!(line["simulated"], true);
    let still = [
        "export", "last", "--format", "png", "--frame", "1", "-o", "one.png",
    ];
    done(folder.path(), &[&still[..], &METHOD, &SCALE].concat());
    let bytes = std::fs::read(folder.path().join("one.png")).unwrap();
    let mut reader = png::Decoder::new(std::io::Cursor::new(&bytes))
        .read_info()
        .unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert_eq!(film.size, [info.width, info.height]);
    let apart = std::iter::zip(&film.first, &pixels).map(|(a, b)| f64::from(a.abs_diff(*b)));
    let mean = apart.sum::<f64>() / pixels.len() as f64;
    // the scale of the film is coloured; that of a single map below its noise is grey
    assert!(mean < 1.0, "{mean}");
}

#[test]
fn interval_and_speed_of_a_film_are_as_named() {
    let folder = tempfile::tempdir().unwrap();
    session_with_alarms(folder.path());
    let (slow, line) = film(folder.path(), &["--every", "250ms", "--speed", "0.5"]);
    assert_eq!(slow.delays, [500; 9], "2 s in quarters");
    assert_eq!(line["frames"], 9);
    let (fast, line) = film(folder.path(), &["--speed", "20"]);
    assert_eq!((fast.delays, &line["every_s"]), (vec![100; 2], &2.0.into()));
}

#[test]
fn films_that_cannot_be_made_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    let before = left(folder.path());
    let export = |more: &[&str], format: &str, code| {
        let export = ["export", "last", "--format", format, "--out", "out.x"];
        let message = refused(folder.path(), &[&export[..], &METHOD, more].concat(), code);
        assert_eq!(left(folder.path()), before, "{more:?}");
        message
    };
    let message = export(&["--every", "500us"], "apng", 2);
    assert!(message.contains("4001 pictures; at most 3000"), "{message}");
    let message = export(&["--every", "1s", "--speed", "1000"], "apng", 2);
    assert!(message.contains("between 0.02 and 60 s"), "{message}");
    let message = export(&["--speed", "0"], "apng", 2);
    assert!(message.contains("0.001"), "{message}");
    let message = export(&["--at", "1"], "apng", 2);
    assert!(message.contains("--at belongs to"), "{message}");
    let message = export(&["--every", "1s"], "png", 2);
    assert!(message.contains("--format apng"), "{message}");
    let message = export(&["--scale", "0,20kPa"], "apng", 2);
    assert!(message.contains("no calibration"), "{message}");
}
