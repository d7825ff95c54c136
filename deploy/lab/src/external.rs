//! External laws in virtual time.
//!
//! The study sends all queries of one instant, waits for all answers and hands them to the next step: a run depends on
//! the content of the answers, never on their timing.
//!
//! A silent law has neither a deadline nor a fallback, because both would depend on the speed of the PC. A law that
//! sends nothing for `LAW_TIMEOUT`, or for `CONNECT_TIMEOUT` from its start on, fails the run, and so does a law that ends. An invalid answer counts as an
//! unanswered query.
//!
//! One set of laws serves one run at a time. It stays for the next run, which begins with a hello.

mod local;
mod trial;

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::mem::{Discriminant, discriminant};
use std::net::TcpListener;
use std::num::NonZeroUsize;
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use skein_common::id::VehicleId;
use skein_common::message::ShortText;
use skein_common::scenario::Scenario;
use skein_core::formation::external::{LawQuery, LawReply};
use skein_host::external::protocol::{self, Fault, Hello, MessageFromLaw, MessageToLaw, Time};
use skein_host::external::session::{LawInput, LawSession, LawUnresponsive, Sink};
use skein_host::external::{ExternalError, LawTransport, port_of, vector};

use crate::world::World;
pub use local::{LawMaker, LocalLaws, LocalRun};
use skein_host::clock::{now, sleep};
pub use trial::Trial;

/// A law that sends nothing for this long has failed, unless the pool has another timeout, wall clock.
const LAW_TIMEOUT: Duration = Duration::from_secs(10);
/// A law may start this much later than the study, s of wall clock: a program with large libraries loads for long on a busy PC.
const CONNECT_TIMEOUT_S: u64 = 60;
const CONNECT_TIMEOUT: Duration = Duration::from_secs(CONNECT_TIMEOUT_S);
/// A datagram without an answer is sent again after this time.
const RESEND_AFTER: Duration = Duration::from_secs(1);
/// Most lines that wait to be read: a law that sends more is blocked until the study reads them.
const QUEUE: usize = 64;

/// The reason why a run with external laws failed.
#[derive(Debug, thiserror::Error)]
pub enum LawError {
    /// The law cannot be reached.
    #[error(transparent)]
    External(#[from] ExternalError),
    /// No law connected to this address in time.
    #[error("no law connected to {0} within {CONNECT_TIMEOUT_S} s")]
    NotConnected(String),
    /// The law sent nothing for too long.
    #[error("the law of vehicle {vehicle} has sent nothing for {for_s} s; the study waits for {awaited}")]
    Silent {
        /// The vehicle whose law is silent.
        vehicle: VehicleId,
        /// Time without a message, s of wall clock.
        for_s: u64,
        /// The message that the study waits for.
        awaited: &'static str,
    },
    /// The law of this vehicle ended or closed its connection.
    #[error("the law of vehicle {0} {1}")]
    Ended(VehicleId, String),
    /// The law of this vehicle, in the process of the study, failed.
    #[error("the law of vehicle {0}: {1}")]
    Local(VehicleId, String),
}

/// The kinds of faults of each vehicle's laws about which a warning was printed: once, however many sets of laws there are.
type Warned = Arc<Mutex<HashSet<(VehicleId, Discriminant<Fault>)>>>;

/// Sets of laws that wait for their next run.
///
/// All clones share the same sets. The laws receive a bye when the last clone is dropped.
#[derive(Clone, Debug, Default)]
pub struct LawPool {
    programs: Arc<Mutex<Vec<Programs>>>,
    /// Faults about which a warning was printed.
    warned: Warned,
    /// Time for which a program may send nothing, if one was set in place of the times above.
    timeout: Option<Duration>,
    /// Makes laws in this process, instead of programs.
    local: Option<LawMaker>,
}

impl LawPool {
    /// Laws that run in this process, in place of the programs that the scenario names.
    pub fn local(maker: LawMaker) -> Self {
        Self { local: Some(maker), ..Self::default() }
    }

    /// Programs that may send nothing for this long, wall clock; without a value, for ten seconds, and for a minute from their start on.
    pub fn with_timeout(timeout: Option<Duration>) -> Self {
        Self { timeout, ..Self::default() }
    }

    /// Whether the laws run in this process.
    pub fn is_local(&self) -> bool {
        self.local.is_some()
    }

