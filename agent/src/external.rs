//! A law in real time: a thread asks it, whoever flies the vehicle waits for nobody.
//!
//! ```text
//!   control thread -- ask (dropped if the queue is full) --> law's thread -- line --> law
//!        ^                                                     |    ^                  |
//!        +------------- newest answer in time -----------------+    +------ line ------+
//! ```
//!
//! An answer that comes later than the deadline, or that is none, is counted here and told the first time of its kind; to
//! the agent it is an ask without an answer. A law that ends is started again, a connection that ends is waited for.

use std::fmt;
use std::net::TcpListener;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use skein_common::id::VehicleId;
use skein_common::scenario::Scenario;

use skein_core::formation::external::{Answer, Ask};
use skein_host::clock::now;
use skein_host::external::protocol::{self, Fault, Heard, Hello, Said, Time};
use skein_host::external::talk::{Deaf, Talk, Word};
use skein_host::external::{ExternalError, Way, port_of, vector};

/// Words between the threads: a law that floods its line loses asks, and the agent waits for none of them.
const QUEUE: usize = 256;
/// How often the thread looks for what is no word: a connection, the end.
const LOOK_UP: Duration = Duration::from_millis(50);
/// A process is started again this long after its last start.
const RESTART_AFTER: Duration = Duration::from_secs(1);
/// A datagram without an answer is sent again.
const ASK_AGAIN_AFTER: Duration = Duration::from_secs(1);

/// The law of one vehicle. When it is dropped the law is told bye.
#[derive(Debug)]
pub struct LiveLaw {
    events: SyncSender<Event>,
    newest: Arc<Mutex<Option<Answer>>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug)]
enum Event {
    Ask(Box<Ask>, Instant),
    /// Of the conversation of this number.
    Heard(u64, Instant, Word),
}

impl LiveLaw {
    /// Begins to talk with vehicle `own`'s law. `None` if no step of the scenario has one.
    ///
    /// # Errors
    /// A program that does not start, an address that is none, a port that cannot be had.
    pub fn start(scenario: &Scenario, own: VehicleId) -> Result<Option<Self>, ExternalError> {
        let Some(way) = Way::of(scenario)? else { return Ok(None) };
        let (events, queue) = sync_channel(QUEUE);
        let (newest, stop) = (Arc::new(Mutex::new(None)), Arc::new(AtomicBool::new(false)));
        let mut keeper = Keeper {
            own,
            hello: Hello::new(scenario, own, Time::Real),
            deadline: Duration::from_secs_f64(scenario.formation.external.deadline_s),
            listener: listener(&way, own)?,
            way,
            events: events.clone(),
            newest: newest.clone(),
            talk: None,
            talks: 0,
            started: None,
            is_ready: false,
            open: None,
            faults: [0; Fault::KINDS],
            has_ended: false,
            has_failed: false,
        };
        // Whatever stands against the first start is said before anything flies.
        keeper.connect()?;
        let of_thread = stop.clone();
        let thread = thread::Builder::new().name("law".to_owned()).spawn(move || keeper.run(&queue, &of_thread));
        let thread = thread.map_err(|error| ExternalError::Port("no thread".to_owned(), error))?;
        Ok(Some(Self { events, newest, stop, thread: Some(thread) }))
    }

    /// Asks. Never waits: an ask for which there is no room is not answered.
    pub fn ask(&self, ask: Ask) {
        let _ = self.events.try_send(Event::Ask(Box::new(ask), now()));
    }

    /// The newest answer that came in time since the last call. Never waits.
    pub fn answer(&self) -> Option<Answer> {
        self.newest.try_lock().ok()?.take()
    }
}

impl Drop for LiveLaw {
    fn drop(&mut self) {
        self.stop.store(true, Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic there has been told.
            let _ = thread.join();
        }
    }
}

/// Where the law of this vehicle connects to, if it does.
fn listener(way: &Way, own: VehicleId) -> Result<Option<TcpListener>, ExternalError> {
    let Way::Listen(host, first) = way else { return Ok(None) };
    let port = port_of(*first, own)?;
    let bound = TcpListener::bind((host.as_str(), port)).and_then(|listener| {
        listener.set_nonblocking(true)?;
        Ok(listener)
    });
    bound.map(Some).map_err(|error| ExternalError::Port(format!("{host}:{port}"), error))
}

/// What the law's thread holds.
struct Keeper {
    own: VehicleId,
    way: Way,
    hello: Hello,
    deadline: Duration,
    listener: Option<TcpListener>,
    events: SyncSender<Event>,
    newest: Arc<Mutex<Option<Answer>>>,
    talk: Option<Talk>,
    /// Conversations begun so far: the number of the present one.
    talks: u64,
    started: Option<Instant>,
    is_ready: bool,
    open: Option<Open>,
    /// How often each kind of fault was heard.
    faults: [u64; Fault::KINDS],
    /// It has ended, and that was told.
    has_ended: bool,
    /// It could not be started again, and that was told.
    has_failed: bool,
}

/// An ask that is not answered yet.
struct Open {
    ask: Box<Ask>,
    asked: Instant,
    said: Instant,
}

impl Keeper {
    fn run(mut self, queue: &Receiver<Event>, stop: &AtomicBool) {
        while !stop.load(Relaxed) {
            if let Err(error) = self.connect()
                && !std::mem::replace(&mut self.has_failed, true)
            {
                tracing::warn!("vehicle {}'s law: {error}", self.own);
            }
            match queue.recv_timeout(LOOK_UP) {
                Ok(Event::Ask(ask, asked)) => self.ask(ask, asked),
                Ok(Event::Heard(talk, at, word)) if talk == self.talks => self.hear(at, word),
                Ok(Event::Heard(..)) | Err(RecvTimeoutError::Timeout) => {}
                // Not while this thread itself holds a sender.
                Err(RecvTimeoutError::Disconnected) => break,
            }
            self.ask_again();
        }
        let late = self.faults.iter().sum::<u64>();
        if late > 0 {
            tracing::info!("vehicle {}'s law: {late} words that were no answers in time", self.own);
        }
    }

