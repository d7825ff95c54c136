use proptest::prelude::*;
use skein_common::frame::{Geodetic, Origin};
use skein_common::id::VehicleId;

use super::*;
use crate::helicopter::tests::xcell60;
use crate::helicopter::{Failures, Start, Weather};

/// One vehicle's part in a flight: its weather, its height at the beginning and its controls.
#[derive(Clone, Debug)]
struct Plan {
    weather: Weather,
    height_m: f64,
    mass_kg: f64,
    /// For each period: failures, new controls (`None` keeps the last), and whether the vehicle is stepped at all.
    periods: Vec<(Failures, Option<Controls>, bool)>,
}

const PERIODS: usize = 6;
const TICKS_PER_PERIOD: usize = 15;

fn controls() -> impl Strategy<Value = Controls> {
    (-1.2..1.2, -1.2..1.2, -1.2..1.2, -0.1..1.1).prop_map(|(roll, pitch, yaw, collective)| Controls {
        roll,
        pitch,
        yaw,
        collective,
    })
}

fn failures() -> impl Strategy<Value = Failures> {
    let any = (any::<bool>(), any::<bool>(), any::<[bool; 3]>(), any::<bool>());
    let any = any.prop_map(|(engine_out, gyro_off, stuck, position_frozen)| Failures {
        engine_out,
        gyro_off,
        stuck,
        position_frozen,
    });
    prop_oneof![3 => Just(Failures::default()), 1 => any]
}

fn plan() -> impl Strategy<Value = Plan> {
    let weather = (0.0..15.0, -3.0..3.0, prop_oneof![Just(0.0), 1.0..20.0])
        .prop_map(|(wind_m_s, wind_from_rad, gust_w20_m_s)| Weather { wind_m_s, wind_from_rad, gust_w20_m_s });
    let height_m = prop_oneof![Just(0.0), 0.0..1.0, 1.0..100.0];
    let period = (failures(), proptest::option::weighted(0.8, controls()), proptest::bool::weighted(0.9));
    let periods = proptest::collection::vec(period, PERIODS);
    (weather, height_m, 6.0..10.0, periods).prop_map(|(weather, height_m, mass_kg, periods)| Plan {
        weather,
        height_m,
        mass_kg,
        periods,
    })
}

fn vehicle(plan: &Plan, number: usize) -> BuiltInVehicle {
    let origin = Origin::new(Geodetic::from_degrees(28.0, -82.0, 10.0));
    let parameters = crate::helicopter::Parameters { mass_kg: plan.mass_kg, ..xcell60() };
    let id = VehicleId::new(number as u8 + 1).unwrap();
    let mut vehicle = BuiltInVehicle::new(&origin, &parameters, &Start::default(), &plan.weather, 7, id);
    vehicle.helicopter.state.0[2] -= plan.height_m;
    vehicle
}

/// All vehicles' states after each tick, to the bit.
type Flight = Vec<Vec<[u64; 23]>>;

fn flown(plans: &[Plan], mut advance: impl FnMut(Vec<(&mut BuiltInVehicle, Option<Controls>)>)) -> Flight {
    let mut vehicles: Vec<_> = plans.iter().enumerate().map(|(nth, plan)| vehicle(plan, nth)).collect();
    let mut flight = Vec::new();
    for tick in 0..PERIODS * TICKS_PER_PERIOD {
        let (period, first) = (tick / TICKS_PER_PERIOD, tick % TICKS_PER_PERIOD == 0);
        let mut stepped = Vec::new();
        for (plan, vehicle) in plans.iter().zip(&mut vehicles) {
            let (failures, controls, is_stepped) = plan.periods[period];
            vehicle.fail(failures);
            if is_stepped {
                stepped.push((vehicle, controls.filter(|_| first)));
            }
        }
        advance(stepped);
        flight.push(vehicles.iter().map(|vehicle| vehicle.helicopter.state.0.map(f64::to_bits)).collect());
    }
    flight
}

fn alone(vehicles: Vec<(&mut BuiltInVehicle, Option<Controls>)>) {
    vehicles.into_iter().for_each(|(vehicle, controls)| vehicle.advance(controls));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn vehicles_in_a_block_fly_as_alone_to_the_bit(plans in proptest::collection::vec(plan(), 1..=Block::SIZE)) {
        let mut block = Block::default();
        let together = flown(&plans, |vehicles| block.advance(vehicles.into_iter(), Block::compute));
        prop_assert_eq!(together, flown(&plans, alone));
    }
}

#[test]
fn a_vehicle_that_is_held_on_the_ground_only_ages() {
    let plan = Plan { weather: Weather::default(), height_m: 0.0, mass_kg: 8.2, periods: Vec::new() };
    let (mut held, mut flying) = (vehicle(&plan, 0), vehicle(&plan, 1));
    let start = held.helicopter.state;
    let mut block = Block::default();
    for _ in 0..10 {
        let climb = Controls { collective: 0.7, ..Controls::default() };
        block.advance([(&mut held, None), (&mut flying, Some(climb))].into_iter(), Block::compute);
    }
    assert_eq!(held.helicopter.state, start);
    assert_eq!(held.frame().time.seconds(), 0.2);
    assert_ne!(flying.helicopter.state, start);
}
