//! The edge to the other agents: Zenoh peers without a broker.
//!
//! Hearing: callbacks on Zenoh's threads decode, check and file the newest word of each peer in a bounded `inbox`; they
//! never wait. The control thread empties it once a step. Speaking: everything is sent as "drop", so that a peer that is
//! slow or gone costs the control thread nothing. Whoever comes late asks each peer whose token it sees for the last
//! register that it said, and Zenoh's threads answer.

mod inbox;
mod line;
mod register;

use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use serde_json::json;
use skein_common::id::{SwarmName, VehicleId};
use skein_common::message::{self, Drops, Event, Health, Message, Mission, State, Trace};
use skein_common::topic::{Cell, Topic, all};
use zenoh::config::EndPoint;
use zenoh::liveliness::LivelinessToken;
use zenoh::qos::{CongestionControl, Priority, Reliability};
use zenoh::sample::{Locality, Sample, SampleKind};
use zenoh::{Config, Session, Wait};

use crate::clock::LocalClock;
use crate::peers::{Heard, Word};
use inbox::Inbox;
pub use line::Line;
use register::Register;

/// Environment variable that says on which threads Zenoh runs. It is read once, at the start of the process.
pub const ZENOH_RUNTIME: &str = "ZENOH_RUNTIME";

/// What that says in an agent of a swarm of so many: everything on one runtime, which takes a third less time on the way and
/// half the processor. It has a thread for every link and some to spare. Zenoh's sockets linger: closing one whose other end
/// fell silent blocks its thread for up to ten seconds, and after a cut that must not make the others wait.
pub fn zenoh_runtime(vehicles: usize) -> String {
    let threads = vehicles + 2;
    format!(
        "(rx:(handover:app),acc:(handover:app),net:(handover:app),tx:(handover:app),app:(worker_threads:{threads}))"
    )
}

/// A session that does not close within this time is left to the end of the process.
const CLOSE_WITHIN: Duration = Duration::from_secs(1);

/// Why there is no link.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// Zenoh does not take our configuration.
    #[error("the network cannot be configured: {}", plain(source))]
    Configuration {
        /// What Zenoh says.
        source: zenoh::Error,
    },
    /// A text that is no endpoint.
    #[error("{0:?} is no endpoint; one is written like tcp/127.0.0.1:7447")]
    Endpoint(String),
    /// No session: most often an address that is taken or not ours.
    #[error("cannot listen on {}: {}", listen.join(", "), plain(source))]
    Open {
        /// Where to listen.
        listen: Vec<String>,
        /// What Zenoh says.
        source: zenoh::Error,
    },
    /// The session refuses to speak or to hear.
    #[error("cannot declare {key}: {}", plain(source))]
    Declare {
        /// The key.
        key: String,
        /// What Zenoh says.
        source: zenoh::Error,
    },
}

/// A session of this swarm, for agents and observers alike: a peer that finds nobody by itself, listens only on `listen`
/// (an observer: nowhere) and keeps dialling `dial`. Endpoints as Zenoh writes them: `tcp/127.0.0.1:7447`. Peers do not
/// relay for each other, so every pair needs one direction, and exactly one, in somebody's `dial`.
///
/// It succeeds with nobody there. Blocks for up to half a second; within Tokio only on a multi-thread runtime.
///
/// # Errors
/// An endpoint that is none, or an address that cannot be listened on.
pub fn open(swarm: &SwarmName, listen: &[String], dial: &[String]) -> Result<Session, LinkError> {
    if let Some(text) = listen.iter().chain(dial).find(|text| EndPoint::from_str(text).is_err()) {
        return Err(LinkError::Endpoint(text.clone()));
    }
    let configuration = configuration(swarm, listen, dial).map_err(|source| LinkError::Configuration { source })?;
    zenoh::open(configuration).wait().map_err(|source| LinkError::Open { listen: listen.to_vec(), source })
}

