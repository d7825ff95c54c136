//! Imperfect sensors: turns the plant's exact measurement into the one that the agent gets.
//!
//! The scenario's `[sensing]` gives each quantity a constant error of each vehicle (bias), noise, and all of them a
//! latency and dropouts. A [`Station`](crate::station::Station) applies them, in real and in virtual time, over any
//! plant. The ground truth stays exact.
//!
//! ```text
//!   exact measurement --> + bias + noise --> lost in a dropout? --> delay line --> agent
//! ```
//!
//! * The bias of each component is drawn once, from a normal distribution.
//! * Noise is drawn for each frame. The noise of position and altitude is a first-order Gauss-Markov process,
//!   n ← e^(−Δt/τ) n + σ √(1 − e^(−2Δt/τ)) N(0, 1), whose standard deviation is σ at any frame rate. White noise has
//!   τ = 0.
//! * Dropouts lose whole measurements, for a share of all time, independently or in bursts (`Gilbert`).
//! * The delay line hands on the newest measurement that is at least as old as the latency.
//! * The height above the ground and the rotor's speed stay exact. A position that the plant repeats bit for bit is no
//!   new reading: it keeps its error, so that a frozen sensor stays visibly frozen.
//!
//! Every quantity draws from a stream of its own, so that one key of `[sensing]` does not change the errors of another
//! quantity, and the same seed with twice the noise has the same errors twice as large.

use alloc::boxed::Box;
use alloc::collections::VecDeque;

use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;
use skein_common::frame::{Attitude, BodyRates, Geodetic, Origin, wrap_rad};
use skein_common::id::VehicleId;
use skein_common::math;
use skein_common::scenario::{Scenario, Sensing};
use skein_common::time::PlantTime;

use crate::gilbert::Gilbert;
use crate::plant::Measurement;
use crate::random::{self, Purpose};

/// The sensors of one vehicle.
#[derive(Clone, Debug)]
pub struct Sensors {
    origin: Origin,
    position: Option<Errors>,
    velocity: Option<Errors>,
    attitude: Option<Errors>,
    rates: Option<Errors>,
    dropouts: Option<Dropouts>,
    /// The exact position of the last frame.
    last_position: Option<Geodetic>,
    last: Option<PlantTime>,
    latency_ns: u64,
    /// Measurements that the agent has not got yet, the oldest first.
    delayed: VecDeque<(PlantTime, Measurement)>,
}

impl Sensors {
    /// The sensors of vehicle `own`; `None` if they are exact, immediate and complete.
    pub fn new(scenario: &Scenario, own: VehicleId) -> Option<Box<Self>> {
        let Scenario { sensing, origin, seed, .. } = scenario;
        if sensing.is_without_errors() {
            return None;
        }
        let generator = |purpose| random::generator(*seed, Some(own), purpose);
        let Sensing { noise, bias, .. } = sensing;
        let errors = |purpose, noise: [f64; 3], bias: [f64; 3], correlation_s| {
            let is_exact = noise == [0.0; 3] && bias == [0.0; 3];
            (!is_exact).then(|| Errors::new(generator(purpose), noise.into(), bias.into(), correlation_s))
        };
        let position = [noise, bias].map(|of| [of.position_m, of.position_m, of.altitude_m]);
        let velocity = [noise, bias].map(|of| [of.velocity_m_s; 3]);
        let attitude = [noise, bias].map(|of| [of.attitude_deg, of.attitude_deg, of.heading_deg].map(f64::to_radians));
        let rates = [noise, bias].map(|of| [of.rate_deg_s.to_radians(); 3]);
        Some(Box::new(Self {
            origin: Origin::new(origin.geodetic()),
            position: errors(Purpose::PositionSensor, position[0], position[1], sensing.correlation_s),
            velocity: errors(Purpose::VelocitySensor, velocity[0], velocity[1], None),
            attitude: errors(Purpose::AttitudeSensor, attitude[0], attitude[1], None),
            rates: errors(Purpose::RateSensor, rates[0], rates[1], None),
            dropouts: (sensing.dropout > 0.0).then(|| Dropouts::new(sensing, generator(Purpose::SensorDropout))),
            last_position: None,
            last: None,
            latency_ns: (sensing.latency_s * 1e9).round() as u64,
            delayed: VecDeque::new(),
        }))
    }

    /// Takes the exact measurement of the frame at plant time `at`. Returns the newest measurement that reaches the
    /// agent in this frame; `None` if none does.
    pub fn measure(&mut self, at: PlantTime, exact: &Measurement) -> Option<Measurement> {
        let since_s = self.last.map_or(0.0, |last| at.seconds_since(last));
        if since_s < 0.0 {
            // The plant has begun again.
            self.delayed.clear();
        }
        self.last = Some(at);
        let measured = self.with_errors(since_s.max(0.0), exact);
        let is_lost = self.dropouts.as_mut().is_some_and(|dropouts| dropouts.is_lost(since_s));
        if self.latency_ns == 0 {
            return (!is_lost).then_some(measured);
        }
        if !is_lost {
            // A paused simulator repeats its time; the line must not grow meanwhile.
            self.delayed.pop_back_if(|(taken_at, _)| *taken_at == at);
            self.delayed.push_back((at, measured));
        }
        let latest_ns = at.nanoseconds().checked_sub(self.latency_ns)?;
        let mut arrived = None;
        while let Some((taken_at, measured)) = self.delayed.front()
            && taken_at.nanoseconds() <= latest_ns
        {
            arrived = Some(*measured);
            self.delayed.pop_front();
        }
        arrived
    }

