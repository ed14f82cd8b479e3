use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use imaging::quantities::QuantityRow;
use render::Sheet;

use super::{
    Course, MapKind, Overview, Place, Playback, PlayedMap, Recordings, RegionShape, SessionEntry,
    SessionList,
};
use crate::tests::{code, served_from};

/// Three sessions; counts how often one is opened.
#[derive(Default)]
struct Shelf {
    opened: Arc<AtomicUsize>,
}

impl Recordings for Shelf {
    fn list(&self) -> Result<SessionList, String> {
        let entry = |id: &str| SessionEntry {
            id: id.to_owned(),
            started_ms: 1000,
            last_ms: Some(3000),
            frames: 3,
            simulated: true,
            closed: true,
            note: "a \"note\"".to_owned(),
        };
        Ok(SessionList {
            sessions: ["m1", "m2", "m3"].map(entry).to_vec(),
            left_out: vec!["m4.tactus is left out: it is empty".to_owned()],
        })
    }

    fn open(&self, id: &str) -> Result<Option<Arc<dyn Playback>>, String> {
        if !["m1", "m2", "m3"].contains(&id) {
            return Ok(None);
        }
        self.opened.fetch_add(1, Ordering::Relaxed);
        Ok(Some(Arc::new(Session(Overview {
            id: id.to_owned(),
            note: String::new(),
            simulated: true,
            first_frame: 1,
            last_frame: 3,
            first_ms: 1000,
            last_ms: 3000,
            events: Vec::new(),
            regions: vec![RegionShape {
                name: "hip".to_owned(),
                corners_mm: vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]],
            }],
        }))))
    }
}

struct Session(Overview);

/// One triangle.
static SHEET: std::sync::LazyLock<Sheet> = std::sync::LazyLock::new(|| Sheet {
    triangles: vec![[[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]]],
    outline: vec![vec![[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]]],
    electrodes: vec![[0.05, 0.0]],
});

impl Playback for Session {
    fn overview(&self) -> &Overview {
        &self.0
    }

    fn sheet(&self) -> &Sheet {
        &SHEET
    }

    fn course(&self, spans: u32) -> Result<Course, String> {
        Ok(Course {
            progress: 0.5,
            failed: None,
            source: format!("at most {spans}"),
            rows: Vec::<QuantityRow>::new(),
            span_s: 60,
        })
    }

    fn map(&self, place: Place, kind: MapKind) -> Result<PlayedMap, String> {
        let sequence = match place {
            Place::Frame(frame) if frame <= 3 => frame,
            Place::Frame(frame) => return Err(format!("no frame {frame}")),
            Place::Time(ms) => ms.unsigned_abs() / 1000,
        };
        Ok(PlayedMap {
            sequence,
            wall_ms: 1000 * sequence as i64,
            method: format!("{kind:?}"),
            unit: "lost share",
            provisional: None,
            noise: None,
            tracked: None,
            quantities: None,
            values: vec![0.5],
        })
    }
}

#[tokio::test]
async fn sessions_are_listed_opened_and_kept() {
    let shelf = Shelf::default();
    let opened = Arc::clone(&shelf.opened);
    let served = served_from(None, Arc::new(shelf)).await;
    let list = served.get("/api/sessions").await;
    assert!(
        list.contains(r#""id":"m2","started_ms":1000,"last_ms":3000,"frames":3"#),
        "{list}"
    );
    let left_out = r#""left_out":["m4.tactus is left out: it is empty"]"#;
    assert!(list.contains(left_out), "{list}");
    let one = served.get("/api/sessions/m1").await;
    for part in [
        r#""nodes":[0.0,0.0,100.0,0.0,0.0,100.0]"#,
        r#""triangles":[0,1,2]"#,
        r#""name":"hip""#,
    ] {
        assert!(one.contains(part), "{part} in {one}");
    }
    let course = served.get("/api/sessions/m1/course").await;
    assert!(course.contains(r#""progress":0.5"#), "{course}");
    assert_eq!(opened.load(Ordering::Relaxed), 1);
    // two stay open: the third replaces the least recently used one
    for (id, count) in [("m2", 2), ("m1", 2), ("m3", 3), ("m1", 3), ("m2", 4)] {
        assert_eq!(
            code(&served.get(&format!("/api/sessions/{id}/course")).await),
            "200"
        );
        assert_eq!(opened.load(Ordering::Relaxed), count, "{id}");
    }
}

#[tokio::test]
async fn a_map_is_its_header_and_its_values() {
    let served = served_from(None, Arc::new(Shelf::default())).await;
    for (path, sequence, method) in [
        ("quick/frame/2", 2, "Quick"),
        ("exact/ms/3000", 3, "Exact"),
        ("unrelieved/ms/-1000", 1, "Unrelieved"),
        ("deviation/frame/2", 2, "Deviation"),
    ] {
        let bytes = served.bytes(&format!("/api/sessions/m1/maps/{path}")).await;
        let length = u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize;
        assert_eq!(length % 4, 0);
        let head: serde_json::Value = serde_json::from_slice(&bytes[4..4 + length]).unwrap();
        assert_eq!(
            (&head["sequence"], &head["method"]),
            (&sequence.into(), &method.into())
        );
        assert_eq!(bytes[4 + length..], 0.5_f32.to_le_bytes());
    }
}

#[tokio::test]
async fn unknown_sessions_and_places_are_refused() {
    let shelf = Shelf::default();
    let opened = Arc::clone(&shelf.opened);
    let served = served_from(None, Arc::new(shelf)).await;
    for (path, wanted, words) in [
        ("m4", "404", "no recorded session m4"),
        ("..%2F..%2Fetc%2Fpasswd", "404", "no recorded session"),
        (
            "m1/maps/best/frame/1",
            "400",
            "quick, exact, unrelieved or deviation",
        ),
        ("m1/maps/quick/frame/-1", "400", "frame/NUMBER"),
        ("m1/maps/quick/day/1", "400", "frame/NUMBER"),
        (
            "m1/maps/quick/frame/99999999999999999999999",
            "400",
            "frame/NUMBER",
        ),
        ("m1/maps/quick/frame/4", "409", "no frame 4"),
    ] {
        let answer = served.get(&format!("/api/sessions/{path}")).await;
        assert_eq!(code(&answer), wanted, "{path}: {answer}");
        assert!(answer.contains(words), "{path}: {answer}");
    }
    assert_eq!(opened.load(Ordering::Relaxed), 1, "only m1 is opened");
}
