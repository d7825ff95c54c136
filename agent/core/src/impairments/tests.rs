use core::mem::discriminant;

use skein_common::frame::{Geodetic, VelocityNed};
use skein_common::message::{Order, Verb};
use skein_common::scenario::{Source, load};
use skein_common::state::VehicleState;

use super::*;
use crate::testing::{header, heartbeat, id};

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

fn state(sender: u8, sequence: u64) -> Word {
    let (position, velocity) = (Geodetic::from_degrees(28.0, -82.0, 30.0), VelocityNed::default());
    Word::State(State {
        header: header(sender, sequence),
        state: VehicleState { position, velocity, heading_rad: 0.0 },
    })
}

fn mission(sender: u8, sequence: u64) -> Word {
    Word::Mission(heartbeat(header(sender, sequence)))
}

fn order(epoch: u64) -> Word {
    Word::Order(Order { epoch, issuer: 1, verb: Verb::Hold, seal: None })
}

/// Somewhere, so long after the take-off.
fn flown(flown_s: f64) -> Whereabouts {
    Whereabouts { flown_s: Some(flown_s), position: None }
}

/// An ear that has flown since its clock's zero.
struct Hearer {
    ear: Ear,
    position: Option<PositionNed>,
    told: Vec<(f64, Word)>,
}

impl Hearer {
    fn new(scenario: &Scenario, own: u8) -> Self {
        Self { ear: Ear::new(scenario, id(own)), position: None, told: Vec::new() }
    }

    fn own(&self, t_s: f64) -> Whereabouts {
        Whereabouts { position: self.position, ..flown(t_s) }
    }

    /// Hears what arrives at `t_s`; gives what is heard then.
    fn hear(&mut self, t_s: f64, words: impl IntoIterator<Item = Word>) -> Vec<Word> {
        let at = LocalTime::from_seconds(t_s);
        let mut out = Vec::new();
        self.ear.hear(at, self.own(t_s), words.into_iter().map(|word| Heard { word, at }), &mut out);
        assert!(out.iter().all(|heard| heard.at <= at), "heard before it arrives");
        self.told.extend(out.iter().map(|heard| (heard.at.seconds(), heard.word)));
        out.into_iter().map(|heard| heard.word).collect()
    }

    /// Frames until `to_s`, in each of which `peer` says a state, and every tenth time its register.
    fn listen(&mut self, peer: u8, from_s: f64, to_s: f64) {
        for frame in (from_s / FRAME_S).round() as u64..(to_s / FRAME_S).round() as u64 {
            let words = [state(peer, frame + 1)].into_iter().chain((frame % 10 == 0).then(|| mission(peer, frame + 1)));
            self.hear(frame as f64 * FRAME_S, words);
        }
    }

    /// Times at which a word of this kind was heard, s.
    fn times(&self, kind: impl Fn(&Word) -> bool) -> Vec<f64> {
        self.told.iter().filter(|(_, word)| kind(word)).map(|(t_s, _)| *t_s).collect()
    }

    fn only_time(&self, word: Word) -> f64 {
        let times = self.times(|told| *told == word);
        assert_eq!(times.len(), 1, "{word:?} at {times:?}");
        times[0]
    }
}

fn is_state(word: &Word) -> bool {
    matches!(word, Word::State(_))
}

/// Times between which nothing of a kind was heard for more than a frame or two, s.
fn gaps(times: &[f64]) -> Vec<(f64, f64)> {
    times.windows(2).filter(|pair| pair[1] - pair[0] > 2.5 * FRAME_S).map(|pair| (pair[0], pair[1])).collect()
}

fn near(one_s: f64, other_s: f64) -> bool {
    (one_s - other_s).abs() < 1.5 * FRAME_S
}

#[test]
fn a_perfect_network_brings_everything_at_once_and_as_it_came() {
    let mut ear = Ear::new(&scenario(""), id(1));
    let at = LocalTime::from_seconds;
    let words = [order(1), state(2, 1), Word::Vanished(id(3)), mission(4, 9)];
    // The last one a little after the step began, as in a real agent.
    let arriving =
        words.map(|word| Heard { word, at: at(1.0) }).into_iter().chain([Heard { word: state(3, 2), at: at(1.01) }]);
    let arriving: Vec<_> = arriving.collect();
    let mut out = vec![Heard { word: order(0), at: at(0.5) }];
    ear.hear(at(1.0), Whereabouts::default(), arriving.iter().copied(), &mut out);
    assert_eq!(out[1..], arriving[..]);
}

