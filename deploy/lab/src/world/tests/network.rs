//! The network of the whole swarm against one network for each receiver, as live agents have it.

use proptest::prelude::*;
use proptest::test_runner::RngSeed;

use super::*;

/// At least 300 histories, the same ones in every run of the tests. PROPTEST_RNG_SEED draws others, PROPTEST_CASES more of them.
fn histories() -> ProptestConfig {
    let given = ProptestConfig::default();
    ProptestConfig {
        cases: given.cases.max(300),
        rng_seed: match given.rng_seed {
            RngSeed::Random => RngSeed::Fixed(1),
            given @ RngSeed::Fixed(_) => given,
        },
        // A swarm of 130 over a network for each receiver takes seconds: a failure must not hold the tests for an hour.
        max_shrink_time: 120_000,
        ..given
    }
}

fn scenario(sets: &[String]) -> Scenario {
    let text = include_str!("../../../../scenarios/hover.toml");
    load(&Source { name: "hover.toml", text }, sets).unwrap_or_else(|why| panic!("{sets:?}: {why}")).scenario
}

/// Whether these keys give a network that is not perfect.
fn is_imperfect(sets: &[String]) -> bool {
    SwarmNetwork::new(&scenario(sets), TICK_NS).is_some()
}

/// A swarm whose agents receive over the network of the swarm, and one whose agents each have the impairments of their own.
fn both(sets: &[String]) -> [World; 2] {
    let scenario = scenario(sets);
    let aircraft = vec![Aircraft::shipped("xcell60").unwrap().unwrap(); scenario.swarm.vehicles];
    let rules = Rules::shipped();
    let network = SwarmNetwork::new(&scenario, TICK_NS);
    assert!(network.is_some(), "{sets:?}");
    [network, None].map(|network| World::over(network, &scenario, &aircraft, &rules).unwrap())
}

/// Flies both for this time, s, and compares all that they give, to the bit.
fn compare(sets: &[String], seconds: f64) {
    let [mut swarm, mut each] = both(sets);
    while swarm.t_s() < seconds {
        let [one, other] = [&mut swarm, &mut each].map(|world| {
            world.tick();
            let events: Vec<_> = world.events().collect();
            let controls: Vec<_> =
                world.all_vehicles().map(|(id, _, truth, controls)| (id, truth.position, controls)).collect();
            (events, controls, world.faults().to_vec())
        });
        assert_eq!(one, other, "at {} s of {sets:?}", swarm.t_s());
        if swarm.ticks.is_multiple_of(7) {
            let [one, other] = [&mut swarm, &mut each].map(|world| world.traces().collect::<Vec<_>>());
            assert_eq!(one, other, "at {} s of {sets:?}", swarm.t_s());
        }
    }
    assert_eq!(swarm.totals(), each.totals());
}

/// All that differs from a correct clock over a perfect network is the jump.
#[test]
fn after_a_jump_of_a_clock_messages_arrive_when_they_do() {
    for by_s in [-16.18, 16.18, -3.0, 3.0] {
        let jump = format!("{{ at_s = 6.79, for_s = 4, fault = 'clock_jump', vehicle = 3, by_s = {by_s} }}");
        let sets = ["swarm.vehicles=5", "seed=240", "plant.model=point_mass", "start.square_m=200"];
        let all = sets.into_iter().map(str::to_owned).chain([format!("mission.events=[{jump}]")]);
        compare(&all.collect::<Vec<_>>(), 20.0);
    }
}

