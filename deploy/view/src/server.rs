//! The HTTP server of the page: its files, and the WebSocket with what happens.
//!
//! It only listens to the swarm, unless orders are allowed. What a browser sends is bounded: connections, headers, messages and
//! the time that a slow client may take. A page of another origin gets nothing, and a request under a foreign name is refused, so that a website
//! cannot reach the server through a name that resolves to this PC (DNS rebinding).

use std::net::TcpListener;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::extract::{Path, Request, State, WebSocketUpgrade};
use axum::http::header::{
    CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HOST, ORIGIN, REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::sync::{Semaphore, watch};

use super::live::Frame;
use super::names::Names;
use super::orders::Rule;
use super::{page, playback, socket};

/// Largest number of connections; one more is closed at once.
const MAX_CONNECTIONS: usize = 64;
/// Longest time that a client may take to send its headers.
const HEADERS_WITHIN: Duration = Duration::from_secs(10);
/// Largest message from a page, bytes: a page asks for little.
const MAX_MESSAGE: usize = 4 * 1024;
/// Number of bytes to a client that may wait: it is too slow when they are more.
const MAX_UNSENT: usize = 4 * 1024 * 1024;

/// The path of the WebSocket through which the swarm is shown.
const LIVE: &str = "/live";

/// The sources that the page may load: its own files and its own server.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; \
                      base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// The source of the snapshots.
pub(super) enum Source {
    /// A live swarm.
    Live(watch::Sender<Arc<Frame>>),
    /// A recording; each page plays it for itself.
    Recording(PathBuf),
}

/// The state that all requests share.
pub(super) struct Shared {
    pub(super) source: Source,
    /// The rule by which pages give orders; `None` if they may not.
    pub(super) orders: Option<Arc<Rule>>,
    /// The names under which this server may be asked for.
    pub(super) names: Names,
}

/// Serves until the runtime ends.
pub(super) async fn serve(listener: TcpListener, shared: Arc<Shared>) {
    let Ok(listener) = tokio::net::TcpListener::from_std(listener) else { return };
    let slots = Arc::new(Semaphore::new(MAX_CONNECTIONS));
    let router = router(shared);
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            // No free file: one may become free.
            tokio::time::sleep(Duration::from_millis(100)).await;
            continue;
        };
        let Ok(slot) = Arc::clone(&slots).try_acquire_owned() else { continue };
        let service = TowerToHyperService::new(router.clone());
        tokio::spawn(async move {
            let mut builder = http1::Builder::new();
            builder.timer(TokioTimer::new()).header_read_timeout(HEADERS_WITHIN);
            // A connection that breaks concerns its client only.
            let _ = builder.serve_connection(TokioIo::new(stream), service).with_upgrades().await;
            drop(slot);
        });
    }
}

fn router(shared: Arc<Shared>) -> Router {
    Router::new()
        .route("/", get(async || file("index.html")))
        // A page whose WebSocket is refused asks by this for the reason: browsers keep the answer to a WebSocket to themselves.
        .route(LIVE, get(live).post(async || StatusCode::NO_CONTENT))
        .route("/{file}", get(async |Path(name): Path<String>| file(&name)))
        .layer(middleware::from_fn_with_state(Arc::clone(&shared), guard))
        .with_state(shared)
}

/// Refuses requests under a foreign name, and for the swarm from pages of another origin, and adds the headers that all answers have.
async fn guard(State(shared): State<Arc<Shared>>, request: Request, next: Next) -> Response {
    let mut response = match check(&shared, request.uri().path(), request.headers()) {
        Ok(()) => next.run(request).await,
        Err(refusal) => refusal.into_response(),
    };
    let headers: [(HeaderName, &'static str); 4] = [
        (CONTENT_SECURITY_POLICY, POLICY),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (REFERRER_POLICY, "no-referrer"),
        (CACHE_CONTROL, "no-store"),
    ];
    response.headers_mut().extend(headers.map(|(name, value)| (name, HeaderValue::from_static(value))));
    response
}

/// Whether these headers are those of a request for this server, and where the swarm is shown by its own page or by no page. The
/// page's files are the same for every swarm: a page that is refused can still be opened, and shows why.
fn check(shared: &Shared, path: &str, headers: &HeaderMap) -> Result<(), (StatusCode, String)> {
    let text = |header: &HeaderValue| String::from_utf8_lossy(header.as_bytes()).into_owned();
    let host = headers.get(HOST).map(text).unwrap_or_default();
    let origin = headers.get(ORIGIN).filter(|_| path == LIVE).map(text);
    shared.names.check(&host, origin.as_deref())
}

fn file(name: &str) -> Response {
    match page::file(name) {
        Some((kind, content)) => ([(CONTENT_TYPE, kind)], content).into_response(),
        None => (StatusCode::NOT_FOUND, "no such file\n").into_response(),
    }
}

async fn live(State(shared): State<Arc<Shared>>, upgrade: WebSocketUpgrade) -> Response {
    let upgrade = upgrade.max_message_size(MAX_MESSAGE).max_frame_size(MAX_MESSAGE).max_write_buffer_size(MAX_UNSENT);
    upgrade.on_upgrade(async move |socket| {
        match &shared.source {
            Source::Live(frames) => socket::serve(socket, frames.subscribe(), shared.orders.clone()).await,
            Source::Recording(path) => playback::serve(socket, path.clone()).await,
        };
    })
}
