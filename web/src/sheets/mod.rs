//! All sheets of an archive on the page: the interface that the program serving the page must supply, and the routes.

#[cfg(test)]
mod tests;

use std::sync::Arc;

use axum::Router;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::routing::get;
use serde_json::Value;
use tokio::sync::Semaphore;

use crate::answer::{Answer, json, refused, worked};

/// Catalogue queries that run at the same time.
const WORKERS: usize = 2;

/// The catalogue of an archive. Rows are objects whose fields are those of `docs/reference/json.md`.
pub trait Sheets: Send + Sync {
    /// Every machine, by site and name.
    ///
    /// # Errors
    /// A sentence: the catalogue cannot be read.
    fn machines(&self) -> Result<Value, String>;

    /// The newest sessions of a machine, the newest first. [`crate::Recordings::open`] opens one by `archive:SITE/DAQ/ID`.
    ///
    /// # Errors
    /// As [`Sheets::machines`].
    fn sessions(&self, site: &str, daq: &str) -> Result<Value, String>;
}

#[derive(Clone)]
struct Shared {
    sheets: Option<Arc<dyn Sheets>>,
    workers: Arc<Semaphore>,
}

/// The routes of all sheets; without an archive they answer 404.
pub(crate) fn router(sheets: Option<Arc<dyn Sheets>>) -> Router {
    Router::new()
        .route("/api/sheets", get(machines))
        .route("/api/sheets/{site}/{daq}", get(sessions))
        .with_state(Shared {
            sheets,
            workers: Arc::new(Semaphore::new(WORKERS)),
        })
}

async fn machines(State(shared): State<Shared>) -> Answer {
    shared.ask(|sheets| sheets.machines()).await
}

async fn sessions(
    State(shared): State<Shared>,
    Path((site, daq)): Path<(String, String)>,
) -> Answer {
    shared.ask(move |sheets| sheets.sessions(&site, &daq)).await
}

impl Shared {
    /// Queries the catalogue on a blocking thread.
    async fn ask(
        self,
        question: impl FnOnce(&dyn Sheets) -> Result<Value, String> + Send + 'static,
    ) -> Answer {
        let Some(sheets) = self.sheets else {
            let text = "this page has no archive; `tactus web --archive` shows all sheets\n";
            return Err((StatusCode::NOT_FOUND, text.to_owned()));
        };
        let found = worked(Some(self.workers), move || question(&*sheets)).await?;
        let found = found.map_err(|why| refused(StatusCode::CONFLICT, why))?;
        Ok(json(found.to_string().into()))
    }
}
