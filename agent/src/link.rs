//! The edge to the other agents: Zenoh peers without a broker.
//!
//! Hearing: callbacks on Zenoh's threads decode, check and file the newest word of each peer in a bounded `inbox`; they
//! never wait. The control thread empties it once a step. Speaking: the control thread hands over what a step sends and never
//! calls Zenoh; a thread of its own sends it (`outgoing`). Whoever comes late asks each peer whose token it sees for the last
//! register that it said, and Zenoh's threads answer.

mod clocks;
mod health;
mod inbox;
mod line;
mod outgoing;
pub mod presence;
mod refusals;
mod register;
pub mod seal;
pub mod security;
mod sessions;
mod trust;
mod tunnel;

use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::Duration;

use serde_json::{Value, json};
use skein_common::id::{SwarmName, VehicleId};
use skein_common::message::{Drops, Event, Message, Mission, Order, Reason, Refused, State, Trace};
use skein_common::topic::{Author, Cell, Topic, all};
use zenoh::bytes::ZBytes;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority, Reliability};
use zenoh::sample::{Locality, Sample, SampleKind};
use zenoh::{Config, Session, Wait};

use clocks::Clocks;
pub use clocks::{ASK_EVERY, Utc};
pub use health::HealthLine;
use inbox::Inbox;
pub use line::Line;
pub use outgoing::Messages;
use outgoing::{Outgoing, Waiting};
use presence::{Change, Presence, watch_tokens};
use register::Register;
use seal::Sealer;
use seal::words::Voices;
pub use security::Security;
pub use sessions::Sessions;
use skein_core::peers::{Heard, Word};
use skein_host::clock::{LocalClock, now, sleep_until};
use trust::Judge;
pub use trust::Trust;

/// Environment variable that says on which threads Zenoh runs. It is read once, at the start of the process.
pub const ZENOH_RUNTIME: &str = "ZENOH_RUNTIME";

/// What that says in an agent: everything on one runtime, which takes a third less time on the way and half the processor, with
/// two threads, however large the swarm is. More of them delay what they carry: each message wakes several. Two are enough
/// because no thread of Zenoh's waits for a network that was cut: those sockets are the tunnel's.
pub const ZENOH_ON_TWO_THREADS: &str =
    "(rx:(handover:app),acc:(handover:app),net:(handover:app),tx:(handover:app),app:(worker_threads:2))";

/// A peer has so long to answer when it is dialled. What cannot be reached over a network is given up sooner, by the tunnel.
const OPEN_WITHIN: Duration = Duration::from_secs(10);
/// A session that has said nothing for so long is over. Agents that are slow because their PC is stay linked: an agent is missed
/// because of the age of what it said, not because of this.
const LEASE: Duration = Duration::from_secs(4);

/// A thread that sends what must not be dropped waits so long for a peer that does not take it; then that link is closed.
const BLOCK_WITHIN: Duration = Duration::from_millis(20);

/// Time for the last messages to arrive before the link ends.
const LINGER: Duration = Duration::from_millis(500);

/// A message from the network may be this large.
const MAX_MESSAGE_BYTES: usize = 1 << 20;

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
    /// An endpoint of the other kind.
    #[error(
        "{endpoint:?}: {}",
        if *wanted == "tls" { "links are secured here, so an endpoint is written like tls/10.0.0.11:7447" }
        else { "there are no keys for secured links; a plain endpoint is written like tcp/127.0.0.1:7447" }
    )]
    Protocol {
        /// The endpoint.
        endpoint: String,
        /// What it has to begin with.
        wanted: &'static str,
    },
    /// A file of keys that is none.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: io::Error,
    },
    /// A name that does not tell who it is.
    #[error("the certificates' name {0:?} has to stand for one and only one of vehicles, observer and operator")]
    Name(String),
    /// A vehicle that the others know by another key.
    #[error("the swarm does not know vehicle {0} by this key")]
    Key(VehicleId),
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
    /// No thread that sends.
    #[error("the system gives no thread: {0}")]
    Thread(io::Error),
}

impl LinkError {
    /// Whether an argument or a file is at fault, not the network.
    pub fn is_the_users(&self) -> bool {
        !matches!(self, Self::Configuration { .. } | Self::Open { .. } | Self::Declare { .. } | Self::Thread(_))
    }
}

