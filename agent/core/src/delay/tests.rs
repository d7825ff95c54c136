use proptest::prelude::*;

use super::*;
use crate::testing::id;

/// One peer's heartbeats, five a second, each way with a delay of its own, and clocks that are set wrong.
struct Pair {
    exchange: Exchange,
    delay: Delay,
    /// In true time, s.
    there_s: fn(f64) -> f64,
    back_s: fn(f64) -> f64,
    /// What the own clock and the peer's show beyond true time, s.
    own_s: fn(f64) -> f64,
    peer_s: fn(f64) -> f64,
}

const SECOND: f64 = 1.0;

impl Pair {
    fn new(there_s: fn(f64) -> f64, back_s: fn(f64) -> f64) -> Self {
        let (own_s, peer_s) = (|_| 100.0, |_| 4000.0);
        Self { exchange: Exchange::default(), delay: Delay::default(), there_s, back_s, own_s, peer_s }
    }

    fn own(&self, t_s: f64) -> LocalTime {
        LocalTime::from_seconds(t_s + (self.own_s)(t_s))
    }

    fn transit_s(&self, said_s: f64) -> (f64, f64) {
        let heard_s = said_s + (self.back_s)(said_s);
        let stamp = SenderStamp::from_seconds(said_s + (self.peer_s)(said_s));
        (heard_s, since_stamp_s(self.own(heard_s), stamp))
    }

    /// Every second the peer echoes the newest heartbeat that it has. Gives, for a message said every 0.2 s, when it was heard,
    /// how long it was on its way, and what was thought of that then.
    fn run(&mut self, until_s: f64) -> Vec<(f64, f64, Option<Way>)> {
        let mut echoes: Vec<(f64, f64, f64)> = Vec::new();
        let (mut sent, mut ways) = (Vec::new(), Vec::new());
        for tick in 0..(until_s / 0.2) as u32 {
            let t_s = 0.2 * f64::from(tick);
            self.exchange.send(self.own(t_s).into());
            sent.push((t_s, t_s + (self.there_s)(t_s)));
            if tick % 5 == 0
                && let Some(&(said_s, there_s)) = sent.iter().rfind(|(_, there_s)| *there_s <= t_s)
            {
                echoes.push((t_s, said_s, t_s - there_s));
            }
            let (heard_s, transit_s) = self.transit_s(t_s);
            // All that has come by then.
            for (echoed_s, said_s, held_s) in core::mem::take(&mut echoes) {
                let (at_s, transit_s) = self.transit_s(echoed_s);
                if at_s > heard_s {
                    echoes.push((echoed_s, said_s, held_s));
                    continue;
                }
                let held_us = (held_s * 1e6) as u32;
                let echo = Echo { of: id(1), stamp: self.own(said_s).into(), held_us };
                let round_trip_s = self.exchange.round_trip_s(self.own(at_s), &echo).unwrap();
                self.delay.take(self.own(at_s), transit_s, round_trip_s);
            }
            ways.push((heard_s, heard_s - t_s, self.delay.of(self.own(heard_s), transit_s)));
        }
        ways
    }
}

#[test]
fn a_delay_from_the_first_message_on_is_bounded_by_the_round_trip_and_halved_by_guess() {
    let mut pair = Pair::new(|_| 2.0, |_| 2.0);
    let ways = pair.run(20.0);
    assert_eq!(ways[0].2, None, "nothing is known yet");
    for (heard_s, on_way_s, way) in ways.into_iter().filter(|(heard_s, ..)| *heard_s > 5.5) {
        let Way { most_s, likely_s } = way.unwrap();
        assert!((most_s - 4.0).abs() < 0.01 && (likely_s - on_way_s).abs() < 0.01, "{heard_s}: {way:?}");
    }
}

#[test]
fn a_delay_that_begins_or_ends_shows_in_the_first_message_that_has_it() {
    let two_from_ten = |t_s: f64| if (10.0..30.0).contains(&t_s) { 2.0 } else { 0.0 };
    let mut pair = Pair::new(two_from_ten, two_from_ten);
    for (heard_s, on_way_s, way) in pair.run(60.0).into_iter().filter(|(heard_s, ..)| *heard_s > 1.5) {
        let Way { most_s, likely_s } = way.unwrap();
        assert!(most_s >= on_way_s - 0.01, "{heard_s}: never less than it was: {most_s} of {on_way_s}");
        // The first four turns know the way without the delay, the next know of one way with it and one without.
        let (most_within_s, likely_within_s) = match heard_s {
            10.0..15.0 => (0.02, 0.02),
            15.0..20.0 => (2.02, 1.02),
            20.0..30.1 => (2.02, 0.02),
            30.1..35.0 => (2.02, 1.02),
            _ => (0.02, 0.02),
        };
        assert!(most_s <= on_way_s + most_within_s, "{heard_s}: {most_s} for {on_way_s}");
        assert!((likely_s - on_way_s).abs() < likely_within_s, "{heard_s}: {likely_s} for {on_way_s}");
    }
}

