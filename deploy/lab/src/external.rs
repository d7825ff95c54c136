//! External laws in virtual time. All asks that are due at one instant are written, all answers waited for, and handed to
//! the next step: a run depends on what the laws say, never on when.
//!
//! There is no deadline, and no fallback for a law that is silent: that would depend on the PC. A law that says nothing for
//! `SILENCE` fails the run, and so does one that ends. What it says wrongly is an ask without an answer.
//!
//! One set of laws serves one run at a time. It is kept for the next one, which begins with a hello.

mod trial;

use std::collections::{BTreeMap, BTreeSet};
use std::net::TcpListener;
use std::num::NonZeroUsize;
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use skein_common::id::VehicleId;
use skein_common::scenario::Scenario;
use skein_core::formation::external::{Answer, Ask};
use skein_host::external::protocol::{self, Fault, Heard, Hello, Said, Time};
use skein_host::external::session::{Deaf, Sink, Talk, Word};
use skein_host::external::{ExternalError, Way, port_of, vector};

use crate::world::World;
use skein_host::clock::{now, sleep};
pub use trial::Trial;

/// A law that says nothing for so long has failed, s of wall clock.
const SILENCE_S: u64 = 10;
const SILENCE: Duration = Duration::from_secs(SILENCE_S);
/// A law that connects or sends datagrams may be started this much later than the study.
const ARRIVAL_S: u64 = 60;
const ARRIVAL: Duration = Duration::from_secs(ARRIVAL_S);
/// A datagram without an answer is sent again.
const ASK_AGAIN_AFTER: Duration = Duration::from_secs(1);
/// Lines that wait to be read: a law that says more waits too.
const QUEUE: usize = 64;

/// Why a run with external laws has failed.
#[derive(Debug, thiserror::Error)]
pub enum LawError {
    /// The law cannot be reached.
    #[error(transparent)]
    External(#[from] ExternalError),
    /// Nobody connects.
    #[error("no law has connected to {0} for {ARRIVAL_S} s")]
    Nobody(String),
    /// The law says nothing.
    #[error("the law of vehicle {vehicle} has said nothing for {for_s} s: it owes {owes}")]
    Silent {
        /// Whose.
        vehicle: VehicleId,
        /// Wall clock, s.
        for_s: u64,
        /// What.
        owes: &'static str,
    },
    /// The law is gone.
    #[error("the law of vehicle {0} {1}")]
    Ended(VehicleId, String),
}

/// Sets of laws that wait for their next run; whoever holds a clone shares them. The last one says bye.
#[derive(Clone, Debug, Default)]
pub struct LawPool(Arc<Mutex<Vec<Laws>>>);

impl LawPool {
    /// Laws for a run of this scenario, to which hello has been said; `None` if it has none that are external.
    ///
    /// # Errors
    /// Laws that cannot be reached or do not get ready.
    pub fn hire(&self, scenario: &Scenario) -> Result<Option<Laws>, LawError> {
        let Some(way) = Way::of(scenario)? else { return Ok(None) };
        let fits = |laws: &Laws| laws.way == way && laws.lives.len() == scenario.swarm.vehicles;
        let kept = {
            let mut pool = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            pool.iter().position(fits).map(|index| pool.swap_remove(index))
        };
        let mut laws = match kept {
            Some(laws) => laws,
            None => Laws::start(way, scenario.ids())?,
        };
        laws.begin(scenario)?;
        Ok(Some(laws))
    }

    /// Keeps laws for another run.
    pub fn keep(&self, laws: Laws) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(laws);
    }
}

/// How many runs at once laws allow, of so many that were asked for: there is one law at the end of an address.
///
/// # Errors
/// If there were more.
pub fn jobs(scenario: &Scenario, asked: Option<NonZeroUsize>) -> Result<Option<NonZeroUsize>, String> {
    match Way::of(scenario).map_err(|error| error.to_string())? {
        Some(Way::Listen(..) | Way::Udp { .. }) => match asked {
            Some(jobs) if jobs.get() > 1 => {
                Err(format!("`formation.external.listen` and `udp` allow one job, not {jobs}; `command` allows any"))
            }
            _ => Ok(Some(NonZeroUsize::MIN)),
        },
        _ => Ok(asked),
    }
}