    /// Begins a conversation, if there is none and it is time, or if a law has made a new connection.
    fn connect(&mut self) -> Result<(), ExternalError> {
        let talk = match (&self.way, &self.listener) {
            (Way::Listen(host, _), Some(listener)) => match listener.accept() {
                Ok((stream, _)) => {
                    let sink = self.sink();
                    Talk::connection(stream, sink).map_err(|error| ExternalError::Port(host.clone(), error))?
                }
                // Nobody, or nobody any more.
                Err(_) => return Ok(()),
            },
            _ if self.talk.is_some() => return Ok(()),
            _ if self.started.is_some_and(|started| now() < started + RESTART_AFTER) => return Ok(()),
            (Way::Command(command), _) => {
                self.started = Some(now());
                let own = self.own;
                let tell = move |line: &str| tracing::warn!("vehicle {own}'s law: {line}");
                let started = Talk::process(command, true, self.sink(), tell);
                started.map_err(|error| ExternalError::Start(command.join(" "), error))?
            }
            (Way::Udp { ask, answer }, _) => {
                let (ask_port, answer_port) = (port_of(ask.1, self.own)?, port_of(answer.1, self.own)?);
                self.started = Some(now());
                let talk = Talk::datagrams((&ask.0, ask_port), (&answer.0, answer_port), self.sink());
                talk.map_err(|error| ExternalError::Port(format!("{}:{answer_port}", answer.0), error))?
            }
            (Way::Listen(..), None) => return Ok(()),
        };
        (self.talks, self.open) = (self.talks + 1, None);
        self.is_ready = talk.is_of_vectors();
        let said = talk.say(&Said::Hello(&self.hello));
        self.talk = Some(talk);
        if said.is_err() {
            self.end();
        }
        Ok(())
    }

    /// Hands on what the next conversation hears, with its number.
    fn sink(&self) -> impl skein_host::external::talk::Sink + use<> {
        let (events, number) = (self.events.clone(), self.talks + 1);
        move |at, word| events.send(Event::Heard(number, at, word)).is_ok()
    }

    fn ask(&mut self, ask: Box<Ask>, asked: Instant) {
        // Before it is ready a law is not asked, and answers nothing.
        self.open = None;
        let Some(talk) = self.talk.as_ref().filter(|_| self.is_ready) else { return };
        let said = talk.say(&Said::Ask(&ask));
        self.open = Some(Open { ask, asked, said: asked });
        if said == Err(Deaf) {
            self.end();
        }
    }

    /// A datagram may be lost, or the model was not running yet.
    fn ask_again(&mut self) {
        let Some((talk, open)) = self.talk.as_ref().zip(self.open.as_mut()) else { return };
        if talk.is_of_vectors() && now() >= open.said + ASK_AGAIN_AFTER {
            open.said = now();
            // A socket is never deaf.
            let _ = talk.say(&Said::Ask(&open.ask));
        }
    }

    fn hear(&mut self, at: Instant, word: Word) {
        let heard = match word {
            Word::End => return self.end(),
            Word::TooLong => Err(Fault::TooLong),
            Word::Said(said) if self.talk.as_ref().is_some_and(Talk::is_of_vectors) => {
                vector::read(&said).map(Heard::Answer)
            }
            Word::Said(line) => protocol::read(&line),
        };
        let taken = match heard {
            Ok(Heard::Ready) if !self.is_ready => {
                self.is_ready = true;
                tracing::info!("vehicle {}'s law is ready", self.own);
                Ok(())
            }
            Ok(Heard::Ready) => Err(Fault::OutOfPlace("ready".to_owned())),
            Ok(Heard::Answer(_)) if !self.is_ready => Err(Fault::OutOfPlace("an answer before ready".to_owned())),
            Ok(Heard::Answer(answer)) => self.take(at, answer),
            Err(fault) => Err(fault),
        };
        if let Err(fault) = taken {
            self.count(&fault);
        }
    }

    /// Hands an answer on, if it is one to the open ask and in time.
    fn take(&mut self, at: Instant, answer: Answer) -> Result<(), Fault> {
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
        *self.newest.lock().unwrap_or_else(PoisonError::into_inner) = Some(answer);
        Ok(())
    }

    fn count(&mut self, fault: &Fault) {
        let count = &mut self.faults[fault.kind()];
        *count += 1;
        // What follows it are misses, and the agent counts those.
        if *count == 1 {
            tracing::warn!("vehicle {}'s law: {fault}; more of the kind are only counted", self.own);
        }
        if !matches!(fault, Fault::Late(_)) {
            self.open = None;
        }
    }

    /// The conversation is over.
    fn end(&mut self) {
        let Some(mut talk) = self.talk.take() else { return };
        (self.is_ready, self.open) = (false, None);
        if !std::mem::replace(&mut self.has_ended, true) {
            let next = Next(&self.way);
            tracing::warn!("vehicle {}'s law {}; {next}", self.own, talk.how_it_ended());
        }
    }
}

/// What is done about a law that has ended.
struct Next<'a>(&'a Way);

impl fmt::Display for Next<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.0 {
            Way::Command(_) => "it is started again, now and whenever it ends",
            Way::Listen(..) | Way::Udp { .. } => "it may come back",
        })
    }
}

#[cfg(test)]
#[cfg(unix)]
mod tests;