    /// Takes laws for a run of this scenario and sends them a hello; `None` if its law is not external.
    ///
    /// # Errors
    /// A law cannot be reached or does not report that it is ready.
    pub fn take(&self, scenario: &Scenario) -> Result<Option<Laws>, LawError> {
        let Some(transport) = LawTransport::of(scenario)? else { return Ok(None) };
        if let Some(maker) = &self.local {
            return LocalRun::begin(maker, scenario).map(|run| Some(Laws::Local(run)));
        }
        let fits = |laws: &Programs| laws.transport == transport && laws.has_asked.len() == scenario.swarm.vehicles;
        let kept = {
            let mut pool = self.programs.lock().unwrap_or_else(PoisonError::into_inner);
            pool.iter().position(fits).map(|index| pool.swap_remove(index))
        };
        let mut laws = match kept {
            Some(laws) => laws,
            None => Programs::start(transport, scenario.ids(), self.warned.clone())?,
        };
        laws.timeout = self.timeout;
        laws.begin_run(scenario)?;
        Ok(Some(Laws::Programs(laws)))
    }

    /// Returns laws to the pool for another run.
    pub fn put_back(&self, laws: Laws) {
        if let Laws::Programs(laws) = laws {
            self.programs.lock().unwrap_or_else(PoisonError::into_inner).push(laws);
        }
    }
}

/// The number of runs that may fly at the same time: only one where the laws have a fixed address.
///
/// # Errors
/// More jobs were requested than the laws allow.
pub fn jobs(scenario: &Scenario, requested: Option<NonZeroUsize>) -> Result<Option<NonZeroUsize>, String> {
    match LawTransport::of(scenario).map_err(|error| error.to_string())? {
        Some(LawTransport::Listen(..) | LawTransport::Udp { .. }) => match requested {
            Some(jobs) if jobs.get() > 1 => {
                Err(format!("`formation.external.listen` and `udp` allow one job, not {jobs}; `command` allows any"))
            }
            _ => Ok(Some(NonZeroUsize::MIN)),
        },
        _ => Ok(requested),
    }
}

/// The laws of all vehicles of one run.
#[derive(Debug)]
pub enum Laws {
    /// In other programs.
    Programs(Programs),
    /// In this process.
    Local(LocalRun),
}

impl Laws {
    /// Sends the queries of the world's last tick to the laws and hands their answers to its next tick.
    ///
    /// # Errors
    /// A law is silent, has ended or has failed.
    pub fn serve(&mut self, world: &mut World) -> Result<(), LawError> {
        match self {
            Self::Programs(laws) => laws.serve(world),
            Self::Local(run) => run.serve(world),
        }
    }
}

/// Laws in other programs during one run.
#[derive(Debug)]
pub struct Programs {
    transport: LawTransport,
    /// One conversation for each vehicle, or a single one for all vehicles.
    conversations: Vec<Conversation>,
    listener: Option<TcpListener>,
    hellos: Vec<Hello>,
    warned: Warned,
    /// Time for which a law may send nothing, if one was set.
    timeout: Option<Duration>,
    /// Whether each vehicle's agent has sent a query in this run.
    has_asked: BTreeMap<VehicleId, bool>,
}

#[derive(Debug)]
struct Conversation {
    /// The vehicles whose law is at the other end.
    vehicles: Vec<VehicleId>,
    session: LawSession,
    messages: Receiver<LawInput>,
    /// Whether the law has sent anything in this session.
    has_answered: bool,
    /// Vehicles and ticks of this run's queries that are closed: answered, or given up because an invalid line came in
    /// place of the answer. In the second case the answer may still come.
    closed: BTreeSet<(VehicleId, u64)>,
    warned: Warned,
    /// The kinds of faults that the agent has to report since the last hello, and the reasons that it has not got yet.
    refused: HashSet<Discriminant<Fault>>,
    refusals: Vec<ShortText>,
}

impl Programs {
    fn start(transport: LawTransport, ids: impl Iterator<Item = VehicleId>, warned: Warned) -> Result<Self, LawError> {
        let bind = |host: &str, port: u16| {
            let listener = TcpListener::bind((host, port));
            let listener = listener.and_then(|listener| listener.set_nonblocking(true).map(|()| listener));
            listener.map_err(|error| ExternalError::Port(format!("{host}:{port}"), error))
        };
        let mut laws = Self {
            conversations: Vec::new(),
            listener: match &transport {
                LawTransport::Listen(host, port) => Some(bind(host, *port)?),
                LawTransport::Command(_) | LawTransport::Udp { .. } => None,
            },
            hellos: Vec::new(),
            warned,
            timeout: None,
            has_asked: ids.map(|id| (id, false)).collect(),
            transport,
        };
        if laws.listener.is_none() {
            laws.conversations =
                laws.has_asked.keys().map(|id| laws.open_conversation(*id)).collect::<Result<_, _>>()?;
        }
        Ok(laws)
    }

