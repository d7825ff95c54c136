//! The peers stage against one that keeps no books: it judges every peer at every step, from the messages alone.

use skein_common::message::{Echo, Order, Verb};
use skein_common::time::SenderStamp;

use super::*;
use crate::delay::{Excess, MessageDelay, RoundTrips, since_stamp_s};
use crate::peers::peer::MAX_OBSTACLE_RADIUS_M;

/// Everything received of one peer in its current incarnation.
#[derive(Clone, Default)]
struct PlainPeer {
    incarnation: u64,
    state: Option<(ReceivedState, LocalTime)>,
    heartbeat: Option<(Heartbeat, LocalTime)>,
    delay: RoundTrips,
    token: Option<bool>,
    received_at: Option<LocalTime>,
    found: bool,
    lost_at: Option<LocalTime>,
    lost_by_silence: bool,
    /// When it was found, or its last missing heartbeat was noticed.
    link_failed: Option<LocalTime>,
}

/// The plain stage of the own vehicle.
struct Plain {
    peers: Vec<PlainPeer>,
    stale_s: f64,
    receives_all_states: bool,
    exchange: Exchange,
    now: LocalTime,
    first: Option<LocalTime>,
    /// 0 while this computer keeps up, 1 and 2 after signs of overload.
    level: u8,
    calm_since: LocalTime,
    /// Number of peers that the last update has found to be suspected too early.
    early: u8,
    alone_since: Option<LocalTime>,
}

impl Plain {
    fn new(network: &Network, roster: u8) -> Self {
        Self {
            peers: vec![PlainPeer::default(); roster.into()],
            stale_s: network.peer_stale_s,
            receives_all_states: network.graph == Graph::All,
            exchange: Exchange::default(),
            now: LocalTime::ZERO,
            first: None,
            level: 0,
            calm_since: LocalTime::ZERO,
            early: 0,
            alone_since: None,
        }
    }

    fn stale_s(&self) -> f64 {
        if self.level == 2 { 2.0 * self.stale_s } else { self.stale_s }
    }

    fn did_not_run(&mut self, for_s: f64) {
        for peer in &mut self.peers {
            peer.received_at = peer.received_at.map(|at| at.plus_seconds(for_s));
        }
        (self.level, self.calm_since, self.early) = (2, self.now.plus_seconds(for_s), 0);
    }

    fn begin(&mut self, header: &Header) -> Option<&mut PlainPeer> {
        let nth = usize::from(header.sender.get()) - 1;
        let peer = self.peers.get_mut(nth).filter(|_| nth + 1 != usize::from(OWN))?;
        if header.incarnation.0 > peer.incarnation {
            (peer.incarnation, peer.state, peer.heartbeat) = (header.incarnation.0, None, None);
            peer.delay = RoundTrips::default();
        }
        (header.incarnation.0 == peer.incarnation).then_some(peer)
    }

    fn receive(&mut self, message: &PeerMessage, at: LocalTime) {
        match message {
            PeerMessage::State(state) => {
                let Some(peer) = self.begin(&state.header) else { return };
                if peer.state.is_none_or(|(last, _)| last.header.sequence < state.header.sequence) {
                    (peer.state, peer.received_at) = (Some((*state, at)), Some(at));
                }
            }
            PeerMessage::Mission(heartbeat) => {
                let Some(peer) = self.begin(&heartbeat.header) else { return };
                let last = peer.heartbeat.map(|(last, _)| last.header.sequence);
                if last >= Some(heartbeat.header.sequence) {
                    return;
                }
                if last.is_some_and(|last| last + 1 < heartbeat.header.sequence) {
                    peer.link_failed = Some(at);
                }
                (peer.heartbeat, peer.received_at) = (Some((*heartbeat, at)), Some(at));
                let echo = heartbeat.echo.filter(|echo| echo.of == id(OWN));
                let round_trip_s = echo.and_then(|echo| self.exchange.round_trip_s(at, &echo));
                let nth = usize::from(heartbeat.header.sender.get()) - 1;
                if let Some(round_trip_s) = round_trip_s {
                    self.peers[nth].delay.take(at, since_stamp_s(at, heartbeat.header.stamp), round_trip_s);
                }
            }
            PeerMessage::Appeared(peer) | PeerMessage::Vanished(peer) => {
                let nth = usize::from(peer.get()) - 1;
                if let Some(peer) = self.peers.get_mut(nth).filter(|_| nth + 1 != usize::from(OWN)) {
                    (peer.token, peer.lost_by_silence) = (Some(matches!(message, PeerMessage::Appeared(_))), false);
                }
            }
            PeerMessage::Order(_) => {}
        }
    }

