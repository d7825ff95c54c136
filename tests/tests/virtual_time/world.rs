//! Real nodes in a simulated world: 300 seeds of faults with one liar, without a broken invariant.

use skein_tests::in_parallel;
use skein_tests::world::{FaultKind, WorldFlight, failure, fly};

/// Number of seeds; `tables -- world` flies more.
const SEEDS: u64 = 300;

#[test]
fn no_seed_of_the_world_breaks_an_invariant() {
    let flights = in_parallel(0..SEEDS, |seed| fly(seed, false));
    let failures: Vec<String> = flights.iter().filter(|flight| flight.violation.is_some()).map(failure).collect();
    assert!(failures.is_empty(), "{}", failures.join("\n"));

    // What was not there was not tested.
    assert!(flights.iter().all(|flight| flight.faults.values().sum::<u32>() >= 5), "at least five faults each");
    for kind in FaultKind::ALL {
        assert!(flights.iter().any(|flight| flight.faults.contains_key(&kind)), "{}", kind.name());
    }
    let ended = flights.iter().filter(|flight| flight.has_ended).count();
    assert_eq!(ended as u64, SEEDS / 10, "missions were flown to their end");
    let sum = |of: fn(&WorldFlight) -> u64| flights.iter().map(of).sum::<u64>();
    let refused = [
        sum(|flight| flight.refused.forged),
        sum(|flight| flight.refused.unsigned),
        sum(|flight| flight.refused.undecodable),
        sum(|flight| flight.refused.other_version),
        sum(|flight| flight.refused.other_plan),
        sum(|flight| flight.refused.old),
    ];
    assert!(refused.iter().all(|count| *count > 10 * SEEDS), "every lie was refused: {refused:?}");
    assert!(sum(|flight| flight.orders.into()) > 3 * SEEDS, "orders were given");
    assert!(sum(|flight| flight.restarts.into()) > SEEDS, "agents were restarted");
    assert!(sum(|flight| flight.steps.into()) > 3 * SEEDS, "the swarms flew their missions");
    assert!(sum(|flight| flight.awaited) > SEEDS, "vehicles had to be awaited");
    assert!(sum(|flight| flight.majorities) > SEEDS / 2, "majorities advanced");
    let longest_rejoin_s = flights.iter().map(|flight| flight.longest_rejoin_s).fold(0.0, f64::max);
    assert!(longest_rejoin_s > 1.0, "the longest rejoin took {longest_rejoin_s:.2} s");
}

#[test]
fn a_seed_flies_the_same_world_again() {
    for seed in [3, 17] {
        let (one, other) = (fly(seed, false), fly(seed, true));
        assert_eq!((one.fingerprint, one.delivered, one.refused), (other.fingerprint, other.delivered, other.refused));
        assert!(!other.log.is_empty() && one.log.is_empty());
    }
}
