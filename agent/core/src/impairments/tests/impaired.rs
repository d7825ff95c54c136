//! Impairments other than loss, delay and cuts.

use proptest::prelude::*;
use skein_common::math;
use skein_common::state::PeerStatus;

use super::super::channel::size_bytes;
use super::*;
use crate::peers::{Broadcast, Peers};

/// All impairments at once.
const ALL: &str = "\
    loss = 0.2\nburst_s = 0.5\ndelay_s = 0.1\njitter_s = 0.3\nreorder = 0.1\nreorder_s = 0.5\nduplicate = 0.1\n\
    bandwidth_bit_s = 30000\nqueue_s = 0.3\nrange_m = 300\nfade_m = 50\ngraph = 'nearest'\nneighbours = 2\n\
    links = [{ from = [2], to = [1], both_ways = true, loss = 0.4, duplicate = 0.5 }]";

fn network(seed: u64, keys: &str) -> Scenario {
    scenario(&format!("seed = {seed}\n[network]\n{keys}"))
}

/// A state of a vehicle this far north of the origin.
fn state_at(sender: u8, sequence: u64, north_m: f64) -> PeerMessage {
    let position = origin().geodetic_from_ned(PositionNed::new(north_m, 0.0, -30.0));
    let state = VehicleState { position, velocity: VelocityNed::default(), heading_rad: 0.0 };
    received_state(State { header: header(sender, sequence), state })
}

/// Offers one state per frame; returns the times of reception with the sequence numbers.
fn deliveries(receiver: &mut Receiver, sender: u8, frames: u64) -> Vec<(f64, u64)> {
    (0..frames).for_each(|frame| drop(receiver.receive(frame as f64 * FRAME_S, [state(sender, frame)])));
    let of = |(t_s, message): &(f64, PeerMessage)| match message {
        PeerMessage::State(payload) if payload.header.sender == id(sender) => Some((*t_s, payload.header.sequence)),
        _ => None,
    };
    receiver.log.iter().filter_map(of).collect()
}

/// Whether the delivery counts add up to `offered + duplicated`.
fn adds_up(impairments: &Impairments) -> bool {
    let DeliveryCounts { offered, duplicated, outside_graph, queue_full, out_of_range, lost, cut, received } =
        impairments.delivery_counts();
    offered + duplicated
        == outside_graph + queue_full + out_of_range + lost + cut + received + impairments.in_flight.len() as u64
}

#[test]
fn bursts_have_the_loss_and_the_length_of_the_scenario() {
    for (seed, loss, burst_s) in [(1, 0.2, 1.0), (2, 0.05, 0.3), (3, 0.5, 2.0), (4, 0.8, 0.5)] {
        let mut receiver = Receiver::new(&network(seed, &format!("loss = {loss}\nburst_s = {burst_s}")), 1);
        let frames = 400_000;
        let mut is_received = vec![false; frames as usize];
        deliveries(&mut receiver, 2, frames).iter().for_each(|(_, sequence)| is_received[*sequence as usize] = true);
        let lost = is_received.iter().filter(|received| !**received).count() as f64 / frames as f64;
        // Five standard deviations of the share of time that a two-state process spends in one state, and of a mean of
        // exponentially distributed lengths.
        let (all_s, fades_s) = (frames as f64 * FRAME_S, (1.0 - loss) * burst_s);
        let bound = 5.0 * (2.0 * loss * (1.0 - loss) * fades_s / all_s).sqrt();
        assert!((lost - loss).abs() < bound, "{lost} lost at {loss}, {burst_s} s; bound {bound}");
        let bursts: Vec<f64> =
            is_received.chunk_by(|a, b| a == b).filter(|run| !run[0]).map(|run| run.len() as f64 * FRAME_S).collect();
        let mean_s = bursts.iter().sum::<f64>() / bursts.len() as f64;
        // Sampled once per frame, a burst ends in a frame with this probability.
        let expected_s = FRAME_S / ((1.0 - loss) * (1.0 - math::exp(-FRAME_S / fades_s)));
        assert!((expected_s / burst_s - 1.0).abs() < 0.15, "{expected_s}");
        let bound_s = 5.0 * expected_s / (bursts.len() as f64).sqrt();
        assert!((mean_s - expected_s).abs() < bound_s, "{mean_s} s, expected {expected_s} s, bound {bound_s}");
    }
}

