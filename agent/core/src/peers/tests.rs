use proptest::prelude::*;
use skein_common::frame::Geodetic;
use skein_common::message::{Order, Verb};
use skein_common::scenario::{Source, load};
use skein_common::state::VehicleState;

use super::*;
use crate::testing::{self, heartbeat, id};

mod ages;

fn origin() -> Origin {
    Origin::new(Geodetic::from_degrees(28.0, -82.0, 0.0))
}

fn header(sender: u8, incarnation: u64, sequence: u64) -> Header {
    Header { incarnation: Incarnation(incarnation), ..testing::header(sender, sequence) }
}

fn seconds(seconds: f64) -> LocalTime {
    LocalTime::from_seconds(seconds)
}

/// Vehicle `sender` is at `north_m` and flies north with 2 m/s.
fn state(sender: u8, incarnation: u64, sequence: u64, north_m: f64) -> Word {
    let position = origin().geodetic_from_ned(PositionNed::new(north_m, 0.0, -30.0));
    let velocity = VelocityNed::new(2.0, 0.0, 0.0);
    let state = VehicleState { position, velocity, heading_rad: 0.0 };
    Word::State(State { header: header(sender, incarnation, sequence), state })
}

fn mission(sender: u8, incarnation: u64, sequence: u64, membership: Membership) -> Word {
    Word::Mission(register(header(sender, incarnation, sequence), 1, membership))
}

fn register(header: Header, plan: u64, membership: Membership) -> Mission {
    Mission { plan, membership, ..heartbeat(header) }
}

/// The network with these keys.
fn network(keys: &str) -> Network {
    let text = format!("swarm.vehicles = 4\n{keys}");
    load(&Source { name: "test.toml", text: &text }, &[]).unwrap().scenario.network
}

/// Vehicle 1's table of a swarm of four.
struct Table(Peers);

impl Table {
    fn new() -> Self {
        Self::of("")
    }

    fn of(keys: &str) -> Self {
        Self(Peers::new(id(1), 4, 1, &network(keys)))
    }

    fn hear(&mut self, at_s: f64, words: &[Word]) -> Vec<Change> {
        let heard: Vec<_> = words.iter().map(|&word| Heard { word, at: seconds(at_s) }).collect();
        self.0.update(seconds(at_s), &origin(), &heard);
        self.0.changes().to_vec()
    }

    fn only(&self) -> Seen {
        assert_eq!(self.0.seen().len(), 1);
        self.0.seen()[0]
    }
}

#[test]
fn a_word_is_carried_forward_then_stale_then_lost_then_no_obstacle() {
    let mut table = Table::new();
    assert_eq!(table.hear(1.0, &[state(2, 1, 1, 10.0), mission(2, 1, 1, Membership::Active)]), [Change::Found(id(2))]);
    table.hear(1.4, &[]);
    let seen = table.only();
    assert!((seen.position.north_m() - 10.8).abs() < 1e-5, "2 m/s for 0.4 s");
    assert_eq!((seen.standing, seen.role), (Standing::Fresh, Role::Member));
    table.hear(2.9, &[]);
    assert_eq!((table.only().standing, table.only().role), (Standing::Stale, Role::Member));
    assert_eq!(table.hear(3.1, &[]), [Change::Lost(id(2))]);
    let near = table.only();
    table.hear(12.0, &[]);
    let far = table.only();
    let (Role::Obstacle { radius_m: early }, Role::Obstacle { radius_m: late }) = (near.role, far.role) else {
        panic!("a lost peer stays an obstacle: {near:?}, {far:?}");
    };
    assert!(early >= 8.0 && late > early + 8.0, "its radius grows: {early} to {late}");
    assert!((far.position.north_m() - 32.0).abs() < 1e-5, "where dead reckoning puts it");
    table.hear(13.2, &[]);
    assert_eq!(table.only().role, Role::Nothing, "10 s after it was lost");
}