/// A Zenoh session of this swarm: a peer that finds nobody by itself, and that is told `more` than all of them.
pub(crate) fn open_zenoh(
    swarm: &SwarmName,
    listen: &[String],
    dial: &[String],
    more: &[(&str, Value)],
) -> Result<Session, LinkError> {
    let configuration =
        configuration(swarm, listen, dial, more).map_err(|source| LinkError::Configuration { source })?;
    zenoh::open(configuration).wait().map_err(|source| LinkError::Open { listen: listen.to_vec(), source })
}

fn configuration(
    swarm: &SwarmName,
    listen: &[String],
    dial: &[String],
    more: &[(&str, Value)],
) -> zenoh::Result<Config> {
    let mut configuration = Config::default();
    let values = [
        ("mode", json!("peer")),
        ("namespace", json!(swarm.as_str())),
        ("listen/endpoints", json!(listen)),
        ("connect/endpoints", json!(dial)),
        // A broken link is dialled again soon: a peer is back within a second of the network's healing.
        ("connect/retry", json!({ "period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 1.5 })),
        // A peer that is slow to answer is not dialled twice.
        ("transport/unicast/open_timeout", json!(OPEN_WITHIN.as_millis())),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
        ("adminspace/enabled", json!(false)),
        ("transport/link/tx/lease", json!(LEASE.as_millis())),
        ("transport/link/tx/keep_alive", json!(4)),
        // Speaking never waits: what finds its queue full is dropped at once, the next word is newer.
        ("transport/link/tx/queue/congestion_control/drop/wait_before_drop", json!(0)),
        // Zenoh itself must not drop its declarations. A peer that does not take them soon loses its link.
        ("transport/link/tx/queue/congestion_control/block/wait_before_close", json!(BLOCK_WITHIN.as_micros())),
        // Answers get the quality of service of their question. Who asks does not choose it: an answer is dropped rather than
        // waited for, and has a queue in which nothing else is sent.
        (
            "qos/network",
            json!([{
                "messages": ["query"],
                "flows": ["ingress"],
                "overwrite": { "congestion_control": "drop", "priority": "interactive_low", "express": true },
            }]),
        ),
        // Memory for what comes in pieces, before anybody looks at it: many times the largest word.
        ("transport/link/rx/max_message_size", json!(MAX_MESSAGE_BYTES)),
    ];
    for (key, value) in values.iter().chain(more) {
        configuration.insert_json5(key, &value.to_string())?;
    }
    Ok(configuration)
}

/// One agent's ears and mouth.
pub struct Link {
    ear: Arc<Ear>,
    outgoing: Outgoing,
    /// In each session.
    trace_is_wanted: Vec<Arc<AtomicBool>>,
    /// Gone with the sessions: then the others know that this agent is.
    _alive: Vec<LivelinessToken>,
    own: VehicleId,
    /// With them and the publisher's thread the sessions end.
    sessions: Sessions,
}

impl Link {
    /// Makes vehicle `own` heard and lets it hear those of the others whom it trusts; their words get their time of arrival
    /// from `clock`.
    ///
    /// # Errors
    /// If a session is closed, or the system gives no thread.
    pub fn new(
        sessions: impl Into<Sessions>,
        own: VehicleId,
        clock: LocalClock,
        trust: Trust,
    ) -> Result<Self, LinkError> {
        let sessions = sessions.into();
        let (voices, sealer, presence) = (trust.voices.clone(), trust.sealer.clone(), sessions.presence());
        let ear = Arc::new(Ear { inbox: Inbox::new(), judge: Judge::new(own, trust), clock, presence, voices, sealer });
        let register = Register::open(&sessions, Topic::Mission(own))?;
        hear_presence(&sessions, own, &ear)?;
        for session in &sessions.all {
            hear::<State>(session, all::STATES, &ear, Word::State)?;
            hear::<Mission>(session, all::MISSIONS, &ear, Word::Mission)?;
            hear::<Order>(session, all::ORDERS, &ear, Word::Order)?;
        }
        let trace = Line::open(&sessions, &ear, Topic::Trace(own), Priority::DataLow)?;
        let trace_is_wanted = trace.publishers.iter().map(watch_matching).collect::<Result<_, _>>()?;
        let mission = Line::open(&sessions, &ear, Topic::Mission(own), Priority::InteractiveHigh)?;
        let event = Line::open(&sessions, &ear, Topic::Event(own), Priority::DataHigh)?;
        let (ear_of_mouth, all) = (ear.clone(), sessions.all.clone());
        let mut mouth =
            Mouth { ear: ear_of_mouth, sessions: all, own, state_key: None, mission, register, event, trace };
        let outgoing = Outgoing::start(move |waiting| mouth.send(waiting)).map_err(LinkError::Thread)?;
        let alive = Topic::Alive(own).key();
        let token = |session: &Arc<Session>| {
            session.liveliness().declare_token(alive.clone()).wait().map_err(declaring(&alive))
        };
        // Last: who sees the token can be heard.
        let alive = sessions.all.iter().map(token).collect::<Result<_, _>>()?;
        Ok(Self { ear, outgoing, trace_is_wanted, _alive: alive, own, sessions })
    }

    /// Moves what was heard since the last time to the end of `heard`: the newest word of each peer and kind.
    pub fn drain(&self, heard: &mut Vec<Heard>) {
        self.ear.inbox.drain(heard);
    }

    /// Hands over what a step sends. Never waits for the network.
    pub fn send(&self, messages: Messages) {
        self.outgoing.hand_over(messages);
    }

    /// Sends the own state, filed under the cell it is in.
    pub fn say_state(&self, state: &State, cell: Cell) {
        self.send(Messages { state: Some((*state, cell)), ..Messages::default() });
    }

    /// Sends the own register of the agreement, and keeps it for whoever comes late.
    pub fn say_mission(&self, mission: &Mission) {
        self.send(Messages { mission: Some(*mission), ..Messages::default() });
    }

    /// Sends what happened.
    pub fn say_event(&self, event: &Event) {
        self.send(Messages { events: vec![*event], ..Messages::default() });
    }

    /// Whether somebody listens to the trace.
    pub fn trace_is_wanted(&self) -> bool {
        self.trace_is_wanted.iter().any(|wanted| wanted.load(Relaxed))
    }

    /// The line for health, which another thread speaks on. From now on whoever asks is told what `utc` shows.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn health(&self, utc: Utc) -> Result<HealthLine, LinkError> {
        let line = Line::open(&self.sessions, &self.ear, Topic::Health(self.own), Priority::DataHigh)?;
        let clocks = Clocks::open(&self.sessions, &self.ear, self.own, utc)?;
        Ok(HealthLine { line, ear: self.ear.clone(), clocks, live: Vec::new() })
    }

    /// What was dropped so far.
    pub fn drops(&self) -> Drops {
        self.ear.inbox.drops()
    }

    /// Events and traces that were not sent so far because the network was too slow.
    pub fn unsent(&self) -> u64 {
        self.outgoing.dropped()
    }

    /// Takes leave of the others, having sent what still waits. Zenoh's own closing can take ten seconds on a bad network; this
    /// never does.
    pub fn close(self) {
        self.outgoing.end();
        // A receiver drops what it reads after the link has ended: the last event has to arrive before that.
        sleep_until(now() + LINGER);
        self.sessions.clone().close(self);
    }
}

/// What the publisher's thread sends, and how.
struct Mouth {
    ear: Arc<Ear>,
    sessions: Vec<Arc<Session>>,
    own: VehicleId,
    state_key: Option<(Cell, String)>,
    mission: Line<Mission>,
    register: Register,
    event: Line<Event>,
    trace: Line<Trace>,
}

impl Mouth {
    /// Sends everything that waits. Zenoh may make it wait for a slow peer.
    fn send(&mut self, waiting: &mut Waiting) {
        if let Some((state, cell)) = waiting.state.take() {
            self.send_state(&state, cell);
        }
        if let Some(mission) = waiting.mission.take() {
            let said = self.mission.write(&mission);
            self.register.keep(said.clone());
            self.mission.put(said);
        }
        waiting.events.drain(..).for_each(|event| self.event.say(&event));
        waiting.traces.drain(..).for_each(|trace| self.trace.say(&trace));
    }

    fn send_state(&mut self, state: &State, cell: Cell) {
        let key = match &mut self.state_key {
            Some((of, key)) if *of == cell => key,
            key => &mut key.insert((cell, Topic::State(self.own, cell).key())).1,
        };
        let said = ZBytes::from(self.ear.write(key, state));
        for session in &self.sessions {
            // Like a line's: it fails only on a closed session. Cells change, so no publisher is declared.
            let _ = session
                .put(key.as_str(), said.clone())
                .congestion_control(CongestionControl::Drop)
                .priority(Priority::RealTime)
                .express(true)
                .reliability(Reliability::BestEffort)
                .allowed_destination(Locality::Remote)
                .wait();
        }
    }
}

/// What Zenoh's threads do with what they hear: they never wait. And how the own words are made out.
struct Ear {
    inbox: Inbox,
    judge: Judge,
    clock: LocalClock,
    presence: Arc<Presence>,
    voices: Voices,
    sealer: Option<Arc<Sealer>>,
}

impl Ear {
    /// Files what is believed of a message that stands under its speaker's own key.
    fn hear<M: Message>(&self, sample: &Sample, word: fn(M) -> Word) {
        let key = sample.key_expr().as_str();
        match Topic::parse(key).map(|topic| topic.author()) {
            // Replayed by somebody else, or on its way while its link broke.
            Some(Author::Vehicle(id)) if !self.presence.may_speak(id) => {
                self.inbox.refuse(Reason::Old, key, &"its speaker is not there");
            }
            _ => match self.voices.read::<M>(key, &sample.payload().to_bytes()) {
                Ok(said) => self.file(key, word(said.message), said.run),
                Err(error) => self.inbox.refuse(error.reason(), key, &error),
            },
        }
    }

    /// Files what is believed of a word, which its speaker has said in this run, if it is sealed.
    fn file(&self, key: &str, word: Word, run: Option<u64>) {
        let at = self.clock.now();
        let refused = |reason: Reason| self.inbox.refuse(reason, key, &reason);
        if let Some(word) = self.judge.hear(word, run, refused) {
            self.inbox.file(key, Heard { word, at });
        }
    }

    /// One of the own words, as it is said.
    fn write(&self, key: &str, message: &impl Message) -> Vec<u8> {
        self.voices.write(self.sealer.as_deref(), self.judge.run(), key, message)
    }

    fn refused(&self) -> Vec<Refused> {
        self.inbox.refused()
    }
}

/// From now on tells whether somebody listens to this publisher.
fn watch_matching(publisher: &Publisher<'static>) -> Result<Arc<AtomicBool>, LinkError> {
    let is_wanted = Arc::new(AtomicBool::new(false));
    let noted = is_wanted.clone();
    let listener = publisher.matching_listener().callback(move |status| noted.store(status.matching(), Relaxed));
    listener.background().wait().map_err(declaring(publisher.key_expr().as_str()))?;
    Ok(is_wanted)
}

/// Files every message of this kind.
fn hear<M: Message + 'static>(
    session: &Session,
    key: &str,
    ear: &Arc<Ear>,
    word: fn(M) -> Word,
) -> Result<(), LinkError> {
    let ear = ear.clone();
    session
        .declare_subscriber(key)
        .allowed_origin(Locality::Remote)
        .callback(move |sample| ear.hear(&sample, word))
        .background()
        .wait()
        .map_err(declaring(key))
}

/// Files who of the others comes and goes, those already there included, and asks who comes for its register.
fn hear_presence(sessions: &Sessions, own: VehicleId, ear: &Arc<Ear>) -> Result<(), LinkError> {
    // The ear knows whom it tells.
    let told = Arc::downgrade(ear);
    let note = move |change| {
        let Some(ear) = told.upgrade() else { return };
        match change {
            // One's own token is reported like any other.
            Change::Came(id) if id != own => ear.file(&Topic::Alive(id).key(), Word::Appeared(id), None),
            Change::Went(id) if id != own => ear.file(&Topic::Alive(id).key(), Word::Vanished(id), None),
            Change::Came(_) | Change::Went(_) => {}
            Change::Refused(address) => ear.inbox.count(Reason::Link, &address),
        }
    };
    ear.presence.watch(sessions, note)?;
    for session in &sessions.all {
        let (ear, asking) = (ear.clone(), Arc::downgrade(session));
        let ask = move |id: VehicleId, kind| {
            if let (true, SampleKind::Put, Some(session)) = (id != own, kind, asking.upgrade()) {
                let ear = ear.clone();
                register::ask(&session, Topic::Mission(id), &[], move |said| ear.hear(said, Word::Mission));
            }
        };
        watch_tokens(session, ask)?;
    }
    Ok(())
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