#[test]
fn a_burst_stops_all_messages_of_one_link_only() {
    let mut receiver = Receiver::new(&network(5, "loss = 0.5\nburst_s = 1"), 1);
    let (mut together, mut of_others) = (0, 0);
    for frame in 0..50_000_u32 {
        let received = receiver.receive(
            f64::from(frame) * FRAME_S,
            [state(2, frame.into()), mission(2, frame.into()), state(3, frame.into())],
        );
        let of = |sender| received.iter().filter(|message| message.sender() == Some(id(sender))).count();
        assert!(of(2) != 1, "only one of two simultaneous messages");
        together += of(2) / 2;
        of_others += usize::from((of(2) > 0) == (of(3) > 0));
    }
    // 1000 s of independent bursts of one second: five standard deviations of the share of time.
    assert!((together as f64 / 50_000.0 - 0.5).abs() < 0.08 && (of_others as f64 / 50_000.0 - 0.5).abs() < 0.08);
}

#[test]
fn jitter_is_evenly_distributed_and_reorders_messages() {
    let mut receiver = Receiver::new(&network(6, "delay_s = 0.2\njitter_s = 0.3"), 1);
    let received = deliveries(&mut receiver, 2, 5_000);
    assert!(
        received.len() > 4_970 && received.windows(2).all(|pair| pair[0].0 <= pair[1].0),
        "in the order of arrival"
    );
    let mut late: Vec<f64> = received.iter().map(|(t_s, sequence)| t_s - *sequence as f64 * FRAME_S - 0.2).collect();
    late.sort_by(f64::total_cmp);
    for (nth, late_s) in late.iter().enumerate() {
        // Kolmogorov and Smirnov: above 0.028 once in a thousand for 5000.
        let (share, is) = (nth as f64 / late.len() as f64, late_s / 0.3);
        assert!((-1e-6..1.0).contains(&is) && (is - share).abs() < 0.028, "{late_s}");
    }
    let overtaken = received.windows(2).filter(|pair| pair[1].1 < pair[0].1).count();
    assert!(overtaken > 1_000, "{overtaken}");
}

#[test]
fn the_reorder_share_of_messages_is_held_back() {
    let mut receiver = Receiver::new(&network(7, "reorder = 0.1\nreorder_s = 0.5"), 1);
    let received = deliveries(&mut receiver, 2, 10_000);
    let late = |(t_s, sequence): &(f64, u64)| t_s - *sequence as f64 * FRAME_S;
    let (held, other): (Vec<_>, Vec<_>) = received.iter().map(late).partition(|late_s| *late_s > 0.25);
    assert!(held.iter().all(|late_s| (late_s - 0.5).abs() < 1e-6) && other.iter().all(|late_s| late_s.abs() < 1e-6));
    // Five standard deviations of a binomial distribution.
    let share = held.len() as f64 / received.len() as f64;
    assert!((share - 0.1).abs() < 0.015, "{share}");
}

#[test]
fn the_duplicate_share_of_messages_arrives_twice() {
    let mut receiver = Receiver::new(&network(8, "duplicate = 0.3\njitter_s = 0.2"), 1);
    let received = deliveries(&mut receiver, 2, 10_000);
    let mut times = vec![Vec::new(); 10_000];
    received.iter().for_each(|(t_s, sequence)| times[*sequence as usize].push(*t_s));
    assert!(times[..9_900].iter().all(|times| (1..=2).contains(&times.len())));
    let twice: Vec<f64> = times.iter().filter(|times| times.len() == 2).map(|times| times[1] - times[0]).collect();
    assert!(twice.iter().all(|after_s| (0.0..0.2).contains(after_s)), "{twice:?}");
    let delivery_counts = receiver.impairments.delivery_counts();
    let share = delivery_counts.duplicated as f64 / delivery_counts.offered as f64;
    assert!((share - 0.3).abs() < 0.023 && adds_up(&receiver.impairments), "{delivery_counts:?}");
}

