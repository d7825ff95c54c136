//! Random helicopters, fitted by the ladder of `skein xplane fit` in virtual time and then flown in the default ring.

use std::net::SocketAddr;
use std::time::Duration;

use rand::{Rng, RngExt};
use skein_agent::plant::xplane::client::{Client, Indices};
use skein_agent::plant::xplane::standin::Simulator;
use skein_common::frame::{Geodetic, Origin};
use skein_common::id::VehicleId;
use skein_core::aircraft::{Aircraft, Profile};
use skein_core::control::Rules;
use skein_core::fit::{Fit, FitError, Fitted, Rung};
use skein_core::helicopter::parameters::Reversed;
use skein_core::helicopter::{BuiltInVehicle, Parameters, Start, Weather};
use skein_core::plant::{Command, Frame};
use skein_core::random::{self, Purpose};
use skein_lab::metrics::Report;

use crate::wire::default_options;
use crate::{in_parallel, study};

/// Longer than any fit takes, s.
const LONGEST_S: f64 = 900.0;
const CALM: Weather = Weather { wind_m_s: 0.0, wind_from_rad: 0.0, gust_w20_m_s: 0.0 };

/// How a fit went.
#[derive(Debug)]
pub struct Climbed {
    /// What it found, or why it found nothing.
    pub end: Result<Fitted, FitError>,
    /// How long it took, s.
    pub took_s: f64,
    /// Largest bank or pitch, degrees.
    pub largest_tilt_deg: f64,
    /// The last frame.
    pub last: Frame,
    /// The last rung before the landing.
    pub rung: Rung,
}

/// The shipped helicopter with mass, inertia, rotor and authority changed by up to 40 %, and controls reversed at random.
///
/// # Panics
/// If the shipped aircraft is not well formed.
pub fn random_helicopter(seed: u64) -> Parameters {
    let mut generator = random::generator(seed, None, Purpose::Study);
    let shipped = Aircraft::shipped("xcell60").expect("a shipped aircraft").expect("a well-formed file");
    let mut parameters = shipped.helicopter.expect("a flight model");
    let mut change = |value: &mut f64| *value *= generator.random_range(0.6..1.4);
    change(&mut parameters.mass_kg);
    change(&mut parameters.inertia.roll_kg_m2);
    change(&mut parameters.inertia.pitch_kg_m2);
    change(&mut parameters.inertia.yaw_kg_m2);
    change(&mut parameters.main_rotor.lift_slope_per_rad);
    change(&mut parameters.head.hub_stiffness_n_m_per_rad);
    change(&mut parameters.servos.cyclic_throw_rad);
    change(&mut parameters.servos.max_collective_rad);
    change(&mut parameters.gyro.max_rate_rad_s);
    let mut is_reversed = || generator.random_bool(0.5);
    parameters.servos.reversed = Reversed { roll: is_reversed(), pitch: is_reversed(), yaw: is_reversed() };
    parameters
}

/// Flies a helicopter up the ladder in calm air.
///
/// # Panics
/// If the ladder has no end, or commands controls beyond their travel.
pub fn climb(parameters: &Parameters) -> Climbed {
    let origin = Origin::new(Geodetic::from_degrees(28.0, -82.0, 10.0));
    let one = VehicleId::new(1).expect("the lowest id");
    let start = Start { heading_rad: 0.7, ..Start::default() };
    let mut vehicle = BuiltInVehicle::new(&origin, parameters, &start, &CALM, 1, one);
    let mut fit = Fit::new(Rules::shipped());
    let (mut largest_tilt_rad, mut rung) = (0.0_f64, Rung::Watch);
    loop {
        let last = vehicle.frame();
        let step = fit.step(last.time, &last.measurement);
        assert!(step.controls.is_within_limits(), "{:?}", step.controls);
        let attitude = last.truth.attitude;
        largest_tilt_rad = largest_tilt_rad.max(attitude.roll_rad.abs()).max(attitude.pitch_rad.abs());
        if step.rung != Rung::Land {
            rung = step.rung;
        }
        let took_s = last.time.seconds();
        if let Some(end) = step.end {
            return Climbed { end, took_s, largest_tilt_deg: largest_tilt_rad.to_degrees(), last, rung };
        }
        assert!(took_s < LONGEST_S, "no end: {fit:?}");
        vehicle.advance(Command::Controls(step.controls).controls());
    }
}