    /// Opens the conversation with the law of one vehicle.
    fn open_conversation(&self, id: VehicleId) -> Result<Conversation, ExternalError> {
        let (sink, messages) = message_queue();
        let session = match &self.transport {
            LawTransport::Command(command) => {
                let print_line = move |line: &str| crate::terminal::complain(&format!("vehicle {id}'s law: {line}"));
                let started = LawSession::process(command, false, sink, print_line);
                started.map_err(|error| ExternalError::Start(command.join(" "), error))?
            }
            LawTransport::Udp { ask, answer } => {
                let (ask_port, answer_port) = (port_of(ask.1, id)?, port_of(answer.1, id)?);
                let session = LawSession::datagrams((&ask.0, ask_port), (&answer.0, answer_port), sink);
                session.map_err(|error| ExternalError::Port(format!("{}:{answer_port}", answer.0), error))?
            }
            LawTransport::Listen(host, _) => {
                return Err(ExternalError::Transport(format!("one connection to {host} serves all vehicles")));
            }
        };
        Ok(Conversation::new(vec![id], session, messages, self.warned.clone()))
    }

    /// Sends a hello for every vehicle before a run and waits until all laws are ready.
    fn begin_run(&mut self, scenario: &Scenario) -> Result<(), LawError> {
        self.hellos = scenario.ids().map(|id| Hello::new(scenario, id, Time::Virtual)).collect();
        self.has_asked.values_mut().for_each(|has_asked| *has_asked = false);
        if self.listener.is_some() && self.conversations.iter_mut().all(Conversation::has_ended) {
            self.conversations = vec![self.accept()?];
        }
        for conversation in &mut self.conversations {
            // Answers that are left from the last run do not belong to this one.
            drop(conversation.messages.try_iter().take(QUEUE).last());
            conversation.send_hellos(&self.hellos)?;
        }
        let timeout = self.timeout;
        let mut all = self.conversations.iter_mut();
        all.try_for_each(|conversation| conversation.wait_until_ready(conversation.vehicles.len(), timeout))
    }

    /// Waits for the law that serves all vehicles.
    fn accept(&self) -> Result<Conversation, LawError> {
        let Some(listener) = &self.listener else {
            return Err(ExternalError::Transport("the study does not listen for a law".to_owned()).into());
        };
        let here = listener.local_addr().map_or_else(|_| String::new(), |here| here.to_string());
        eprintln!("waiting for a law to connect to {here}");
        let until = now() + CONNECT_TIMEOUT;
        let stream = loop {
            match listener.accept() {
                Ok((stream, _)) => break stream,
                Err(_) if now() < until => sleep(Duration::from_millis(20)),
                Err(_) => return Err(LawError::NotConnected(here)),
            }
        };
        let (sink, messages) = message_queue();
        let session = LawSession::connection(stream, sink).map_err(|error| ExternalError::Port(here, error))?;
        let vehicles = self.has_asked.keys().copied().collect();
        Ok(Conversation::new(vehicles, session, messages, self.warned.clone()))
    }