#[test]
fn one_impairment_does_not_change_the_effect_of_another() {
    let received = |keys: &str| deliveries(&mut Receiver::new(&network(9, keys), 1), 2, 500);
    let sequences = |keys: &str| {
        let mut all: Vec<u64> = received(keys).into_iter().map(|(_, sequence)| sequence).collect();
        all.sort_unstable();
        all.dedup();
        all
    };
    let lossy = sequences("loss = 0.3");
    assert_eq!(lossy, sequences("loss = 0.3\nduplicate = 0.2"));
    assert_eq!(lossy, sequences("loss = 0.1\nduplicate = 0.5\nlinks = [{ to = [1], loss = 0.3 }]"));
    let jittered = received("jitter_s = 0.1");
    let duplicated = received("jitter_s = 0.1\nduplicate = 0.4");
    assert!(jittered.iter().all(|message| duplicated.contains(message)) && duplicated.len() > jittered.len() + 100);
    let held = received("jitter_s = 0.1\nreorder = 0.4\nreorder_s = 60");
    assert!(
        held.iter().all(|message| jittered.contains(message)) && (200..400).contains(&held.len()),
        "{}",
        held.len()
    );
}

#[test]
fn a_narrow_link_is_limited_by_its_bandwidth_and_its_queue() {
    // 9600 bit/s are seven states a second, and fifty are sent.
    let mut receiver = Receiver::new(&network(1, "bandwidth_bit_s = 9600\nqueue_s = 0.4\ndelay_s = 0.1"), 1);
    let received = deliveries(&mut receiver, 2, 5_000);
    let bits = 8.0 * size_bytes(&state(2, 5_000)) as f64;
    let most = 100.0 * 9600.0 / bits;
    assert!((most - 5.0..most + 1.0).contains(&(received.len() as f64)), "{} of at most {most}", received.len());
    let late = received.iter().map(|(t_s, sequence)| t_s - *sequence as f64 * FRAME_S).fold(0.0, f64::max);
    assert!(late <= 0.1 + 0.4 + bits / 9600.0 + 1e-6 && late > 0.4, "{late}");
    assert!(received.windows(2).all(|pair| pair[0].1 < pair[1].1), "a queue keeps the order");
    assert!(
        receiver.impairments.delivery_counts().queue_full > 4_000 && adds_up(&receiver.impairments),
        "{:?}",
        receiver.impairments.delivery_counts()
    );
    // Another link has its own queue.
    let at_s = 200.0;
    receiver.receive(at_s, [state(3, 1)]);
    assert_eq!(receiver.receive(at_s + 0.3, []), [state(3, 1)]);
}

#[test]
fn a_listed_link_has_its_own_directed_settings() {
    let scenario =
        network(1, "delay_s = 0.1\nlinks = [{ from = [2], delay_s = 0.3 }, { from = [2], to = [1], delay_s = 0.5 }]");
    for (own, sender, delay_s) in [(1, 2, 0.5), (3, 2, 0.3), (2, 1, 0.1), (1, 3, 0.1)] {
        let mut receiver = Receiver::new(&scenario, own);
        receiver.receive(0.0, [state(sender, 1), PeerMessage::Appeared(id(sender))]);
        receiver.receive(1.0, []);
        let times = receiver.times(|_| true);
        assert!(
            times.len() == 2 && times.iter().all(|t_s| (t_s - delay_s).abs() < 1e-9),
            "{own} receives from {sender} after {times:?}"
        );
    }
    let both = network(1, "links = [{ from = [2], to = [1], both_ways = true, loss = 1 }]");
    for (own, sender, is_received) in [(1, 2, false), (2, 1, false), (3, 1, true), (2, 3, true)] {
        assert_eq!(Receiver::new(&both, own).receive(0.0, [state(sender, 1)]).len(), usize::from(is_received));
    }
}

