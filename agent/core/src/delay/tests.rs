use proptest::prelude::*;

use super::*;
use crate::tests::id;

/// Heartbeats of one peer, five a second, with separate delays of the two directions and wrong clocks.
struct Pair {
    exchange: Exchange,
    delay: RoundTrips,
    /// Delays by true time, s.
    there_s: fn(f64) -> f64,
    back_s: fn(f64) -> f64,
    /// Offsets of the own clock and the peer's clock from true time, s.
    own_s: fn(f64) -> f64,
    peer_s: fn(f64) -> f64,
}

const SECOND: f64 = 1.0;

/// The delay of a message with this transit that arrives now.
fn delay_of(trips: &RoundTrips, now: LocalTime, transit_s: f64) -> Option<MessageDelay> {
    trips.choose(now).0.at_arrival(Excess::new(now, transit_s)).after(0.0)
}

impl Pair {
    fn new(there_s: fn(f64) -> f64, back_s: fn(f64) -> f64) -> Self {
        let (own_s, peer_s) = (|_| 100.0, |_| 4000.0);
        Self { exchange: Exchange::default(), delay: RoundTrips::default(), there_s, back_s, own_s, peer_s }
    }

    fn own(&self, t_s: f64) -> LocalTime {
        LocalTime::from_seconds(t_s + (self.own_s)(t_s))
    }

    fn transit_s(&self, sent_s: f64) -> (f64, f64) {
        let received_s = sent_s + (self.back_s)(sent_s);
        let stamp = SenderStamp::from_seconds(sent_s + (self.peer_s)(sent_s));
        (received_s, since_stamp_s(self.own(received_s), stamp))
    }

    /// Runs until this time; every second the peer echoes the newest heartbeat it has. For a message sent every 0.2 s,
    /// returns when it was received, its true delay and the delay estimated then.
    fn run(&mut self, until_s: f64) -> Vec<(f64, f64, Option<MessageDelay>)> {
        let mut echoes: Vec<(f64, f64, f64)> = Vec::new();
        let (mut sent, mut delays) = (Vec::new(), Vec::new());
        for tick in 0..(until_s / 0.2) as u32 {
            let t_s = 0.2 * f64::from(tick);
            self.exchange.send(self.own(t_s).into());
            sent.push((t_s, t_s + (self.there_s)(t_s)));
            if tick % 5 == 0
                && let Some(&(sent_s, there_s)) = sent.iter().rfind(|(_, there_s)| *there_s <= t_s)
            {
                echoes.push((t_s, sent_s, t_s - there_s));
            }
            let (received_s, transit_s) = self.transit_s(t_s);
            // All echoes that have arrived by then.
            for (echoed_s, sent_s, held_s) in core::mem::take(&mut echoes) {
                let (at_s, transit_s) = self.transit_s(echoed_s);
                if at_s > received_s {
                    echoes.push((echoed_s, sent_s, held_s));
                    continue;
                }
                let held_us = (held_s * 1e6) as u32;
                let echo = Echo { of: id(1), stamp: self.own(sent_s).into(), held_us };
                let round_trip_s = self.exchange.round_trip_s(self.own(at_s), &echo).unwrap();
                self.delay.take(self.own(at_s), transit_s, round_trip_s);
            }
            delays.push((received_s, received_s - t_s, delay_of(&self.delay, self.own(received_s), transit_s)));
        }
        delays
    }
}

#[test]
fn a_constant_delay_is_bounded_by_the_round_trip_and_estimated_as_half_of_it() {
    let mut pair = Pair::new(|_| 2.0, |_| 2.0);
    let delays = pair.run(20.0);
    assert_eq!(delays[0].2, None, "no round trip is known yet");
    for (received_s, true_delay_s, message_delay) in delays.into_iter().filter(|(received_s, ..)| *received_s > 5.5) {
        let MessageDelay { most_s, likely_s } = message_delay.unwrap();
        assert!(
            (most_s - 4.0).abs() < 0.01 && (likely_s - true_delay_s).abs() < 0.01,
            "{received_s}: {message_delay:?}"
        );
    }
}

#[test]
fn a_change_of_the_delay_is_measured_with_the_first_message_it_affects() {
    let two_from_ten = |t_s: f64| if (10.0..30.0).contains(&t_s) { 2.0 } else { 0.0 };
    let mut pair = Pair::new(two_from_ten, two_from_ten);
    for (received_s, true_delay_s, message_delay) in
        pair.run(60.0).into_iter().filter(|(received_s, ..)| *received_s > 1.5)
    {
        let MessageDelay { most_s, likely_s } = message_delay.unwrap();
        assert!(most_s >= true_delay_s - 0.01, "{received_s}: the bound {most_s} is below the delay {true_delay_s}");
        // The first four round trips are without the delay, the next have it in one direction only.
        let (most_within_s, likely_within_s) = match received_s {
            10.0..15.0 => (0.02, 0.02),
            15.0..20.0 => (2.02, 1.02),
            20.0..30.1 => (2.02, 0.02),
            30.1..35.0 => (2.02, 1.02),
            _ => (0.02, 0.02),
        };
        assert!(most_s <= true_delay_s + most_within_s, "{received_s}: {most_s} for {true_delay_s}");
        assert!((likely_s - true_delay_s).abs() < likely_within_s, "{received_s}: {likely_s} for {true_delay_s}");
    }
}