fn configuration(swarm: &SwarmName, listen: &[String], dial: &[String]) -> zenoh::Result<Config> {
    let mut configuration = Config::default();
    let values = [
        ("mode", json!("peer")),
        ("namespace", json!(swarm.as_str())),
        ("listen/endpoints", json!(listen)),
        ("connect/endpoints", json!(dial)),
        // A broken link is dialled again soon: a peer is back within a second of the network's healing.
        ("connect/retry", json!({ "period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 1.5 })),
        ("transport/unicast/open_timeout", json!(1000)),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
        // A silent peer is gone after a second.
        ("transport/link/tx/lease", json!(1000)),
        ("transport/link/tx/keep_alive", json!(4)),
        // Speaking never waits: what finds its queue full is dropped at once, the next word is newer.
        ("transport/link/tx/queue/congestion_control/drop/wait_before_drop", json!(0)),
    ];
    for (key, value) in values {
        configuration.insert_json5(key, &value.to_string())?;
    }
    Ok(configuration)
}

/// One agent's ears and mouth.
pub struct Link {
    inbox: Arc<Inbox>,
    state_key: Option<(Cell, String)>,
    mission: Line<Mission>,
    register: Register,
    event: Line<Event>,
    trace: Line<Trace>,
    trace_is_wanted: Arc<AtomicBool>,
    /// Gone with the session: then the others know that this agent is.
    _alive: LivelinessToken,
    own: VehicleId,
    /// The only one but for a moment of a callback: with it the session ends.
    session: Arc<Session>,
}

impl Link {
    /// Makes vehicle `own` heard and lets it hear the others, whose words get their time of arrival from `clock`.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn new(session: Session, own: VehicleId, clock: LocalClock) -> Result<Self, LinkError> {
        let (session, inbox) = (Arc::new(session), Arc::new(Inbox::new()));
        let register = Register::open(&session, Topic::Mission(own))?;
        hear::<State>(&session, all::STATES, &inbox, clock, Word::State)?;
        hear::<Mission>(&session, all::MISSIONS, &inbox, clock, Word::Mission)?;
        hear::<message::Order>(&session, all::ORDERS, &inbox, clock, Word::Order)?;
        hear_tokens(&session, own, &inbox, clock)?;
        let trace = Line::open(&session, Topic::Trace(own), Priority::DataLow)?;
        let trace_is_wanted = Arc::new(AtomicBool::new(false));
        let is_wanted = trace_is_wanted.clone();
        let listener =
            trace.publisher.matching_listener().callback(move |status| is_wanted.store(status.matching(), Relaxed));
        listener.background().wait().map_err(declaring(&Topic::Trace(own).key()))?;
        let alive = Topic::Alive(own).key();
        Ok(Self {
            inbox,
            state_key: None,
            mission: Line::open(&session, Topic::Mission(own), Priority::InteractiveHigh)?,
            register,
            event: Line::open(&session, Topic::Event(own), Priority::DataHigh)?,
            trace,
            trace_is_wanted,
            // Last: who sees the token can be heard.
            _alive: session.liveliness().declare_token(alive.clone()).wait().map_err(declaring(&alive))?,
            own,
            session,
        })
    }

    /// Moves what was heard since the last time to the end of `heard`: the newest word of each peer and kind.
    pub fn drain(&self, heard: &mut Vec<Heard>) {
        self.inbox.drain(heard);
    }

    /// Says the own state, filed under the cell it is in.
    pub fn say_state(&mut self, state: &State, cell: Cell) {
        let key = match &mut self.state_key {
            Some((of, key)) if *of == cell => key,
            key => &mut key.insert((cell, Topic::State(self.own, cell).key())).1,
        };
        // Like a line's: it fails only on a closed session. Cells change, so no publisher is declared.
        let _ = self
            .session
            .put(key.as_str(), message::encode(state))
            .congestion_control(CongestionControl::Drop)
            .priority(Priority::RealTime)
            .express(true)
            .reliability(Reliability::BestEffort)
            .allowed_destination(Locality::Remote)
            .wait();
    }

    /// Says the own part in the agreement, and keeps it for whoever comes late.
    pub fn say_mission(&self, mission: &Mission) {
        self.register.keep(mission);
        self.mission.say(mission);
    }

    /// Says what happened.
    pub fn say_event(&self, event: &Event) {
        self.event.say(event);
    }

    /// Whether somebody listens to the trace.
    pub fn trace_is_wanted(&self) -> bool {
        self.trace_is_wanted.load(Relaxed)
    }

    /// Says how a step went.
    pub fn say_trace(&self, trace: &Trace) {
        self.trace.say(trace);
    }

    /// The line for health, which another thread speaks on.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn health(&self) -> Result<Line<Health>, LinkError> {
        Line::open(&self.session, Topic::Health(self.own), Priority::DataHigh)
    }

    /// What was dropped so far.
    pub fn drops(&self) -> Drops {
        self.inbox.drops()
    }

    /// Takes leave of the others. Zenoh's own closing can take ten seconds on a bad network; this never does.
    pub fn close(self) {
        close(Session::clone(&self.session), self);
    }
}

/// Closes a session and drops what stands on it, within [`CLOSE_WITHIN`] or else in the background.
fn close(session: Session, rest: impl Send + 'static) {
    let (done, is_done) = mpsc::channel();
    thread::spawn(move || {
        // A session that cannot be closed ends with the process.
        let _ = session.close().wait();
        drop(rest);
        let _ = done.send(());
    });
    let _ = is_done.recv_timeout(CLOSE_WITHIN);
}

/// Files every message of this kind that stands under its speaker's own key.
fn hear<M: Message + 'static>(
    session: &Session,
    key: &str,
    inbox: &Arc<Inbox>,
    clock: LocalClock,
    word: fn(M) -> Word,
) -> Result<(), LinkError> {
    let inbox = inbox.clone();
    session
        .declare_subscriber(key)
        .allowed_origin(Locality::Remote)
        .callback(move |sample| file(&inbox, clock, &sample, word))
        .background()
        .wait()
        .map_err(declaring(key))
}