/// The laws of all vehicles of one run.
#[derive(Debug)]
pub struct Laws {
    way: Way,
    /// One for each vehicle, or one for all.
    conversations: Vec<Conversation>,
    listener: Option<TcpListener>,
    hellos: Vec<Hello>,
    /// Whether the vehicle's agent has asked in this run.
    lives: BTreeMap<VehicleId, bool>,
}

#[derive(Debug)]
struct Conversation {
    /// Whose laws are at the other end.
    vehicles: Vec<VehicleId>,
    talk: Talk,
    words: Receiver<Word>,
    /// Somebody is there.
    was_heard: bool,
    /// Vehicles and ticks of this run's asks that are answered, or whose answer may still come after what came in its place.
    settled: BTreeSet<(VehicleId, u64)>,
    /// Kinds of faults that were told.
    told: [bool; Fault::KINDS],
}

impl Laws {
    fn start(way: Way, ids: impl Iterator<Item = VehicleId>) -> Result<Self, LawError> {
        let bind = |host: &str, port: u16| {
            let listener = TcpListener::bind((host, port));
            let listener = listener.and_then(|listener| listener.set_nonblocking(true).map(|()| listener));
            listener.map_err(|error| ExternalError::Port(format!("{host}:{port}"), error))
        };
        let mut laws = Self {
            conversations: Vec::new(),
            listener: match &way {
                Way::Listen(host, port) => Some(bind(host, *port)?),
                Way::Command(_) | Way::Udp { .. } => None,
            },
            hellos: Vec::new(),
            lives: ids.map(|id| (id, false)).collect(),
            way,
        };
        if laws.listener.is_none() {
            laws.conversations = laws.lives.keys().map(|id| laws.converse(*id)).collect::<Result<_, _>>()?;
        }
        Ok(laws)
    }

    /// A conversation with the law of one vehicle.
    fn converse(&self, id: VehicleId) -> Result<Conversation, ExternalError> {
        let (sink, words) = ear();
        let talk = match &self.way {
            Way::Command(command) => {
                let tell = move |line: &str| crate::terminal::complain(&format!("vehicle {id}'s law: {line}"));
                let started = Talk::process(command, false, sink, tell);
                started.map_err(|error| ExternalError::Start(command.join(" "), error))?
            }
            Way::Udp { ask, answer } => {
                let (ask_port, answer_port) = (port_of(ask.1, id)?, port_of(answer.1, id)?);
                let talk = Talk::datagrams((&ask.0, ask_port), (&answer.0, answer_port), sink);
                talk.map_err(|error| ExternalError::Port(format!("{}:{answer_port}", answer.0), error))?
            }
            Way::Listen(host, _) => return Err(ExternalError::Transport(format!("{host} is listened to once"))),
        };
        Ok(Conversation::new(vec![id], talk, words))
    }

    /// Says hello to everybody, before a run, and waits until all are ready.
    fn begin(&mut self, scenario: &Scenario) -> Result<(), LawError> {
        self.hellos = scenario.ids().map(|id| Hello::new(scenario, id, Time::Virtual)).collect();
        self.lives.values_mut().for_each(|has_asked| *has_asked = false);
        if self.listener.is_some() && self.conversations.iter_mut().all(Conversation::has_ended) {
            self.conversations = vec![self.accept()?];
        }
        for conversation in &mut self.conversations {
            // Whatever is left of the last run is not meant for this one.
            drop(conversation.words.try_iter().take(QUEUE).last());
            conversation.greet(&self.hellos)?;
        }
        self.conversations
            .iter_mut()
            .try_for_each(|conversation| conversation.wait_until_ready(conversation.vehicles.len()))
    }

