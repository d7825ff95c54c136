//! Runs an external law in real time: a thread of its own queries the law, so that the control thread never waits for
//! it.
//!
//! ```text
//!   control thread -- query (dropped if the queue is full) --> law's thread -- line --> law
//!        ^                                                       |    ^                  |
//!        +-------------- newest reply in time -------------------+    +------ line ------+
//! ```
//!
//! A reply that is late or not valid is counted, and the agent reports the first of each kind; to it the query had no
//! reply. A law that ends is started again; a law that disconnects may connect again.

use std::collections::{HashMap, VecDeque};
use std::mem::{Discriminant, discriminant};
use std::net::TcpListener;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use skein_common::id::VehicleId;
use skein_common::message::ShortText;
use skein_common::scenario::Scenario;

use skein_core::formation::external::{LawQuery, LawReply};
use skein_host::clock::now;
use skein_host::external::protocol::{self, Fault, Hello, MessageFromLaw, MessageToLaw, Time};
use skein_host::external::session::{LawInput, LawSession, LawUnresponsive};
use skein_host::external::{ExternalError, LawTransport, port_of, vector};

/// Queue between the threads, messages. A law that floods its output makes queries get lost, but delays nothing.
const QUEUE: usize = 256;
/// Interval at which the law's thread checks for a new connection or a stop.
const POLL_PERIOD: Duration = Duration::from_millis(50);
/// Least time between two starts of the law's process.
const RESTART_DELAY: Duration = Duration::from_secs(1);
/// A datagram without a reply is sent again after this time.
const RESEND_DELAY: Duration = Duration::from_secs(1);

/// Replies and refusals that wait for the control thread.
#[derive(Debug, Default)]
struct FromLaw {
    reply: Option<LawReply>,
    /// The reasons of refusals, at most one for each kind of fault.
    refusals: VecDeque<ShortText>,
    /// Whether the law's thread has to end.
    is_over: bool,
}

/// The external law of one vehicle. Dropping it sends the law a bye.
#[derive(Debug)]
pub struct LiveLaw {
    events: SyncSender<Event>,
    newest: Arc<Mutex<FromLaw>>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug)]
enum Event {
    Query(Box<LawQuery>, Instant),
    /// Input from the session of this number.
    Input(u64, Instant, LawInput),
}

impl LiveLaw {
    /// Starts a session with the law of vehicle `own`. Returns `None` if no step of the scenario has an external law.
    ///
    /// # Errors
    /// If a program does not start, an address is not valid, or a port cannot be bound.
    pub fn start(scenario: &Scenario, own: VehicleId) -> Result<Option<Self>, ExternalError> {
        let Some(transport) = LawTransport::of(scenario)? else { return Ok(None) };
        let (events, queue) = sync_channel(QUEUE);
        let newest = Arc::<Mutex<FromLaw>>::default();
        let mut law_thread = LawThread {
            own,
            hello: Hello::new(scenario, own, Time::Real),
            deadline: Duration::from_secs_f64(scenario.formation.external.deadline_s),
            listener: listener(&transport, own)?,
            transport,
            events: events.clone(),
            newest: newest.clone(),
            session: None,
            sessions: 0,
            started: None,
            is_ready: false,
            open: None,
            faults: HashMap::new(),
            has_ended: false,
            has_failed: false,
        };
        // An error at the first start is reported before the flight begins.
        law_thread.connect()?;
        let thread = thread::Builder::new().name("law".to_owned()).spawn(move || law_thread.run(&queue));
        let thread = thread.map_err(|error| ExternalError::Port("cannot start a thread".to_owned(), error))?;
        Ok(Some(Self { events, newest, thread: Some(thread) }))
    }

    /// Sends a query. Never waits: a query that does not fit into the queue gets no reply.
    pub fn ask(&self, ask: LawQuery) {
        let _ = self.events.try_send(Event::Query(Box::new(ask), now()));
    }

    /// The newest reply since the last call that came in time, and the reason why something else was refused: one reason a
    /// call, and each kind of reason once. Never waits.
    pub fn take(&self) -> (Option<LawReply>, Option<ShortText>) {
        let Some(mut newest) = self.newest.try_lock() else { return (None, None) };
        (newest.reply.take(), newest.refusals.pop_front())
    }
}

