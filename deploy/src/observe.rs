//! Listening to a live swarm: what every vehicle says of itself, decoded and checked. `fly` and `order` stand on it. An
//! observer is never in the loop: the swarm flies the same with it and without it.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Instant;

use skein_agent::link::presence::{Change, Presence};
use skein_agent::link::seal::Sealer;
use skein_agent::link::seal::orders::{self, Checker};
use skein_agent::link::seal::words::Voices;
use skein_agent::link::{LinkError, Sessions};
use skein_common::id::{SwarmName, VehicleId};
use skein_common::message::{self, Event, Health, Message, Mission, Order, Reason, Trace};
use skein_common::topic::{self, Author, Topic};
use zenoh::Wait;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::{Locality, Sample};

use crate::reach::Reach;
use skein_host::clock;
use skein_lab::error::Error;

/// What waits to be read; what comes on top is dropped and counted. Two seconds of 250 vehicles.
const QUEUE: usize = 25_000;

/// Whether every step is listened to. A vehicle works out, seals and sends its steps only while somebody does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Steps {
    /// They are.
    Heard,
    /// Only everything else is.
    Unheard,
}

/// Something that a vehicle said, or that became of it.
#[derive(Clone, Debug, PartialEq)]
pub enum Heard {
    /// One of its steps.
    Trace(Trace),
    /// How well it does.
    Health(Health),
    /// Its part in the agreement.
    Mission(Mission),
    /// What happened.
    Event(Event),
    /// It is there.
    Appeared(VehicleId),
    /// It is gone.
    Vanished(VehicleId),
}

/// As it is handed over.
struct Caught {
    heard: Heard,
    /// The run that its speaker has sealed it for.
    run: Option<u64>,
    at: Instant,
}

/// The newest that is known of one vehicle.
#[derive(Clone, Debug, Default)]
pub struct Seen {
    /// It is there: its liveliness token, or its link where links are secured.
    pub alive: bool,
    /// The run of the swarm that it is in, where words are sealed.
    pub run: Option<u64>,
    /// Its newest step.
    pub trace: Option<Trace>,
    /// When that was heard.
    pub trace_at: Option<Instant>,
    /// How well it does.
    pub health: Option<Health>,
    /// When that was received.
    pub health_at: Option<Instant>,
    /// The run of the swarm that it was sealed for, where messages are sealed.
    pub health_run: Option<u64>,
    /// Its part in the agreement.
    pub mission: Option<Mission>,
}

/// What was not believed.
#[derive(Debug, Default)]
struct Dropped {
    undecodable: AtomicU64,
    forged: AtomicU64,
    overflow: AtomicU64,
}

/// Listens to one swarm.
pub struct Observer {
    sessions: Sessions,
    inbox: Receiver<Caught>,
    dropped: Arc<Dropped>,
    vehicles: BTreeMap<VehicleId, Seen>,
    swarm: SwarmName,
    /// Tells which orders are an operator's, where they are sealed.
    orders: Option<Checker>,
    sealer: Option<Arc<Sealer>>,
    /// The run that was begun from this PC last, if one was.
    own_run: Option<u64>,
}

/// Why nothing can be observed.
#[derive(Debug, thiserror::Error)]
pub enum ObserveError {
    /// No session.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// A session that refuses.
    #[error("cannot listen to the swarm: {0}")]
    Zenoh(#[from] zenoh::Error),
}

impl From<ObserveError> for Error {
    fn from(error: ObserveError) -> Self {
        match &error {
            ObserveError::Link(fault) if fault.is_user_error() => Self::Refused(error.to_string()),
            _ => Self::Failed(error.to_string()),
        }
    }
}

impl Observer {
    /// Listens to this swarm; agents that are not there yet are dialled again and again.
    ///
    /// # Errors
    /// If a key is none, or Zenoh refuses.
    pub fn open(reach: &Reach, steps: Steps) -> Result<Self, ObserveError> {
        let sessions = Sessions::open(&reach.swarm, &[], &reach.all(), &reach.security)?;
        let session = sessions.first();
        let (sender, inbox) = sync_channel(QUEUE);
        let dropped = Arc::new(Dropped::default());
        let voices = reach.security.voices(&reach.swarm);
        let ear = Ear { sender, dropped: dropped.clone(), voices, presence: sessions.presence() };
        if steps == Steps::Heard {
            ear.subscribe(session, topic::all::TRACES, Heard::Trace)?;
        }
        ear.subscribe(session, topic::all::HEALTH, Heard::Health)?;
        ear.subscribe(session, topic::all::MISSIONS, Heard::Mission)?;
        ear.subscribe(session, topic::all::EVENTS, Heard::Event)?;
        let note = move |change| match change {
            Change::Appeared(id) => ear.hand_over(Heard::Appeared(id), None),
            Change::Vanished(id) => ear.hand_over(Heard::Vanished(id), None),
            Change::Refused(_) => {}
        };
        sessions.presence().watch(&sessions, note)?;
        let (swarm, sealer) = (reach.swarm.clone(), reach.sealer.clone());
        let orders = reach.orders_key.map(|key| Checker::new(key, swarm.clone()));
        let own_run = reach.own_run;
        Ok(Self { sessions, inbox, dropped, vehicles: BTreeMap::new(), swarm, orders, sealer, own_run })
    }