#[test]
fn loss_grows_with_distance_up_to_total_loss() {
    let keys = "range_m = 300\nfade_m = 100";
    let mut shares = Vec::new();
    for north_m in [0.0, 99.0, 150.0, 200.0, 250.0, 299.0, 300.0, 1000.0] {
        let mut receiver = Receiver::new(&network(3, keys), 1);
        receiver.position = Some(PositionNed::new(0.0, 0.0, -30.0));
        let received = (0..4_000).filter(|n| !receiver.receive(0.0, [state_at(2, *n, north_m)]).is_empty()).count();
        assert!(adds_up(&receiver.impairments));
        shares.push(received as f64 / 4_000.0);
    }
    // 1 - s²(3 - 2s), and five standard deviations.
    let expected = [1.0, 1.0, 0.84375, 0.5, 0.15625, 7.5e-5, 0.0, 0.0];
    for (share, expected) in shares.iter().zip(expected) {
        let bound =
            5.0 * (expected * (1.0 - expected) / 4_000.0_f64).sqrt() + 1e-3 * f64::from(u8::from(expected < 1e-3));
        assert!((share - expected).abs() <= bound, "{shares:?}");
    }
    // A heartbeat has the position of the sender's last state, an order has none.
    let mut receiver = Receiver::new(&network(3, "range_m = 300"), 1);
    receiver.position = Some(PositionNed::new(0.0, 0.0, -30.0));
    assert_eq!(receiver.receive(0.0, [state_at(2, 1, 301.0), mission(2, 1), order(1)]), [order(1)]);
    assert_eq!(receiver.receive(0.1, [state_at(2, 2, 299.0), mission(2, 2)]).len(), 2);
    receiver.position = Some(PositionNed::new(-2.0, 0.0, -30.0));
    assert_eq!(receiver.receive(0.2, [mission(2, 3)]), []);
    receiver.position = None;
    assert_eq!(receiver.receive(0.3, [mission(2, 4)]).len(), 1, "without an own position distance has no effect");
}

#[test]
fn the_nearest_are_the_current_neighbours_that_send() {
    let mut receiver = Receiver::new(&network(3, "graph = 'nearest'\nneighbours = 1"), 1);
    receiver.position = Some(PositionNed::new(0.0, 0.0, -30.0));
    let messages = |n| [state_at(2, n, 50.0), state_at(3, n, -30.0), state_at(4, n, 70.0), mission(4, n)];
    receiver.receive(0.0, messages(1));
    assert_eq!(receiver.receive(0.1, messages(2)), [messages(2)[1], messages(2)[3]], "heartbeats reach every vehicle");
    receiver.position = Some(PositionNed::new(65.0, 0.0, -30.0));
    assert_eq!(receiver.receive(0.2, messages(3)), messages(3)[2..]);
    // Vehicle 4 sends nothing more, and 2 becomes the nearest.
    receiver.receive(1.0, [state_at(2, 4, 50.0)]);
    assert_eq!(receiver.receive(2.3, [state_at(2, 5, 50.0)]).len(), 1);
    // Vehicle 2 has gone, and 3 is left.
    receiver.receive(2.4, [PeerMessage::Vanished(id(2)), state_at(3, 6, -30.0)]);
    assert_eq!(receiver.receive(2.5, [state_at(3, 7, -30.0)]).len(), 1);
    assert!(adds_up(&receiver.impairments) && receiver.impairments.delivery_counts().outside_graph > 0);
}

#[test]
fn edges_are_directed_and_carry_states_only() {
    let scenario = network(3, "graph = 'edges'\nedges = [[1, 2], [2, 3]]");
    for (own, sender) in [(1, 2), (2, 1), (2, 3), (3, 2), (4, 1)] {
        let messages = [state(sender, 1), mission(sender, 1), PeerMessage::Appeared(id(sender)), order(1)];
        let received = Receiver::new(&scenario, own).receive(0.0, messages);
        let is_edge = [(1, 2), (2, 3)].contains(&(sender, own));
        assert_eq!(received, messages[usize::from(!is_edge)..], "{own} of {sender}");
    }
}

#[test]
fn tokens_arrive_once_and_in_order_under_any_impairment() {
    let mut receiver = Receiver::new(&network(3, &format!("{ALL}\npeer_stale_s = 3")), 3);
    let token = |n: u32| if n.is_multiple_of(2) { PeerMessage::Appeared(id(2)) } else { PeerMessage::Vanished(id(2)) };
    for n in 0..2_000 {
        receiver
            .receive(f64::from(n) * FRAME_S, [token(n), state(2, n.into()), state(2, n.into()), state(2, n.into())]);
    }
    receiver.receive(100.0, []);
    let tokens: Vec<_> = receiver.log.iter().filter(|(_, message)| !is_state(message)).copied().collect();
    assert_eq!(tokens.len(), 2_000);
    for (n, (t_s, message)) in (0..).zip(tokens) {
        assert!(message == token(n) && (t_s - f64::from(n) * FRAME_S - 0.1).abs() < 1e-6, "{n}: {message:?} at {t_s}");
    }
}