    /// Serves the world as [`Laws::serve`] does.
    fn serve(&mut self, world: &mut World) -> Result<(), LawError> {
        let asks = world.take_asks();
        for ask in asks.iter().filter(|ask| ask.tick == 0) {
            // A restarted agent needs a restarted law.
            if self.has_asked.insert(ask.vehicle, true) == Some(true) {
                self.send_hello_again(ask.vehicle)?;
            }
        }
        let mut open: Vec<Vec<&LawQuery>> = Vec::with_capacity(self.conversations.len());
        for conversation in &mut self.conversations {
            let its: Vec<&LawQuery> = asks.iter().filter(|ask| conversation.vehicles.contains(&ask.vehicle)).collect();
            its.iter().try_for_each(|ask| conversation.send(&MessageToLaw::LawQuery(ask)))?;
            open.push(its);
        }
        for (conversation, open) in self.conversations.iter_mut().zip(open) {
            conversation.wait_for_answers(open, self.timeout, |answer| world.answer(answer))?;
            let vehicle = conversation.first_vehicle();
            conversation.refusals.drain(..).for_each(|reason| world.refuse(vehicle, reason));
        }
        Ok(())
    }

    fn send_hello_again(&mut self, id: VehicleId) -> Result<(), LawError> {
        let hellos: Vec<_> = self.hellos.iter().filter(|hello| hello.vehicle == id).cloned().collect();
        for conversation in self.conversations.iter_mut().filter(|it| it.vehicles.contains(&id)) {
            conversation.send_hellos(&hellos)?;
            conversation.wait_until_ready(1, self.timeout)?;
        }
        Ok(())
    }
}

impl Drop for Programs {
    /// Sends bye to all laws first, so that they end at the same time.
    fn drop(&mut self) {
        self.conversations.iter_mut().for_each(|conversation| conversation.session.send_bye());
    }
}

/// A short queue for the messages of a law, and the sink that fills it.
fn message_queue() -> (impl Sink, Receiver<LawInput>) {
    let (sender, messages) = sync_channel(QUEUE);
    (move |_: Instant, message| sender.send(message).is_ok(), messages)
}

impl Conversation {
    fn new(vehicles: Vec<VehicleId>, session: LawSession, messages: Receiver<LawInput>, warned: Warned) -> Self {
        Self {
            vehicles,
            session,
            messages,
            has_answered: false,
            closed: BTreeSet::new(),
            warned,
            refused: HashSet::new(),
            refusals: Vec::new(),
        }
    }

    /// The vehicle that names this law in messages: the first of those that it serves.
    fn first_vehicle(&self) -> VehicleId {
        // A conversation always serves at least one vehicle.
        self.vehicles[0]
    }

    fn has_ended(&mut self) -> bool {
        loop {
            match self.messages.try_recv() {
                Ok(LawInput::End) => return true,
                Ok(_) => {}
                Err(error) => return error == std::sync::mpsc::TryRecvError::Disconnected,
            }
        }
    }

    /// Sends the hellos of the vehicles that this law serves.
    fn send_hellos(&mut self, hellos: &[Hello]) -> Result<(), LawError> {
        let vehicles = self.vehicles.clone();
        self.refused.clear();
        for hello in hellos.iter().filter(|hello| vehicles.contains(&hello.vehicle)) {
            // The ticks of a restarted agent count from 0 again.
            self.closed.retain(|(vehicle, _)| *vehicle != hello.vehicle);
            self.send(&MessageToLaw::Hello(hello))?;
        }
        Ok(())
    }

    fn send(&mut self, message: &MessageToLaw<'_>) -> Result<(), LawError> {
        self.session.send(message).map_err(|LawUnresponsive| self.ended())
    }

    /// Waits until the law has reported `times` times that it is ready. Answers before that belong to the last run.
    fn wait_until_ready(&mut self, mut times: usize, timeout: Option<Duration>) -> Result<(), LawError> {
        if self.session.uses_vectors() {
            return Ok(());
        }
        let since = now();
        while times > 0 {
            match self.next(since, timeout, "a ready")? {
                Some(Ok(MessageFromLaw::Ready)) => times -= 1,
                Some(Ok(MessageFromLaw::LawReply(_))) | None => {}
                Some(Err(fault)) => self.warn_once(&fault),
            }
        }
        Ok(())
    }

