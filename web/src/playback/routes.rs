//! `/api/sessions`: the list, a session, its quantities over time, its maps.

use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::Duration;

use axum::Router;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::routing::get;
use render::Sheet;
use tokio::sync::Semaphore;
use tokio::time::Instant;

use super::{MapKind, Place, Playback, Recordings};
use crate::answer::{Answer, geometry_json, json, packed, refused, worked};

/// Most sessions that stay open.
const OPEN: usize = 2;
/// Time without a request after which a session is closed: an open session keeps the daemon from completing its file.
const IDLE: Duration = Duration::from_secs(60);
const IDLE_CHECK: Duration = Duration::from_secs(15);
/// Requests that are computed at the same time.
const WORKERS: usize = 4;
/// Most rows of a curve: one for about two pixels of a screen.
const SPANS: u32 = 720;

#[derive(Clone)]
struct Shared {
    recordings: Arc<dyn Recordings>,
    /// The open sessions, the last used at the end.
    open: Arc<Mutex<Vec<Opened>>>,
    /// Held while a session is opened: fetching one from an archive may take minutes, and the open sessions are played
    /// meanwhile.
    opening: Arc<Mutex<()>>,
    workers: Arc<Semaphore>,
}

/// An open session, and when it was used last.
#[derive(Clone)]
struct Opened {
    playback: Arc<dyn Playback>,
    used: Instant,
}

/// Closes sessions that are not used any more; ends when the routes are dropped.
async fn close_idle(open: Weak<Mutex<Vec<Opened>>>) {
    let mut ticks = tokio::time::interval(IDLE_CHECK);
    loop {
        let now = ticks.tick().await;
        let Some(open) = open.upgrade() else { return };
        let mut open = open.lock().unwrap_or_else(PoisonError::into_inner);
        open.retain(|opened| now.duration_since(opened.used) < IDLE);
    }
}

/// The routes of recorded sessions. Must be called in a tokio runtime.
pub(crate) fn router(recordings: Arc<dyn Recordings>) -> Router {
    let open = Arc::default();
    tokio::spawn(close_idle(Arc::downgrade(&open)));
    Router::new()
        .route("/api/sessions", get(list))
        .route("/api/sessions/{id}", get(session))
        .route("/api/sessions/{id}/course", get(course))
        .route("/api/sessions/{id}/maps/{kind}/{by}/{number}", get(map))
        .with_state(Shared {
            recordings,
            open,
            opening: Arc::default(),
            workers: Arc::new(Semaphore::new(WORKERS)),
        })
}

impl Shared {
    /// Runs `work` on a blocking thread, limited by `workers`.
    async fn work<T: Send + 'static>(
        self,
        work: impl FnOnce(&Self) -> Result<T, (StatusCode, String)> + Send + 'static,
    ) -> Result<T, (StatusCode, String)> {
        worked(Some(Arc::clone(&self.workers)), move || work(&self)).await?
    }

    /// The session with this id if it is open.
    fn opened(&self, id: &str) -> Option<Arc<dyn Playback>> {
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        let place = open
            .iter()
            .position(|opened| opened.playback.overview().id == id)?;
        let playback = open.remove(place).playback;
        open.push(Opened {
            playback: Arc::clone(&playback),
            used: Instant::now(),
        });
        Some(playback)
    }

    /// The session with this id; opens it if it is not open.
    fn playback(&self, id: &str) -> Result<Arc<dyn Playback>, (StatusCode, String)> {
        if let Some(playback) = self.opened(id) {
            return Ok(playback);
        }
        let _opening = self.opening.lock().unwrap_or_else(PoisonError::into_inner);
        // another request may have opened it meanwhile
        if let Some(playback) = self.opened(id) {
            return Ok(playback);
        }
        let failed = |why| refused(StatusCode::CONFLICT, why);
        let playback = self.recordings.open(id).map_err(failed)?.ok_or_else(|| {
            let text = format!("there is no recorded session {id} here");
            refused(StatusCode::NOT_FOUND, text)
        })?;
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        if open.len() >= OPEN {
            open.remove(0);
        }
        open.push(Opened {
            playback: Arc::clone(&playback),
            used: Instant::now(),
        });
        Ok(playback)
    }
}

async fn list(State(shared): State<Shared>) -> Answer {
    let sessions = shared
        .work(|shared| {
            let sessions = shared.recordings.list();
            sessions.map_err(|why| refused(StatusCode::CONFLICT, why))
        })
        .await?;
    Ok(json(serde_json::json!(sessions).to_string().into()))
}

async fn session(State(shared): State<Shared>, Path(id): Path<String>) -> Answer {
    let playback = shared.work(move |shared| shared.playback(&id)).await?;
    let text = format!(
        "{{\"overview\":{},\"geometry\":{}}}",
        serde_json::json!(playback.overview()),
        geometry_json(&geometry(playback.sheet()))
    );
    Ok(json(text.into()))
}

/// A sheet in the form in which the daemon sends it; triangles share no nodes.
fn geometry(sheet: &Sheet) -> dbus::Geometry {
    dbus::Geometry {
        mesh_hash: String::new(),
        nodes: sheet
            .triangles
            .iter()
            .flatten()
            .flatten()
            .copied()
            .collect(),
        triangles: (0..3 * sheet.triangles.len() as u32).collect(),
        outline: sheet.outline.iter().flatten().flatten().copied().collect(),
        outline_lengths: sheet
            .outline
            .iter()
            .map(|points| points.len() as u32)
            .collect(),
        electrodes: sheet.electrodes.iter().flatten().copied().collect(),
        more: dbus::GeometryDetails::default(),
    }
}

async fn course(State(shared): State<Shared>, Path(id): Path<String>) -> Answer {
    let course = shared
        .work(move |shared| {
            let course = shared.playback(&id)?.course(SPANS);
            course.map_err(|why| refused(StatusCode::CONFLICT, why))
        })
        .await?;
    Ok(json(serde_json::json!(course).to_string().into()))
}

/// `/api/sessions/ID/maps/KIND/BY/NUMBER`: a kind, and a place given by `frame` or `ms`.
async fn map(
    State(shared): State<Shared>,
    Path((id, kind, by, number)): Path<(String, String, String, String)>,
) -> Answer {
    let asked = kind_of(&kind).zip(place_of(&by, &number));
    let (kind, place) = asked.ok_or_else(|| {
        let text = "the address of a map is maps/KIND/frame/NUMBER or maps/KIND/ms/TIME, with KIND quick, exact, unrelieved or deviation";
        refused(StatusCode::BAD_REQUEST, text.to_owned())
    })?;
    let played = shared
        .work(move |shared| {
            let played = shared.playback(&id)?.map(place, kind);
            played.map_err(|why| refused(StatusCode::CONFLICT, why))
        })
        .await?;
    Ok(packed(&played, &played.values))
}

fn kind_of(text: &str) -> Option<MapKind> {
    Some(match text {
        "quick" => MapKind::Quick,
        "exact" => MapKind::Exact,
        "unrelieved" => MapKind::Unrelieved,
        "deviation" => MapKind::Deviation,
        _ => return None,
    })
}

fn place_of(by: &str, number: &str) -> Option<Place> {
    match by {
        "frame" => number.parse().ok().map(Place::Frame),
        "ms" => number.parse().ok().map(Place::Time),
        _ => None,
    }
}
