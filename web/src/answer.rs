//! HTTP responses that the live page and playback share.

use std::sync::Arc;

use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use imaging::quantities::RegionShape;
use serde::Serialize;
use tokio::sync::Semaphore;

/// A response, or a refusal with a sentence.
pub(crate) type Answer = Result<Response, (StatusCode, String)>;

pub(crate) fn refused(code: StatusCode, why: impl std::fmt::Display) -> (StatusCode, String) {
    (code, format!("{why}\n"))
}

/// Runs `work` on a blocking thread, and not on the server's own. `bound` limits how many of these run at the same
/// time; each holds its permit until it is done, even if its client has gone.
pub(crate) async fn worked<T: Send + 'static>(
    bound: Option<Arc<Semaphore>>,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, (StatusCode, String)> {
    let stops = || refused(StatusCode::SERVICE_UNAVAILABLE, "the server is stopping");
    let permit = match bound {
        Some(bound) => Some(bound.acquire_owned().await.map_err(|_| stops())?),
        None => None,
    };
    let worker = tokio::task::spawn_blocking(move || {
        let _permit = permit;
        work()
    });
    worker.await.map_err(|_| stops())
}

/// A response of JSON text.
pub(crate) fn json(text: Arc<str>) -> Response {
    let kind = [(header::CONTENT_TYPE, "application/json")];
    (kind, text.to_string()).into_response()
}

/// A geometry with coordinates in mm.
pub(crate) fn geometry_json(geometry: &dbus::Geometry) -> String {
    let millimetres = |metres: &[f64]| -> Vec<f64> {
        metres
            .iter()
            .map(|metres| (1e6 * metres).round() * 1e-3)
            .collect()
    };
    let regions = geometry.more.regions.as_deref();
    let regions = regions.and_then(|json| serde_json::from_str::<Vec<RegionShape>>(json).ok());
    serde_json::json!({
        "name": geometry.more.name,
        // empty for a daemon of an earlier version
        "regions": regions.unwrap_or_default(),
        "nodes": millimetres(&geometry.nodes),
        "triangles": geometry.triangles,
        "outline": millimetres(&geometry.outline),
        "outline_lengths": geometry.outline_lengths,
        "electrodes": millimetres(&geometry.electrodes),
    })
    .to_string()
}

/// Values as single-precision numbers, little-endian.
pub(crate) fn bytes(values: &[f32]) -> Vec<u8> {
    let each = values.iter().flat_map(|value| value.to_le_bytes());
    each.collect()
}

/// A response of the length of the JSON (u32), the JSON padded with spaces to a multiple of four, and the values in
/// single precision; all little-endian.
pub(crate) fn packed(head: &impl Serialize, values: &[f32]) -> Response {
    let mut text = serde_json::json!(head).to_string();
    while !text.len().is_multiple_of(4) {
        text.push(' ');
    }
    let mut packed = (text.len() as u32).to_le_bytes().to_vec();
    packed.extend(text.as_bytes());
    packed.extend(bytes(values));
    let media = [(header::CONTENT_TYPE, "application/octet-stream")];
    (media, packed).into_response()
}