    /// Waits until every query is answered, or until as many invalid lines came as queries are open.
    ///
    /// Each invalid line counts in place of one answer: if that answer comes later, it does not answer the next query.
    fn wait_for_answers(
        &mut self,
        mut open: Vec<&LawQuery>,
        timeout: Option<Duration>,
        mut give: impl FnMut(LawReply),
    ) -> Result<(), LawError> {
        let since = now();
        let (mut faults, mut may_come) = (0, false);
        while open.len() > faults {
            let fault = match self.next(since, timeout, "an answer")? {
                None => {
                    // A datagram may be lost, or the model was not running yet.
                    if self.session.uses_vectors() {
                        open.iter().try_for_each(|ask| self.send(&MessageToLaw::LawQuery(ask)))?;
                    }
                    continue;
                }
                Some(Ok(MessageFromLaw::LawReply(answer))) => {
                    let asked = (answer.vehicle, answer.tick);
                    if let Some(nth) = open.iter().position(|ask| (ask.vehicle, ask.tick) == asked) {
                        open.remove(nth);
                        self.closed.insert(asked);
                        give(answer);
                        continue;
                    }
                    // The answer to a query that was sent twice.
                    if self.session.uses_vectors() {
                        continue;
                    }
                    if self.closed.contains(&asked) {
                        self.warn_once(&Fault::Late(answer.tick));
                        continue;
                    }
                    match open.iter().find(|ask| ask.vehicle == answer.vehicle) {
                        Some(ask) => Fault::Tick { got: answer.tick, open: ask.tick },
                        None => Fault::Vehicle(answer.vehicle.get().into()),
                    }
                }
                Some(Ok(MessageFromLaw::Ready)) => Fault::OutOfPlace("ready".to_owned()),
                Some(Err(fault)) => fault,
            };
            self.warn_once(&fault);
            faults += 1;
            // An answer with a wrong tick was itself the answer: no other one will come.
            may_come |= !matches!(fault, Fault::Tick { .. });
        }
        if may_come {
            self.closed.extend(open.iter().map(|ask| (ask.vehicle, ask.tick)));
        }
        Ok(())
    }

    /// Receives the next message of the law; `None` when it is time to send the datagrams again.
    fn next(
        &mut self,
        since: Instant,
        timeout: Option<Duration>,
        awaited: &'static str,
    ) -> Result<Option<Result<MessageFromLaw, Fault>>, LawError> {
        let limit = limit(self.has_answered, self.session.uses_vectors(), timeout);
        let left = (since + limit).saturating_duration_since(now());
        if left.is_zero() {
            let for_s = limit.as_secs();
            return Err(LawError::Silent { vehicle: self.first_vehicle(), for_s, awaited });
        }
        let timeout = if self.session.uses_vectors() { left.min(RESEND_AFTER) } else { left };
        match self.messages.recv_timeout(timeout) {
            Ok(LawInput::Data(message)) => {
                self.has_answered = true;
                Ok(Some(if self.session.uses_vectors() {
                    vector::read(&message).map(MessageFromLaw::LawReply)
                } else {
                    protocol::read(&message)
                }))
            }
            Ok(LawInput::TooLong) => Ok(Some(Err(Fault::TooLong))),
            Ok(LawInput::End) | Err(RecvTimeoutError::Disconnected) => Err(self.ended()),
            Err(RecvTimeoutError::Timeout) => Ok(None),
        }
    }

    /// Keeps the first fault of each kind for the agent to report, and prints a warning about it if there was none yet in another
    /// run.
    fn warn_once(&mut self, fault: &Fault) {
        if self.refused.insert(discriminant(fault)) {
            self.refusals.push(ShortText::beginning_of(&fault.to_string()));
        }
        if self.is_first_of_its_kind(fault) {
            let vehicle = self.first_vehicle();
            crate::terminal::complain(&format!("vehicle {vehicle}'s law: {fault}; more of the kind are only counted"));
        }
    }

    /// Notes the kind of this fault. Returns whether no law of this vehicle had such a fault before, in any run.
    fn is_first_of_its_kind(&self, fault: &Fault) -> bool {
        self.warned.lock().unwrap_or_else(PoisonError::into_inner).insert((self.first_vehicle(), discriminant(fault)))
    }

    fn ended(&mut self) -> LawError {
        LawError::Ended(self.first_vehicle(), self.session.how_it_ended())
    }
}

/// The time for which a law may send nothing. A set time counts from the begin on, unless the law gets datagrams: it may be started
/// later than the study.
fn limit(has_answered: bool, gets_datagrams: bool, set: Option<Duration>) -> Duration {
    match set {
        Some(set) if has_answered || !gets_datagrams => set,
        None if has_answered => LAW_TIMEOUT,
        _ => CONNECT_TIMEOUT,
    }
}

#[cfg(test)]
mod tests;