    /// Waits for the law that serves all vehicles.
    fn accept(&self) -> Result<Conversation, LawError> {
        let Some(listener) = &self.listener else {
            return Err(ExternalError::Transport("nobody listens".to_owned()).into());
        };
        let here = listener.local_addr().map_or_else(|_| String::new(), |here| here.to_string());
        eprintln!("waits for a law to connect to {here}");
        let until = now() + ARRIVAL;
        let stream = loop {
            match listener.accept() {
                Ok((stream, _)) => break stream,
                Err(_) if now() < until => sleep(Duration::from_millis(20)),
                Err(_) => return Err(LawError::Nobody(here)),
            }
        };
        let (sink, words) = ear();
        let talk = Talk::connection(stream, sink).map_err(|error| ExternalError::Port(here, error))?;
        Ok(Conversation::new(self.lives.keys().copied().collect(), talk, words))
    }

    /// Carries the asks of the world's last tick to the laws, and their answers to its next.
    ///
    /// # Errors
    /// A law that is silent or gone.
    pub fn serve(&mut self, world: &mut World) -> Result<(), LawError> {
        let asks = world.take_asks();
        for ask in asks.iter().filter(|ask| ask.tick == 0) {
            // A second life of the vehicle's agent is one of its law too.
            if self.lives.insert(ask.vehicle, true) == Some(true) {
                self.greet_again(ask.vehicle)?;
            }
        }
        let mut open: Vec<Vec<&Ask>> = Vec::with_capacity(self.conversations.len());
        for conversation in &mut self.conversations {
            let its: Vec<&Ask> = asks.iter().filter(|ask| conversation.vehicles.contains(&ask.vehicle)).collect();
            its.iter().try_for_each(|ask| conversation.say(&Said::Ask(ask)))?;
            open.push(its);
        }
        for (conversation, open) in self.conversations.iter_mut().zip(open) {
            conversation.settle(open, |answer| world.answer(answer))?;
        }
        Ok(())
    }

    fn greet_again(&mut self, id: VehicleId) -> Result<(), LawError> {
        let hellos: Vec<_> = self.hellos.iter().filter(|hello| hello.vehicle == id).cloned().collect();
        for conversation in self.conversations.iter_mut().filter(|it| it.vehicles.contains(&id)) {
            conversation.greet(&hellos)?;
            conversation.wait_until_ready(1)?;
        }
        Ok(())
    }
}

impl Drop for Laws {
    /// All at once: then none is waited for longer than another.
    fn drop(&mut self) {
        self.conversations.iter_mut().for_each(|conversation| conversation.talk.send_bye());
    }
}

/// Puts what is heard in a short queue.
fn ear() -> (impl Sink, Receiver<Word>) {
    let (sender, words) = sync_channel(QUEUE);
    (move |_: Instant, word| sender.send(word).is_ok(), words)
}

impl Conversation {
    fn new(vehicles: Vec<VehicleId>, talk: Talk, words: Receiver<Word>) -> Self {
        Self { vehicles, talk, words, was_heard: false, settled: BTreeSet::new(), told: [false; Fault::KINDS] }
    }

    /// Of several that one law serves, the first stands for it.
    fn name(&self) -> VehicleId {
        // A conversation is about somebody.
        self.vehicles[0]
    }

    fn has_ended(&mut self) -> bool {
        loop {
            match self.words.try_recv() {
                Ok(Word::End) => return true,
                Ok(_) => {}
                Err(error) => return error == std::sync::mpsc::TryRecvError::Disconnected,
            }
        }
    }

    /// Says hello for those whose law is here.
    fn greet(&mut self, hellos: &[Hello]) -> Result<(), LawError> {
        let vehicles = self.vehicles.clone();
        for hello in hellos.iter().filter(|hello| vehicles.contains(&hello.vehicle)) {
            // Its asks are counted anew.
            self.settled.retain(|(vehicle, _)| *vehicle != hello.vehicle);
            self.say(&Said::Hello(hello))?;
        }
        Ok(())
    }

    fn say(&mut self, said: &Said<'_>) -> Result<(), LawError> {
        self.talk.send(said).map_err(|Deaf| self.ended())
    }

