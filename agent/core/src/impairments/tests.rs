use core::mem::discriminant;

use skein_common::frame::{Geodetic, VelocityNed};
use skein_common::message::{Order, State, Verb};
use skein_common::scenario::{Source, load};
use skein_common::state::VehicleState;

use super::*;
use crate::tests::{header, heartbeat, id, origin, received_state};

mod impaired;

const FRAME_S: f64 = 0.02;

fn scenario(text: &str) -> Scenario {
    let text = format!("swarm.vehicles = 4\n{text}");
    load(&Source { name: "test.toml", text: &text }, &[]).unwrap().scenario
}

/// A scenario with these events.
fn with_events(seed: u64, events: &str) -> Scenario {
    scenario(&format!("seed = {seed}\n[mission]\nsteps = [{{ centre_ne_m = [0, 0] }}]\nevents = [{events}]"))
}

fn state(sender: u8, sequence: u64) -> PeerMessage {
    let (position, velocity) = (Geodetic::from_degrees(28.0, -82.0, 30.0), VelocityNed::default());
    let state = VehicleState { position, velocity, heading_rad: 0.0 };
    received_state(State { header: header(sender, sequence), state })
}

fn mission(sender: u8, sequence: u64) -> PeerMessage {
    PeerMessage::Mission(heartbeat(header(sender, sequence)))
}

fn order(epoch: u64) -> PeerMessage {
    PeerMessage::Order(Order { epoch, issuer: 1, verb: Verb::Hold, vehicles: None, signature: None })
}

/// The receiver's data this long after take-off, without a position.
fn flown(flown_s: f64) -> ReceiverPosition {
    ReceiverPosition { flown_s: Some(flown_s), position: None }
}

/// A receiver that took off at its clock's zero.
struct Receiver {
    impairments: Impairments,
    position: Option<PositionNed>,
    log: Vec<(f64, PeerMessage)>,
}

impl Receiver {
    fn new(scenario: &Scenario, own: u8) -> Self {
        Self { impairments: Impairments::new(scenario, id(own)), position: None, log: Vec::new() }
    }

    fn own(&self, t_s: f64) -> ReceiverPosition {
        ReceiverPosition { position: self.position, ..flown(t_s) }
    }

    /// Offers the messages that arrive at `t_s` and returns those received by then.
    fn receive(&mut self, t_s: f64, messages: impl IntoIterator<Item = PeerMessage>) -> Vec<PeerMessage> {
        let at = LocalTime::from_seconds(t_s);
        let mut out = Vec::new();
        self.impairments.receive(
            at,
            self.own(t_s),
            messages.into_iter().map(|message| Received { message, at }),
            &mut out,
        );
        assert!(out.iter().all(|received| received.at <= at), "received before its arrival");
        self.log.extend(out.iter().map(|received| (received.at.seconds(), received.message)));
        out.into_iter().map(|received| received.message).collect()
    }

    /// Runs until `to_s`; `peer` sends a state in every frame and a heartbeat in every tenth.
    fn run_with_peer(&mut self, peer: u8, from_s: f64, to_s: f64) {
        for frame in (from_s / FRAME_S).round() as u64..(to_s / FRAME_S).round() as u64 {
            let messages =
                [state(peer, frame + 1)].into_iter().chain((frame % 10 == 0).then(|| mission(peer, frame + 1)));
            self.receive(frame as f64 * FRAME_S, messages);
        }
    }

    /// Times at which messages of this kind were received, s.
    fn times(&self, kind: impl Fn(&PeerMessage) -> bool) -> Vec<f64> {
        self.log.iter().filter(|(_, message)| kind(message)).map(|(t_s, _)| *t_s).collect()
    }

    fn only_time(&self, message: PeerMessage) -> f64 {
        let times = self.times(|log| *log == message);
        assert_eq!(times.len(), 1, "{message:?} at {times:?}");
        times[0]
    }
}

fn is_state(message: &PeerMessage) -> bool {
    matches!(message, PeerMessage::State(_))
}

