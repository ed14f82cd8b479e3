//! The routes: the page's files, and the data that the page reads.

use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::Bytes;
use axum::extract::{DefaultBodyLimit, Path, State};
use axum::http::{StatusCode, header};
use axum::middleware;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use tokio::sync::{Semaphore, watch};

use crate::answer::{Answer, geometry_json, json, packed, refused, worked};
use crate::beside::Beside;
use crate::control::{self, Call};
use crate::guard::{self, Guard};
use crate::page;
use crate::playback::{self, Recordings};
use crate::sheets;
use crate::snapshot::{Live, OfSession};
use crate::{Control, Settings};

/// Most pages that wait for a change at the same time.
const WAITING: usize = 32;
/// Time after which a page receives the state without a change, so that a lost connection is noticed.
const KEEP_ALIVE: Duration = Duration::from_secs(15);

/// Header of data that belong to a session: the id of the session in the state at that moment, empty if there is none.
/// A page ignores data of another session than that of its own state, because a session may have begun since.
const SESSION: &str = "tactus-session";

/// Most bytes of a command.
const LONGEST_COMMAND: usize = 8192;

#[derive(Clone)]
struct Shared {
    live: Live,
    stop: watch::Receiver<bool>,
    waiting: Arc<Semaphore>,
    colours: Arc<str>,
    control: Option<Control>,
    beside: Arc<Beside>,
}

/// All routes behind the guard.
pub(crate) fn router(
    settings: &Settings,
    port: u16,
    live: Live,
    recordings: Arc<dyn Recordings>,
    beside: Arc<Beside>,
    stop: watch::Receiver<bool>,
) -> Router {
    let guard = Arc::new(Guard::new(port, settings));
    let shared = Shared {
        live,
        stop,
        waiting: Arc::new(Semaphore::new(WAITING)),
        colours: colours().into(),
        control: settings.control.clone(),
        beside,
    };
    let mut router = Router::new();
    for (path, kind, text) in page::FILES {
        router = router.route(path, get(move || async move { file(kind, text) }));
    }
    router
        .route("/api/state", get(state))
        .route("/api/state/{version}", get(next_state))
        .route("/api/geometry", get(geometry))
        .route(
            "/api/colours",
            get(|State(shared): State<Shared>| async move { json(shared.colours) }),
        )
        .route("/api/map/{sequence}", get(map))
        .route("/api/provisional/{sequence}", get(provisional))
        .route("/api/deviation", get(deviation))
        .route("/api/control", post(control))
        .layer(DefaultBodyLimit::max(LONGEST_COMMAND))
        .fallback(|| async { (StatusCode::NOT_FOUND, "no such page\n") })
        .with_state(shared)
        .merge(sheets::router(recordings.sheets()))
        .merge(playback::history::router(Arc::clone(&recordings)))
        .merge(playback::routes::router(recordings))
        .layer(middleware::from_fn_with_state(guard, guard::check))
}

fn file(kind: &'static str, text: &'static str) -> Response {
    ([(header::CONTENT_TYPE, kind)], text).into_response()
}

/// 256 colours each from zero to the largest load and to the largest gain, as in every other picture:
/// `{"loads": [[r, g, b], ...], "gains": ...}`.
fn colours() -> String {
    let colours = |sign: f64| -> Vec<render::Rgb> {
        let steps = (0..256).map(f64::from);
        steps
            .filter_map(|step| render::colour(sign * step / 255.0))
            .collect()
    };
    serde_json::json!({"loads": colours(-1.0), "gains": colours(1.0)}).to_string()
}

async fn state(State(shared): State<Shared>) -> Response {
    shared.beside.set_watched();
    let text = shared.live.subscribe().borrow().json();
    json(text.into())
}

/// A command for the daemon. The guard forwards it only if the page may control.
async fn control(State(shared): State<Shared>, body: Bytes) -> Response {
    let Some(to) = &shared.control else {
        return (StatusCode::FORBIDDEN, guard::READ_ONLY).into_response();
    };
    let call: Call = match serde_json::from_slice(&body) {
        Ok(call) => call,
        Err(error) => {
            let text = format!("this is not a command: {error}");
            return refused(StatusCode::BAD_REQUEST, text).into_response();
        }
    };
    match control::carry_out(to.address.as_ref(), call).await {
        Ok(()) => StatusCode::NO_CONTENT.into_response(),
        Err(why) => refused(StatusCode::CONFLICT, why).into_response(),
    }
}

async fn geometry(State(shared): State<Shared>) -> Response {
    match shared.live.geometry() {
        Some((session, geometry)) => {
            let text = json(geometry_json(&geometry).into());
            ([(SESSION, session)], text).into_response()
        }
        None => (StatusCode::NOT_FOUND, "no geometry yet\n").into_response(),
    }
}

/// A map as little-endian single precision, one value a triangle. A browser must not cache it: the next session has
/// frames with the same numbers.
async fn map(State(shared): State<Shared>, Path(sequence): Path<String>) -> Response {
    let sequence = sequence.parse().ok();
    kept(sequence.and_then(|sequence| shared.live.map(sequence)))
}

/// The map that is shown until the map of the session's own method arrives, in the same format.
async fn provisional(State(shared): State<Shared>, Path(sequence): Path<String>) -> Response {
    let sequence = sequence.parse().ok();
    kept(sequence.and_then(|sequence| shared.live.provisional(sequence)))
}

/// Standard deviations of the last frame, or of one of the last seconds: `{"session", "sequence", "unit"}` and one
/// value a triangle.
async fn deviation(State(shared): State<Shared>) -> Answer {
    let beside = Arc::clone(&shared.beside);
    let made = worked(None, move || beside.deviation(&shared.live)).await?;
    let made = made.map_err(|why| refused(StatusCode::CONFLICT, why))?;
    Ok(packed(&*made, &made.values))
}

fn kept(known: Option<OfSession<Arc<[u8]>>>) -> Response {
    match known {
        Some((session, map)) => (
            [(header::CONTENT_TYPE, "application/octet-stream")],
            [(SESSION, session)],
            Bytes::from_owner(map),
        )
            .into_response(),
        None => (StatusCode::NOT_FOUND, "this map is no longer kept\n").into_response(),
    }
}

/// The state after a version that the page has: at once if there is a newer one, otherwise at the next change. The page
/// requests the next one when it has read the response: over a slow link it gets fewer states, but no old ones.
async fn next_state(State(mut shared): State<Shared>, Path(known): Path<String>) -> Response {
    let Ok(known) = known.parse::<u64>() else {
        return (StatusCode::BAD_REQUEST, "the version must be a number\n").into_response();
    };
    let Ok(_permit) = Arc::clone(&shared.waiting).try_acquire_owned() else {
        let text = format!("{WAITING} pages are connected already; close one\n");
        return (StatusCode::SERVICE_UNAVAILABLE, text).into_response();
    };
    let mut changes = shared.live.subscribe();
    let changed = async {
        // an error means that the sender is gone: no further change
        let _ = changes.wait_for(|now| now.version != known).await;
    };
    tokio::select! {
        _ = tokio::time::timeout(KEEP_ALIVE, changed) => {}
        _ = shared.stop.wait_for(|stop| *stop) => {}
    }
    state(State(shared)).await
}