#[test]
fn the_latency_of_the_newest_state_is_reported_per_sender() {
    let keys = "delay_s = 0.1\nreorder = 0.3\nreorder_s = 0.55\nlinks = [{ from = [3], to = [1], delay_s = 0.4 }]";
    let mut receiver = Receiver::new(&network(3, keys), 1);
    let ages = |receiver: &Receiver| {
        let blank = |number| PeerAge {
            id: id(number),
            standing: PeerStatus::Fresh,
            age_s: 0.0,
            delay_s: None,
            delivered_age_s: 0.0,
        };
        let mut peers = [2, 3, 4].map(blank);
        receiver.impairments.report_latency(&mut peers);
        peers.map(|peer| peer.delivered_age_s)
    };
    assert_eq!(ages(&receiver), [0.0; 3]);
    let mut newest = [(0, 0.0); 2];
    let mut held = 0;
    for frame in 0..1_000_u64 {
        let before = receiver.log.len();
        receiver.receive(frame as f64 * FRAME_S, [state(2, frame + 1), state(3, frame + 1)]);
        for (t_s, message) in &receiver.log[before..] {
            let PeerMessage::State(payload) = message else { panic!("{message:?}") };
            let of = &mut newest[usize::from(payload.header.sender.get()) - 2];
            let late_s = t_s - (payload.header.sequence - 1) as f64 * FRAME_S;
            held += usize::from(late_s > 0.6 && payload.header.sequence > of.0);
            if payload.header.sequence > of.0 {
                *of = (payload.header.sequence, late_s);
            }
        }
        let log = ages(&receiver);
        assert!((log[0] - newest[0].1).abs() < 1e-6 && (log[1] - newest[1].1).abs() < 1e-6, "{log:?} {newest:?}");
        assert_eq!(log[2], 0.0);
    }
    assert!(newest[0].1 > 0.09 && newest[1].1 > 0.39, "{newest:?}");
    assert_eq!(held, 0, "an overtaken state is not the newest");
}

#[test]
fn the_same_seed_gives_identical_deliveries_that_differ_per_direction() {
    let log = |seed, own| {
        let mut receiver = Receiver::new(&network(seed, ALL), own);
        receiver.position = Some(PositionNed::new(0.0, 0.0, -30.0));
        for frame in 0..500 {
            let messages = [2, 3, 4].map(|sender| state_at(sender, frame, 40.0 * f64::from(sender)));
            receiver.receive(frame as f64 * FRAME_S, messages.into_iter().chain([mission(4, frame), order(frame)]));
        }
        assert!(adds_up(&receiver.impairments));
        receiver.log
    };
    assert_eq!(log(1, 1), log(1, 1));
    assert_ne!(log(1, 1), log(2, 1));
    let of = |log: &[(f64, PeerMessage)]| log.iter().filter(|(_, message)| message.sender() == Some(id(4))).count();
    assert_ne!(of(&log(1, 2)), of(&log(1, 3)), "two receivers of the same sender");
}

/// The losses of 20,000 messages over a network that loses half of them: 1 for a lost message, -1 for a received one.
fn losses(seed: u64, own: u8, message: impl Fn(u64) -> PeerMessage) -> Vec<f64> {
    let mut receiver = Receiver::new(&network(seed, "loss = 0.5"), own);
    let mut is_lost = |nth| receiver.receive(nth as f64 * FRAME_S, [message(nth)]).is_empty();
    (1..=20_000).map(|nth| if is_lost(nth) { 1.0 } else { -1.0 }).collect()
}

#[test]
fn losses_of_different_links_kinds_and_seeds_are_independent() {
    let links = [
        ("states of 2 at 1", losses(1, 1, |nth| state(2, nth))),
        ("the message after each of them", losses(1, 1, |nth| state(2, nth + 1))),
        ("states of 2 at 3", losses(1, 3, |nth| state(2, nth))),
        ("states of 3 at 1", losses(1, 1, |nth| state(3, nth))),
        ("states of 1 at 2", losses(1, 2, |nth| state(1, nth))),
        ("heartbeats of 2 at 1", losses(1, 1, |nth| mission(2, nth))),
        ("orders at 1", losses(1, 1, order)),
        ("states of 2 at 1 with another seed", losses(2, 1, |nth| state(2, nth))),
    ];
    // Five standard deviations of the mean of 20,000 independent numbers of variance 1.
    let bound = 5.0 / 20_000_f64.sqrt();
    let mean_product = |one: &[f64], other: &[f64]| one.iter().zip(other).map(|(a, b)| a * b).sum::<f64>() / 20_000.0;
    for (nth, (name, lost)) in links.iter().enumerate() {
        let excess = lost.iter().sum::<f64>() / 20_000.0;
        assert!(excess.abs() < bound, "{name}: {excess}");
        for (other_name, other) in &links[..nth] {
            let correlation = mean_product(lost, other);
            assert!(correlation.abs() < bound, "{name} and {other_name}: {correlation}");
        }
    }
}