#[test]
fn the_share_lost_is_that_of_the_scenario_and_tokens_are_never_lost() {
    for (loss, own) in [(0.05, 1), (0.3, 2), (0.9, 3)] {
        let mut hearer = Hearer::new(&scenario(&format!("seed = 7\nnetwork.loss = {loss}")), own);
        let rounds = 20_000_u32;
        for round in 0..rounds {
            let words = [state(4, round.into()), mission(4, round.into()), order(round.into()), Word::Appeared(id(4))];
            hearer.hear(f64::from(round) * FRAME_S, words);
        }
        // Five standard deviations of a binomial distribution.
        let bound = 5.0 * (loss * (1.0 - loss) / f64::from(rounds)).sqrt();
        for first in [state(4, 0), mission(4, 0), order(0)] {
            let heard = hearer.times(|word| discriminant(word) == discriminant(&first)).len();
            let lost = 1.0 - heard as f64 / f64::from(rounds);
            assert!((lost - loss).abs() < bound, "{lost} of the words like {first:?} at {loss}");
        }
        assert_eq!(hearer.times(|word| matches!(word, Word::Appeared(_))).len(), rounds as usize);
    }
}

#[test]
fn each_hearer_loses_its_own_words_and_the_same_ones_again() {
    let lossy = |seed: u64| scenario(&format!("seed = {seed}\nnetwork.loss = 0.5"));
    let heard = |scenario: &Scenario, own| {
        let mut hearer = Hearer::new(scenario, own);
        (0..200).map(|n| hearer.hear(n as f64, [state(4, n)]).len()).collect::<Vec<_>>()
    };
    assert_eq!(heard(&lossy(1), 1), heard(&lossy(1), 1));
    assert_ne!(heard(&lossy(1), 1), heard(&lossy(1), 2), "independent");
    assert_ne!(heard(&lossy(1), 1), heard(&lossy(2), 1), "another seed");
}

#[test]
fn a_delay_is_exact_and_keeps_the_order_of_equal_arrivals() {
    let mut hearer = Hearer::new(&scenario("network.delay_s = 0.25"), 1);
    let words = [state(2, 1), Word::Appeared(id(3)), order(1), state(4, 1), mission(2, 1)];
    assert_eq!(hearer.hear(1.0, words), []);
    assert_eq!(hearer.hear(1.24, [state(2, 2)]), []);
    assert_eq!(hearer.hear(1.26, []), words);
    assert!(hearer.told.iter().all(|(t_s, _)| *t_s == 1.25), "{:?}", hearer.told);
    assert_eq!(hearer.hear(1.48, []), []);
    assert_eq!(hearer.hear(1.5, []), [state(2, 2)]);
    assert_eq!(hearer.told.last().unwrap().0, 1.49);
}

#[test]
fn what_comes_out_of_order_is_put_in_order() {
    let mut ear = Ear::new(&scenario("network.delay_s = 0.1"), id(1));
    let at = LocalTime::from_seconds;
    let arriving = [(state(2, 1), 0.99), (state(3, 1), 0.97), (state(4, 1), 0.98)];
    let mut out = Vec::new();
    ear.hear(at(1.0), Whereabouts::default(), arriving.map(|(word, t_s)| Heard { word, at: at(t_s) }), &mut out);
    ear.hear(at(1.085), Whereabouts::default(), [], &mut out);
    assert_eq!(out.iter().map(|heard| heard.word).collect::<Vec<_>>(), [state(3, 1), state(4, 1)]);
}

#[test]
fn after_a_cut_both_ways_the_token_is_gone_a_lease_later_and_back_a_retry_after_healing() {
    let scenario =
        with_events(3, "{ at_s = 10, for_s = 20, fault = 'cut', from = [1], to = [2, 3], both_ways = true }");
    let returns = [(1, 2), (2, 1), (1, 3), (3, 1)].map(|(own, peer)| {
        let mut hearer = Hearer::new(&scenario, own);
        hearer.hear(0.0, [Word::Appeared(id(peer))]);
        hearer.listen(peer, FRAME_S, 40.0);
        let gone_s = hearer.only_time(Word::Vanished(id(peer)));
        assert!(near(gone_s, 11.0), "{own} from {peer}: gone at {gone_s}");
        let [_, back_s] = hearer.times(|word| matches!(word, Word::Appeared(_)))[..] else { panic!("not back once") };
        assert!((30.2..31.0 + FRAME_S).contains(&back_s), "{own} from {peer}: back at {back_s}");
        let gaps = gaps(&hearer.times(is_state));
        assert_eq!(gaps.len(), 1, "{gaps:?}");
        assert!(near(gaps[0].0, 10.0) && near(gaps[0].1, back_s), "{gaps:?}");
        // The register that the peer keeps is there with the token, states come as they are said.
        let registers = hearer.times(|word| matches!(word, Word::Mission(_)));
        assert!(registers.contains(&back_s), "{registers:?}");
        back_s
    });
    assert_eq!((returns[0], returns[2]), (returns[1], returns[3]), "both ends of a link agree");
    assert_ne!(returns[0], returns[2], "each pair has its own");
}

