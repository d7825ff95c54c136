use proptest::prelude::*;
use skein_common::id::Incarnation;
use skein_common::message::{Header, Heartbeat, Order, State, Verb};
use skein_common::scenario::{Graph, Source, load};
use skein_common::state::VehicleState;

use super::*;
use crate::tests::{self as testing, heartbeat, id, origin, progress, received_state};

mod ages;
mod plain;
mod timeout;

fn header(sender: u8, incarnation: u64, sequence: u64) -> Header {
    Header { incarnation: Incarnation(incarnation), ..testing::header(sender, sequence) }
}

fn seconds(seconds: f64) -> LocalTime {
    LocalTime::from_seconds(seconds)
}

/// A state of vehicle `sender` at `north_m`, flying north at 2 m/s.
fn state(sender: u8, incarnation: u64, sequence: u64, north_m: f64) -> PeerMessage {
    let position = origin().geodetic_from_ned(PositionNed::new(north_m, 0.0, -30.0));
    let velocity = VelocityNed::new(2.0, 0.0, 0.0);
    let state = VehicleState { position, velocity, heading_rad: 0.0 };
    received_state(State { header: header(sender, incarnation, sequence), state })
}

fn mission(sender: u8, incarnation: u64, sequence: u64, membership: Membership) -> PeerMessage {
    PeerMessage::Mission(heartbeat_of(header(sender, incarnation, sequence), 1, membership))
}

fn heartbeat_of(header: Header, plan: u64, membership: Membership) -> Heartbeat {
    Heartbeat { plan, membership, ..heartbeat(header) }
}

/// The network settings with these keys.
fn network(keys: &str) -> Network {
    let text = format!("swarm.vehicles = 4\n{keys}");
    load(&Source { name: "test.toml", text: &text }, &[]).unwrap().scenario.network
}

/// The peers stage of vehicle 1 in a swarm of four.
struct PeersStage(Peers);

impl PeersStage {
    fn new() -> Self {
        Self::of("")
    }

    fn of(keys: &str) -> Self {
        Self(Peers::new(id(1), 4, 1, &network(keys)))
    }

    fn receive(&mut self, at_s: f64, messages: &[PeerMessage]) -> Vec<Change> {
        let received: Vec<_> = messages.iter().map(|&message| Received { message, at: seconds(at_s) }).collect();
        self.0.update(seconds(at_s), &received, Broadcast::default());
        self.0.changes().collect()
    }

    fn only(&self) -> PeerEstimate {
        let estimates: Vec<_> = self.0.estimates().collect();
        assert_eq!(estimates.len(), 1);
        estimates[0]
    }
}

#[test]
fn a_silent_peer_is_extrapolated_then_stale_then_lost_then_ignored() {
    let mut table = PeersStage::new();
    assert_eq!(
        table.receive(1.0, &[state(2, 1, 1, 10.0), mission(2, 1, 1, Membership::Active)]),
        [Change::Found(id(2))]
    );
    table.receive(1.4, &[]);
    let estimate = table.only();
    assert!((estimate.position.north_m() - 10.8).abs() < 1e-5, "2 m/s for 0.4 s");
    assert_eq!((estimate.standing, estimate.role), (PeerStatus::Fresh, Role::Member));
    table.receive(2.9, &[]);
    assert_eq!((table.only().standing, table.only().role), (PeerStatus::Stale, Role::Member));
    assert_eq!(table.receive(3.1, &[]), [Change::Lost(id(2))]);
    let near = table.only();
    table.receive(12.0, &[]);
    let far = table.only();
    let (Role::Obstacle { radius_m: early }, Role::Obstacle { radius_m: late }) = (near.role, far.role) else {
        panic!("a lost peer stays an obstacle: {near:?}, {far:?}");
    };
    assert!(early >= 8.0 && late > early + 8.0, "its radius grows: {early} to {late}");
    assert!((far.position.north_m() - 32.0).abs() < 1e-5, "where dead reckoning puts it");
    table.receive(13.2, &[]);
    assert_eq!(table.only().role, Role::Nothing, "10 s after it was lost");
}