    /// Takes the messages and returns the changes.
    fn update(&mut self, now: LocalTime, received: &[PeerMessage]) -> Vec<Change> {
        if self.early > 0 {
            (self.level, self.calm_since, self.early) = ((self.level + self.early).min(2), self.now, 0);
        }
        self.now = now;
        self.first.get_or_insert(now);
        received.iter().for_each(|message| self.receive(message, now));
        if self.level > 0 && now.seconds_since(self.calm_since) > 10.0 {
            (self.level, self.calm_since) = (self.level - 1, now);
        }
        let (stale_s, level) = (self.stale_s, self.level);
        let mut changes = Vec::new();
        for (peer, id) in self.peers.iter_mut().zip(VehicleId::first(250)) {
            let Some(received_at) = peer.received_at else { continue };
            let is_proven = peer.link_failed.is_none_or(|at| now.seconds_since(at) >= 10.0);
            let limit_s = stale_s * [if is_proven { 0.5 } else { 1.0 }, 1.0, 2.0][usize::from(level)];
            let gone = peer.token == Some(false) || now.seconds_since(received_at) > limit_s;
            if gone && peer.lost_at.is_none() {
                peer.lost_at = Some(now);
                peer.lost_by_silence = peer.token != Some(false);
                changes.extend((peer.membership() != Membership::Left).then_some(Change::Lost(id)));
            } else if !gone && (peer.lost_at.is_some() || !peer.found) {
                self.early +=
                    u8::from(peer.lost_by_silence && peer.lost_at.is_some_and(|at| now.seconds_since(at) <= stale_s));
                (peer.lost_at, peer.found, peer.link_failed) = (None, true, Some(received_at));
                changes.push(Change::Found(id));
            }
        }
        let mut met = self.peers.iter().filter(|peer| peer.found);
        let any_not_left = met.clone().any(|peer| peer.membership() != Membership::Left);
        let alone = any_not_left && met.all(|peer| peer.lost_at.is_some());
        self.alone_since = if alone { self.alone_since.or(Some(now)) } else { None };
        changes
    }

    fn ids(&self, is_one: impl Fn(&PlainPeer) -> bool) -> VehicleSet {
        self.peers.iter().zip(VehicleId::first(250)).filter(|(peer, _)| is_one(peer)).map(|(_, id)| id).collect()
    }

    fn is_active(&self, peer: &PlainPeer) -> bool {
        peer.found
            && peer.lost_at.is_none()
            && peer.heartbeat.is_some_and(|(last, _)| last.plan == 1 && last.membership == Membership::Active)
    }

    /// Whether it is in contact and reports the own vehicle as lost.
    fn has_lost_own(&self, peer: &PlainPeer) -> bool {
        let reports = peer.heartbeat.is_some_and(|(last, _)| last.plan == 1 && last.lost.contains(id(OWN)));
        reports && peer.found && peer.lost_at.is_none()
    }

    fn is_in_sight(&self, peer: &PlainPeer) -> bool {
        let Some((_, at)) = peer.state else { return self.receives_all_states };
        let is_young = match peer.lost_at {
            None => self.now.seconds_since(at) <= self.stale_s(),
            Some(lost_at) => lost_at.seconds_since(at) <= self.stale_s() + FRESH_S,
        };
        self.receives_all_states || is_young
    }

    fn estimates(&self) -> Vec<PeerEstimate> {
        let seen = self.ids(|peer| self.is_in_sight(peer) && peer.state.is_some());
        seen.iter().map(|id| self.estimate(id)).collect()
    }