#[test]
fn a_delay_of_one_direction_is_within_the_bound() {
    for (there_s, back_s) in [(|_| 1.0, |_| 0.0), (|_| 0.0, |_| 1.0)] as [(fn(f64) -> f64, fn(f64) -> f64); 2] {
        for (_, true_delay_s, message_delay) in Pair::new(there_s, back_s).run(20.0).into_iter().skip(20) {
            let MessageDelay { most_s, likely_s } = message_delay.unwrap();
            assert!((most_s - 1.0).abs() < 0.01 && (likely_s - 0.5).abs() < 0.01 && true_delay_s <= most_s + 0.01);
        }
    }
}

/// Each clock is set forward by three seconds and back again, with a delay of 0.1 s in each direction.
#[test]
fn after_a_clock_was_set_the_delay_is_correct_within_four_round_trips() {
    let jump: fn(f64) -> f64 = |t_s| if (10.0..30.0).contains(&t_s) { 103.0 } else { 100.0 };
    let right: fn(f64) -> f64 = |_| 100.0;
    for (own_s, peer_s) in [(jump, right), (right, jump)] {
        let mut pair = Pair { own_s, peer_s, ..Pair::new(|_| 0.1, |_| 0.1) };
        for (received_s, _, message_delay) in pair.run(60.0) {
            let since_jump_s = [0.0, 10.0, 30.0].map(|at_s| received_s - at_s).into_iter().filter(|s| *s >= -0.2);
            // Four round trips and a margin.
            if since_jump_s.fold(f64::INFINITY, f64::min) > 4.5 * SECOND {
                let MessageDelay { most_s, likely_s } = message_delay.unwrap();
                assert!(
                    (most_s - 0.2).abs() < 0.01 && (likely_s - 0.1).abs() < 0.01,
                    "{received_s}: {message_delay:?}"
                );
            }
        }
    }
}

#[test]
fn without_new_echoes_the_bound_grows_and_then_expires() {
    let mut delay = RoundTrips::default();
    delay.take(LocalTime::from_seconds(10.0), 5.0, 0.2);
    let of = |at_s| delay_of(&delay, LocalTime::from_seconds(at_s), 5.0);
    assert!((of(10.0).unwrap().most_s - 0.2).abs() < 1e-9);
    assert!(of(60.0).unwrap().most_s > 0.2, "the bound grows because clocks drift");
    assert_eq!(of(71.0), None);
}

#[test]
fn an_impossible_echo_or_one_of_an_unknown_stamp_is_ignored() {
    let mut exchange = Exchange::default();
    let at = LocalTime::from_seconds(10.0);
    exchange.send(SenderStamp::from_seconds(9.0));
    let echo = |stamp_s, held_us| Echo { of: id(1), stamp: SenderStamp::from_seconds(stamp_s), held_us };
    assert!((exchange.round_trip_s(at, &echo(9.0, 400_000)).unwrap() - 0.6).abs() < 1e-9);
    for stamp_s in [0.0, 8.999, 9.001, 11.0, 1e6] {
        assert_eq!(exchange.round_trip_s(at, &echo(stamp_s, 0)), None, "{stamp_s}");
    }
    let mut delay = RoundTrips::default();
    delay.take(at, 0.0, exchange.round_trip_s(at, &echo(9.0, 3_000_000)).unwrap());
    assert_eq!(delay_of(&delay, at, 0.0), None, "the hold exceeds the time since the stamp");
    for nth in 0..STAMPS_KEPT {
        exchange.send(SenderStamp::from_seconds(10.0 + nth as f64));
    }
    assert_eq!(exchange.round_trip_s(at, &echo(9.0, 0)), None, "the stamp is too old to be remembered");
}

#[test]
fn the_partners_are_echoed_in_turn() {
    let mut exchange = Exchange::default();
    let mut next_partner = |partners: &[u8]| {
        exchange.next_partner(partners.iter().map(|&number| id(number)).collect()).map(VehicleId::get)
    };
    assert_eq!([(); 4].map(|()| next_partner(&[2, 3, 5])), [2, 3, 5, 2].map(Some));
    assert_eq!(next_partner(&[]), None);
    assert_eq!([next_partner(&[2, 5]), next_partner(&[2, 5]), next_partner(&[9])], [2, 5, 9].map(Some));
}

proptest! {
    #[test]
    fn no_bound_is_below_the_true_delay(
        trips in proptest::collection::vec((0.0..3.0_f64, 0.0..3.0_f64), 1..10), last_s in 0.0..3.0_f64, ahead_s in -1e5..1e5_f64,
    ) {
        let mut delay = RoundTrips::default();
        for (nth, (there_s, back_s)) in trips.iter().enumerate() {
            delay.take(LocalTime::from_seconds(nth as f64), back_s + ahead_s, there_s + back_s);
        }
        let message_delay = delay_of(&delay, LocalTime::from_seconds(trips.len() as f64), last_s + ahead_s).unwrap();
        prop_assert!(message_delay.most_s >= last_s - 1e-6);
        prop_assert!(message_delay.likely_s <= message_delay.most_s + 1e-9 && message_delay.likely_s >= 0.0);
    }
}