#[test]
fn a_token_gone_is_lost_at_once_and_back_when_it_returns() {
    let mut table = Table::new();
    table.hear(1.0, &[Word::Appeared(id(2)), state(2, 1, 1, 0.0), mission(2, 1, 1, Membership::Active)]);
    assert!(!table.0.all_lost());
    assert_eq!(table.hear(1.1, &[Word::Vanished(id(2))]), [Change::Lost(id(2))]);
    assert!(table.0.all_lost());
    assert_eq!(table.hear(1.2, &[state(2, 1, 2, 0.0)]), [], "words without a token do not bring it back");
    assert_eq!(table.hear(1.3, &[Word::Appeared(id(2))]), [Change::Found(id(2))]);
    assert_eq!(table.only().role, Role::Member);
}

#[test]
fn late_repeated_and_earlier_words_change_nothing() {
    let mut table = Table::new();
    table.hear(1.0, &[state(2, 5, 10, 50.0)]);
    for stale in [state(2, 5, 10, 0.0), state(2, 5, 9, 0.0), state(2, 4, 99, 0.0), mission(2, 4, 1, Membership::Left)] {
        table.hear(1.0, &[stale]);
        assert!((table.only().position.north_m() - 50.0).abs() < 1e-5);
    }
    assert_eq!(table.0.old(), 4);
    table.hear(1.0, &[state(2, 6, 1, 7.0)]);
    assert!((table.only().position.north_m() - 7.0).abs() < 1e-5, "a restarted peer counts from one");
    table.hear(1.0, &[state(3, 1, 1, 0.0), state(3, 1, 1, 0.0), state(4, 1, 1, 90.0)]);
    assert_eq!(table.0.old_words().collect::<Vec<_>>(), [(id(2), 4), (id(3), 1)], "who had said them");
    assert_eq!(table.0.old(), 5);
}

#[test]
fn words_in_the_own_name_or_of_strangers_are_forged() {
    let mut table = Table::new();
    table.hear(1.0, &[state(1, 9, 1, 0.0), state(5, 9, 1, 0.0), mission(1, 9, 1, Membership::Active)]);
    assert_eq!(table.0.forged(), 3);
    assert!(table.0.seen().is_empty());
    table.hear(1.0, &[Word::Order(Order { epoch: 1, issuer: 1, verb: Verb::Land, seal: None }), Word::Vanished(id(9))]);
    assert!(table.0.seen().is_empty());
}

#[test]
fn who_flies_another_plan_is_an_obstacle() {
    let mut table = Table::new();
    let stranger = register(header(2, 1, 1), 99, Membership::Active);
    table.hear(1.0, &[state(2, 1, 1, 0.0), Word::Mission(stranger)]);
    assert!(matches!(table.only().role, Role::Obstacle { .. }));
}

#[test]
fn joining_and_landed_peers_are_no_members() {
    let mut table = Table::new();
    table.hear(1.0, &[state(2, 1, 1, 0.0)]);
    assert!(matches!(table.only().role, Role::Obstacle { .. }), "joining");
    table.hear(1.1, &[mission(2, 1, 1, Membership::Active)]);
    assert_eq!(table.only().role, Role::Member);
    table.hear(1.2, &[mission(2, 1, 2, Membership::Left)]);
    assert!(matches!(table.only().role, Role::Obstacle { .. }), "leaving");
    assert_eq!(table.hear(1.3, &[Word::Vanished(id(2))]), [], "who left is not missed");
    assert!(!table.0.all_lost());
}

#[test]
fn a_peer_that_speaks_but_does_not_know_where_it_is_counts_as_heard_and_is_given_room() {
    let mut table = Table::new();
    table.hear(1.0, &[state(2, 1, 1, 0.0), mission(2, 1, 1, Membership::Active)]);
    for sequence in 2..60 {
        table.hear(1.0 + 0.2 * sequence as f64, &[mission(2, 1, sequence, Membership::Joining)]);
    }
    assert!(table.0.heard().contains(id(2)) && !table.0.all_lost());
    let Role::Obstacle { radius_m } = table.only().role else { panic!("no member without a state") };
    assert!((19.0..=20.0).contains(&radius_m), "its radius stops growing: {radius_m}");
}