/// Gaps of more than two frames between these times, s.
fn gaps(times: &[f64]) -> Vec<(f64, f64)> {
    times.windows(2).filter(|pair| pair[1] - pair[0] > 2.5 * FRAME_S).map(|pair| (pair[0], pair[1])).collect()
}

fn near(one_s: f64, other_s: f64) -> bool {
    (one_s - other_s).abs() < 1.5 * FRAME_S
}

#[test]
fn an_ideal_network_delivers_all_messages_at_once_and_in_order() {
    let mut impairments = Impairments::new(&scenario(""), id(1));
    let at = LocalTime::from_seconds;
    let messages = [order(1), state(2, 1), PeerMessage::Vanished(id(3)), mission(4, 9)];
    // The last one arrives shortly after the step began, as in a real agent.
    let arriving = messages
        .map(|message| Received { message, at: at(1.0) })
        .into_iter()
        .chain([Received { message: state(3, 2), at: at(1.01) }]);
    let arriving: Vec<_> = arriving.collect();
    let mut out = vec![Received { message: order(0), at: at(0.5) }];
    impairments.receive(at(1.0), ReceiverPosition::default(), arriving.iter().copied(), &mut out);
    assert_eq!(out[1..], arriving[..]);
}

#[test]
fn the_loss_matches_the_scenario_and_tokens_are_never_lost() {
    for (loss, own) in [(0.05, 1), (0.3, 2), (0.9, 3)] {
        let mut receiver = Receiver::new(&scenario(&format!("seed = 7\nnetwork.loss = {loss}")), own);
        let rounds = 20_000_u32;
        for round in 0..rounds {
            let messages =
                [state(4, round.into()), mission(4, round.into()), order(round.into()), PeerMessage::Appeared(id(4))];
            receiver.receive(f64::from(round) * FRAME_S, messages);
        }
        // Five standard deviations of a binomial distribution.
        let bound = 5.0 * (loss * (1.0 - loss) / f64::from(rounds)).sqrt();
        for first in [state(4, 0), mission(4, 0), order(0)] {
            let received = receiver.times(|message| discriminant(message) == discriminant(&first)).len();
            let lost = 1.0 - received as f64 / f64::from(rounds);
            assert!((lost - loss).abs() < bound, "lost {lost} of the messages like {first:?} at {loss}");
        }
        assert_eq!(receiver.times(|message| matches!(message, PeerMessage::Appeared(_))).len(), rounds as usize);
    }
}

#[test]
fn losses_differ_between_receivers_and_repeat_with_the_seed() {
    let lossy = |seed: u64| scenario(&format!("seed = {seed}\nnetwork.loss = 0.5"));
    let received = |scenario: &Scenario, own| {
        let mut receiver = Receiver::new(scenario, own);
        (0..200).map(|n| receiver.receive(n as f64, [state(4, n)]).len()).collect::<Vec<_>>()
    };
    assert_eq!(received(&lossy(1), 1), received(&lossy(1), 1));
    assert_ne!(received(&lossy(1), 1), received(&lossy(1), 2), "independent");
    assert_ne!(received(&lossy(1), 1), received(&lossy(2), 1), "another seed");
}

#[test]
fn a_delay_is_exact_and_keeps_the_order_of_simultaneous_arrivals() {
    let mut receiver = Receiver::new(&scenario("network.delay_s = 0.25"), 1);
    let messages = [state(2, 1), PeerMessage::Appeared(id(3)), order(1), state(4, 1), mission(2, 1)];
    assert_eq!(receiver.receive(1.0, messages), []);
    assert_eq!(receiver.receive(1.24, [state(2, 2)]), []);
    assert_eq!(receiver.receive(1.26, []), messages);
    assert!(receiver.log.iter().all(|(t_s, _)| *t_s == 1.25), "{:?}", receiver.log);
    assert_eq!(receiver.receive(1.48, []), []);
    assert_eq!(receiver.receive(1.5, []), [state(2, 2)]);
    assert_eq!(receiver.log.last().unwrap().0, 1.49);
}

