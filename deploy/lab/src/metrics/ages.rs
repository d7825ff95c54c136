//! Samples the ages of peers' states.

use skein_common::id::{VehicleId, VehicleSet};

/// Chooses the peers of which ages are sampled: four at most at each step, one in a swarm of more than 28, each of them again
/// after a number of steps that is a prime. Two states of a vehicle are ten steps apart or another number that the prime does not divide, so that all
/// ages occur in turn.
#[derive(Clone, Debug)]
pub(super) struct AgeSampling {
    groups: Vec<VehicleSet>,
    now: usize,
}

/// Numbers of steps between two samples of one peer's age, all primes: the first for swarms of up to
/// [`LARGEST_SMALL_SWARM`], the least that is not below the number of vehicles for larger ones.
const SAMPLING_STEPS: [usize; 8] = [7, 29, 43, 61, 89, 127, 179, 251];
const LARGEST_SMALL_SWARM: usize = 28;

impl AgeSampling {
    pub(super) fn new(vehicles: usize) -> Self {
        let is_enough = |steps: &usize| *steps >= vehicles || vehicles <= LARGEST_SMALL_SWARM;
        let steps = SAMPLING_STEPS.into_iter().find(is_enough).unwrap_or(SAMPLING_STEPS[SAMPLING_STEPS.len() - 1]);
        let group = |nth| VehicleId::first(vehicles).skip(nth).step_by(steps).collect();
        Self { groups: (0..steps).map(group).collect(), now: 0 }
    }

    /// The peers of which the age is sampled at this step.
    pub(super) fn now(&self) -> VehicleSet {
        self.groups[self.now]
    }

    pub(super) fn next_step(&mut self) {
        self.now = (self.now + 1) % self.groups.len();
    }
}
