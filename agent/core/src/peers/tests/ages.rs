//! The peers stages of two vehicles over a network with a delay, each with its own clock.

use super::*;

/// One vehicle: its peers stage, its clock and the messages in flight to it.
struct Side {
    peers: Peers,
    /// Reading of the clock at true time t, s.
    clock_s: fn(f64) -> f64,
    sequence: u64,
    /// Messages with their true times of arrival and of sending, s.
    in_flight: Vec<(f64, f64, PeerMessage)>,
    /// True time of sending of the newest state that has arrived, s.
    newest_sent_s: f64,
}

impl Side {
    fn new(own: u8, clock_s: fn(f64) -> f64) -> Self {
        let peers = Peers::new(id(own), 2, 1, &network(""));
        Self { peers, clock_s, sequence: 0, in_flight: Vec::new(), newest_sent_s: f64::NEG_INFINITY }
    }

    fn now(&self, t_s: f64) -> LocalTime {
        seconds((self.clock_s)(t_s))
    }

    fn receive(&mut self, t_s: f64) {
        let (mut arrived, in_flight): (Vec<_>, Vec<_>) = self.in_flight.drain(..).partition(|(at_s, ..)| *at_s <= t_s);
        self.in_flight = in_flight;
        arrived.sort_by(|one, other| one.0.total_cmp(&other.0));
        let now = self.now(t_s);
        let received: Vec<_> = arrived.iter().map(|&(.., message)| Received { message, at: now }).collect();
        self.newest_sent_s = arrived.iter().map(|&(_, sent_s, _)| sent_s).fold(self.newest_sent_s, f64::max);
        self.peers.update(now, &received, Broadcast::default());
    }

    /// Sends a state and a heartbeat, which arrive `delay_s` later.
    fn send(&mut self, own: u8, t_s: f64, delay_s: f64) -> [(f64, f64, PeerMessage); 2] {
        self.sequence += 1;
        let stamp = self.now(t_s).into();
        let header = Header { stamp, ..header(own, 1, self.sequence) };
        let PeerMessage::State(sent) = state(own, 1, self.sequence, 2.0 * t_s) else { unreachable!() };
        let heartbeat = Heartbeat { echo: self.peers.echo(stamp), ..heartbeat_of(header, 1, Membership::Active) };
        [PeerMessage::State(ReceivedState { header, ..sent }), PeerMessage::Mission(heartbeat)]
            .map(|message| (t_s + delay_s, t_s, message))
    }
}

/// One step of the flight as observed by vehicle 1.
struct Step {
    t_s: f64,
    /// True age of the peer's newest state, s.
    age_s: f64,
    estimate: PeerEstimate,
}

/// Flies for a minute with this delay of messages sent at true time t, in both directions.
fn fly(delay_s: fn(f64) -> f64, clocks_s: [fn(f64) -> f64; 2]) -> Vec<Step> {
    let [mut one, mut two] = [Side::new(1, clocks_s[0]), Side::new(2, clocks_s[1])];
    let mut steps = Vec::new();
    for tick in 0..3_000 {
        let t_s = 0.02 * f64::from(tick);
        one.receive(t_s);
        two.receive(t_s);
        if tick % 10 == 0 {
            two.in_flight.extend(one.send(1, t_s, delay_s(t_s)));
            one.in_flight.extend(two.send(2, t_s, delay_s(t_s)));
        }
        steps.extend(one.peers.estimates().map(|estimate| Step { t_s, age_s: t_s - one.newest_sent_s, estimate }));
    }
    steps
}

const RIGHT: [fn(f64) -> f64; 2] = [|t_s| 100.0 + t_s, |t_s| 86_400.0 + t_s];

#[test]
fn a_constant_delay_is_in_the_age_after_one_round_trip() {
    let steps = fly(|_| 2.0, RIGHT);
    assert_eq!(steps[0].estimate.delay_s, None, "no round trip is known yet");
    for Step { t_s, age_s, estimate } in steps {
        if t_s < 4.3 {
            continue;
        }
        let delay_s = estimate.delay_s.unwrap();
        assert!((3.99..4.1).contains(&delay_s), "{t_s}: the whole round trip is the bound: {delay_s}");
        assert!((age_s - 1e-6..age_s + 2.1).contains(&estimate.age_s), "{t_s}: {} for {age_s}", estimate.age_s);
        assert!((estimate.carried_s - age_s).abs() < 0.05, "{t_s}: {} for {age_s}", estimate.carried_s);
        assert!((estimate.position.north_m() - 2.0 * t_s).abs() < 0.1, "{t_s}: {:?}", estimate.position);
        // The delay is as long as network.peer_stale_s, but the peer is not silent.
        assert_eq!((estimate.standing, estimate.role), (PeerStatus::Stale, Role::Member), "{t_s}");
    }
}

#[test]
fn a_delay_that_begins_in_flight_is_in_the_age_from_its_first_message() {
    // While it begins, nothing arrives: a longer delay would be a lost peer.
    const DELAY_S: f64 = 0.7;
    let delay_s = |t_s: f64| if (20.0..40.0).contains(&t_s) { DELAY_S } else { 0.0 };
    for Step { t_s, age_s, estimate } in fly(delay_s, RIGHT) {
        if t_s < 0.5 {
            continue;
        }
        assert!(estimate.delay_s.is_some() && estimate.standing != PeerStatus::Lost, "{t_s}: {estimate:?}");
        assert!(
            (age_s - 1e-3..age_s + DELAY_S + 0.1).contains(&estimate.age_s),
            "{t_s}: {} for {age_s}",
            estimate.age_s
        );
        let settled = [(1.0, 20.0), (25.0, 40.0), (45.0, 60.0)].iter().any(|(from, to)| (*from..*to).contains(&t_s));
        assert!(!settled || (estimate.carried_s - age_s).abs() < 0.05, "{t_s}: {} for {age_s}", estimate.carried_s);
    }
}

/// The peer's clock is set forward by three seconds and back again, which an agent's clock does not do in flight.
#[test]
fn after_a_peers_clock_was_set_the_age_is_correct_within_two_seconds() {
    let jumps: fn(f64) -> f64 = |t_s| if (20.0..40.0).contains(&t_s) { 503.0 + t_s } else { 500.0 + t_s };
    for Step { t_s, age_s, estimate } in fly(|_| 0.1, [RIGHT[0], jumps]) {
        assert_ne!(estimate.standing, PeerStatus::Lost, "{t_s}");
        if [2.0..20.0, 22.0..40.0, 42.0..60.0].iter().any(|settled| settled.contains(&t_s)) {
            assert!((age_s - 1e-3..age_s + 0.15).contains(&estimate.age_s), "{t_s}: {} for {age_s}", estimate.age_s);
            assert_eq!(estimate.standing, PeerStatus::Fresh, "{t_s}: {estimate:?}");
        }
    }
}