#[test]
fn who_hears_nobody_waits_for_them_and_then_takes_itself_for_the_only_one() {
    let mut table = Table::new();
    table.hear(1.0, &[state(2, 1, 1, 0.0), mission(2, 1, 1, Membership::Active)]);
    table.hear(3.1, &[]);
    assert!(table.0.all_lost() && table.0.heard().is_empty());
    table.hear(63.0, &[]);
    assert!(table.0.all_lost());
    table.hear(63.2, &[]);
    assert!(!table.0.all_lost());
}

#[test]
fn of_two_parts_that_miss_each_other_the_one_without_the_smallest_id_flies_above() {
    // Of four in a chain, 3 hears the state of 2 alone, and of 1 that it takes part.
    let mut table = Table(Peers::new(id(3), 4, 1, &network("network.graph = 'edges'\nnetwork.edges = [[2, 3]]")));
    let all = |sequence| [1, 2, 4].map(|peer| mission(peer, 1, sequence, Membership::Active));
    table.hear(1.0, &all(1));
    table.hear(1.1, &[Word::Vanished(id(4))]);
    assert!(!table.0.others().flies_above, "with the smallest id");
    table.hear(1.2, &[Word::Vanished(id(2))]);
    assert!(!table.0.others().flies_above, "1 is heard, out of sight as it is");
    table.hear(1.3, &[Word::Vanished(id(1))]);
    assert!(table.0.others().flies_above, "missed, though never seen");
    table.hear(61.5, &[]);
    assert!(!table.0.others().flies_above, "after a minute nobody is missed any more");
}

#[test]
fn the_newest_heartbeats_of_the_peers_in_contact_are_there_whatever_plan_they_fly() {
    let mut table = Table::new();
    table.hear(1.0, &[mission(2, 1, 1, Membership::Active), mission(3, 1, 1, Membership::Active), state(4, 1, 1, 0.0)]);
    let plans = |table: &Table| -> Vec<_> {
        table.0.missions().map(|heartbeat| (heartbeat.header.sender.get(), heartbeat.plan)).collect()
    };
    assert_eq!(plans(&table), [(2, 1), (3, 1)], "4 has not said what it flies");
    // 2 comes back with a scenario that was changed.
    table.hear(1.2, &[Word::Mission(register(header(2, 2, 1), 9, Membership::Active))]);
    assert!(table.0.heard().contains(id(2)));
    assert_eq!(plans(&table), [(2, 9), (3, 1)]);
    table.hear(1.3, &[Word::Vanished(id(3))]);
    assert_eq!(plans(&table), [(2, 9)]);
}

#[test]
fn what_a_jumping_clock_stamped_came_since_the_last_update() {
    let mut table = Table::new();
    table.hear(1.0, &[]);
    let heard =
        [(2, 0.2), (3, 999.0)].map(|(sender, at_s)| Heard { word: state(sender, 1, 1, 0.0), at: seconds(at_s) });
    table.0.update(seconds(1.5), &origin(), &heard);
    let ages: Vec<_> = table.0.seen().iter().map(|seen| seen.age_s).collect();
    assert_eq!(ages, [0.5, 0.0]);
}

#[test]
fn whose_states_are_kept_from_a_vehicle_is_out_of_its_sight_but_not_lost() {
    let graph = "network.graph = 'edges'\nnetwork.edges = [[2, 1]]";
    for (keys, is_seen) in [("", true), (graph, false)] {
        let mut table = Table::of(keys);
        table.hear(1.0, &[state(2, 1, 1, 0.0), mission(2, 1, 1, Membership::Active)]);
        // It has gone out of the nearest few: of what it says, its part in the agreement still comes.
        for sequence in 2..100_u64 {
            let at_s = 1.0 + 0.2 * sequence as f64;
            assert_eq!(table.hear(at_s, &[mission(2, 1, sequence, Membership::Active)]), [], "never lost");
            let is_young = at_s <= 3.0;
            assert_eq!(table.0.seen().len(), usize::from(is_young || is_seen), "{keys}: at {at_s} s");
        }
        assert!(table.0.heard().contains(id(2)), "the mission counts on it");
        assert_eq!(table.0.others().unseen.contains(id(2)), !is_seen, "it has its rank in the formation");
        // Its death, too, is known; it was nowhere near.
        assert_eq!(table.hear(21.0, &[Word::Vanished(id(2))]), [Change::Lost(id(2))]);
        assert_eq!(table.0.seen().len(), usize::from(is_seen));
        assert!(table.0.others().unseen.is_empty());
    }
}