    /// Waits until the law has said so often that it is ready. What it said before belongs to what was before.
    fn wait_until_ready(&mut self, mut times: usize) -> Result<(), LawError> {
        if self.talk.uses_vectors() {
            return Ok(());
        }
        let since = now();
        while times > 0 {
            match self.next(since, "a ready")? {
                Some(Ok(Heard::Ready)) => times -= 1,
                Some(Ok(Heard::Answer(_))) | None => {}
                Some(Err(fault)) => self.tell(&fault),
            }
        }
        Ok(())
    }

    /// Waits until every ask is answered, or as many lines were none as asks are left. Each of those lines costs one answer:
    /// that answer may come later, and then it is not the next ask's.
    fn settle(&mut self, mut open: Vec<&Ask>, mut give: impl FnMut(Answer)) -> Result<(), LawError> {
        let since = now();
        let (mut faults, mut may_come) = (0, false);
        while open.len() > faults {
            let fault = match self.next(since, "an answer")? {
                None => {
                    // A datagram may be lost, or the model was not running yet.
                    if self.talk.uses_vectors() {
                        open.iter().try_for_each(|ask| self.say(&Said::Ask(ask)))?;
                    }
                    continue;
                }
                Some(Ok(Heard::Answer(answer))) => {
                    let asked = (answer.vehicle, answer.tick);
                    if let Some(nth) = open.iter().position(|ask| (ask.vehicle, ask.tick) == asked) {
                        open.remove(nth);
                        self.settled.insert(asked);
                        give(answer);
                        continue;
                    }
                    // To an ask that was sent twice.
                    if self.talk.uses_vectors() {
                        continue;
                    }
                    if self.settled.contains(&asked) {
                        self.tell(&Fault::Late(answer.tick));
                        continue;
                    }
                    match open.iter().find(|ask| ask.vehicle == answer.vehicle) {
                        Some(ask) => Fault::Tick { got: answer.tick, open: ask.tick },
                        None => Fault::Vehicle(answer.vehicle.get().into()),
                    }
                }
                Some(Ok(Heard::Ready)) => Fault::OutOfPlace("ready".to_owned()),
                Some(Err(fault)) => fault,
            };
            self.tell(&fault);
            faults += 1;
            // With a wrong tick it was the answer.
            may_come |= !matches!(fault, Fault::Tick { .. });
        }
        if may_come {
            self.settled.extend(open.iter().map(|ask| (ask.vehicle, ask.tick)));
        }
        Ok(())
    }

    /// The next thing that the law says, or nothing when it is time to ask by datagram again.
    fn next(&mut self, since: Instant, owes: &'static str) -> Result<Option<Result<Heard, Fault>>, LawError> {
        let (limit, for_s) =
            if self.talk.uses_vectors() && !self.was_heard { (ARRIVAL, ARRIVAL_S) } else { (SILENCE, SILENCE_S) };
        let left = (since + limit).saturating_duration_since(now());
        if left.is_zero() {
            return Err(LawError::Silent { vehicle: self.name(), for_s, owes });
        }
        let patience = if self.talk.uses_vectors() { left.min(ASK_AGAIN_AFTER) } else { left };
        match self.words.recv_timeout(patience) {
            Ok(Word::Data(said)) if self.talk.uses_vectors() => {
                self.was_heard = true;
                Ok(Some(vector::read(&said).map(Heard::Answer)))
            }
            Ok(Word::Data(line)) => Ok(Some(protocol::read(&line))),
            Ok(Word::TooLong) => Ok(Some(Err(Fault::TooLong))),
            Ok(Word::End) | Err(RecvTimeoutError::Disconnected) => Err(self.ended()),
            Err(RecvTimeoutError::Timeout) => Ok(None),
        }
    }

    /// Tells of the first fault of a kind.
    fn tell(&mut self, fault: &Fault) {
        if !std::mem::replace(&mut self.told[fault.kind()], true) {
            crate::terminal::complain(&format!(
                "vehicle {}'s law: {fault}; more of the kind are only counted",
                self.name()
            ));
        }
    }

    fn ended(&mut self) -> LawError {
        LawError::Ended(self.name(), self.talk.how_it_ended())
    }
}

#[cfg(test)]
mod tests;