#[test]
fn who_is_in_no_cut_hears_everything() {
    let scenario = with_events(3, "{ at_s = 10, for_s = 20, fault = 'cut', from = [1], to = [2], both_ways = true }");
    for (own, peer) in [(1, 3), (3, 1), (3, 4), (2, 4)] {
        let mut hearer = Hearer::new(&scenario, own);
        hearer.listen(peer, 0.0, 40.0);
        assert_eq!(hearer.times(is_state).len(), 2_000);
    }
}

#[test]
fn over_a_one_way_cut_the_other_way_delivers_for_a_lease_and_then_neither_does() {
    let scenario = with_events(5, "{ at_s = 10, for_s = 20, fault = 'cut', from = [1], to = [2] }");
    let ends = [(1, 2), (2, 1)].map(|(own, peer)| {
        let mut hearer = Hearer::new(&scenario, own);
        hearer.hear(0.0, [Word::Appeared(id(peer))]);
        hearer.listen(peer, FRAME_S, 40.0);
        let gone_s = hearer.only_time(Word::Vanished(id(peer)));
        assert!(near(gone_s, 11.0), "{own} from {peer}: gone at {gone_s}");
        let gaps = gaps(&hearer.times(is_state));
        assert_eq!(gaps.len(), 1, "{gaps:?}");
        gaps[0]
    });
    assert!(near(ends[0].0, 11.0), "vehicle 2 was heard until {} s", ends[0].0);
    assert!(near(ends[1].0, 10.0), "vehicle 1 was heard until {} s", ends[1].0);
    assert!(near(ends[0].1, ends[1].1) && (30.2..31.1).contains(&ends[0].1), "{ends:?}");
}

#[test]
fn a_cut_shorter_than_the_lease_only_delays() {
    let scenario = with_events(5, "{ at_s = 10, for_s = 0.9, fault = 'cut', from = [2], to = [1] }");
    let mut hearer = Hearer::new(&scenario, 1);
    hearer.hear(0.0, [Word::Appeared(id(2))]);
    hearer.listen(2, FRAME_S, 10.0);
    // The last word before a long pause falls into the cut.
    assert_eq!(hearer.hear(10.5, [state(2, 1_000), mission(2, 1_000)]), []);
    assert_eq!(hearer.hear(10.6, [state(2, 1_001)]), []);
    assert_eq!(hearer.hear(10.88, []), []);
    assert_eq!(hearer.hear(10.9, []), [state(2, 1_001), mission(2, 1_000)], "the newest");
    hearer.listen(2, 10.92, 20.0);
    assert!(hearer.times(|word| matches!(word, Word::Vanished(_))).is_empty());
    assert_eq!(gaps(&hearer.times(is_state)).len(), 1);
}

#[test]
fn a_cut_for_good_heals_never() {
    let scenario = with_events(5, "{ at_s = 10, fault = 'cut', from = [2], to = [1], both_ways = true }");
    let mut hearer = Hearer::new(&scenario, 1);
    hearer.hear(0.0, [Word::Appeared(id(2))]);
    hearer.listen(2, FRAME_S, 500.0);
    assert!(near(hearer.only_time(Word::Vanished(id(2))), 11.0));
    assert!(hearer.times(is_state).last().is_some_and(|&t_s| t_s < 10.0));
}

#[test]
fn a_death_on_the_far_side_of_a_cut_is_noticed_with_the_lease_and_a_new_life_after_the_retry() {
    let scenario = with_events(5, "{ at_s = 10, for_s = 20, fault = 'cut', from = [2], to = [1], both_ways = true }");
    let mut dead = Hearer::new(&scenario, 1);
    dead.hear(0.0, [Word::Appeared(id(2))]);
    dead.listen(2, FRAME_S, 10.4);
    assert_eq!(dead.hear(10.4, [Word::Vanished(id(2))]), []);
    let mut reborn = Hearer { ear: dead.ear.clone(), position: None, told: Vec::new() };
    for frame in 521..2_000 {
        let t_s = f64::from(frame) * FRAME_S;
        dead.hear(t_s, []);
        reborn.hear(t_s, (frame == 1_000).then_some(Word::Appeared(id(2))));
    }
    assert!(near(dead.only_time(Word::Vanished(id(2))), 11.0));
    assert!(dead.times(is_state).last().is_some_and(|&t_s| t_s < 10.0), "nothing comes back of who is gone");
    assert!((30.2..31.1).contains(&reborn.only_time(Word::Appeared(id(2)))));
}

