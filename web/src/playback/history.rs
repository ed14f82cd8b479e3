//! `/api/history/HOURS/REGION`: stored quantities over all sessions, for the last hours.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use axum::Router;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::routing::get;
use imaging::quantities::{SHEET, is_name};

use super::{History, Recordings};
use crate::answer::{Answer, json, refused, worked};

/// Most rows of a curve: one for about two pixels of a screen.
const SPANS: u32 = 720;
/// Longest period, h: ten years.
const LONGEST_H: u32 = 87_600;
/// Time for which a response is reused: months of rows are read once, for any number of pages.
const KEPT_FOR: Duration = Duration::from_secs(20);
/// Most responses that are kept.
const ANSWERS: usize = 64;

/// Hours and region.
type Request = (u32, String);

/// Time when the response was made, and its text.
type Kept = (Instant, Arc<str>);

#[derive(Clone)]
struct Shared {
    recordings: Arc<dyn Recordings>,
    answers: Arc<Mutex<HashMap<Request, Kept>>>,
}

/// The route of the history.
pub(crate) fn router(recordings: Arc<dyn Recordings>) -> Router {
    Router::new()
        .route("/api/history/{hours}/{region}", get(history))
        .with_state(Shared {
            recordings,
            answers: Arc::default(),
        })
}

/// The requested period, and its rows.
#[derive(serde::Serialize)]
struct Rows {
    from_ms: i64,
    to_ms: i64,
    #[serde(flatten)]
    history: History,
}

async fn history(
    State(shared): State<Shared>,
    Path((hours, region)): Path<(String, String)>,
) -> Answer {
    let hours = hours.parse().ok().filter(|h| (1..=LONGEST_H).contains(h));
    let (Some(hours), true) = (hours, region == SHEET || is_name(&region)) else {
        let text = format!(
            "the address of a history is history/HOURS/REGION, with 1 to {LONGEST_H} hours"
        );
        return Err(refused(StatusCode::BAD_REQUEST, text));
    };
    // the lock lets one request compute at a time; the next one finds the response of the first
    let found = worked(None, move || shared.answer(hours, &region)).await?;
    let text = found.map_err(|why| refused(StatusCode::CONFLICT, why))?;
    Ok(json(text))
}

impl Shared {
    fn answer(&self, hours: u32, region: &str) -> Result<Arc<str>, String> {
        let mut answers = self.answers.lock().unwrap_or_else(PoisonError::into_inner);
        answers.retain(|_, (made, _)| made.elapsed() < KEPT_FOR);
        let request = (hours, region.to_owned());
        if let Some((_, text)) = answers.get(&request) {
            return Ok(Arc::clone(text));
        }
        let now = SystemTime::now().duration_since(UNIX_EPOCH);
        let to_ms = now.map_or(0, |since| since.as_millis() as i64);
        let from_ms = to_ms - 3_600_000 * i64::from(hours);
        let ends = (from_ms.div_euclid(1000), to_ms.div_euclid(1000));
        let history = self.recordings.history(ends.0, ends.1, region, SPANS)?;
        let answer = Rows {
            from_ms,
            to_ms,
            history,
        };
        let text: Arc<str> = serde_json::json!(answer).to_string().into();
        if answers.len() < ANSWERS {
            answers.insert(request, (Instant::now(), Arc::clone(&text)));
        }
        Ok(text)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};

    use imaging::quantities::{LoadUnit, Quantity, QuantityRow};

    use super::*;
    use crate::tests::served_from;
    use crate::{Playback, SessionList};

    /// Returns one row of load per request, and counts the requests.
    #[derive(Default)]
    struct Counted(AtomicU64);

    impl Recordings for Counted {
        fn list(&self) -> Result<SessionList, String> {
            Ok(SessionList::default())
        }

        fn open(&self, _: &str) -> Result<Option<Arc<dyn Playback>>, String> {
            Ok(None)
        }

        fn history(&self, from_s: i64, to_s: i64, region: &str, _: u32) -> Result<History, String> {
            if region == "gone" {
                return Err("the folder cannot be read".to_owned());
            }
            let count = self.0.fetch_add(1, Ordering::Relaxed);
            Ok(History {
                rows: vec![QuantityRow {
                    begin_s: from_s,
                    region: region.to_owned(),
                    quantity: Quantity::Load,
                    of: LoadUnit::Pressure,
                    min: 1.0,
                    mean: 2.0,
                    max: (to_s - from_s) as f64,
                    frames: count,
                    known: 1,
                }],
                span_s: 120,
                regions: vec!["sheet".to_owned(), "hip".to_owned()],
                damaged: 0,
                other_unit: 3,
            })
        }
    }

    #[tokio::test]
    async fn a_history_has_its_time_and_is_read_once() {
        let served = served_from(None, Arc::new(Counted::default())).await;
        let ask = async |path: &str| -> serde_json::Value {
            serde_json::from_slice(&served.bytes(path).await).unwrap()
        };
        let first = ask("/api/history/2/sheet").await;
        let length = first["to_ms"].as_i64().unwrap() - first["from_ms"].as_i64().unwrap();
        assert_eq!(length, 7_200_000);
        assert_eq!(first["rows"][0]["max"], 7200.0);
        assert_eq!(first["rows"][0]["quantity"], "load");
        assert_eq!(first["regions"], serde_json::json!(["sheet", "hip"]));
        assert_eq!(first["other_unit"], 3);
        let again = ask("/api/history/2/sheet").await;
        assert_eq!(again, first);
        let other = ask("/api/history/2/hip").await;
        assert_eq!(other["rows"][0]["frames"], 1);
    }

    #[tokio::test]
    async fn a_history_of_no_time_or_region_is_refused() {
        let served = served_from(None, Arc::new(Counted::default())).await;
        for path in [
            "0/sheet",
            "x/sheet",
            "-1/sheet",
            "99999999/sheet",
            "1/a%2Fb",
            "1/%20",
        ] {
            let answer = served.get(&format!("/api/history/{path}")).await;
            assert_eq!(crate::tests::code(&answer), "400", "{path}: {answer}");
        }
        let answer = served.get("/api/history/1/gone").await;
        assert_eq!(crate::tests::code(&answer), "409", "{answer}");
        assert!(answer.contains("the folder cannot be read"), "{answer}");
    }
}