#[test]
fn a_peer_without_token_is_lost_at_once_and_back_with_its_token() {
    let mut table = PeersStage::new();
    table.receive(1.0, &[PeerMessage::Appeared(id(2)), state(2, 1, 1, 0.0), mission(2, 1, 1, Membership::Active)]);
    assert!(!table.0.all_lost());
    assert_eq!(table.receive(1.1, &[PeerMessage::Vanished(id(2))]), [Change::Lost(id(2))]);
    assert!(table.0.all_lost());
    assert_eq!(table.receive(1.2, &[state(2, 1, 2, 0.0)]), [], "messages without a token do not bring it back");
    assert_eq!(table.receive(1.3, &[PeerMessage::Appeared(id(2))]), [Change::Found(id(2))]);
    assert_eq!(table.only().role, Role::Member);
}

#[test]
fn late_repeated_and_earlier_messages_are_ignored() {
    let mut table = PeersStage::new();
    table.receive(1.0, &[state(2, 5, 10, 50.0)]);
    for stale in [state(2, 5, 10, 0.0), state(2, 5, 9, 0.0), state(2, 4, 99, 0.0), mission(2, 4, 1, Membership::Left)] {
        table.receive(1.0, &[stale]);
        assert!((table.only().position.north_m() - 50.0).abs() < 1e-5);
    }
    assert_eq!(table.0.old(), 4);
    table.receive(1.0, &[state(2, 6, 1, 7.0)]);
    assert!((table.only().position.north_m() - 7.0).abs() < 1e-5, "a restarted peer counts from one");
    table.receive(1.0, &[state(3, 1, 1, 0.0), state(3, 1, 1, 0.0), state(4, 1, 1, 90.0)]);
    assert_eq!(table.0.old_messages().collect::<Vec<_>>(), [(id(2), 4), (id(3), 1)], "by sender");
    assert_eq!(table.0.old(), 5);
}

#[test]
fn messages_with_the_own_id_or_an_unknown_one_are_forged() {
    let mut table = PeersStage::new();
    table.receive(1.0, &[state(1, 9, 1, 0.0), state(5, 9, 1, 0.0), mission(1, 9, 1, Membership::Active)]);
    assert_eq!(table.0.forged(), 3);
    assert_eq!(table.0.estimates().count(), 0);
    table.receive(
        1.0,
        &[
            PeerMessage::Order(Order { epoch: 1, issuer: 1, verb: Verb::Land, vehicles: None, signature: None }),
            PeerMessage::Vanished(id(9)),
        ],
    );
    assert_eq!(table.0.estimates().count(), 0);
}

#[test]
fn a_peer_with_another_plan_is_an_obstacle() {
    let mut table = PeersStage::new();
    let other_plan = heartbeat_of(header(2, 1, 1), 99, Membership::Active);
    table.receive(1.0, &[state(2, 1, 1, 0.0), PeerMessage::Mission(other_plan)]);
    assert!(matches!(table.only().role, Role::Obstacle { .. }));
}

#[test]
fn joining_and_landed_peers_are_not_members() {
    let mut table = PeersStage::new();
    table.receive(1.0, &[state(2, 1, 1, 0.0)]);
    assert!(matches!(table.only().role, Role::Obstacle { .. }), "joining");
    table.receive(1.1, &[mission(2, 1, 1, Membership::Active)]);
    assert_eq!(table.only().role, Role::Member);
    table.receive(1.2, &[mission(2, 1, 2, Membership::Left)]);
    assert!(matches!(table.only().role, Role::Obstacle { .. }), "leaving");
    assert_eq!(table.receive(1.3, &[PeerMessage::Vanished(id(2))]), [], "a vehicle that left is not reported as lost");
    assert!(!table.0.all_lost());
}

#[test]
fn a_peer_that_sends_only_heartbeats_is_in_contact_and_becomes_an_obstacle() {
    let mut table = PeersStage::new();
    table.receive(1.0, &[state(2, 1, 1, 0.0), mission(2, 1, 1, Membership::Active)]);
    for sequence in 2..60 {
        table.receive(1.0 + 0.2 * sequence as f64, &[mission(2, 1, sequence, Membership::Joining)]);
    }
    assert!(table.0.in_contact().contains(id(2)) && !table.0.all_lost());
    let Role::Obstacle { radius_m } = table.only().role else { panic!("no member without a state") };
    assert!((19.0..=20.0).contains(&radius_m), "its radius stops growing: {radius_m}");
}

