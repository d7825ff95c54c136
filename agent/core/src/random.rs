//! Random numbers from one seed. Every vehicle and every purpose draws from its own stream, so that one more draw in
//! one stream does not change another. The streams are ChaCha8's and are the same on every computer and in every
//! release.

use core::f64::consts::TAU;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use skein_common::id::{Incarnation, VehicleId};
use skein_common::math;

/// The purpose of random numbers. The discriminants are part of the meaning of a seed: never reuse one, 6 and 12 neither.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Purpose {
    /// Start position and heading of a vehicle.
    Start = 1,
    /// Trim error of a vehicle's controller.
    Trim = 2,
    /// Gusts at a vehicle.
    Wind = 3,
    /// Retry times of cut links.
    Network = 4,
    /// The seed passed to a law.
    Law = 5,
    /// Errors of a vehicle's measured position.
    PositionSensor = 7,
    /// Errors of a vehicle's measured velocity.
    VelocitySensor = 8,
    /// Errors of a vehicle's measured attitude.
    AttitudeSensor = 9,
    /// Errors of a vehicle's measured body rates.
    RateSensor = 10,
    /// Dropouts of a vehicle's measurements.
    SensorDropout = 11,
    /// Frame lengths and lost datagrams of a stand-in for X-Plane.
    Simulator = 13,
    /// Impairments of messages in the network.
    Message = 14,
    /// Choices across many runs: the points a sweep samples, the runs a bootstrap draws.
    Study = 64,
}

/// The stream of this vehicle (`None`: the whole swarm) for this purpose.
pub fn generator(seed: u64, vehicle: Option<VehicleId>, purpose: Purpose) -> ChaCha8Rng {
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    // Ids begin at one, so zero is the swarm.
    let vehicle = vehicle.map_or(0, VehicleId::get);
    generator.set_stream(u64::from(vehicle) << 32 | purpose as u64);
    generator
}

/// The stream of the numbers that decide the same (`draw`) of all messages of this incarnation of a sender, whose number is
/// below 2²¹. `of_seed` is a generator with the key of the seed that has given no number yet.
pub fn network_generator(of_seed: &ChaCha8Rng, sender: u32, draw: u8, incarnation: Incarnation) -> ChaCha8Rng {
    let mut generator = of_seed.clone();
    let sent_by = u64::from(sender) << 16 | incarnation.0 << 37;
    generator.set_stream(sent_by | u64::from(draw) << 8 | Purpose::Message as u64);
    generator
}

/// A number evenly distributed in [0, 1), in steps of 2⁻⁵³.
#[inline]
pub fn uniform(rng: &mut impl Rng) -> f64 {
    (rng.next_u64() >> 11) as f64 * (1.0 / (1_u64 << 53) as f64)
}

/// A 32-bit number as a share, exactly, in steps of 2⁻³².
#[inline]
pub(crate) fn share(number: u32) -> f64 {
    f64::from(number) * (1.0 / 4_294_967_296.0)
}

/// A normally distributed number with mean 0 and variance 1, by Box and Muller (1958). Always finite: the logarithm's
/// argument is at least 2⁻⁵³, so its magnitude is at most 8.6.
#[inline]
pub fn standard_normal(rng: &mut impl Rng) -> f64 {
    let radius = (-2.0 * math::ln(1.0 - uniform(rng))).sqrt();
    radius * math::cos(TAU * uniform(rng))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn first_draw(seed: u64, vehicle: Option<u8>, purpose: Purpose) -> u64 {
        let vehicle = vehicle.map(|number| VehicleId::new(number).unwrap());
        generator(seed, vehicle, purpose).next_u64()
    }

    #[test]
    fn every_seed_vehicle_and_purpose_has_its_own_stream() {
        let mut draws = Vec::new();
        for seed in [0, 1, u64::MAX] {
            for vehicle in [None, Some(1), Some(2), Some(250)] {
                let sensors = [Purpose::PositionSensor, Purpose::VelocitySensor, Purpose::AttitudeSensor];
                let more = [Purpose::RateSensor, Purpose::SensorDropout];
                let others = [Purpose::Start, Purpose::Trim, Purpose::Wind, Purpose::Network, Purpose::Law];
                for purpose in others.into_iter().chain(sensors).chain(more) {
                    draws.push(first_draw(seed, vehicle, purpose));
                    assert_eq!(draws.last(), Some(&first_draw(seed, vehicle, purpose)));
                }
            }
        }
        // Messages additionally have a sender and an incarnation.
        for (sender, draw, incarnation) in
            [(0, 0, 1), (1, 0, 1), (1, 0, 2), (1, 1, 1), (2, 0, 1), ((1 << 21) - 1, 255, 1)]
        {
            draws.push(
                network_generator(&ChaCha8Rng::seed_from_u64(1), sender, draw, Incarnation(incarnation)).next_u64(),
            );
        }
        let count = draws.len();
        draws.sort_unstable();
        draws.dedup();
        assert_eq!(draws.len(), count);
    }

    #[test]
    fn the_streams_never_change_between_releases() {
        let draws = [(0, None, Purpose::Start), (1, Some(1), Purpose::Wind), (42, Some(250), Purpose::Law)]
            .map(|(seed, vehicle, purpose)| first_draw(seed, vehicle, purpose));
        assert_eq!(
            draws,
            [0xc16a7b0fc8d48f13, 0x2fef08f619f4d0af, 0xb5f24be049e28e34],
            "recorded seeds would give other flights"
        );
    }

    #[test]
    fn normal_draws_have_the_moments_of_the_normal_distribution() {
        let mut rng = generator(7, None, Purpose::Wind);
        let n = 200_000;
        let draws: Vec<f64> = (0..n).map(|_| standard_normal(&mut rng)).collect();
        let moment =
            |power: i32| draws.iter().map(|x| (0..power).map(|_| x).product::<f64>()).sum::<f64>() / f64::from(n);
        // Four standard errors of each moment: sqrt(1, 2, 15, 96) / sqrt(n).
        for (power, expected, error) in [(1, 0.0, 0.009), (2, 1.0, 0.013), (3, 0.0, 0.035), (4, 3.0, 0.088)] {
            assert!((moment(power) - expected).abs() < error, "moment {power}: {}", moment(power));
        }
        let beyond_two = draws.iter().filter(|x| x.abs() > 2.0).count() as f64 / f64::from(n);
        assert!((beyond_two - 0.0455).abs() < 0.002, "{beyond_two}");
    }

    /// A generator that always returns the same number.
    struct Stuck(u64);

    impl rand::TryRng for Stuck {
        type Error = core::convert::Infallible;
        fn try_next_u32(&mut self) -> Result<u32, Self::Error> {
            Ok(self.0 as u32)
        }
        fn try_next_u64(&mut self) -> Result<u64, Self::Error> {
            Ok(self.0)
        }
        fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> Result<(), Self::Error> {
            bytes.fill(self.0 as u8);
            Ok(())
        }
    }

    #[test]
    fn normal_draws_are_finite_at_both_ends_of_the_generator() {
        for bits in [0, 1, 1 << 11, u64::MAX - 1, u64::MAX] {
            assert!(standard_normal(&mut Stuck(bits)).is_finite(), "{bits}");
        }
    }

    proptest! {
        #[test]
        fn uniform_draws_stay_below_one(bits: u64) {
            let draw = uniform(&mut Stuck(bits));
            prop_assert!((0.0..1.0).contains(&draw));
        }
    }
}
