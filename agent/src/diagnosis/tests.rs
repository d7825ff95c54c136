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
        let Controls { roll, pitch, yaw, climb, .. } = controls;
        for (share, excess) in self.shares.iter_mut().zip([&roll.excess, &pitch.excess, &climb.excess, &yaw.excess]) {
            *share = share.max(excess.sum / excess.limit);
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
    for seed in 0..240 {
        let (wind_m_s, gust_w20_m_s) = [(0.0, 0.0), (3.0, 3.0), (8.0, 8.0), (5.0, 8.0)][seed as usize % 4];
        let senses = if seed % 8 < 4 { Senses::Exact } else { Senses::Paper };
        let (flight, nearest) = normal_flight(Flight::new(senses, wind_m_s, gust_w20_m_s, seed));
        if !flight.found.is_empty() {
            println!("{seed} {:?}", flight.found);
        }
        if nearest.shares.iter().any(|s| *s > 0.3) {
            println!("{seed} {senses:?} {wind_m_s} {gust_w20_m_s} {nearest:.2?}");
        }
        for (worst, share) in worst.shares.iter_mut().zip(nearest.shares) {
            *worst = worst.max(share);
        }
        worst.rotor_lost_rad_s = worst.rotor_lost_rad_s.max(nearest.rotor_lost_rad_s);
    }
    println!("nearest to the limits of roll, pitch, climb, yaw: {worst:.2?}");
}

fn stuck(servo: usize) -> Failures {
    let mut stuck = [false; 3];
    stuck[servo] = true;
    Failures { stuck, ..Failures::default() }
}

#[test]
fn zz_detect() {
    let sound = Failures::default();
    let kinds = [
        ("engine", Failures { engine_out: true, ..sound }),
        ("gyro", Failures { gyro_off: true, ..sound }),
        ("roll", stuck(0)),
        ("pitch", stuck(1)),
        ("coll", stuck(2)),
        ("pos", Failures { position_frozen: true, ..sound }),
    ];
    for (name, failures) in kinds {
        for phase in ["takeoff", "ground", "hover", "step", "transit", "coast"] {
            for wind in [0.0, 5.0, 8.0] {
                let mut times = Vec::new();
                let (mut tilt, mut away, mut speed) = (0.0f64, 0.0f64, 0.0f64);
                let mut never = 0;
                let mut wrong = 0;
                for seed in 0..16 {
                    let mut flight =
                        Flight::new(if seed % 2 == 0 { Senses::Exact } else { Senses::Paper }, wind, wind, seed);
                    match phase {
                        "takeoff" => flight.fly(5.0 + 0.3 * seed as f64),
                        "ground" => {}
                        "hover" => flight.fly(60.0 + seed as f64),
                        _ => {
                            flight.fly(60.0);
                            if phase == "step" {
                                flight.place_ne_m += Vector2::new(10.0, 10.0);
                                flight.altitude_m += 5.0;
                                flight.fly(0.2 * seed as f64);
                            } else {
                                flight.moves_ne_m_s = Vector2::new(7.0, 0.0);
                                flight.fly(if phase == "coast" { 20.0 } else { 2.0 } + 0.2 * seed as f64);
                            }
                        }
                    }
                    assert!(flight.found.is_empty());
                    flight.fail(failures);
                    let from_s = flight.time_s();
                    let error0 = flight.truth().position;
                    let _ = error0;
                    while flight.found.is_empty()
                        && flight.time_s() < from_s + 30.0
                        && (flight.truth().height_m > 0.3 || flight.time_s() < from_s + 3.0)
                    {
                        flight.fly(0.02);
                    }
                    let t = flight.truth();
                    match flight.found.first() {
                        Some((time, f)) => {
                            times.push(time - from_s);
                            let right = match name {
                                "engine" => Failure::Engine,
                                "gyro" => Failure::Gyro,
                                "pos" => Failure::Position,
                                _ => Failure::Servo,
                            };
                            wrong += u32::from(*f != right);
                            tilt = tilt.max(t.attitude.roll_rad.abs().max(t.attitude.pitch_rad.abs()).to_degrees());
                            let v = t.velocity.horizontal() - flight.moves_ne_m_s;
                            speed = speed.max(v.norm());
                            away = away.max((t.height_m - flight.altitude_m).abs());
                        }
                        None => never += 1,
                    }
                }
                times.sort_by(f64::total_cmp);
                let median = times.get(times.len() / 2).copied().unwrap_or(f64::NAN);
                println!(
                    "{name:7} {phase:8} {wind:.0}: found {:2} never {never:2} wrong {wrong} median {median:5.2} worst {:5.2}; then tilt {tilt:3.0} speed {speed:4.1} off altitude {away:4.1}",
                    times.len(),
                    times.last().unwrap_or(&f64::NAN)
                );
            }
        }
    }
}