/// Settings of one link.
fn link() -> impl Strategy<Value = Vec<String>> {
    let maybe = |key: &'static str, value: BoxedStrategy<f64>| {
        prop_oneof![Just(Vec::new()), value.prop_map(move |value| vec![format!("{key}={value:.3}")])]
    };
    let from = |range: std::ops::Range<f64>| range.boxed();
    (
        maybe("loss", prop_oneof![0.0..0.3, 0.0..1.0].boxed()),
        maybe("delay_s", prop_oneof![Just(0.02), Just(0.1), 0.0..0.5].boxed()),
        maybe("jitter_s", from(0.001..0.3)),
        prop_oneof![
            2 => Just(Vec::new()),
            1 => from(0.0..0.5).prop_map(|share| vec![format!("reorder={share:.3}")]),
            1 => (0.0..0.5, 0.02..0.8)
                .prop_map(|(share, by_s): (f64, f64)| vec![format!("reorder={share:.3}"), format!("reorder_s={by_s:.3}")]),
        ],
        maybe("duplicate", from(0.0..0.5)),
        prop_oneof![
            2 => Just(Vec::new()),
            1 => prop_oneof![5e3..5e4, 2e4..5e5].prop_map(|bit_s: f64| vec![format!("bandwidth_bit_s={bit_s:.3}")]),
            1 => (5e3..5e4, 0.02..2.0).prop_map(|(bit_s, queue_s): (f64, f64)| {
                vec![format!("bandwidth_bit_s={bit_s:.3}"), format!("queue_s={queue_s:.3}")]
            }),
        ],
        maybe("burst_s", from(0.05..3.0)),
    )
        .prop_map(|(loss, delay, jitter, reorder, duplicate, bandwidth, burst)| {
            let burst = if loss.is_empty() { Vec::new() } else { burst };
            [loss, delay, jitter, reorder, duplicate, bandwidth, burst].concat()
        })
}

/// The graph and the range.
fn reach() -> impl Strategy<Value = Vec<String>> {
    let graph = prop_oneof![
        2 => Just(Vec::new()),
        1 => (1_usize..4).prop_map(|count| vec!["graph='nearest'".to_owned(), format!("neighbours={count}")]),
        1 => Just(vec!["graph='edges'".to_owned(), "edges=[[1,2],[2,1],[2,3],[3,2],[1,3]]".to_owned()]),
    ];
    let range = prop_oneof![
        2 => Just(Vec::new()),
        1 => (30.0..200.0).prop_map(|range_m: f64| vec![format!("range_m={range_m:.1}")]),
        1 => (60.0..200.0, 0.2..0.9).prop_map(|(range_m, share): (f64, f64)| {
            vec![format!("range_m={range_m:.1}"), format!("fade_m={:.1}", range_m * share)]
        }),
    ];
    (graph, range).prop_map(|(graph, range)| [graph, range].concat())
}

/// Errors of the clocks of two vehicles.
fn clocks() -> impl Strategy<Value = Vec<String>> {
    let error = (1_u8..4, -3.0..3.0, prop_oneof![Just(0.0), -200.0..200.0]);
    let wrong = prop::collection::vec(error, 1..3).prop_map(|errors| {
        let keys = |(vehicle, offset_s, drift_ppm): (u8, f64, f64)| {
            let of = format!("vehicle.{vehicle}.clock");
            [format!("{of}_offset_s={offset_s:.3}"), format!("{of}_drift_ppm={drift_ppm:.1}")]
        };
        errors.into_iter().flat_map(keys).collect()
    });
    prop_oneof![3 => Just(Vec::new()), 1 => wrong]
}

/// Events that cut or delay links.
fn link_event(vehicles: u8) -> impl Strategy<Value = String> {
    let ids = || prop::collection::btree_set(1..=vehicles, 1..4).prop_map(Vec::from_iter);
    let what = prop_oneof![
        3 => Just("fault = 'cut'".to_owned()),
        1 => (0.02..1.5).prop_map(|delay_s: f64| format!("fault = 'delay', delay_s = {delay_s:.3}")),
    ];
    let lasts = prop_oneof![Just(String::new()), (0.1..9.0).prop_map(|for_s: f64| format!("for_s = {for_s:.2}, "))];
    (0.0..25.0, lasts, ids(), ids(), any::<bool>(), what).prop_map(|(at_s, lasts, from, to, both_ways, what)| {
        format!("{{ at_s = {at_s:.2}, {lasts}from = {from:?}, to = {to:?}, both_ways = {both_ways}, {what} }}")
    })
}