    /// Everything heard since the last call, in order; takes it up in [`Self::vehicles`]. Never waits.
    pub fn poll(&mut self) -> Vec<Heard> {
        self.poll_timed().into_iter().map(|(heard, _)| heard).collect()
    }

    /// As [`Self::poll`], with when it came.
    pub fn poll_timed(&mut self) -> Vec<(Heard, Instant)> {
        let mut all = Vec::new();
        while let Ok(caught) = self.inbox.try_recv() {
            if take_up(&mut self.vehicles, &caught) {
                all.push((caught.heard, caught.at));
            }
        }
        all
    }

    /// Every vehicle ever heard of, with the newest that is known of it.
    pub fn vehicles(&self) -> &BTreeMap<VehicleId, Seen> {
        &self.vehicles
    }

    /// Messages that were not believed, or came faster than they were read.
    pub fn dropped(&self) -> u64 {
        let Dropped { undecodable, forged, overflow } = &*self.dropped;
        undecodable.load(Relaxed) + forged.load(Relaxed) + overflow.load(Relaxed)
    }

    /// The run that the swarm flies in, where runs are sealed: the one that more than half of the vehicles in contact name; if
    /// none has a majority, the one that was begun from this PC, if a vehicle names it. `None` leaves it open.
    pub fn run(&self) -> Option<u64> {
        let named: Vec<u64> = self.vehicles.values().filter(|seen| seen.alive).filter_map(|seen| seen.run).collect();
        majority(&named, named.len()).or(self.own_run.filter(|own| named.contains(own)))
    }

    /// The health of a vehicle, and when it was received: while the vehicle is in contact, and if it sent this in its present
    /// life and in the run that the swarm flies in.
    pub fn health_of(&self, id: VehicleId) -> Option<(&Health, Instant)> {
        let seen = self.vehicles.get(&id).filter(|seen| seen.alive)?;
        let (health, at) = seen.health.as_ref().zip(seen.health_at)?;
        let is_of_this_life =
            seen.mission.is_none_or(|mission| mission.header.incarnation <= health.header.incarnation);
        let is_of_this_run = seen.health_run.is_none_or(|run| self.run() == Some(run));
        (is_of_this_life && is_of_this_run).then_some((health, at))
    }

    /// The order that a vehicle repeats, if it is an operator's: where orders are sealed, anybody can make one up, but no seal
    /// of the run that this vehicle flies in.
    pub fn order_of(&self, seen: &Seen) -> Option<Order> {
        let is_sealed =
            |order: &Order| self.orders.as_ref().is_none_or(|orders| orders.is_sealed(seen.run.unwrap_or(0), order));
        seen.mission?.order.filter(is_sealed)
    }

    /// One more than the largest epoch of any order that was heard of.
    pub fn next_epoch(&self) -> u64 {
        let orders = self.vehicles.values().filter_map(|seen| self.order_of(seen));
        orders.map(|order| order.epoch).max().unwrap_or(0).saturating_add(1)
    }