#[test]
fn who_begins_a_life_during_an_outage_hears_nothing_before_its_end() {
    let scenario = with_events(5, "{ at_s = 10, for_s = 20, fault = 'cut', from = [1], to = [2] }");
    // Over the direction that is alive as well: a session needs both.
    for (begin_s, own, peer) in [(10.4, 1, 2), (10.4, 2, 1), (15.0, 1, 2), (30.1, 2, 1)] {
        let mut hearer = Hearer::new(&scenario, own);
        assert_eq!(hearer.hear(begin_s, [Word::Appeared(id(peer)), mission(peer, 1)]), []);
        hearer.listen(peer, begin_s + FRAME_S, 40.0);
        assert!(hearer.times(|word| matches!(word, Word::Vanished(_))).is_empty());
        let first_s = hearer.only_time(Word::Appeared(id(peer)));
        assert!(
            (30.2..31.1).contains(&first_s) && hearer.told[0].0 == first_s,
            "from {begin_s} s: {:?}",
            hearer.told[0]
        );
    }
}

#[test]
fn retries_are_spread_over_their_range() {
    let cuts = "{ at_s = 10, for_s = 5, fault = 'cut', from = [1], to = [2] }, \
                { at_s = 20, for_s = 5, fault = 'cut', from = [2], to = [1] }";
    let mut retries: Vec<f64> = (0..250)
        .flat_map(|seed| cuts::outages(&with_events(seed, cuts), id(1), id(2)))
        .map(|outage| outage.back_s - outage.until_s)
        .collect();
    retries.sort_by(f64::total_cmp);
    retries.dedup();
    assert_eq!(retries.len(), 500, "drawn for each cut");
    // Kolmogorov and Smirnov's distance from the uniform distribution: above 0.09 once in a thousand.
    for (nth, retry_s) in retries.iter().enumerate() {
        let share = (retry_s - 0.2) / 0.8;
        assert!((0.0..1.0).contains(&share) && (share - nth as f64 / 500.0).abs() < 0.09, "{retry_s}");
    }
}

#[test]
fn cuts_that_touch_are_one_and_halves_that_are_short_close_nothing() {
    let halves = "{ at_s = 10, for_s = 0.75, fault = 'cut', from = [1], to = [2] }, \
                  { at_s = 10.75, for_s = 0.75, fault = 'cut', from = [2], to = [1] }";
    let outages = cuts::outages(&with_events(1, halves), id(2), id(1));
    assert_eq!(outages.len(), 1);
    assert_eq!((outages[0].from_s, outages[0].closes_s, outages[0].until_s), (10.0, f64::INFINITY, 11.5));
    let both = "{ at_s = 10, for_s = 0.75, fault = 'cut', from = [1], to = [2] }, \
                { at_s = 10.5, for_s = 0.75, fault = 'cut', from = [1], to = [2, 3] }";
    let outages = cuts::outages(&with_events(1, both), id(1), id(2));
    assert_eq!((outages[0].closes_s, outages[0].until_s), (11.0, 11.25));
    assert_eq!(silences(&with_events(1, both).mission.events, id(1), id(2)), vec![10.0..11.25]);
    assert_eq!(silences(&with_events(1, both).mission.events, id(2), id(1)), vec![]);
}

#[test]
fn cuts_wait_for_the_take_off() {
    let scenario = with_events(5, "{ at_s = 0, fault = 'cut', from = [2], to = [1] }");
    let mut ear = Ear::new(&scenario, id(1));
    let mut out = Vec::new();
    let at = LocalTime::from_seconds(100.0);
    ear.hear(
        at,
        Whereabouts::default(),
        [Heard { word: Word::Appeared(id(2)), at }, Heard { word: state(2, 1), at }],
        &mut out,
    );
    assert_eq!(out.len(), 2);
    ear.hear(at, flown(0.0), [Heard { word: state(2, 2), at }], &mut out);
    assert_eq!(out.len(), 2);
}

#[test]
fn loss_and_delay_act_beside_a_cut() {
    let mut scenario =
        with_events(5, "{ at_s = 10, for_s = 20, fault = 'cut', from = [2], to = [1], both_ways = true }");
    (scenario.network.loss, scenario.network.delay_s) = (0.3, 0.5);
    let mut hearer = Hearer::new(&scenario, 1);
    hearer.hear(0.0, [Word::Appeared(id(2))]);
    hearer.listen(2, FRAME_S, 40.0);
    assert!(near(hearer.only_time(Word::Vanished(id(2))), 11.5));
    let states = hearer.times(is_state);
    let before = states.iter().filter(|t_s| **t_s < 10.4).count();
    assert!((300..400).contains(&before), "{before} of 495");
    assert!(states.iter().all(|t_s| !(10.5..30.7).contains(t_s)));
}
