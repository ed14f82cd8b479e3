use std::sync::Arc;

use serde_json::{Value, json};

use super::Sheets;
use crate::playback::{Playback, Recordings, SessionList};
use crate::tests::{code, served_from};

/// An archive of one machine, or one that cannot be reached.
#[derive(Clone, Copy)]
struct Archive {
    reachable: bool,
}

impl Sheets for Archive {
    fn machines(&self) -> Result<Value, String> {
        match self.reachable {
            true => Ok(json!([{"site": "berlin", "daq": "bed3", "alarms": ["<b>heel"]}])),
            false => Err("cannot reach PostgreSQL at db:5432".to_owned()),
        }
    }

    fn sessions(&self, site: &str, daq: &str) -> Result<Value, String> {
        Ok(json!([{"id": format!("of {site} and {daq}")}]))
    }
}

impl Recordings for Archive {
    fn list(&self) -> Result<SessionList, String> {
        Ok(SessionList::default())
    }

    fn open(&self, _: &str) -> Result<Option<Arc<dyn Playback>>, String> {
        Ok(None)
    }

    fn sheets(&self) -> Option<Arc<dyn Sheets>> {
        Some(Arc::new(*self))
    }
}

#[tokio::test]
async fn machines_and_their_sessions_are_answered_as_json() {
    let served = served_from(None, Arc::new(Archive { reachable: true })).await;
    let machines = served.get("/api/sheets").await;
    assert!(
        machines.contains("content-type: application/json"),
        "{machines}"
    );
    assert!(
        machines.ends_with(r#"[{"site":"berlin","daq":"bed3","alarms":["<b>heel"]}]"#),
        "{machines}"
    );
    let sessions = served.get("/api/sheets/berlin/bed%203").await;
    assert!(
        sessions.ends_with(r#"[{"id":"of berlin and bed 3"}]"#),
        "{sessions}"
    );
    for path in ["/api/sheets/berlin", "/api/sheets/berlin/bed3/m1"] {
        assert_eq!(code(&served.get(path).await), "404", "{path}");
    }
}

#[tokio::test]
async fn archive_that_is_missing_or_down_is_a_sentence() {
    let down = served_from(None, Arc::new(Archive { reachable: false })).await;
    let answer = down.get("/api/sheets").await;
    assert_eq!(code(&answer), "409");
    assert!(
        answer.ends_with("cannot reach PostgreSQL at db:5432\n"),
        "{answer}"
    );
    let none = served_from(None, Arc::new(crate::tests::NoRecordings)).await;
    for path in ["/api/sheets", "/api/sheets/berlin/bed3"] {
        let answer = none.get(path).await;
        assert_eq!(code(&answer), "404", "{path}");
        assert!(answer.contains("tactus web --archive"), "{answer}");
    }
}