    fn estimate(&self, id: VehicleId) -> PeerEstimate {
        let peer = &self.peers[usize::from(id.get()) - 1];
        let (last, at) = peer.state.unwrap();
        let silent_s = self.now.seconds_since(at).max(0.0);
        let (base, _) = peer.delay.choose(self.now);
        let delay = base.at_arrival(Excess::new(at, since_stamp_s(at, last.header.stamp))).after(silent_s);
        let MessageDelay { most_s, likely_s } = delay.unwrap_or_default();
        let (age_s, carried_s) = (silent_s + most_s, silent_s + likely_s);
        let standing = match peer.lost_at {
            Some(_) => PeerStatus::Lost,
            None if age_s > 0.5 => PeerStatus::Stale,
            None => PeerStatus::Fresh,
        };
        let same_plan = peer.heartbeat.is_some_and(|(last, _)| last.plan == 1);
        let role = match (peer.membership(), peer.lost_at) {
            (Membership::Active, None) if silent_s <= self.stale_s() && same_plan && !self.has_lost_own(peer) => {
                Role::Member
            }
            (_, Some(lost_at)) if self.now.seconds_since(lost_at) > 10.0 => Role::Nothing,
            _ => Role::Obstacle { radius_m: 8.0 + age_s.min(12.0) },
        };
        let ReceivedState { velocity, heading_rad, .. } = last;
        let position = last.position + velocity.0 * carried_s;
        let delay_s = delay.map(|delay| delay.most_s);
        PeerEstimate { id, position, velocity, heading_rad, age_s, delay_s, carried_s, standing, role }
    }

    fn fresh(&self) -> VehicleSet {
        let is_fresh = |peer: &PlainPeer| {
            let is_young = peer.state.is_some_and(|(_, at)| self.now.seconds_since(at) < FRESH_S);
            is_young && self.is_in_sight(peer) && peer.found && peer.lost_at.is_none()
        };
        self.ids(is_fresh)
    }

    fn members(&self) -> VehicleSet {
        let seen = self.estimates().into_iter().filter(|peer| peer.role == Role::Member).map(|peer| peer.id).collect();
        self.ids(|peer| !self.is_in_sight(peer) && self.is_active(peer) && !self.has_lost_own(peer)).either(seen)
    }

    fn is_lost_lately(&self, peer: &PlainPeer) -> bool {
        peer.lost_at.is_some_and(|lost_at| self.now.seconds_since(lost_at) < 60.0)
    }

    fn may_return(&self, peer: &PlainPeer) -> bool {
        peer.membership() != Membership::Left && self.is_lost_lately(peer)
    }

    fn absent_may_fly(&self) -> bool {
        let listened_s = self.now.seconds_since(self.first.unwrap());
        let is_complete = self.ids(|peer| peer.found).len() + 1 == self.peers.len();
        (!is_complete && listened_s < 60.0) || self.peers.iter().any(|peer| self.may_return(peer))
    }

    fn flies_above(&self) -> bool {
        let agrees =
            |peer: &PlainPeer| peer.lost_at.is_none() && peer.heartbeat.is_some_and(|(last, _)| last.plan == 1);
        let together = self.ids(|peer| agrees(peer) && !self.has_lost_own(peer));
        let lowest = together.first().unwrap_or(id(OWN)).min(id(OWN));
        let is_lost = |peer: &PlainPeer| peer.membership() == Membership::Active && self.may_return(peer);
        let apart = self.ids(|peer| self.is_lost_lately(peer) || self.has_lost_own(peer));
        let may_fly = self.ids(|peer| is_lost(peer) || self.is_active(peer) && self.has_lost_own(peer));
        !may_fly.is_empty() && apart.first().is_some_and(|apart| apart < lowest)
    }

    fn all_lost(&self) -> bool {
        self.alone_since.is_some_and(|since| self.now.seconds_since(since) < 60.0)
    }

    fn heartbeats(&self) -> Vec<PeerProgress> {
        let newest = self.peers.iter().filter(|peer| peer.lost_at.is_none()).filter_map(|peer| peer.heartbeat);
        newest.filter(|(last, _)| last.plan == 1).map(|(last, _)| progress(&last)).collect()
    }

    fn echo(&mut self, stamp: SenderStamp) -> Option<Echo> {
        self.exchange.send(stamp);
        let partners = self.ids(|peer| peer.lost_at.is_none() && peer.heartbeat.is_some());
        let of = self.exchange.next_partner(partners)?;
        let (last, at) = self.peers[usize::from(of.get()) - 1].heartbeat?;
        let held_us = (self.now.seconds_since(at) * 1e6).round() as u32;
        Some(Echo { of, stamp: last.header.stamp, held_us })
    }
}

impl PlainPeer {
    fn membership(&self) -> Membership {
        self.heartbeat.map_or(Membership::Joining, |(last, _)| last.membership)
    }
}

/// What happens to the network and the peers before a step.
#[derive(Clone, Debug)]
enum Event {
    /// A message of a peer: its incarnation, sequence, kind and position.
    Message {
        sender: u8,
        incarnation: u64,
        sequence: u64,
        kind: u8,
        north_m: f64,
    },
    /// The last messages arrive again.
    Repeated,
    Token {
        sender: u8,
        is_up: bool,
    },
    /// This agent does not run for a while.
    Late {
        for_s: f64,
    },
}