#[test]
fn messages_are_delivered_in_order_of_arrival() {
    let mut impairments = Impairments::new(&scenario("network.delay_s = 0.1"), id(1));
    let at = LocalTime::from_seconds;
    let arriving = [(state(2, 1), 0.99), (state(3, 1), 0.97), (state(4, 1), 0.98)];
    let mut out = Vec::new();
    impairments.receive(
        at(1.0),
        ReceiverPosition::default(),
        arriving.map(|(message, t_s)| Received { message, at: at(t_s) }),
        &mut out,
    );
    impairments.receive(at(1.085), ReceiverPosition::default(), [], &mut out);
    assert_eq!(out.iter().map(|received| received.message).collect::<Vec<_>>(), [state(3, 1), state(4, 1)]);
}

#[test]
fn a_cut_removes_the_token_after_a_lease_and_a_retry_after_healing_returns_it() {
    let scenario =
        with_events(3, "{ at_s = 10, for_s = 20, fault = 'cut', from = [1], to = [2, 3], both_ways = true }");
    let returns = [(1, 2), (2, 1), (1, 3), (3, 1)].map(|(own, peer)| {
        let mut receiver = Receiver::new(&scenario, own);
        receiver.receive(0.0, [PeerMessage::Appeared(id(peer))]);
        receiver.run_with_peer(peer, FRAME_S, 40.0);
        let gone_s = receiver.only_time(PeerMessage::Vanished(id(peer)));
        assert!(near(gone_s, 11.0), "{own} from {peer}: gone at {gone_s}");
        let [_, back_s] = receiver.times(|message| matches!(message, PeerMessage::Appeared(_)))[..] else {
            panic!("not back once")
        };
        assert!((30.2..31.0 + FRAME_S).contains(&back_s), "{own} from {peer}: back at {back_s}");
        let gaps = gaps(&receiver.times(is_state));
        assert_eq!(gaps.len(), 1, "{gaps:?}");
        assert!(near(gaps[0].0, 10.0) && near(gaps[0].1, back_s), "{gaps:?}");
        // The peer's register arrives with the token; states arrive as they are sent.
        let registers = receiver.times(|message| matches!(message, PeerMessage::Mission(_)));
        assert!(registers.contains(&back_s), "{registers:?}");
        back_s
    });
    assert_eq!((returns[0], returns[2]), (returns[1], returns[3]), "both ends of a link agree");
    assert_ne!(returns[0], returns[2], "each pair has its own retry time");
}

#[test]
fn a_vehicle_outside_all_cuts_receives_every_message() {
    let scenario = with_events(3, "{ at_s = 10, for_s = 20, fault = 'cut', from = [1], to = [2], both_ways = true }");
    for (own, peer) in [(1, 3), (3, 1), (3, 4), (2, 4)] {
        let mut receiver = Receiver::new(&scenario, own);
        receiver.run_with_peer(peer, 0.0, 40.0);
        assert_eq!(receiver.times(is_state).len(), 2_000);
    }
}

#[test]
fn under_a_one_way_cut_the_other_direction_delivers_for_a_lease_only() {
    let scenario = with_events(5, "{ at_s = 10, for_s = 20, fault = 'cut', from = [1], to = [2] }");
    let ends = [(1, 2), (2, 1)].map(|(own, peer)| {
        let mut receiver = Receiver::new(&scenario, own);
        receiver.receive(0.0, [PeerMessage::Appeared(id(peer))]);
        receiver.run_with_peer(peer, FRAME_S, 40.0);
        let gone_s = receiver.only_time(PeerMessage::Vanished(id(peer)));
        assert!(near(gone_s, 11.0), "{own} from {peer}: gone at {gone_s}");
        let gaps = gaps(&receiver.times(is_state));
        assert_eq!(gaps.len(), 1, "{gaps:?}");
        gaps[0]
    });
    assert!(near(ends[0].0, 11.0), "vehicle 2 was received until {} s", ends[0].0);
    assert!(near(ends[1].0, 10.0), "vehicle 1 was received until {} s", ends[1].0);
    assert!(near(ends[0].1, ends[1].1) && (30.2..31.1).contains(&ends[0].1), "{ends:?}");
}