    /// The measurement with the errors of this frame, `since_s` after the last.
    fn with_errors(&mut self, since_s: f64, exact: &Measurement) -> Measurement {
        let mut measured = *exact;
        if let Some(errors) = &mut self.position {
            let repeats = self.last_position.replace(exact.position) == Some(exact.position);
            let error_ned_m = if repeats { errors.last() } else { errors.next(since_s) };
            let (position, true_convergence) = self.origin.locate(&exact.position);
            let (place, convergence) = self.origin.place(position + error_ned_m);
            measured.position = place;
            // The axes are those of the measured position.
            measured.velocity = convergence.velocity_to_local(true_convergence.velocity_from_local(exact.velocity));
            measured.attitude = convergence.attitude_to_local(true_convergence.attitude_from_local(exact.attitude));
        }
        if let Some(errors) = &mut self.velocity {
            measured.velocity.0 += errors.next(since_s);
        }
        if let Some(errors) = &mut self.attitude {
            let [roll_rad, pitch_rad, heading_rad] = errors.next(since_s).into();
            let Attitude { roll_rad: roll, pitch_rad: pitch, heading_rad: heading } = measured.attitude;
            measured.attitude = Attitude {
                roll_rad: wrap_rad(roll + roll_rad),
                pitch_rad: wrap_rad(pitch + pitch_rad),
                heading_rad: wrap_rad(heading + heading_rad),
            };
        }
        if let Some(errors) = &mut self.rates {
            let [roll_rad_s, pitch_rad_s, yaw_rad_s] = errors.next(since_s).into();
            let BodyRates { roll_rad_s: p, pitch_rad_s: q, yaw_rad_s: r } = exact.rates;
            measured.rates =
                BodyRates { roll_rad_s: p + roll_rad_s, pitch_rad_s: q + pitch_rad_s, yaw_rad_s: r + yaw_rad_s };
        }
        measured
    }
}

/// The errors of a quantity with three components.
#[derive(Clone, Debug)]
struct Errors {
    generator: ChaCha8Rng,
    bias: Vector3<f64>,
    /// Standard deviations σ of the noise.
    sigma: Vector3<f64>,
    /// Correlation time τ of the noise, s; `None`: white noise.
    correlation_s: Option<f64>,
    /// Noise of the last frame; `None` before the first.
    noise: Option<Vector3<f64>>,
}

impl Errors {
    fn new(mut generator: ChaCha8Rng, sigma: Vector3<f64>, bias: Vector3<f64>, correlation_s: Option<f64>) -> Self {
        let bias = normal(&mut generator).component_mul(&bias);
        Self { generator, bias, sigma, correlation_s, noise: None }
    }

    /// The errors of the last frame.
    fn last(&self) -> Vector3<f64> {
        self.bias + self.noise.unwrap_or_default()
    }

    /// The errors of a new frame, `since_s` seconds after the last.
    fn next(&mut self, since_s: f64) -> Vector3<f64> {
        let fresh = normal(&mut self.generator).component_mul(&self.sigma);
        let noise = match (self.correlation_s, self.noise) {
            (Some(correlation_s), Some(before)) => {
                let left = math::exp(-since_s / correlation_s);
                before * left + fresh * (1.0 - left * left).sqrt()
            }
            _ => fresh,
        };
        self.noise = Some(noise);
        self.last()
    }
}

/// Three independent draws from the standard normal distribution.
fn normal(generator: &mut ChaCha8Rng) -> Vector3<f64> {
    let mut draw = || random::standard_normal(generator);
    Vector3::new(draw(), draw(), draw())
}

/// Decides which measurements are lost.
#[derive(Clone, Debug)]
struct Dropouts {
    generator: ChaCha8Rng,
    share: f64,
    /// Dropouts that last; `None`: each measurement is lost independently.
    lasting: Option<Gilbert>,
}

impl Dropouts {
    fn new(sensing: &Sensing, generator: ChaCha8Rng) -> Self {
        let lasting = sensing.dropout_s.map(|mean_s| Gilbert::new(sensing.dropout, mean_s));
        Self { generator, share: sensing.dropout, lasting }
    }

    /// Whether the measurement of a frame, `since_s` seconds after the last frame, is lost.
    fn is_lost(&mut self, since_s: f64) -> bool {
        let chance = random::uniform(&mut self.generator);
        match &mut self.lasting {
            Some(lasting) => lasting.is_bad(since_s, chance),
            None => chance < self.share,
        }
    }
}

#[cfg(test)]
mod tests;