#[test]
fn the_fates_of_messages_never_change_between_releases() {
    // The first 64 states from 2 to 1: a set bit is a lost one.
    let lost = |keys: &str| {
        let mut receiver = Receiver::new(&network(1, keys), 1);
        (0..64).map(|nth| u64::from(receiver.receive(nth as f64 * FRAME_S, [state(2, nth)]).is_empty()) << nth).sum()
    };
    let lost: [u64; 2] = ["loss = 0.5", "loss = 0.5\nburst_s = 0.1"].map(lost);
    assert_eq!(lost, [0x13c8721b72c67522, 0x9803f80bffc0], "{lost:#x?}: recorded seeds would give other flights");
}

#[test]
fn one_more_vehicle_changes_no_delivery_between_the_others() {
    let log = |vehicles: u8, own| {
        let text = format!("seed = 4\n[network]\n{ALL}");
        let sets = [format!("swarm.vehicles={vehicles}")];
        let scenario = load(&Source { name: "test.toml", text: &text }, &sets).unwrap().scenario;
        let mut receiver = Receiver::new(&scenario, own);
        receiver.position = Some(PositionNed::new(0.0, 0.0, -30.0));
        // The fifth is the farthest, so that it takes no place among the nearest.
        let senders = || (1..=vehicles).filter(|&sender| sender != own);
        for frame in 0..500 {
            let states = senders().map(|sender| state_at(sender, frame, 40.0 * f64::from(sender)));
            let heartbeats = senders().map(|sender| mission(sender, frame));
            receiver.receive(frame as f64 * FRAME_S, states.chain(heartbeats).chain([order(frame)]));
        }
        let is_of_fifth = |(_, message): &(f64, PeerMessage)| message.sender() == Some(id(5));
        let (of_fifth, of_others): (Vec<_>, Vec<_>) = receiver.log.into_iter().partition(is_of_fifth);
        assert_eq!(of_fifth.is_empty(), vehicles < 5);
        of_others
    };
    for own in 1..=4 {
        assert_eq!(log(4, own), log(5, own), "vehicle {own}");
    }
}

/// The messages of each frame, as sender and kind.
fn traffic() -> impl Strategy<Value = Vec<Vec<(u8, u8)>>> {
    prop::collection::vec(prop::collection::vec((2_u8..=4, 0_u8..10), 0..4), 1..200)
}

/// The messages of each frame, with ascending sequence numbers.
fn messages(traffic: &[Vec<(u8, u8)>]) -> impl Iterator<Item = (f64, Vec<PeerMessage>)> + '_ {
    let mut sequence = 0;
    traffic.iter().enumerate().map(move |(frame, sent)| {
        let message = |(sender, kind): &(u8, u8)| {
            sequence += 1;
            match kind {
                0 => PeerMessage::Appeared(id(*sender)),
                1 => PeerMessage::Vanished(id(*sender)),
                2..4 => mission(*sender, sequence),
                4 => order(sequence),
                _ => state_at(*sender, sequence, f64::from(*sender) * 60.0),
            }
        };
        (frame as f64 * 0.05, sent.iter().map(message).collect())
    })
}