#[test]
fn without_contact_a_vehicle_waits_a_minute_and_then_counts_itself_as_the_only_one() {
    let mut table = PeersStage::new();
    table.receive(1.0, &[state(2, 1, 1, 0.0), mission(2, 1, 1, Membership::Active)]);
    table.receive(3.1, &[]);
    assert!(table.0.all_lost() && table.0.in_contact().is_empty());
    table.receive(63.0, &[]);
    assert!(table.0.all_lost());
    table.receive(63.2, &[]);
    assert!(!table.0.all_lost());
}

fn flies_above(table: &mut PeersStage) -> bool {
    table.0.near(PositionNed::default(), f64::INFINITY).flies_above
}

#[test]
fn of_two_partitions_the_one_without_the_lowest_id_flies_above() {
    // Of four in a chain, vehicle 3 receives the states of 2 only, and the heartbeats of 1.
    let mut table = PeersStage(Peers::new(id(3), 4, 1, &network("network.graph = 'edges'\nnetwork.edges = [[2, 3]]")));
    let all = |sequence| [1, 2, 4].map(|peer| mission(peer, 1, sequence, Membership::Active));
    table.receive(1.0, &all(1));
    table.receive(1.1, &[PeerMessage::Vanished(id(4))]);
    assert!(!flies_above(&mut table), "with the smallest id");
    table.receive(1.2, &[PeerMessage::Vanished(id(2))]);
    assert!(!flies_above(&mut table), "1 is in contact, although out of sight");
    table.receive(1.3, &[PeerMessage::Vanished(id(1))]);
    assert!(flies_above(&mut table), "lost, although its states were never received");
    table.receive(61.5, &[]);
    assert!(!flies_above(&mut table), "after a minute no lost peer counts as flying");
}

/// The heartbeat of an active member that has lost these vehicles.
fn with_lost<const N: usize>(sender: u8, sequence: u64, lost: [u8; N]) -> PeerMessage {
    let heartbeat = heartbeat_of(header(sender, 1, sequence), 1, Membership::Active);
    PeerMessage::Mission(Heartbeat { lost: lost.map(id).into_iter().collect(), ..heartbeat })
}

#[test]
fn a_peer_that_does_not_receive_this_vehicle_is_an_obstacle_and_of_another_partition() {
    let mut table = PeersStage(Peers::new(id(3), 4, 1, &network("")));
    let states = |sequence| [1, 2, 4].map(|peer| state(peer, 1, sequence, 40.0 * f64::from(peer)));
    table.receive(1.0, &states(1));
    table.receive(1.0, &[with_lost(1, 1, []), with_lost(2, 1, []), with_lost(4, 1, [])]);
    assert_eq!((table.0.members().len(), flies_above(&mut table)), (3, false));
    table.receive(1.1, &states(2));
    table.receive(1.1, &[with_lost(1, 2, [3, 4]), with_lost(2, 2, [3, 4]), with_lost(4, 2, [])]);
    let roles = |table: &PeersStage| table.0.estimates().map(|peer| peer.role).collect::<Vec<_>>();
    assert!(matches!(roles(&table)[..], [Role::Obstacle { .. }, Role::Obstacle { .. }, Role::Member]));
    assert_eq!(table.0.members(), [id(4)].into_iter().collect());
    assert_eq!(table.0.heartbeats().count(), 3, "the agreement follows all that it receives");
    assert!(flies_above(&mut table), "1 does not know where this vehicle is");
    table.receive(1.2, &[with_lost(1, 3, []), with_lost(2, 3, [3, 4])]);
    assert!(!flies_above(&mut table), "1 receives this vehicle: its partition has the lowest id");
    assert_eq!(table.0.members().len(), 2);
    // Vehicle 1 has landed: its partition still has the lowest id, and 2 still flies below.
    let left =
        Heartbeat { lost: [3].map(id).into_iter().collect(), ..heartbeat_of(header(1, 1, 4), 1, Membership::Left) };
    table.receive(1.25, &[PeerMessage::Mission(left)]);
    assert!(flies_above(&mut table));
    // The heartbeat of another plan says nothing of this swarm.
    let other =
        Heartbeat { lost: [id(3)].into_iter().collect(), ..heartbeat_of(header(1, 1, 5), 9, Membership::Active) };
    let together = with_lost(2, 4, []);
    table.receive(1.3, &[PeerMessage::Mission(other), together]);
    assert!(!flies_above(&mut table));
    // Of 1 and 4, without contact to 2 and 3, vehicle 1 has landed.
    let mut table = PeersStage(Peers::new(id(4), 4, 1, &network("")));
    table.receive(1.0, &[with_lost(1, 1, []), with_lost(2, 1, []), with_lost(3, 1, [])]);
    table.receive(3.1, &[mission(1, 1, 2, Membership::Left)]);
    assert_eq!(table.0.lost().len(), 2);
    assert!(!flies_above(&mut table), "4 stays where its partition was");
    // Vehicle 1 has landed before 2 loses it and 3: they may count it as one of theirs.
    let mut table = PeersStage(Peers::new(id(2), 4, 1, &network("")));
    table.receive(1.0, &[with_lost(1, 1, []), with_lost(3, 1, []), with_lost(4, 1, [])]);
    table.receive(3.1, &[mission(1, 1, 2, Membership::Left), with_lost(3, 2, []), with_lost(4, 2, [])]);
    table.receive(6.1, &[with_lost(4, 3, [])]);
    assert!(flies_above(&mut table), "3 keeps its altitude");
    let mut table = PeersStage(Peers::new(id(1), 4, 1, &network("")));
    table.receive(1.0, &[with_lost(2, 1, []), with_lost(3, 1, [])]);
    table.receive(3.1, &[with_lost(3, 2, [])]);
    assert_eq!(table.0.lost(), [id(2)].into_iter().collect(), "what the own heartbeats report");
}