#[test]
fn a_delay_of_one_direction_is_within_the_bound() {
    for (there_s, back_s) in [(|_| 1.0, |_| 0.0), (|_| 0.0, |_| 1.0)] as [(fn(f64) -> f64, fn(f64) -> f64); 2] {
        for (_, on_way_s, way) in Pair::new(there_s, back_s).run(20.0).into_iter().skip(20) {
            let Way { most_s, likely_s } = way.unwrap();
            assert!((most_s - 1.0).abs() < 0.01 && (likely_s - 0.5).abs() < 0.01 && on_way_s <= most_s + 0.01);
        }
    }
}

/// Each clock is set forward by three seconds and back again: what is thought of a delay of 0.1 s each way.
#[test]
fn after_a_clock_was_set_the_delay_is_soon_right_again() {
    let jump: fn(f64) -> f64 = |t_s| if (10.0..30.0).contains(&t_s) { 103.0 } else { 100.0 };
    let right: fn(f64) -> f64 = |_| 100.0;
    for (own_s, peer_s) in [(jump, right), (right, jump)] {
        let mut pair = Pair { own_s, peer_s, ..Pair::new(|_| 0.1, |_| 0.1) };
        for (heard_s, _, way) in pair.run(60.0) {
            let since_jump_s = [0.0, 10.0, 30.0].map(|at_s| heard_s - at_s).into_iter().filter(|s| *s >= -0.2);
            // Four turns, and a little.
            if since_jump_s.fold(f64::INFINITY, f64::min) > 4.5 * SECOND {
                let Way { most_s, likely_s } = way.unwrap();
                assert!((most_s - 0.2).abs() < 0.01 && (likely_s - 0.1).abs() < 0.01, "{heard_s}: {way:?}");
            }
        }
    }
}

#[test]
fn a_peer_that_echoes_nothing_any_more_is_not_vouched_for() {
    let mut delay = Delay::default();
    delay.take(LocalTime::from_seconds(10.0), 5.0, 0.2);
    let of = |at_s| delay.of(LocalTime::from_seconds(at_s), 5.0);
    assert!((of(10.0).unwrap().most_s - 0.2).abs() < 1e-9);
    assert!(of(60.0).unwrap().most_s > 0.2, "clocks run apart");
    assert_eq!(of(71.0), None);
}

#[test]
fn an_echo_of_what_was_never_sent_or_that_cannot_be_is_ignored() {
    let mut exchange = Exchange::default();
    let at = LocalTime::from_seconds(10.0);
    exchange.send(SenderStamp::from_seconds(9.0));
    let echo = |stamp_s, held_us| Echo { of: id(1), stamp: SenderStamp::from_seconds(stamp_s), held_us };
    assert!((exchange.round_trip_s(at, &echo(9.0, 400_000)).unwrap() - 0.6).abs() < 1e-9);
    for stamp_s in [0.0, 8.999, 9.001, 11.0, 1e6] {
        assert_eq!(exchange.round_trip_s(at, &echo(stamp_s, 0)), None, "{stamp_s}");
    }
    let mut delay = Delay::default();
    delay.take(at, 0.0, exchange.round_trip_s(at, &echo(9.0, 3_000_000)).unwrap());
    assert_eq!(delay.of(at, 0.0), None, "held for longer than it is past");
    for nth in 0..SENT {
        exchange.send(SenderStamp::from_seconds(10.0 + nth as f64));
    }
    assert_eq!(exchange.round_trip_s(at, &echo(9.0, 0)), None, "too long ago to be remembered");
}

#[test]
fn each_partner_has_its_turn() {
    let mut exchange = Exchange::default();
    let mut turn = |partners: &[u8]| exchange.turn(partners.iter().map(|&number| id(number))).map(VehicleId::get);
    assert_eq!([(); 4].map(|()| turn(&[2, 3, 5])), [2, 3, 5, 2].map(Some));
    assert_eq!(turn(&[]), None);
    assert_eq!([turn(&[2, 5]), turn(&[2, 5]), turn(&[9])], [2, 5, 9].map(Some));
}

proptest! {
    #[test]
    fn no_bound_is_less_than_the_time_on_the_way(
        trips in proptest::collection::vec((0.0..3.0_f64, 0.0..3.0_f64), 1..10), last_s in 0.0..3.0_f64, ahead_s in -1e5..1e5_f64,
    ) {
        let mut delay = Delay::default();
        for (nth, (there_s, back_s)) in trips.iter().enumerate() {
            delay.take(LocalTime::from_seconds(nth as f64), back_s + ahead_s, there_s + back_s);
        }
        let way = delay.of(LocalTime::from_seconds(trips.len() as f64), last_s + ahead_s).unwrap();
        prop_assert!(way.most_s >= last_s - 1e-6);
        prop_assert!(way.likely_s <= way.most_s + 1e-9 && way.likely_s >= 0.0);
    }
}