#[test]
fn a_cut_shorter_than_the_lease_only_delays() {
    let scenario = with_events(5, "{ at_s = 10, for_s = 0.9, fault = 'cut', from = [2], to = [1] }");
    let mut receiver = Receiver::new(&scenario, 1);
    receiver.receive(0.0, [PeerMessage::Appeared(id(2))]);
    receiver.run_with_peer(2, FRAME_S, 10.0);
    // The last message before a long pause is stopped by the cut.
    assert_eq!(receiver.receive(10.5, [state(2, 1_000), mission(2, 1_000)]), []);
    assert_eq!(receiver.receive(10.6, [state(2, 1_001)]), []);
    assert_eq!(receiver.receive(10.88, []), []);
    assert_eq!(receiver.receive(10.9, []), [state(2, 1_001), mission(2, 1_000)], "the newest");
    receiver.run_with_peer(2, 10.92, 20.0);
    assert!(receiver.times(|message| matches!(message, PeerMessage::Vanished(_))).is_empty());
    assert_eq!(gaps(&receiver.times(is_state)).len(), 1);
}

#[test]
fn a_permanent_cut_never_heals() {
    let scenario = with_events(5, "{ at_s = 10, fault = 'cut', from = [2], to = [1], both_ways = true }");
    let mut receiver = Receiver::new(&scenario, 1);
    receiver.receive(0.0, [PeerMessage::Appeared(id(2))]);
    receiver.run_with_peer(2, FRAME_S, 500.0);
    assert!(near(receiver.only_time(PeerMessage::Vanished(id(2))), 11.0));
    assert!(receiver.times(is_state).last().is_some_and(|&t_s| t_s < 10.0));
}

#[test]
fn a_peer_gone_behind_a_cut_is_lost_with_the_lease_and_a_new_one_appears_after_the_retry() {
    let scenario = with_events(5, "{ at_s = 10, for_s = 20, fault = 'cut', from = [2], to = [1], both_ways = true }");
    let mut gone = Receiver::new(&scenario, 1);
    gone.receive(0.0, [PeerMessage::Appeared(id(2))]);
    gone.run_with_peer(2, FRAME_S, 10.4);
    assert_eq!(gone.receive(10.4, [PeerMessage::Vanished(id(2))]), []);
    let mut restarted = Receiver { impairments: gone.impairments.clone(), position: None, log: Vec::new() };
    for frame in 521..2_000 {
        let t_s = f64::from(frame) * FRAME_S;
        gone.receive(t_s, []);
        restarted.receive(t_s, (frame == 1_000).then_some(PeerMessage::Appeared(id(2))));
    }
    assert!(near(gone.only_time(PeerMessage::Vanished(id(2))), 11.0));
    assert!(
        gone.times(is_state).last().is_some_and(|&t_s| t_s < 10.0),
        "messages of a vehicle that has gone are dropped"
    );
    assert!((30.2..31.1).contains(&restarted.only_time(PeerMessage::Appeared(id(2)))));
}

#[test]
fn an_agent_started_during_an_outage_receives_nothing_before_its_end() {
    let scenario = with_events(5, "{ at_s = 10, for_s = 20, fault = 'cut', from = [1], to = [2] }");
    // The direction that is alive is affected as well: a session needs both.
    for (begin_s, own, peer) in [(10.4, 1, 2), (10.4, 2, 1), (15.0, 1, 2), (30.1, 2, 1)] {
        let mut receiver = Receiver::new(&scenario, own);
        assert_eq!(receiver.receive(begin_s, [PeerMessage::Appeared(id(peer)), mission(peer, 1)]), []);
        receiver.run_with_peer(peer, begin_s + FRAME_S, 40.0);
        assert!(receiver.times(|message| matches!(message, PeerMessage::Vanished(_))).is_empty());
        let first_s = receiver.only_time(PeerMessage::Appeared(id(peer)));
        assert!(
            (30.2..31.1).contains(&first_s) && receiver.log[0].0 == first_s,
            "from {begin_s} s: {:?}",
            receiver.log[0]
        );
    }
}