/// Flies the ladder over X-Plane's protocol, in a simulator that has loaded the aircraft of this path. Returns the file that
/// `skein xplane fit` would write for this base.
///
/// # Errors
/// What the ladder could not do.
///
/// # Panics
/// If the base is not an aircraft file, or the ladder has no end.
pub fn fit_over_wire(base: &str, acf: &str) -> Result<String, FitError> {
    let profile = Profile::from_text("base.toml", base).expect("an aircraft file");
    let origin = Origin::new(Geodetic::from_degrees(28.0, -82.0, 0.0));
    let simulator_address = SocketAddr::from(([127, 0, 0, 1], 49_000));
    let own_address = SocketAddr::from(([127, 0, 0, 1], 20_000));
    let mut options = default_options();
    options.acf = acf.to_owned();
    let mut simulator = Simulator::new(&options).expect("valid options");
    let mut generator = random::generator(1, None, Purpose::Study);
    let indices = Indices::draw(|bytes| {
        generator.fill_bytes(bytes);
        true
    });
    let mut client = Client::new(&origin, &profile, 50, indices.expect("random numbers"));
    let mut fit = Fit::new(Rules::shipped());
    let mut now = skein_host::clock::now();
    let mut sent: Vec<Vec<u8>> = Vec::new();
    for _ in 0..(LONGEST_S * 50.0) as u32 {
        now += Duration::from_millis(20);
        client.renew(now, &mut |datagram| sent.push(datagram.to_vec()));
        for datagram in sent.drain(..) {
            simulator.receive(&datagram, own_address);
        }
        let (frame_s, _) = simulator.begin_frame();
        let mut received = Vec::new();
        simulator.end_frame(frame_s, |_, datagram| received.push(datagram.to_vec()));
        for datagram in received {
            client.receive(&datagram, simulator_address, simulator_address.ip(), now);
        }
        let Some(frame) = client.frame() else { continue };
        let step = fit.step(frame.time, &frame.measurement);
        client.command(Command::Controls(step.controls), now, &mut |datagram| sent.push(datagram.to_vec()));
        if let Some(end) = step.end {
            return end.map(|fitted| skein::fit::aircraft_file(&fitted, "fitted", "a stand-in", base));
        }
    }
    panic!("no end: {fit:?}");
}

/// Flies the default ring with four of these helicopters and the file that was found for them, over seeds from 0.
///
/// # Panics
/// If the file of the fit is not an aircraft file, or a flight does not begin.
pub fn ring(parameters: &Parameters, fitted: &Fitted, seeds: u64) -> Vec<Report> {
    let text = skein::fit::aircraft_file(fitted, "fitted", "the built-in helicopter", "");
    let mut aircraft = Aircraft::from_text("fitted.toml", &text).expect("an aircraft file");
    aircraft.helicopter = Some(parameters.clone());
    let mut study = study("hover.toml", &[]);
    study.aircraft.fill(aircraft);
    in_parallel(0..seeds, |seed| study.fly(seed).expect("a flight"))
}

/// A row for each of the first random helicopters, until so many have been fitted: what was found, and their ring.
pub fn table(fitted: usize, seeds: u64) -> String {
    let mut text = "helicopter  mass kg  collective  gain roll  pitch    yaw  collective  tilt deg  fit s  in band s  \
                    even 10 deg s  radial rms m  separation m\n"
        .to_owned();
    let mut count = 0;
    for seed in 0.. {
        if count == fitted {
            break;
        }
        let parameters = random_helicopter(seed);
        let mass_kg = parameters.mass_kg;
        if let Err(error) = parameters.check() {
            text += &format!("{seed:<10} {mass_kg:8.1}  rejected: {error}\n");
            continue;
        }
        let climbed = climb(&parameters);
        let found = match &climbed.end {
            Ok(found) => found,
            Err(error) => {
                text += &format!("{seed:<10} {mass_kg:8.1}  rejected: {error}\n");
                continue;
            }
        };
        count += 1;
        let flown = ring(&parameters, found, seeds);
        let worst = |figure: fn(&Report) -> Option<f64>| {
            let values: Option<Vec<f64>> = flown.iter().map(figure).collect();
            values.map_or_else(
                || "never".to_owned(),
                |values| format!("{:.2}", values.iter().fold(f64::MIN, |a, b| a.max(*b))),
            )
        };
        let separations: Vec<f64> = flown.iter().filter_map(|report| report.min_separation_m).collect();
        let gains = found.gains;
        text += &format!(
            "{seed:<10} {mass_kg:8.1} {:11.2} {:10.2} {:6.2} {:6.2} {:11.2} {:9.1} {:6.0} {:>10} {:>14} {:>13} {:13.1}\n",
            found.trim.collective,
            gains.roll,
            gains.pitch,
            gains.yaw,
            gains.collective,
            climbed.largest_tilt_deg,
            climbed.took_s,
            worst(|report| report.in_band_s),
            worst(|report| report.even_10deg_s),
            worst(|report| report.radial_rms_m),
            separations.iter().fold(f64::MAX, |a, b| a.min(*b)),
        );
    }
    text + &format!("Figures of the ring: the worst of {seeds} flights of four such helicopters, 400 s each.")
}