impl Drop for LiveLaw {
    fn drop(&mut self) {
        self.newest.lock().is_over = true;
        if let Some(thread) = self.thread.take() {
            // A panic in the thread has been printed.
            let _ = thread.join();
        }
    }
}

/// Socket to which the law of this vehicle connects, if it does.
fn listener(transport: &LawTransport, own: VehicleId) -> Result<Option<TcpListener>, ExternalError> {
    let LawTransport::Listen(host, first) = transport else { return Ok(None) };
    let port = port_of(*first, own)?;
    let bound = TcpListener::bind((host.as_str(), port)).and_then(|listener| {
        listener.set_nonblocking(true)?;
        Ok(listener)
    });
    bound.map(Some).map_err(|error| ExternalError::Port(format!("{host}:{port}"), error))
}

/// State of the law's thread.
struct LawThread {
    own: VehicleId,
    transport: LawTransport,
    hello: Hello,
    deadline: Duration,
    listener: Option<TcpListener>,
    events: SyncSender<Event>,
    newest: Arc<Mutex<FromLaw>>,
    session: Option<LawSession>,
    /// Number of sessions so far, which is the number of the current one.
    sessions: u64,
    started: Option<Instant>,
    is_ready: bool,
    open: Option<OpenQuery>,
    /// Number of faults by kind.
    faults: HashMap<Discriminant<Fault>, u64>,
    /// Whether the end of the law was logged.
    has_ended: bool,
    /// Whether a failed restart was logged.
    has_failed: bool,
}

/// A query that awaits its reply.
struct OpenQuery {
    ask: Box<LawQuery>,
    asked: Instant,
    sent: Instant,
}

impl LawThread {
    fn run(mut self, queue: &Receiver<Event>) {
        while !self.newest.lock().is_over {
            if let Err(error) = self.connect()
                && !std::mem::replace(&mut self.has_failed, true)
            {
                tracing::warn!("vehicle {}'s law: {error}", self.own);
            }
            match queue.recv_timeout(POLL_PERIOD) {
                Ok(Event::Query(ask, asked)) => self.ask(ask, asked),
                Ok(Event::Input(session, at, message)) if session == self.sessions => self.receive(at, message),
                Ok(Event::Input(..)) | Err(RecvTimeoutError::Timeout) => {}
                // Impossible while this thread itself holds a sender.
                Err(RecvTimeoutError::Disconnected) => break,
            }
            self.ask_again();
        }
        let faults = self.faults.values().sum::<u64>();
        if faults > 0 {
            tracing::info!("vehicle {}'s law: {faults} messages were not replies in time", self.own);
        }
    }

    /// Starts a session if the law has connected, or if the last session has ended and the restart time has passed.
    fn connect(&mut self) -> Result<(), ExternalError> {
        let session = match (&self.transport, &self.listener) {
            (LawTransport::Listen(host, _), Some(listener)) => match listener.accept() {
                Ok((stream, _)) => {
                    let sink = self.sink();
                    LawSession::connection(stream, sink).map_err(|error| ExternalError::Port(host.clone(), error))?
                }
                // No new connection.
                Err(_) => return Ok(()),
            },
            _ if self.session.is_some() => return Ok(()),
            _ if self.started.is_some_and(|started| now() < started + RESTART_DELAY) => return Ok(()),
            (LawTransport::Command(command), _) => {
                self.started = Some(now());
                let own = self.own;
                let log = move |line: &str| tracing::warn!("vehicle {own}'s law: {line}");
                let started = LawSession::process(command, true, self.sink(), log);
                started.map_err(|error| ExternalError::Start(command.join(" "), error))?
            }
            (LawTransport::Udp { ask, answer }, _) => {
                let (ask_port, answer_port) = (port_of(ask.1, self.own)?, port_of(answer.1, self.own)?);
                self.started = Some(now());
                let session = LawSession::datagrams((&ask.0, ask_port), (&answer.0, answer_port), self.sink());
                session.map_err(|error| ExternalError::Port(format!("{}:{answer_port}", answer.0), error))?
            }
            (LawTransport::Listen(..), None) => return Ok(()),
        };
        (self.sessions, self.open) = (self.sessions + 1, None);
        self.is_ready = session.uses_vectors();
        let sent = session.send(&MessageToLaw::Hello(&self.hello));
        self.session = Some(session);
        if sent.is_err() {
            self.end();
        }
        Ok(())
    }