    /// The order as vehicles believe it: where orders are sealed, on an operator's PC, with a seal for each run that a vehicle
    /// in contact flies in. So no vehicle decides for another which run is ordered, and none is left in the air because it is
    /// of another run than most. A seal for a run that flies no more is of no use: that run is never joined again.
    pub fn sealed(&self, order: Order) -> Vec<Order> {
        let Some(sealer) = &self.sealer else { return vec![order] };
        let there = self.vehicles.values().filter(|seen| seen.alive);
        let runs: BTreeSet<u64> = there.filter_map(|seen| seen.run).filter(|run| *run != 0).collect();
        runs.into_iter().map(|run| orders::sign(sealer, &self.swarm, run, order)).collect()
    }

    /// Publishes an order to every agent that can be reached now. It is a register: publishing it again changes nothing.
    ///
    /// # Errors
    /// If Zenoh refuses.
    pub fn order(&self, order: &Order) -> Result<(), ObserveError> {
        let key = Topic::Order(order.issuer).key();
        self.sealed(*order).iter().try_for_each(|order| {
            let put = self.sessions.first().put(key.as_str(), message::encode(order));
            let put = put.congestion_control(CongestionControl::Drop).priority(Priority::RealTime);
            Ok(put.express(true).wait()?)
        })
    }
}

/// What Zenoh's threads do: decode, check, hand over. They never wait.
#[derive(Clone)]
struct Ear {
    sender: SyncSender<Caught>,
    dropped: Arc<Dropped>,
    voices: Voices,
    presence: Arc<Presence>,
}

impl Ear {
    fn subscribe<M: Message + 'static>(
        &self,
        session: &zenoh::Session,
        keys: &'static str,
        heard: fn(M) -> Heard,
    ) -> zenoh::Result<()> {
        let ear = self.clone();
        let listen = move |sample: Sample| {
            let key = sample.key_expr().as_str();
            match Topic::parse(key).map(|topic| topic.author()) {
                // Replayed by another, or on its way while its link broke.
                Some(Author::Vehicle(id)) if !ear.presence.may_send(id) => count(&ear.dropped.forged),
                _ => match ear.voices.read(key, &sample.payload().to_bytes()) {
                    Ok(said) => ear.hand_over(heard(said.message), said.run),
                    Err(error) => count(match error.reason() {
                        Reason::Undecodable | Reason::OtherVersion => &ear.dropped.undecodable,
                        _ => &ear.dropped.forged,
                    }),
                },
            }
        };
        session.declare_subscriber(keys).allowed_origin(Locality::Remote).callback(listen).background().wait()
    }

    fn hand_over(&self, heard: Heard, run: Option<u64>) {
        if self.sender.try_send(Caught { heard, run, at: clock::now() }).is_err() {
            count(&self.dropped.overflow);
        }
    }
}

/// The run that more than half of `all` name; 0 names none.
pub fn majority(named: &[u64], all: usize) -> Option<u64> {
    let has_majority = |run: &u64| *run != 0 && 2 * named.iter().filter(|other| *other == run).count() > all;
    named.iter().copied().find(has_majority)
}

fn count(counter: &AtomicU64) {
    counter.fetch_add(1, Relaxed);
}

/// Keeps the newest of everything. False for what is older than what is known.
fn take_up(vehicles: &mut BTreeMap<VehicleId, Seen>, Caught { heard, run, at }: &Caught) -> bool {
    let newer = |header: &message::Header, known: Option<&message::Header>| {
        known.map(message::Header::order) < Some(header.order())
    };
    match heard {
        Heard::Trace(trace) => {
            let seen = vehicles.entry(trace.header.sender).or_default();
            let news = newer(&trace.header, seen.trace.as_ref().map(|known| &known.header));
            if news {
                seen.trace = Some(trace.clone());
                seen.trace_at = Some(*at);
            }
            news
        }
        Heard::Health(health) => {
            let seen = vehicles.entry(health.header.sender).or_default();
            let news = newer(&health.header, seen.health.as_ref().map(|known| &known.header));
            if news {
                (seen.health, seen.health_at, seen.health_run) = (Some(health.clone()), Some(*at), *run);
            }
            news
        }
        Heard::Mission(mission) => {
            let seen = vehicles.entry(mission.header.sender).or_default();
            let news = newer(&mission.header, seen.mission.as_ref().map(|known| &known.header));
            if news {
                (seen.mission, seen.run) = (Some(*mission), *run);
            }
            news
        }
        Heard::Event(_) => true,
        Heard::Appeared(id) | Heard::Vanished(id) => {
            vehicles.entry(*id).or_default().alive = matches!(heard, Heard::Appeared(_));
            true
        }
    }
}