#[test]
fn the_newest_heartbeats_of_peers_in_contact_that_fly_the_same_plan_are_kept() {
    let mut table = PeersStage::new();
    table.receive(
        1.0,
        &[mission(2, 1, 1, Membership::Active), mission(3, 1, 1, Membership::Active), state(4, 1, 1, 0.0)],
    );
    let senders = |table: &PeersStage| -> Vec<_> { table.0.heartbeats().map(|heartbeat| heartbeat.id.get()).collect() };
    assert_eq!(senders(&table), [2, 3], "4 has sent no heartbeat");
    // Vehicle 2 returns with a changed scenario.
    table.receive(1.2, &[PeerMessage::Mission(heartbeat_of(header(2, 2, 1), 9, Membership::Active))]);
    assert!(table.0.in_contact().contains(id(2)));
    assert_eq!(senders(&table), [3]);
    let report = Report { id: id(2), plan: 9, order: None };
    assert_eq!(table.0.reports().collect::<Vec<_>>(), [&report], "and reported");
    table.receive(1.3, &[PeerMessage::Vanished(id(3))]);
    assert!(senders(&table).is_empty());
}

#[test]
fn arrival_times_are_limited_to_the_time_since_the_last_update() {
    let mut table = PeersStage::new();
    table.receive(1.0, &[]);
    let received =
        [(2, 0.2), (3, 999.0)].map(|(sender, at_s)| Received { message: state(sender, 1, 1, 0.0), at: seconds(at_s) });
    table.0.update(seconds(1.5), &received, Broadcast::default());
    let ages: Vec<_> = table.0.estimates().map(|estimate| estimate.age_s).collect();
    assert_eq!(ages, [0.5, 0.0]);
}

#[test]
fn a_peer_whose_states_are_withheld_is_out_of_sight_but_not_lost() {
    let graph = "network.graph = 'edges'\nnetwork.edges = [[2, 1]]";
    for (keys, is_seen) in [("", true), (graph, false)] {
        let mut table = PeersStage::of(keys);
        table.receive(1.0, &[state(2, 1, 1, 0.0), mission(2, 1, 1, Membership::Active)]);
        // It has left the nearest peers, so only its heartbeats arrive.
        for sequence in 2..100_u64 {
            let at_s = 1.0 + 0.2 * sequence as f64;
            assert_eq!(table.receive(at_s, &[mission(2, 1, sequence, Membership::Active)]), [], "never lost");
            let is_young = at_s <= 3.0;
            assert_eq!(table.0.estimates().count(), usize::from(is_young || is_seen), "{keys}: at {at_s} s");
        }
        assert!(table.0.in_contact().contains(id(2)), "the mission waits for it");
        assert_eq!(table.0.members().contains(id(2)), !is_seen, "out of sight it has its rank in the formation");
        // Its end is noticed as well; its position was unknown.
        assert_eq!(table.receive(21.0, &[PeerMessage::Vanished(id(2))]), [Change::Lost(id(2))]);
        assert_eq!(table.0.estimates().count(), usize::from(is_seen));
        assert!(table.0.members().is_empty());
    }
}