/// Files a message that stands under its speaker's own key.
fn file<M: Message>(inbox: &Inbox, clock: LocalClock, sample: &Sample, word: fn(M) -> Word) {
    let at = clock.now();
    let key = sample.key_expr().as_str();
    match message::decode::<M>(&sample.payload().to_bytes()) {
        Ok(said) if Topic::parse(key).is_some_and(|topic| said.may_stand_under(&topic)) => {
            inbox.file(Heard { word: word(said), at });
        }
        Ok(_) => inbox.forged(key),
        Err(error) => inbox.refuse(key, error),
    }
}

/// Files who of the others comes and goes, those already there included, and asks who comes for its register.
fn hear_tokens(session: &Arc<Session>, own: VehicleId, inbox: &Arc<Inbox>, clock: LocalClock) -> Result<(), LinkError> {
    let (inbox, asking) = (inbox.clone(), Arc::downgrade(session));
    let callback = move |sample: Sample| {
        // One's own token is reported like any other.
        if let Some(Topic::Alive(id)) = Topic::parse(sample.key_expr().as_str())
            && id != own
        {
            let word = match sample.kind() {
                SampleKind::Put => Word::Appeared(id),
                SampleKind::Delete => Word::Vanished(id),
            };
            inbox.file(Heard { word, at: clock.now() });
            if let (SampleKind::Put, Some(session)) = (sample.kind(), asking.upgrade()) {
                let inbox = inbox.clone();
                register::ask(&session, Topic::Mission(id), move |said| file(&inbox, clock, said, Word::Mission));
            }
        }
    };
    let tokens = session.liveliness().declare_subscriber(all::ALIVE).history(true).callback(callback);
    tokens.background().wait().map_err(declaring(all::ALIVE))
}

/// What Zenoh says, without the places in its source, `at .../tcp.rs:61.`, that it mixes in.
fn plain(error: &zenoh::Error) -> String {
    let mut text = error.to_string();
    while let Some(place) = text.find(".rs:") {
        let begin = text[..place].rfind(" at ").unwrap_or(place);
        let number = place + ".rs:".len();
        let after = text[number..].find(|c: char| !c.is_ascii_digit() && c != '.');
        text.replace_range(begin..after.map_or(text.len(), |after| number + after), "");
    }
    text
}

fn declaring(key: &str) -> impl FnOnce(zenoh::Error) -> LinkError {
    let key = key.to_owned();
    move |source| LinkError::Declare { key, source }
}

#[cfg(test)]
mod tests;