proptest! {
    #[test]
    fn every_message_is_accounted_for(traffic in traffic(), seed: u64) {
        let seed = seed >> 1;
        let cut = "[mission]\nsteps = [{ centre_ne_m = [0, 0] }]\n\
                   events = [{ at_s = 1, for_s = 2, fault = 'cut', from = [1], to = [3], both_ways = true }]";
        let mut receiver = Receiver::new(&network(seed, &format!("{ALL}\n{cut}")), 1);
        receiver.position = Some(PositionNed::new(0.0, 0.0, -30.0));
        for (t_s, messages) in messages(&traffic) {
            receiver.receive(t_s, messages);
            prop_assert!(adds_up(&receiver.impairments), "{:?}", receiver.impairments.delivery_counts());
        }
        // A healed link first repeats its newest messages.
        receiver.receive(1e4, []);
        receiver.receive(2e4, []);
        prop_assert_eq!(receiver.impairments.in_flight.len(), 0);
        prop_assert!(adds_up(&receiver.impairments) && receiver.log.windows(2).all(|pair| pair[0].0 <= pair[1].0));
    }

    #[test]
    fn copies_are_counted_and_change_nothing(traffic in traffic(), seed: u64) {
        let seed = seed >> 1;
        let keys = "loss = 0.1\njitter_s = 0.4\nreorder = 0.2";
        let [one, other] = [0.0, 0.7].map(|share| network(seed, &format!("{keys}\nduplicate = {share}")));
        let table = |scenario: &Scenario| (Receiver::new(scenario, 1), Peers::new(id(1), 4, 1, &scenario.network));
        let (mut once, mut twice) = (table(&one), table(&other));
        for (t_s, messages) in messages(&traffic) {
            let now = LocalTime::from_seconds(t_s);
            for (receiver, peers) in [&mut once, &mut twice] {
                let from = receiver.log.len();
                receiver.receive(t_s, messages.clone());
                let received: Vec<_> = receiver.log[from..]
                    .iter()
                    .map(|(at_s, message)| Received { message: *message, at: LocalTime::from_seconds(*at_s) })
                    .collect();
                peers.update(now, &received, Broadcast::default());
            }
            prop_assert!(once.1.estimates().eq(twice.1.estimates()));
            prop_assert!(once.1.changes().eq(twice.1.changes()));
            prop_assert!(once.1.heartbeats().eq(twice.1.heartbeats()) && once.1.in_contact() == twice.1.in_contact());
        }
        prop_assert!(twice.1.old() >= once.1.old());
        prop_assert_eq!(once.0.impairments.delivery_counts().duplicated, 0);
    }

    #[test]
    fn a_narrow_link_delivers_in_order_and_within_its_bandwidth(
        gaps_ms in prop::collection::vec(0_u32..200, 1..300),
        bandwidth in 1_000.0_f64..1e5,
        queue_s in 0.0_f64..2.0,
    ) {
        let mut receiver = Receiver::new(&network(1, &format!("bandwidth_bit_s = {bandwidth:?}\nqueue_s = {queue_s:?}")), 1);
        let mut t_s = 0.0;
        for (gap_ms, sequence) in gaps_ms.iter().zip(1..) {
            t_s += f64::from(*gap_ms) * 1e-3;
            receiver.receive(t_s, [state(2, sequence)]);
            prop_assert!(adds_up(&receiver.impairments));
        }
        receiver.receive(t_s + 1e3, []);
        prop_assert_eq!(receiver.impairments.in_flight.len(), 0);
        let received = receiver.log;
        let each_s = 8.0 * size_bytes(&state(2, 1)) as f64 / bandwidth;
        prop_assert!(received.windows(2).all(|pair| pair[1].0 - pair[0].0 > each_s - 1e-6), "{received:?} {each_s}");
        prop_assert!(!received.is_empty(), "the first message finds a free link");
    }

    #[test]
    fn a_greater_distance_never_delivers_more(fade in 0.0_f64..=1.0, near_m in 0.0_f64..500.0, more_m in 0.0_f64..500.0, seed in 0_u64..1_000) {
        // With the same random numbers, every message received from afar is received from nearby.
        let keys = format!("range_m = 300\nfade_m = {:?}", (300.0 * fade).max(1e-3));
        let received = [near_m, near_m + more_m].map(|north_m| {
            let mut receiver = Receiver::new(&network(seed, &keys), 1);
            receiver.position = Some(PositionNed::new(0.0, 0.0, -30.0));
            (0..20).map(|n| receiver.receive(0.0, [state_at(2, n, north_m)]).len()).collect::<Vec<_>>()
        });
        prop_assert!(received[0].iter().zip(&received[1]).all(|(near, far)| near >= far), "{received:?}");
    }
}
