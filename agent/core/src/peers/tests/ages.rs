//! Two vehicles' tables over a network with a delay, each by a clock of its own.

use super::*;

/// One vehicle: its table, its clock and what is on its way to it.
struct Side {
    peers: Peers,
    /// What the clock shows at true time t, s.
    clock_s: fn(f64) -> f64,
    sequence: u64,
    /// Messages with the true times at which they arrive and were sent, s.
    under_way: Vec<(f64, f64, Word)>,
    /// When the newest state that has arrived was sent, in true time, s.
    newest_sent_s: f64,
}

impl Side {
    fn new(own: u8, clock_s: fn(f64) -> f64) -> Self {
        let peers = Peers::new(id(own), 2, 1, &network(""));
        Self { peers, clock_s, sequence: 0, under_way: Vec::new(), newest_sent_s: f64::NEG_INFINITY }
    }

    fn now(&self, t_s: f64) -> LocalTime {
        seconds((self.clock_s)(t_s))
    }

    fn hear(&mut self, t_s: f64) {
        let (mut arrived, under_way): (Vec<_>, Vec<_>) = self.under_way.drain(..).partition(|(at_s, ..)| *at_s <= t_s);
        self.under_way = under_way;
        arrived.sort_by(|one, other| one.0.total_cmp(&other.0));
        let now = self.now(t_s);
        let heard: Vec<_> = arrived.iter().map(|&(.., word)| Heard { word, at: now }).collect();
        self.newest_sent_s = arrived.iter().map(|&(_, sent_s, _)| sent_s).fold(self.newest_sent_s, f64::max);
        self.peers.update(now, &origin(), &heard);
    }

    /// A state and a heartbeat, which arrive `delay_s` later.
    fn send(&mut self, own: u8, t_s: f64, delay_s: f64) -> [(f64, f64, Word); 2] {
        self.sequence += 1;
        let stamp = self.now(t_s).into();
        let header = Header { stamp, ..header(own, 1, self.sequence) };
        let Word::State(said) = state(own, 1, self.sequence, 2.0 * t_s) else { unreachable!() };
        let heartbeat = Mission { echo: self.peers.echo(stamp), ..register(header, 1, Membership::Active) };
        [Word::State(State { header, ..said }), Word::Mission(heartbeat)].map(|word| (t_s + delay_s, t_s, word))
    }
}

/// One step of the flight as vehicle 1 has seen it.
struct Step {
    t_s: f64,
    /// How old the peer's newest state was in truth, s.
    age_s: f64,
    seen: Seen,
}

/// Flies for a minute with this delay of what is sent at true time t, both ways.
fn fly(delay_s: fn(f64) -> f64, clocks_s: [fn(f64) -> f64; 2]) -> Vec<Step> {
    let [mut one, mut two] = [Side::new(1, clocks_s[0]), Side::new(2, clocks_s[1])];
    let mut steps = Vec::new();
    for tick in 0..3_000 {
        let t_s = 0.02 * f64::from(tick);
        one.hear(t_s);
        two.hear(t_s);
        if tick % 10 == 0 {
            two.under_way.extend(one.send(1, t_s, delay_s(t_s)));
            one.under_way.extend(two.send(2, t_s, delay_s(t_s)));
        }
        steps.extend(one.peers.seen().iter().map(|&seen| Step { t_s, age_s: t_s - one.newest_sent_s, seen }));
    }
    steps
}

const RIGHT: [fn(f64) -> f64; 2] = [|t_s| 100.0 + t_s, |t_s| 86_400.0 + t_s];

#[test]
fn a_delay_from_the_first_message_on_is_in_the_age_after_one_round_trip() {
    let steps = fly(|_| 2.0, RIGHT);
    assert_eq!(steps[0].seen.delay_s, None, "no round trip is known yet");
    for Step { t_s, age_s, seen } in steps {
        if t_s < 4.3 {
            continue;
        }
        let delay_s = seen.delay_s.unwrap();
        assert!((3.99..4.1).contains(&delay_s), "{t_s}: the whole round trip is the bound: {delay_s}");
        assert!((age_s - 1e-6..age_s + 2.1).contains(&seen.age_s), "{t_s}: {} for {age_s}", seen.age_s);
        assert!((seen.carried_s - age_s).abs() < 0.05, "{t_s}: {} for {age_s}", seen.carried_s);
        assert!((seen.position.north_m() - 2.0 * t_s).abs() < 0.1, "{t_s}: {:?}", seen.position);
        // As long as network.peer_stale_s, but it is not silent.
        assert_eq!((seen.standing, seen.role), (Standing::Stale, Role::Member), "{t_s}");
    }
}

#[test]
fn a_delay_that_begins_in_flight_is_in_the_age_from_its_first_message_on() {
    let delay_s = |t_s: f64| if (20.0..40.0).contains(&t_s) { 1.5 } else { 0.0 };
    for Step { t_s, age_s, seen } in fly(delay_s, RIGHT) {
        if t_s < 0.5 {
            continue;
        }
        assert!(seen.delay_s.is_some() && seen.standing != Standing::Lost, "{t_s}: {seen:?}");
        assert!((age_s - 1e-3..age_s + 1.6).contains(&seen.age_s), "{t_s}: {} for {age_s}", seen.age_s);
        let settled = [(1.0, 20.0), (25.0, 40.0), (45.0, 60.0)].iter().any(|(from, to)| (*from..*to).contains(&t_s));
        assert!(!settled || (seen.carried_s - age_s).abs() < 0.05, "{t_s}: {} for {age_s}", seen.carried_s);
    }
}

/// The peer's clock is set forward by three seconds and back again, which no agent's clock does in flight.
#[test]
fn after_a_peers_clock_was_set_the_age_is_right_within_two_seconds() {
    let jumps: fn(f64) -> f64 = |t_s| if (20.0..40.0).contains(&t_s) { 503.0 + t_s } else { 500.0 + t_s };
    for Step { t_s, age_s, seen } in fly(|_| 0.1, [RIGHT[0], jumps]) {
        assert_ne!(seen.standing, Standing::Lost, "{t_s}");
        if [2.0..20.0, 22.0..40.0, 42.0..60.0].iter().any(|settled| settled.contains(&t_s)) {
            assert!((age_s - 1e-3..age_s + 0.15).contains(&seen.age_s), "{t_s}: {} for {age_s}", seen.age_s);
            assert_eq!(seen.standing, Standing::Fresh, "{t_s}: {seen:?}");
        }
    }
}
