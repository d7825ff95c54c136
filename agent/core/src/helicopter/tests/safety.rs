//! No controls and no weather make the helicopter's state non-finite.

use proptest::prelude::*;

use super::*;
use crate::random::{self, Purpose, uniform};

/// A fall from 1000 m with random controls, each held for up to a second; it ends on the ground and the random controls
/// continue there.
fn flown(seed: u64, seconds: u32, weather: &Weather, mut check: impl FnMut(&Helicopter)) -> Helicopter {
    let mut chance = random::generator(seed, None, Purpose::Start);
    let mut air = LocalWind::new(weather, random::generator(seed, None, Purpose::Wind));
    let mut helicopter = Helicopter::at_rest(&xcell60(), 0.0, 0.0, 0.0, 0.0);
    helicopter.state.0[2] -= 1_000.0;
    let mut ticks = 0;
    while ticks < seconds * 50 {
        let mut deflection = || 2.0 * uniform(&mut chance) - 1.0;
        let (roll, pitch, yaw) = (deflection(), deflection(), deflection());
        let controls = Controls { roll, pitch, yaw, collective: 0.3 + 0.7 * uniform(&mut chance) };
        for _ in 0..(1.0 + 50.0 * uniform(&mut chance)) as u32 {
            helicopter.advance(&controls, air.advance(helicopter.height_m()));
            check(&helicopter);
            ticks += 1;
        }
    }
    helicopter
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4))]

    #[test]
    fn no_controls_or_wind_make_the_state_non_finite(seed: u64) {
        let weather = Weather { wind_m_s: 20.0, wind_from_rad: 1.0, gust_w20_m_s: 20.0 };
        let (mut airborne, mut grounded) = (0, 0);
        flown(seed, 120, &weather, |helicopter| {
            let State(state) = &helicopter.state;
            assert!(state.iter().all(|value| value.is_finite()), "{state:?}");
            let unit: f64 = state[6..10].iter().map(|part| part * part).sum();
            assert!((unit - 1.0).abs() < 1e-12, "{unit}");
            // Flat pitch in a dive drives the rotor like a windmill: up to 520 rad/s in 3,000 such flights.
            assert!(state[15] > 0.0 && state[15] < 800.0, "rotor speed {}", state[15]);
            assert!(helicopter.velocity().0.norm() < 150.0, "{:?}", helicopter.velocity());
            assert!(helicopter.rates().is_finite() && helicopter.attitude().is_finite());
            assert!((0.0..=2_000.0).contains(&helicopter.power_w()));
            *if helicopter.height_m() > 1.0 { &mut airborne } else { &mut grounded } += 1;
        });
        prop_assert!(airborne > 500 && grounded > 500, "{airborne} ticks in the air, {grounded} on the ground");
    }
}

#[test]
fn the_same_seed_gives_a_bit_identical_flight() {
    let weather = Weather { wind_m_s: 5.0, wind_from_rad: 1.0, gust_w20_m_s: 5.0 };
    let bits = |seed| flown(seed, 20, &weather, |_| ()).state.0.map(f64::to_bits);
    assert_eq!(bits(1), bits(1));
    assert_ne!(bits(1), bits(2));
}

#[test]
fn a_dropped_helicopter_comes_to_rest_on_its_skids() {
    let mut helicopter = Helicopter::at_rest(&xcell60(), 0.0, 0.0, 50.0, 0.0);
    helicopter.state.0[2] -= 1.0;
    for _ in 0..500 {
        // The gyro's integral winds up on the ground. It is held, because only the drop matters.
        helicopter.state.0[17] = 0.175;
        helicopter.advance(&Controls { collective: 0.2, ..Controls::default() }, VelocityNed::default());
    }
    assert_near(0.03, helicopter.height_m(), 0.242);
    assert!(helicopter.velocity().0.norm() < 0.02, "{:?}", helicopter.velocity());
}

#[test]
fn negligible_states_become_zero() {
    let mut flight = Flight::trimmed(0.0);
    flight.state.0[4] = 1e-35;
    flight.advance();
    assert!(flight.state.0.iter().all(|value| *value == 0.0 || value.abs() >= 1e-30));
}