    /// Passes on the input of the next session, with its number.
    fn sink(&self) -> impl skein_host::external::session::Sink + use<> {
        let (events, number) = (self.events.clone(), self.sessions + 1);
        move |at, message| events.send(Event::Input(number, at, message)).is_ok()
    }

    fn ask(&mut self, ask: Box<LawQuery>, asked: Instant) {
        // A law that is not ready gets no query, and its replies are faults.
        self.open = None;
        let Some(session) = self.session.as_ref().filter(|_| self.is_ready) else { return };
        let sent = session.send(&MessageToLaw::LawQuery(&ask));
        self.open = Some(OpenQuery { ask, asked, sent: asked });
        if sent == Err(LawUnresponsive) {
            self.end();
        }
    }

    /// Sends an unanswered query again: the datagram may be lost, or the model may not have run yet.
    fn ask_again(&mut self) {
        let Some((session, open)) = self.session.as_ref().zip(self.open.as_mut()) else { return };
        if session.uses_vectors() && now() >= open.sent + RESEND_DELAY {
            open.sent = now();
            // A UDP socket never reports an unresponsive law.
            let _ = session.send(&MessageToLaw::LawQuery(&open.ask));
        }
    }

    fn receive(&mut self, at: Instant, message: LawInput) {
        let received = match message {
            LawInput::End => return self.end(),
            LawInput::TooLong => Err(Fault::TooLong),
            LawInput::Data(datagram) if self.session.as_ref().is_some_and(LawSession::uses_vectors) => {
                vector::read(&datagram).map(MessageFromLaw::LawReply)
            }
            LawInput::Data(line) => protocol::read(&line),
        };
        let taken = received.and_then(|message| match message {
            MessageFromLaw::Ready if !self.is_ready => {
                self.is_ready = true;
                tracing::info!("vehicle {}'s law is ready", self.own);
                Ok(())
            }
            MessageFromLaw::Ready => Err(Fault::OutOfPlace("ready".to_owned())),
            MessageFromLaw::LawReply(_) if !self.is_ready => Err(Fault::OutOfPlace("a reply before ready".to_owned())),
            MessageFromLaw::LawReply(answer) => self.take(at, answer),
        });
        if let Err(fault) = taken {
            self.count(&fault);
        }
    }

    /// Passes a reply on, if it answers the open query in time.
    fn take(&mut self, at: Instant, answer: LawReply) -> Result<(), Fault> {
        if answer.vehicle != self.own {
            return Err(Fault::Vehicle(answer.vehicle.get().into()));
        }
        let late = Fault::Late(answer.tick);
        let open = self.open.as_ref().ok_or(late.clone())?;
        if answer.tick < open.ask.tick {
            return Err(late);
        }
        if answer.tick > open.ask.tick {
            return Err(Fault::Tick { got: answer.tick, open: open.ask.tick });
        }
        let is_late = at > open.asked + self.deadline;
        self.open = None;
        if is_late {
            return Err(late);
        }
        self.newest.lock().reply = Some(answer);
        Ok(())
    }

    fn count(&mut self, fault: &Fault) {
        let count = self.faults.entry(discriminant(fault)).or_default();
        *count += 1;
        // Its consequences are missed replies, and the agent counts those.
        if *count == 1 {
            let reason = ShortText::beginning_of(&fault.to_string());
            self.newest.lock().refusals.push_back(reason);
        }
        if !matches!(fault, Fault::Late(_)) {
            self.open = None;
        }
    }

    /// Ends the session, and logs the first end.
    fn end(&mut self) {
        let Some(mut session) = self.session.take() else { return };
        (self.is_ready, self.open) = (false, None);
        if !std::mem::replace(&mut self.has_ended, true) {
            let next = match self.transport {
                LawTransport::Command(_) => "it is started again, now and whenever it ends",
                LawTransport::Listen(..) | LawTransport::Udp { .. } => "it may come back",
            };
            tracing::warn!("vehicle {}'s law {}; {next}", self.own, session.how_it_ended());
        }
    }
}

#[cfg(test)]
#[cfg(unix)]
mod tests;
