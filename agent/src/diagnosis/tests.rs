//! Closed loop on the built-in helicopter; `cargo test -- --nocapture diagnosis` prints what was measured.

pub(crate) mod flight;

use nalgebra::Vector2;

use super::*;
use crate::plant::helicopter::Failures;
use flight::{Flight, Senses};

/// How near normal flights come to each limit: roll, pitch, climb, yaw; and how slow the rotor turns.
#[derive(Clone, Copy, Debug, Default)]
struct Nearest {
    shares: [f64; 4],
    rotor_lost_rad_s: f64,
}

impl Nearest {
    fn look(&mut self, flight: &Flight) {
        let controls = flight.diagnosis.controls.as_ref().unwrap();
        let channels = [&controls.roll, &controls.pitch, &controls.climb, &controls.yaw];
        for (share, channel) in self.shares.iter_mut().zip(channels) {
            *share = share.max(channel.difference.abs() / channel.limit);
        }
        self.rotor_lost_rad_s = self.rotor_lost_rad_s.max(167.0 - flight.vehicle.helicopter().rotor_speed_rad_s());
    }
}

/// Take-off, hover, steps across and up, turns on the spot, transit at 7 m/s round two corners, zigzag, landing.
fn normal_flight(mut flight: Flight) -> (Flight, Nearest) {
    let mut nearest = Nearest::default();
    let mut fly = |flight: &mut Flight, seconds: f64| {
        for _ in 0..(seconds * 50.0) as u32 {
            flight.fly(0.02);
            nearest.look(flight);
        }
    };
    fly(&mut flight, 60.0);
    flight.place_ne_m += Vector2::new(30.0, 30.0);
    flight.altitude_m = 60.0;
    fly(&mut flight, 20.0);
    flight.heading_rad += 3.0;
    fly(&mut flight, 10.0);
    flight.altitude_m = 25.0;
    fly(&mut flight, 25.0);
    for moves_ne_m_s in [[7.0, 0.0], [0.0, 7.0], [-7.0, 0.0], [0.0, 0.0]] {
        flight.moves_ne_m_s = moves_ne_m_s.into();
        fly(&mut flight, 20.0);
    }
    for east_m in [28.0, -28.0, 28.0, -28.0] {
        flight.place_ne_m += Vector2::new(10.0, east_m);
        fly(&mut flight, 4.0);
    }
    fly(&mut flight, 10.0);
    flight.land();
    (flight, nearest)
}

#[test]
fn normal_flights_raise_no_alarm() {
    let mut worst = Nearest::default();
    for seed in 0..48 {
        let (wind_m_s, gust_w20_m_s) = [(0.0, 0.0), (3.0, 3.0), (8.0, 8.0), (5.0, 8.0)][seed as usize % 4];
        let senses = if seed % 8 < 4 { Senses::Exact } else { Senses::Paper };
        let (flight, nearest) = normal_flight(Flight::new(senses, wind_m_s, gust_w20_m_s, seed));
        assert_eq!(flight.found, [], "seed {seed}");
        println!("{seed} {senses:?} {wind_m_s} {gust_w20_m_s} {nearest:.2?}");
        for (worst, share) in worst.shares.iter_mut().zip(nearest.shares) {
            *worst = worst.max(share);
        }
        worst.rotor_lost_rad_s = worst.rotor_lost_rad_s.max(nearest.rotor_lost_rad_s);
    }
    println!("nearest to the limits of roll, pitch, climb, yaw: {worst:.2?}");
}
#[test]
fn zz_debug() {
    let mut flight = Flight::new(Senses::Exact, 8.0, 8.0, 26);
    flight.fly(60.0);
    flight.place_ne_m += Vector2::new(30.0, 30.0);
    flight.altitude_m = 60.0;
    flight.fly(20.0);
    flight.heading_rad += 3.0;
    flight.fly(10.0);
    flight.altitude_m = 25.0;
    flight.fly(25.0);
    flight.moves_ne_m_s = Vector2::new(7.0, 0.0);
    for k in 0..300 {
        flight.fly(0.02);
        if k % 10 == 0 {
            let c = flight.diagnosis.controls.as_ref().unwrap();
            let (t, m) = (flight.truth(), flight.vehicle.frame().measurement);
            println!("{:.2} v {:.1?} att {:.1} {:.1} {:.1} rates {:.2} {:.2} {:.2} rotor {:.1} cmd {:.2?} diffs {:.2} {:.2} {:.2} {:.2}", flight.time_s(), t.velocity.0.as_slice(), t.attitude.roll_rad.to_degrees(), t.attitude.pitch_rad.to_degrees(), t.attitude.heading_rad.to_degrees(), m.rates.roll_rad_s, m.rates.pitch_rad_s, m.rates.yaw_rad_s, m.rotor_speed_rad_s.unwrap(), flight.command, c.roll.difference, c.pitch.difference, c.climb.difference, c.yaw.difference);
        }
    }
}