#[test]
fn a_peer_lost_in_sight_stays_an_obstacle_under_any_graph() {
    let mut table = PeersStage::of("network.graph = 'nearest'\nnetwork.neighbours = 2");
    table.receive(1.0, &[state(2, 1, 1, 10.0), mission(2, 1, 1, Membership::Active)]);
    assert_eq!(table.receive(1.2, &[mission(2, 1, 2, Membership::Active)]), []);
    assert_eq!(table.receive(3.3, &[]), [Change::Lost(id(2))]);
    assert!(matches!(table.only().role, Role::Obstacle { .. }), "{:?}", table.only());
    table.receive(13.4, &[]);
    assert_eq!(table.only().role, Role::Nothing);
}

#[test]
fn time_in_which_the_own_agent_did_not_run_is_not_a_peers_silence() {
    let mut table = PeersStage::new();
    table.receive(1.0, &[state(2, 1, 1, 0.0)]);
    table.0.did_not_run(5.0);
    assert_eq!(table.receive(6.0, &[]), [], "five seconds do not count");
    assert!((table.only().age_s - 5.0).abs() < 1e-9, "the age of its state does count");
    assert_eq!(table.receive(9.9, &[]), [], "twice the usual time");
    assert_eq!(table.receive(10.1, &[]), [Change::Lost(id(2))]);
    table.receive(20.0, &[state(2, 1, 2, 0.0)]);
    assert_eq!(table.receive(22.1, &[]), [Change::Lost(id(2))], "the usual time again");
}

/// A message of vehicle 2; the position of a state identifies it.
fn message_of(incarnation: u64, sequence: u64, is_state: bool) -> PeerMessage {
    let PeerMessage::State(sent) = state(2, incarnation, sequence, north_m(incarnation, sequence)) else {
        unreachable!()
    };
    if is_state {
        PeerMessage::State(ReceivedState { velocity: VelocityNed::default(), ..sent })
    } else {
        mission(2, incarnation, sequence, Membership::Active)
    }
}

fn north_m(incarnation: u64, sequence: u64) -> f64 {
    incarnation as f64 * 100.0 + sequence as f64
}

proptest! {
    #[test]
    fn the_newest_message_of_the_newest_incarnation_is_used_under_any_disorder(
        received in proptest::collection::vec((1_u64..4, 1_u64..8, any::<bool>(), 0.0..0.3, -1.0..1.0), 1..60),
    ) {
        let mut table = PeersStage::new();
        let (mut now_s, mut states, mut heartbeats) = (1.0, Vec::new(), Vec::new());
        for (incarnation, sequence, is_state, after_s, off_s) in received {
            now_s += after_s;
            // The time of arrival may be wrong because the own clock was set.
            let received = Received { message: message_of(incarnation, sequence, is_state), at: seconds(now_s + off_s) };
            table.0.update(seconds(now_s), &[received], Broadcast::default());
            if is_state { states.push((incarnation, sequence)) } else { heartbeats.push((incarnation, sequence)) }
            let newest_incarnation = states.iter().chain(&heartbeats).map(|(incarnation, _)| *incarnation).max();
            let newest = |sent: &[(u64, u64)]| {
                sent.iter().filter(|(incarnation, _)| Some(*incarnation) == newest_incarnation).max().copied()
            };

            let believed = table.0.estimates().next();
            prop_assert_eq!(believed.is_some(), newest(&states).is_some(), "a state of an earlier incarnation is dropped");
            if let Some((believed, (incarnation, sequence))) = believed.zip(newest(&states)) {
                prop_assert!((believed.position.north_m() - north_m(incarnation, sequence)).abs() < 1e-4, "{believed:?}");
                prop_assert!(believed.age_s >= believed.delay_s.unwrap_or_default() && believed.carried_s >= 0.0);
            }
            let newest_of_peer = table.0.records.messages.newest(id(2));
            let kept = newest_of_peer.and_then(|newest| Some((newest.incarnation.0, newest.heartbeat?.sequence)));
            prop_assert_eq!(kept, newest(&heartbeats));
        }
    }
}
