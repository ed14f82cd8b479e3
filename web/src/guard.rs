//! Access check of every HTTP request (exact `Host`, same origin, token), and the security headers of every response.

use std::str::FromStr;
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use crate::Settings;
use crate::token::Token;

/// A value of `Host` that is accepted: a name, or a name and a port.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HostName(String);

/// A text that is not a host name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("'{0}' is not a host name such as lab.example.org or lab.example.org:8443")]
pub struct HostNameError(String);

impl FromStr for HostName {
    type Err = HostNameError;

    fn from_str(text: &str) -> Result<Self, HostNameError> {
        let (name, port) = text.split_once(':').unwrap_or((text, "1"));
        let part = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '.';
        let good = !name.is_empty() && name.chars().all(part) && port.parse::<u16>().is_ok();
        match good {
            true => Ok(Self(text.to_ascii_lowercase())),
            false => Err(HostNameError(text.to_owned())),
        }
    }
}

/// The rules that a request must satisfy.
#[derive(Debug)]
pub(crate) struct Guard {
    hosts: Vec<String>,
    token: Token,
    /// Whether commands are allowed.
    control: bool,
}

impl Guard {
    pub(crate) fn new(port: u16, settings: &Settings) -> Self {
        let own = ["127.0.0.1", "localhost", "[::1]"].map(|name| format!("{name}:{port}"));
        let names = settings.names.iter().map(|name| name.0.clone());
        Self {
            hosts: own.into_iter().chain(names).collect(),
            token: settings.token.clone(),
            control: settings.control.is_some(),
        }
    }

    /// Why a request is refused.
    fn refusal(&self, method: &Method, path: &str, headers: &HeaderMap) -> Option<Refusal> {
        // the only header that a page of another site cannot choose if the site's name resolves to this machine (DNS
        // rebinding)
        let mut hosts = headers.get_all(header::HOST).iter();
        let (host, second) = (
            hosts.next().and_then(|host| host.to_str().ok()),
            hosts.next(),
        );
        let known = host.is_some_and(|host| self.hosts.contains(&host.to_ascii_lowercase()));
        if !known || second.is_some() {
            return Some((
                StatusCode::FORBIDDEN,
                "this name is not served here; `tactus web --name NAME` allows it\n",
            ));
        }
        let reads = method == Method::GET || method == Method::HEAD;
        if !reads && (method != Method::POST || path != CONTROL) {
            return Some((
                StatusCode::METHOD_NOT_ALLOWED,
                "only GET, and POST of commands to /api/control, are allowed\n",
            ));
        }
        if !reads && !self.control {
            return Some((StatusCode::FORBIDDEN, READ_ONLY));
        }
        if !path.starts_with("/api/") {
            return None;
        }
        let site = headers.get(HeaderName::from_static("sec-fetch-site"));
        let known = |site: &HeaderValue| site == "same-origin" || (reads && site == "none");
        if site.is_some_and(|site| !known(site)) {
            return Some((
                StatusCode::FORBIDDEN,
                "a page of another site may not use this\n",
            ));
        }
        // a form of another site can send other content types without a CORS preflight
        let kind = headers.get(header::CONTENT_TYPE);
        if !reads && kind.is_none_or(|kind| kind != "application/json") {
            let text = "a command needs Content-Type: application/json\n";
            return Some((StatusCode::UNSUPPORTED_MEDIA_TYPE, text));
        }
        let bearer = headers
            .get(header::AUTHORIZATION)
            .and_then(|value| value.as_bytes().strip_prefix(b"Bearer "));
        match bearer {
            Some(token) if self.token.is(token) => None,
            _ => Some((
                StatusCode::UNAUTHORIZED,
                "the token is missing or wrong; open the address that `tactus web` prints\n",
            )),
        }
    }
}

/// Path of commands.
const CONTROL: &str = "/api/control";
/// Text for a command that is refused because the page only reads.
pub(crate) const READ_ONLY: &str =
    "this page is read-only; `tactus web --control` allows commands\n";

type Refusal = (StatusCode, &'static str);

/// Headers of every response.
const HEADERS: [(&str, &str); 6] = [
    (
        "content-security-policy",
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    ),
    ("x-content-type-options", "nosniff"),
    ("cross-origin-resource-policy", "same-origin"),
    ("cross-origin-opener-policy", "same-origin"),
    ("referrer-policy", "no-referrer"),
    ("cache-control", "no-store"),
];

/// Middleware: refuses or forwards a request, and adds the headers to the response.
pub(crate) async fn check(
    State(guard): State<Arc<Guard>>,
    request: Request,
    next: Next,
) -> Response {
    let refusal = guard.refusal(request.method(), request.uri().path(), request.headers());
    let mut response = match refusal {
        Some(refusal) => refusal.into_response(),
        None => next.run(request).await,
    };
    for (name, value) in HEADERS {
        let name = HeaderName::from_static(name);
        let value = HeaderValue::from_static(value);
        response.headers_mut().entry(name).or_insert(value);
    }
    response
}
