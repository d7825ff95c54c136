//! X-Plane 12's Web API of the stand-in: REST and WebSocket over HTTP, for programs on this computer.
//!
//! It runs on a thread of its own. Each request becomes a [`Task`] that the frame loop carries out between two frames; the
//! channel to it is bounded, and so are connections, bodies and the time that a slow client may take.
//! Numbers of datarefs and commands change at every start of the simulator.
//! A flight is placed on the ground whatever it asks for, and needs the aircraft that the stand-in pretends to have: it
//! has no airports and no other aircraft. As one version of X-Plane does, it refuses whole numbers where a number with
//! decimals belongs. While the simulator is gone, requests are answered with 503.

mod flight;
mod rest;
mod socket;

use std::collections::BTreeMap;
use std::hash::{BuildHasher, RandomState};
use std::io;
use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::Duration;

use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use parking_lot::Mutex;
use serde_json::{Value as Json, json};
use tokio::sync::{Semaphore, mpsc, oneshot};
use tokio::time::Instant;

use crate::plant::xplane::server::{COMMANDS, DATAREFS, Dataref, Task};

/// Largest number of connections, and of WebSockets beside them.
const MAX_CONNECTIONS: usize = 32;
const MAX_SOCKETS: usize = 16;
/// Largest number of tasks that wait for the frame loop, and that one frame carries out.
const MAX_TASKS: usize = 64;
/// Longest time that a client may take to send its headers, or that a request may take.
const HEADERS_WITHIN: Duration = Duration::from_secs(30);
pub(super) const REQUEST_WITHIN: Duration = Duration::from_secs(30);
/// Largest body of a request and largest message of a WebSocket, bytes.
pub(super) const MAX_BODY: usize = 256 * 1024;

/// Number of engines of X-Plane 12, the only version with a Web API.
const ENGINES: usize = 16;

/// A task and where its result goes.
struct Request {
    task: Task,
    reply: oneshot::Sender<Vec<Json>>,
}

/// State that the threads share.
pub(super) struct WebState {
    tasks: mpsc::Sender<Request>,
    /// Added to the position of a dataref to make its number; differs from start to start.
    first_id: AtomicU64,
    /// Path of the aircraft's file.
    acf: String,
    /// Whether X-Plane's settings accept incoming connections.
    accepts: bool,
    active: Mutex<Active>,
    sockets: Arc<Semaphore>,
}

/// An error as X-Plane sends it.
#[derive(Debug, PartialEq)]
pub(super) struct Fault {
    status: StatusCode,
    code: &'static str,
    message: String,
}

impl Fault {
    fn new(status: StatusCode, code: &'static str, message: impl Into<String>) -> Self {
        Self { status, code, message: message.into() }
    }

    fn bad(code: &'static str, message: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, code, message)
    }

    fn missing(code: &'static str, message: impl Into<String>) -> Self {
        Self::new(StatusCode::NOT_FOUND, code, message)
    }
}

impl IntoResponse for Fault {
    fn into_response(self) -> Response {
        let body = json!({ "error_code": self.code, "error_message": self.message });
        (self.status, axum::Json(body)).into_response()
    }
}

impl WebState {
    /// Has the frame loop carry out a task.
    async fn run(&self, task: Task) -> Result<Vec<Json>, Fault> {
        let busy = |what| Fault::new(StatusCode::SERVICE_UNAVAILABLE, "not_running", what);
        let (reply, result) = oneshot::channel();
        self.tasks
            .try_send(Request { task, reply })
            .map_err(|_| busy("the simulator has too many requests waiting"))?;
        result.await.map_err(|_| busy("the simulator is not running"))
    }

    fn first_id(&self) -> u64 {
        self.first_id.load(Relaxed)
    }

    /// Number of the dataref at this position in the table.
    fn dataref_id(&self, at: usize) -> u64 {
        self.first_id() + at as u64
    }

    /// Number of the command at this position in the table.
    fn command_id(&self, at: usize) -> u64 {
        self.first_id() % 9000 + 1 + at as u64
    }

    /// The dataref with this number, and its position in the table.
    fn dataref(&self, id: &str) -> Result<(usize, &'static Dataref), Fault> {
        let at = nth(id, self.dataref_id(0)).and_then(|at| Some((at, DATAREFS.get(at)?)));
        at.ok_or_else(|| Fault::missing("invalid_dataref_id", format!("Dataref {id} doesn't exist")))
    }

    /// The position of the command with this number in the table.
    fn command(&self, id: &str) -> Result<usize, Fault> {
        let at = nth(id, self.command_id(0)).filter(|&at| at < COMMANDS.len());
        at.ok_or_else(|| Fault::missing("invalid_command_id", format!("Command {id} doesn't exist")))
    }
}

/// Position of what has this number, where the first thing has the number `first`.
fn nth(id: &str, first: u64) -> Option<usize> {
    usize::try_from(id.parse::<u64>().ok()?.checked_sub(first)?).ok()
}

/// First number of the datarefs of one start of the simulator: no client can guess it.
fn first_id(start: u64) -> u64 {
    1_000_000 + RandomState::new().hash_one(start) % (1 << 40)
}