/// How the messages reach the vehicle: alone; with all others; or with all others that share what they know, until this
/// one's agent was late.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Delivery {
    ToOne,
    ToAll,
    Shared,
}

const ROSTER: u8 = 6;
/// The vehicle whose stage is tested: some ids are lower and some higher.
const OWN: u8 = 3;

fn event() -> impl Strategy<Value = Event> {
    let message = (1..=ROSTER + 1, 1_u64..3, 0_u64..400, 0_u8..12, -300.0..300.0);
    prop_oneof![
        30 => message.prop_map(|(sender, incarnation, sequence, kind, north_m)| Event::Message {
            sender, incarnation, sequence, kind, north_m
        }),
        2 => Just(Event::Repeated),
        2 => (1..ROSTER, any::<bool>()).prop_map(|(nth, is_up)| Event::Token { sender: nth + u8::from(nth >= OWN), is_up }),
        1 => (0.1..8.0).prop_map(|for_s| Event::Late { for_s }),
    ]
}

fn message_of(event: &Event, echo: Option<Echo>) -> Option<PeerMessage> {
    match *event {
        Event::Message { sender, incarnation, sequence, kind, north_m } => {
            let stamp = SenderStamp::from_seconds(0.2 * sequence as f64 + 3.0 * f64::from(sender));
            let header = Header { stamp, ..header(sender, incarnation, sequence) };
            if kind < 6 {
                let PeerMessage::State(sent) = state(sender, incarnation, sequence, north_m) else { unreachable!() };
                return Some(PeerMessage::State(ReceivedState { header, ..sent }));
            }
            let membership = [Membership::Active, Membership::Active, Membership::Joining, Membership::Left];
            let plan = if kind == 10 { 9 } else { 1 };
            let order = (kind == 11).then_some(Order {
                epoch: sequence / 50,
                issuer: 1,
                verb: Verb::Hold,
                vehicles: None,
                signature: None,
            });
            let heartbeat = heartbeat_of(header, plan, membership[usize::from(kind) % 4]);
            let step = (sequence / 30) as u32;
            let progress_m = sequence as f64;
            let lost = if sequence % 5 == 0 { [1, OWN].map(id).into_iter().collect() } else { VehicleSet::default() };
            Some(PeerMessage::Mission(Heartbeat { step, vouched: step, progress_m, order, echo, lost, ..heartbeat }))
        }
        Event::Token { sender, is_up: true } => Some(PeerMessage::Appeared(id(sender))),
        Event::Token { sender, is_up: false } => Some(PeerMessage::Vanished(id(sender))),
        Event::Repeated | Event::Late { .. } => None,
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn the_books_equal_a_stage_that_judges_every_peer_at_every_step(
        steps in proptest::collection::vec(
            (proptest::collection::vec(event(), 0..6), prop_oneof![8 => Just(0.02), 2 => 0.1..1.0, 1 => 2.0..70.0]), 1..150,
        ),
        graph in 0_u8..2,
        reach_m in 1.0..300.0,
        delivery in prop_oneof![Just(Delivery::ToOne), Just(Delivery::ToAll), Just(Delivery::Shared)],
    ) {
        let network = network(["", "network.graph = 'nearest'\nnetwork.neighbours = 2"][usize::from(graph)]);
        let (mut kept, mut plain) = (Peers::new(id(OWN), ROSTER, 1, &network), Plain::new(&network, ROSTER));
        let mut shared = SharedRecords::starting_with(Records::new(ROSTER, 1, &network));
        let (mut now, mut own_m) = (seconds(1.0), 0.0);
        let (mut last, mut stamps) = (Vec::new(), Vec::new());
        let (mut revision, mut agreed) = (0, Vec::new());
        for (events, after_s) in steps {
            now = now.plus_seconds(after_s);
            own_m += 20.0 * after_s;
            let mut messages = Vec::new();
            for event in &events {
                match event {
                    Event::Repeated => messages.extend_from_slice(&last),
                    Event::Late { for_s } => {
                        kept.did_not_run(*for_s);
                        plain.did_not_run(*for_s);
                    }
                    _ => {
                        let echo = stamps.last().map(|&stamp| Echo { of: id(OWN), stamp, held_us: 10_000 });
                        messages.extend(message_of(event, echo));
                    }
                }
            }
            let received: Vec<_> = messages.iter().map(|&message| Received { message, at: now }).collect();
            shared.update(now, &messages);
            let records = (delivery == Delivery::Shared).then_some(&shared);
            match delivery {
                Delivery::ToOne => kept.update(now, &received, Broadcast::default()),
                Delivery::ToAll | Delivery::Shared => kept.update(now, &[], Broadcast { messages: &messages, records, inbox: None }),
            }
            let changes = plain.update(now, &messages);
            prop_assert_eq!(kept.changes().collect::<Vec<_>>(), changes);
            prop_assert_eq!(kept.estimates().collect::<Vec<_>>(), plain.estimates());
            let ages: Vec<_> = kept.ages(VehicleId::first(ROSTER.into()).collect()).map(|peer| (peer.id, peer.age_s, peer.delay_s)).collect();
            let in_contact = plain.estimates().into_iter().filter(|peer| peer.standing != PeerStatus::Lost);
            prop_assert_eq!(kept.fresh(), plain.fresh());
            prop_assert_eq!(ages, in_contact.map(|peer| (peer.id, peer.age_s, peer.delay_s)).collect::<Vec<_>>());
            prop_assert_eq!(kept.heartbeats().collect::<Vec<_>>(), plain.heartbeats());
            prop_assert_eq!(kept.in_contact(), plain.ids(|peer| peer.found && peer.lost_at.is_none()));
            prop_assert_eq!((kept.absent_may_fly(), kept.all_lost()), (plain.absent_may_fly(), plain.all_lost()));
            let own = PositionNed::new(own_m % 500.0 - 250.0, 0.0, -30.0);
            let PeerSummary { near, members, flies_above } = kept.near(own, reach_m);
            let near: Vec<_> = near.collect();
            let is_near = |peer: &PeerEstimate| (peer.position - own).xy().norm_squared() <= reach_m * reach_m;
            let expected: Vec<_> = plain.estimates().into_iter().filter(is_near).collect();
            prop_assert_eq!(near, expected, "within {} m of {:?}", reach_m, own);
            prop_assert_eq!((members, flies_above), (plain.members(), plain.flies_above()));
            let now_agreed: Vec<_> =
                plain.heartbeats().into_iter().map(|it| PeerProgress { progress_m: 0.0, ..it }).collect();
            prop_assert!(kept.revision() != revision || now_agreed == agreed, "a change raises the revision");
            (revision, agreed) = (kept.revision(), now_agreed);
            let stamp = SenderStamp::from(now);
            prop_assert_eq!(kept.echo(stamp), plain.echo(stamp));
            stamps.push(stamp);
            last = messages;
        }
    }
}

#[test]
fn no_obstacle_is_larger_than_the_largest() {
    let mut table = PeersStage::new();
    table.receive(1.0, &[state(2, 1, 1, 0.0)]);
    table.receive(9.0, &[]);
    table.receive(18.9, &[]);
    let Role::Obstacle { radius_m } = table.only().role else { panic!("still an obstacle") };
    assert!(radius_m <= MAX_OBSTACLE_RADIUS_M);
}

/// A silent vehicle counts as back without any message when another one turns out to be suspected too early: longer silences
/// are allowed from then on. Shared records see this of every vehicle, an agent never of its own.
#[test]
fn the_silence_of_the_own_vehicle_is_no_sign_of_overload() {
    let network = network("");
    let mut shared = SharedRecords::starting_with(Records::new(ROSTER, 1, &network));
    let mut kept = Peers::new(id(OWN), ROSTER, 1, &network);
    let mut changes = Vec::new();
    let before =
        [(1.0, Some((2, 1))), (1.0, Some((OWN, 1))), (20.0, Some((OWN, 2))), (20.4, Some((1, 1))), (21.2, None)];
    let after = [(21.3, Some((2, 2))), (21.4, None), (22.2, None), (22.9, None)];
    for (at_s, sent) in before.into_iter().chain(after) {
        let messages: Vec<_> = sent.map(|(sender, sequence)| state(sender, 1, sequence, 0.0)).into_iter().collect();
        shared.update(seconds(at_s), &messages);
        kept.update(seconds(at_s), &[], Broadcast { messages: &messages, records: Some(&shared), inbox: None });
        changes.extend(kept.changes().map(|change| (at_s, change)));
    }
    use Change::{Found, Lost};
    let expected =
        [(1.0, Found(id(2))), (20.0, Lost(id(2))), (20.4, Found(id(1))), (21.3, Found(id(2))), (22.9, Lost(id(1)))];
    assert_eq!(changes, expected);
}