/// The outages of the link between two vehicles.
fn outages_of(scenario: &Scenario, one: u8, other: u8) -> Vec<cuts::Outage> {
    let (one, other) = (id(one), id(other));
    let silences = [(one, other), (other, one)].map(|(from, to)| silences(&scenario.mission.events, from, to));
    cuts::outages(scenario.seed, [one, other], [&silences[0], &silences[1]])
}

#[test]
fn retries_are_spread_over_their_range() {
    let cuts = "{ at_s = 10, for_s = 5, fault = 'cut', from = [1], to = [2] }, \
                { at_s = 20, for_s = 5, fault = 'cut', from = [2], to = [1] }";
    let mut retries: Vec<f64> = (0..250)
        .flat_map(|seed| outages_of(&with_events(seed, cuts), 1, 2))
        .map(|outage| outage.back_s - outage.until_s)
        .collect();
    retries.sort_by(f64::total_cmp);
    retries.dedup();
    assert_eq!(retries.len(), 500, "drawn for each cut");
    // Kolmogorov-Smirnov distance from the uniform distribution: above 0.09 once in a thousand.
    for (nth, retry_s) in retries.iter().enumerate() {
        let share = (retry_s - 0.2) / 0.8;
        assert!((0.0..1.0).contains(&share) && (share - nth as f64 / 500.0).abs() < 0.09, "{retry_s}");
    }
}

#[test]
fn adjoining_cuts_merge_and_short_one_way_cuts_close_no_session() {
    let one_way = "{ at_s = 10, for_s = 0.75, fault = 'cut', from = [1], to = [2] }, \
                  { at_s = 10.75, for_s = 0.75, fault = 'cut', from = [2], to = [1] }";
    let outages = outages_of(&with_events(1, one_way), 2, 1);
    assert_eq!(outages.len(), 1);
    assert_eq!((outages[0].from_s, outages[0].closes_s, outages[0].until_s), (10.0, f64::INFINITY, 11.5));
    let both = "{ at_s = 10, for_s = 0.75, fault = 'cut', from = [1], to = [2] }, \
                { at_s = 10.5, for_s = 0.75, fault = 'cut', from = [1], to = [2, 3] }";
    let outages = outages_of(&with_events(1, both), 1, 2);
    assert_eq!((outages[0].closes_s, outages[0].until_s), (11.0, 11.25));
    assert_eq!(silences(&with_events(1, both).mission.events, id(1), id(2)), vec![10.0..11.25]);
    assert_eq!(silences(&with_events(1, both).mission.events, id(2), id(1)), vec![]);
}

#[test]
fn cuts_count_from_take_off() {
    let scenario = with_events(5, "{ at_s = 0, fault = 'cut', from = [2], to = [1] }");
    let mut impairments = Impairments::new(&scenario, id(1));
    let mut out = Vec::new();
    let at = LocalTime::from_seconds(100.0);
    impairments.receive(
        at,
        ReceiverPosition::default(),
        [Received { message: PeerMessage::Appeared(id(2)), at }, Received { message: state(2, 1), at }],
        &mut out,
    );
    assert_eq!(out.len(), 2);
    impairments.receive(at, flown(0.0), [Received { message: state(2, 2), at }], &mut out);
    assert_eq!(out.len(), 2);
}

#[test]
fn loss_and_delay_act_in_addition_to_a_cut() {
    let mut scenario =
        with_events(5, "{ at_s = 10, for_s = 20, fault = 'cut', from = [2], to = [1], both_ways = true }");
    (scenario.network.loss, scenario.network.delay_s) = (0.3, 0.5);
    let mut receiver = Receiver::new(&scenario, 1);
    receiver.receive(0.0, [PeerMessage::Appeared(id(2))]);
    receiver.run_with_peer(2, FRAME_S, 40.0);
    assert!(near(receiver.only_time(PeerMessage::Vanished(id(2))), 11.5));
    let states = receiver.times(is_state);
    let before = states.iter().filter(|t_s| **t_s < 10.4).count();
    assert!((300..400).contains(&before), "{before} of 495");
    assert!(states.iter().all(|t_s| !(10.5..30.7).contains(t_s)));
}