/// Checks an index against a dataref; `what` names the dataref in the message.
fn check_index(dataref: &Dataref, index: Option<u64>, what: &str) -> Result<Option<usize>, Fault> {
    let Some(index) = index else { return Ok(None) };
    if !dataref.is_array() {
        let message = format!("An index was provided for {what} but the dataref is not an array");
        return Err(Fault::bad("not_an_array", message));
    }
    let at = usize::try_from(index).ok().filter(|&at| at < dataref.elements(ENGINES));
    at.map(Some).ok_or_else(|| Fault::bad("index_out_of_range", format!("{what} array index out of range")))
}

/// The elements that a client wants to write, with their values.
fn elements(dataref: &Dataref, index: Option<usize>, data: &Json) -> Result<Vec<(usize, f64)>, Fault> {
    let unfit = || {
        Fault::bad("incompatible_data", "Provided data is too much or not enough to set all elements of the dataref")
    };
    if !dataref.is_writable() {
        let message = "Attempted to write to a read-only dataref";
        return Err(Fault::new(StatusCode::FORBIDDEN, "dataref_is_readonly", message));
    }
    match (data, index) {
        (Json::Array(values), None) if values.len() == dataref.elements(ENGINES) && dataref.is_array() => {
            values.iter().enumerate().map(|(at, value)| Ok((at, value.as_f64().ok_or_else(unfit)?))).collect()
        }
        (Json::Number(value), None) if !dataref.is_array() => Ok(vec![(0, value.as_f64().ok_or_else(unfit)?)]),
        (Json::Number(value), Some(at)) => Ok(vec![(at, value.as_f64().ok_or_else(unfit)?)]),
        _ => Err(unfit()),
    }
}

/// Commands that are held down. A connection is a number; 0 are the requests without a WebSocket.
#[derive(Debug, Default)]
struct Active {
    held: BTreeMap<(u64, usize), Option<Instant>>,
    connections: u64,
}

impl Active {
    /// Number of a new connection.
    fn connect(&mut self) -> u64 {
        self.connections += 1;
        self.connections
    }

    /// Holds a command down until then, or until it is released; returns whether nothing held it before.
    fn hold(&mut self, connection: u64, command: usize, until: Option<Instant>) -> bool {
        let was_held = self.is_held(command);
        self.held.insert((connection, command), until);
        !was_held
    }

    /// Releases a command.
    fn release(&mut self, connection: u64, command: usize) {
        self.held.remove(&(connection, command));
    }

    /// Releases all commands of a connection that has ended.
    fn disconnect(&mut self, connection: u64) {
        self.held.retain(|(holder, _), _| *holder != connection);
    }

    /// Whether anything holds the command down.
    fn is_held(&mut self, command: usize) -> bool {
        let now = Instant::now();
        self.held.retain(|_, until| until.is_none_or(|until| until > now));
        self.held.keys().any(|(_, held)| *held == command)
    }
}

/// The frame loop's end.
pub(super) struct Web {
    shared: Arc<WebState>,
    tasks: mpsc::Receiver<Request>,
    starts: u64,
    /// The address at which it listens.
    pub(super) address: SocketAddr,
}

impl Web {
    /// Listens on this port of the loopback and serves on a thread of its own, until the process ends.
    pub(super) fn open(port: u16, acf: &str, accepts: bool) -> io::Result<Self> {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port))?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        let (sender, tasks) = mpsc::channel(MAX_TASKS);
        let shared = Arc::new(WebState {
            tasks: sender,
            first_id: AtomicU64::new(first_id(1)),
            acf: acf.to_owned(),
            accepts,
            active: Mutex::default(),
            sockets: Arc::new(Semaphore::new(MAX_SOCKETS)),
        });
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let of_thread = Arc::clone(&shared);
        let serve = move || runtime.block_on(accept(listener, of_thread));
        std::thread::Builder::new().name("standin-web".to_owned()).spawn(serve)?;
        Ok(Self { shared, tasks, starts: 1, address })
    }

    /// Carries out what waits; `serve` is the simulator.
    pub(super) fn serve(&mut self, starts: u64, mut serve: impl FnMut(&Task) -> Option<Vec<Json>>) {
        if starts != self.starts {
            self.starts = starts;
            self.shared.first_id.store(first_id(starts), Relaxed);
        }
        for _ in 0..MAX_TASKS {
            let Ok(Request { task, reply }) = self.tasks.try_recv() else { return };
            if let Some(values) = serve(&task) {
                // A client that has gone does not wait for its reply.
                let _ = reply.send(values);
            }
        }
    }

    /// Loses what waits: the simulator is gone.
    pub(super) fn discard(&mut self) {
        while self.tasks.try_recv().is_ok() {}
    }
}

/// Serves connections; one beyond the largest number is closed at once.
async fn accept(listener: TcpListener, shared: Arc<WebState>) {
    let Ok(listener) = tokio::net::TcpListener::from_std(listener) else { return };
    let slots = Arc::new(Semaphore::new(MAX_CONNECTIONS));
    let router = rest::router(shared);
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