#[test]
fn zz_spin() {
    let env = |name: &str, d: f64| std::env::var(name).ok().and_then(|s| s.parse().ok()).unwrap_or(d);
    for axis in [0usize, 1] {
        for phase in ["takeoff", "hover", "step", "transit"] {
            for wind in [0.0, 5.0] {
                for spin in [1.0, -1.0] {
                    let mut crashes = 0;
                    let (mut far, mut hard, mut fast, mut tilted, mut n) = (0.0f64, Vec::new(), 0.0f64, 0.0f64, 0);
                    for seed in 0..16 {
                        let mut flight = Flight::new(Senses::Exact, wind, wind, seed);
                        match phase {
                            "takeoff" => flight.fly(5.0 + 0.3 * seed as f64),
                            "hover" => flight.fly(60.0 + seed as f64),
                            _ => {
                                flight.fly(60.0);
                                if phase == "step" {
                                    flight.place_ne_m += Vector2::new(10.0, 10.0);
                                    flight.altitude_m += 5.0;
                                    flight.fly(0.2 * seed as f64);
                                } else {
                                    flight.moves_ne_m_s = Vector2::new(7.0, 0.0);
                                    flight.fly(2.0 + 0.2 * seed as f64);
                                }
                            }
                        }
                        flight.fail(stuck(axis));
                        let from_s = flight.time_s();
                        while flight.found.is_empty() && flight.time_s() < from_s + 30.0 && flight.truth().height_m > 0.3 {
                            flight.fly(0.02);
                        }
                        if flight.found.is_empty() { continue; }
                        n += 1;
                        flight.moves_ne_m_s = Vector2::zeros();
                        let t = flight.truth();
                        flight.place_ne_m = t.position.horizontal();
                        flight.altitude_m = t.position.altitude_m();
                        let place = flight.place_ne_m;
                        let mut before = t;
                        let end_s = flight.time_s() + 60.0;
                        while flight.truth().height_m > 0.26 && flight.time_s() < end_s {
                            before = flight.truth();
                            far = far.max((before.position.horizontal() - place).norm());
                            let sink_m_s = if before.height_m > 6.0 { 2.0 } else { 0.7 };
                            flight.altitude_m = (flight.altitude_m - sink_m_s * 0.02).max(before.position.altitude_m() - 3.0);
                            let estimate = flight.look();
                            let mut setpoint = flight.setpoint(&estimate);
                            if spin != 0.0 { setpoint.heading_rad = estimate.attitude.heading_rad; }
                            if env("NOPLACE", 0.0) > 0.0 { setpoint.error_ne_m *= 0.0; }
                            let mut sticks = flight.controller.step(0.02, &estimate, &setpoint).sticks;
                            if spin != 0.0 { sticks.yaw = spin; }
                            flight.advance(sticks);
                        }
                        let speed = before.velocity.0.norm();
                        let tilt = before.attitude.roll_rad.abs().max(before.attitude.pitch_rad.abs()).to_degrees();
                        hard.push(before.velocity.down_m_s());
                        fast = fast.max(before.velocity.horizontal().norm());
                        tilted = tilted.max(tilt);
                        crashes += u32::from(speed > 4.0 || tilt > 25.0);
                    }
                    hard.sort_by(f64::total_cmp);
                    println!("axis {axis} {phase:8} wind {wind:.0} spin {spin:.2}: n {n} crashes {crashes:2} far {far:5.1} sink median {:.1} worst {:.1} horizontal {fast:.1} tilt {tilted:.0}", hard.get(hard.len()/2).unwrap_or(&f64::NAN), hard.last().unwrap_or(&f64::NAN));
                }
            }
        }
    }
}