/// Events with which agents end, begin and are given orders.
fn events(vehicles: u8) -> impl Strategy<Value = String> {
    let event = prop_oneof![
        (0.0..25.0, 1..=vehicles, 1.0..10.0).prop_map(|(at_s, vehicle, for_s): (f64, u8, f64)| {
            format!("{{ at_s = {at_s:.2}, fault = 'kill', vehicle = {vehicle}, for_s = {for_s:.2} }}")
        }),
        (0.0..25.0, 1..=vehicles).prop_map(|(at_s, vehicle): (f64, u8)| format!(
            "{{ at_s = {at_s:.2}, fault = 'kill', vehicle = {vehicle} }}"
        )),
        (0.0..25.0).prop_map(|at_s: f64| format!("{{ at_s = {at_s:.2}, for_s = 3, order = 'hold' }}")),
        (0.0..25.0, 1..=vehicles)
            .prop_map(|(at_s, id): (f64, u8)| format!("{{ at_s = {at_s:.2}, order = 'land', vehicles = [{id}] }}")),
        (0.0..25.0, prop_oneof![Just("'goto', step = 0"), Just("'goto', step = 1"), Just("'abort'")])
            .prop_map(|(at_s, order): (f64, &str)| format!("{{ at_s = {at_s:.2}, order = {order} }}")),
        (0.0..25.0, 1..=vehicles).prop_map(|(at_s, id): (f64, u8)| {
            format!("{{ at_s = {at_s:.2}, order = 'release', vehicles = [{id}] }}")
        }),
        (0.0..25.0, 40.0..90.0).prop_map(move |(at_s, more_m): (f64, f64)| {
            // The vehicles need room on the ring.
            let radius_m = more_m + 2.0 * f64::from(vehicles);
            format!("{{ at_s = {at_s:.2}, order = 'set', key = 'formation.radius_m', value = {radius_m:.1} }}")
        }),
        (0.0..25.0, 1..=vehicles, 1.0..8.0).prop_map(|(at_s, vehicle, for_s): (f64, u8, f64)| {
            format!("{{ at_s = {at_s:.2}, fault = 'simulator_freeze', vehicle = {vehicle}, for_s = {for_s:.2} }}")
        }),
        (
            0.0..25.0,
            1..=vehicles,
            prop_oneof![-30.0..30.0, -2.0..2.0],
            prop_oneof![Just(String::new()), Just("for_s = 4, ".to_owned())]
        )
            .prop_map(|(at_s, vehicle, by_s, lasts): (f64, u8, f64, String)| {
                format!("{{ at_s = {at_s:.2}, {lasts}fault = 'clock_jump', vehicle = {vehicle}, by_s = {by_s:.2} }}")
            }),
    ];
    let event = prop_oneof![2 => event, 1 => link_event(vehicles)];
    prop::collection::vec(event, 0..5).prop_map(|events| format!("mission.events=[{}]", events.join(", ")))
}

proptest! {
    #![proptest_config(histories())]
    #[test]
    fn the_network_of_the_swarm_delivers_what_those_of_all_receivers_do(
        (vehicles, events) in prop_oneof![57 => 3_u8..8, 2 => 65_u8..70, 1 => 129_u8..135]
            .prop_flat_map(|vehicles| (Just(vehicles), events(vehicles))),
        seed in 0_u64..1000,
        everywhere in link(),
        particular in prop_oneof![Just(Vec::new()), link()],
        reach in reach(),
        law in prop_oneof![Just("ring"), Just("flock")],
        clocks in clocks(),
    ) {
        let everywhere: Vec<String> = everywhere.into_iter().chain(reach).map(|key| format!("network.{key}")).collect();
        let of_link = format!("network.links=[{{ from = [1, 2], to = [2, 3], {} }}]", particular.join(", "));
        let mut sets = vec![format!("swarm.vehicles={vehicles}"), format!("seed={seed}"), format!("formation.law={law}"), events];
        sets.push("plant.model=point_mass".to_owned());
        sets.push("mission.steps=[{ hold_s = 10 }, { centre_ne_m = [60, 0] }, { land = true }]".to_owned());
        sets.extend(everywhere.into_iter().chain(clocks));
        if !particular.is_empty() {
            sets.push(of_link);
        }
        // Room for the largest swarm on the ground and on the ring.
        if vehicles < 100 {
            sets.push("start.square_m=200".to_owned());
        } else {
            sets.extend(["start.square_m=250".to_owned(), "formation.radius_m=180".to_owned()]);
        }
        prop_assume!(is_imperfect(&sets));
        compare(&sets, if vehicles < 10 { 30.0 } else { 12.0 });
    }
}