#[cfg(test)]
impl Observer {
    /// Takes up what vehicles are supposed to have sent, each in a run and at a time.
    pub(crate) fn suppose(&mut self, heard: impl IntoIterator<Item = (Heard, Option<u64>, Instant)>) {
        for (heard, run, at) in heard {
            take_up(&mut self.vehicles, &Caught { heard, run, at });
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use ring::rand::SystemRandom;
    use ring::signature::Ed25519KeyPair;
    use skein_agent::link::{Link, Security, Trust};
    use skein_common::id::Incarnation;
    use skein_common::message::{Happening, Header, Verb};
    use skein_common::scenario::{Source, load};
    use skein_common::state::Membership;
    use skein_common::time::SenderStamp;
    use skein_host::clock::LocalClock;

    use super::*;
    use crate::reach::Flown;

    fn mission(sender: u8, life: u64, sequence: u64) -> Mission {
        Mission {
            header: Header {
                sender: VehicleId::new(sender).unwrap(),
                incarnation: Incarnation(life),
                sequence,
                stamp: SenderStamp::ZERO,
            },
            plan: 0,
            membership: Membership::Active,
            step: 0,
            vouched: 0,
            reached: None,
            progress_m: 0.0,
            order: Some(Order { epoch: sequence, issuer: 1, verb: Verb::Hold, seal: None }),
            echo: None,
        }
    }

    fn caught(heard: Heard) -> Caught {
        Caught { heard, run: None, at: clock::now() }
    }

    #[test]
    fn the_newest_word_of_the_newest_life_stands() {
        let mut vehicles = BTreeMap::new();
        let mut hear = |life, sequence| {
            let news = take_up(&mut vehicles, &caught(Heard::Mission(mission(2, life, sequence))));
            (news, vehicles[&VehicleId::new(2).unwrap()].mission.unwrap().header.sequence)
        };
        assert_eq!(hear(1, 5), (true, 5));
        assert_eq!(hear(1, 4), (false, 5), "late");
        assert_eq!(hear(1, 5), (false, 5), "twice");
        assert_eq!(hear(2, 1), (true, 1), "restarted");
        assert_eq!(hear(1, 9), (false, 1), "of an earlier life");
    }

    #[test]
    fn a_token_makes_alive() {
        let id = VehicleId::new(1).unwrap();
        let mut vehicles = BTreeMap::new();
        let event = Event { header: mission(1, 1, 1).header, what: Happening::Landed };
        for (heard, alive) in [(Heard::Appeared(id), true), (Heard::Event(event), true), (Heard::Vanished(id), false)] {
            assert!(take_up(&mut vehicles, &caught(heard)));
            assert_eq!(vehicles[&id].alive, alive);
        }
    }

    #[test]
    fn steps_are_made_only_for_whoever_listens_to_them() {
        let swarm = SwarmName::new(format!("steps-{}", std::process::id())).unwrap();
        let id = VehicleId::new(1).unwrap();
        let here = ["tcp/127.0.0.1:0".to_owned()];
        let sessions = Sessions::open(&swarm, &here, &[], &Security::Plain).unwrap();
        let agents = BTreeMap::from([(id, sessions.endpoints().remove(0))]);
        let scenario = load(&Source { name: "x", text: "swarm.vehicles = 1" }, &[]).unwrap().scenario;
        let trust = Trust { swarm: swarm.clone(), ..Trust::of(&scenario) };
        let link = Link::new(sessions, id, LocalClock::start(), trust).unwrap();
        let reach = Reach::plain(swarm, agents, Flown::Text(String::new()));
        let event = Event { header: mission(1, 1, 1).header, what: Happening::Landed };
        for (steps, wanted) in [(Steps::Unheard, false), (Steps::Heard, true)] {
            let mut observer = Observer::open(&reach, steps).unwrap();
            let until = clock::now() + Duration::from_secs(20);
            let mut is_heard = false;
            while !(is_heard && link.trace_is_wanted() == wanted) {
                assert!(clock::now() < until, "heard: {is_heard}, {steps:?}");
                link.publish_event(&event);
                clock::sleep(Duration::from_millis(20));
                is_heard |= observer.poll().contains(&Heard::Event(event));
            }
        }
    }

    #[test]
    fn the_run_that_flies_is_named_by_more_than_half() {
        assert_eq!((majority(&[5, 7, 7], 3), majority(&[7, 7], 3), majority(&[7], 3)), (Some(7), Some(7), None));
        assert_eq!((majority(&[5, 5, 7, 7], 4), majority(&[0, 0, 0], 3), majority(&[], 0)), (None, None, None));
        let reach = Reach::plain(SwarmName::new("runs").unwrap(), BTreeMap::new(), Flown::Text(String::new()));
        let run = |own_run, named: &[(u8, u64, bool)]| {
            let mut observer = Observer::open(&Reach { own_run, ..reach.clone() }, Steps::Unheard).unwrap();
            for (sender, run, alive) in named {
                let there = alive.then(|| Heard::Appeared(VehicleId::new(*sender).unwrap()));
                let heard = there.into_iter().chain([Heard::Mission(mission(*sender, 1, 1))]);
                observer.suppose(heard.map(|heard| (heard, Some(*run), clock::now())));
            }
            observer.run()
        };
        assert_eq!(run(None, &[(1, 7, true), (2, 5, true), (3, 5, false)]), None, "a tie of those in contact");
        assert_eq!(run(Some(7), &[(1, 7, true), (2, 5, true)]), Some(7), "begun from here");
        assert_eq!(run(Some(7), &[(1, 7, true), (2, 5, true), (3, 5, true)]), Some(5));
        assert_eq!(run(Some(7), &[(2, 5, true), (3, 6, true)]), None, "nobody is in it");
    }

    #[test]
    fn an_order_that_somebody_has_made_up_counts_for_nothing() {
        let key = Ed25519KeyPair::generate_pkcs8(&SystemRandom::new()).unwrap();
        let sealer = Arc::new(Sealer::from_pkcs8(key.as_ref()).unwrap());
        let swarm = SwarmName::new(format!("observe-{}", std::process::id())).unwrap();
        let public = sealer.key();
        let scenario = Flown::Text(String::new());
        let plain = Reach::plain(swarm.clone(), BTreeMap::new(), scenario);
        let sealed = Reach { orders_key: Some(public), sealer: Some(sealer.clone()), ..plain.clone() };
        let order = |epoch| Order { epoch, issuer: 1, verb: Verb::Hold, seal: None };
        // The run that most are in; and what each of them repeats.
        let said = [
            (1, 7, orders::sign(&sealer, &swarm, 7, order(3))),
            (2, 7, order(u64::MAX - 1)),
            (3, 6, orders::sign(&sealer, &swarm, 6, order(50))),
        ];
        let observe = |reach: &Reach| {
            let mut observer = Observer::open(reach, Steps::Unheard).unwrap();
            for (sender, run, order) in said {
                let id = VehicleId::new(sender).unwrap();
                take_up(&mut observer.vehicles, &caught(Heard::Appeared(id)));
                let mission = Mission { order: Some(order), ..mission(sender, 1, 1) };
                take_up(&mut observer.vehicles, &Caught { run: Some(run), ..caught(Heard::Mission(mission)) });
            }
            observer
        };
        let observer = observe(&sealed);
        assert_eq!((observer.run(), observer.next_epoch()), (Some(7), 51));
        // An order is for every vehicle, whichever run it flies in, and is sealed for each of these runs.
        let given = observer.sealed(order(51));
        assert_eq!(given.len(), 2);
        for (given, run) in given.into_iter().zip([6, 7]) {
            assert!(orders::is_sealed(&public, &swarm, run, &given));
            let mission = Some(Mission { order: Some(given), ..mission(1, 1, 2) });
            let of_run = |run| Seen { mission, run: Some(run), ..Seen::default() };
            assert_eq!(observer.order_of(&of_run(run)), Some(given));
            assert_eq!(observer.order_of(&of_run(13 - run)), None, "a seal of another run");
        }
        let anybody = observe(&plain);
        assert_eq!(anybody.next_epoch(), u64::MAX);
        assert_eq!(anybody.sealed(order(4)), [order(4)], "where nothing is sealed");
    }
}