#[test]
fn who_is_lost_in_sight_stays_an_obstacle_whatever_the_graph() {
    let mut table = Table::of("network.graph = 'nearest'\nnetwork.neighbours = 2");
    table.hear(1.0, &[state(2, 1, 1, 10.0), mission(2, 1, 1, Membership::Active)]);
    assert_eq!(table.hear(1.2, &[mission(2, 1, 2, Membership::Active)]), []);
    assert_eq!(table.hear(3.3, &[]), [Change::Lost(id(2))]);
    assert!(matches!(table.only().role, Role::Obstacle { .. }), "{:?}", table.only());
    table.hear(13.4, &[]);
    assert_eq!(table.only().role, Role::Nothing);
}

#[test]
fn a_peer_is_not_blamed_for_the_time_in_which_the_own_agent_did_not_run() {
    let mut table = Table::new();
    table.hear(1.0, &[state(2, 1, 1, 0.0)]);
    table.0.did_not_run(5.0);
    assert_eq!(table.hear(6.0, &[]), [], "five seconds do not count");
    assert!((table.only().age_s - 5.0).abs() < 1e-9, "its state is as old as it is");
    assert_eq!(table.hear(9.9, &[]), [], "twice the usual time");
    assert_eq!(table.hear(10.1, &[]), [Change::Lost(id(2))]);
    table.hear(20.0, &[state(2, 1, 2, 0.0)]);
    assert_eq!(table.hear(22.1, &[]), [Change::Lost(id(2))], "the usual time again");
}

/// A message of vehicle 2, whose place says which state it is.
fn message_of(life: u64, sequence: u64, is_state: bool) -> Word {
    let Word::State(sent) = state(2, life, sequence, north_m(life, sequence)) else { unreachable!() };
    let at_rest = VehicleState { velocity: VelocityNed::default(), ..sent.state };
    if is_state {
        Word::State(State { state: at_rest, ..sent })
    } else {
        mission(2, life, sequence, Membership::Active)
    }
}

fn north_m(life: u64, sequence: u64) -> f64 {
    life as f64 * 100.0 + sequence as f64
}

proptest! {
    #[test]
    fn under_loss_reordering_duplication_and_restarts_the_newest_message_of_the_last_life_is_believed(
        received in proptest::collection::vec((1_u64..4, 1_u64..8, any::<bool>(), 0.0..0.3, -1.0..1.0), 1..60),
    ) {
        let mut table = Table::new();
        let (mut now_s, mut states, mut heartbeats) = (1.0, Vec::new(), Vec::new());
        for (life, sequence, is_state, after_s, off_s) in received {
            now_s += after_s;
            // The time of arrival may be wrong: the own clock was set.
            let heard = Heard { word: message_of(life, sequence, is_state), at: seconds(now_s + off_s) };
            table.0.update(seconds(now_s), &origin(), &[heard]);
            if is_state { states.push((life, sequence)) } else { heartbeats.push((life, sequence)) }
            let last_life = states.iter().chain(&heartbeats).map(|(life, _)| *life).max();
            let newest = |sent: &[(u64, u64)]| sent.iter().filter(|(life, _)| Some(*life) == last_life).max().copied();

            let believed = table.0.seen().first();
            prop_assert_eq!(believed.is_some(), newest(&states).is_some(), "a state of an earlier life is forgotten");
            if let Some((believed, (life, sequence))) = believed.zip(newest(&states)) {
                prop_assert!((believed.position.north_m() - north_m(life, sequence)).abs() < 1e-4, "{believed:?}");
                prop_assert!(believed.age_s >= 0.0 && believed.carried_s >= 0.0 && believed.silent_s() >= 0.0);
            }
            if let Some(heartbeat) = table.0.missions().next() {
                let order = heartbeat.header.order();
                prop_assert_eq!(Some((order.incarnation.0, order.sequence)), newest(&heartbeats));
            }
        }
    }
}
