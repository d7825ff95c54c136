//! Displacement consensus: every vehicle keeps the commanded displacement to each neighbour whose states it receives.
//!
//! W. Ren & R. W. Beard, "Distributed Consensus in Multi-vehicle Cooperative Control" (Springer, 2008), for single
//! integrators; in the notation of K.-K. Oh, M.-C. Park & H.-S. Ahn, "A survey of multi-agent formation control",
//! Automatica 53 (2015), section 4, displacement-based control. With position x_i, slot s_i and centre c,
//!
//! v_i = ċ − k Σ_j ((x_i − s_i) − (x_j − s_j)) − k_g (x_i − s_i − c)      over the received neighbours j.
//!
//! The last term is ours and ties the formation to the centre. Without it the displacements converge as exp(−k λ₂ t),
//! where λ₂ is the algebraic connectivity of the communication graph, and the mean position of the formation stays
//! constant.
//!
//! Slots belong to ids, not to ranks: vehicles that receive only some of the others would not agree on ranks. A lost
//! vehicle leaves a gap.

use alloc::boxed::Box;
use alloc::string::String;
use alloc::vec::Vec;

use nalgebra::Vector2;
use skein_common::id::VehicleId;

use super::law::{Law, LawCommand, LawOutput, Observation, Setup};
use super::slots::{Slots, is_in_slot};

/// The law's gains and slots.
#[derive(Clone, Debug, PartialEq)]
struct DisplacementConsensus {
    /// Slots by id, relative to the centre, north and east, m.
    slots_ne_m: Vec<Vector2<f64>>,
    gain_per_s: f64,
    goal_gain_per_s: f64,
}

/// Builds the law for a scenario.
pub(super) fn make(setup: &Setup<'_>) -> Result<Box<dyn Law>, String> {
    let gains = &setup.formation.displacement_consensus;
    let slots = Slots::of(setup.formation);
    Ok(Box::new(DisplacementConsensus {
        slots_ne_m: (0..setup.vehicles).map(|nth| slots.slot_ne_m(nth, setup.vehicles)).collect(),
        gain_per_s: gains.gain_per_s,
        goal_gain_per_s: gains.goal_gain_per_s,
    }))
}

impl DisplacementConsensus {
    fn slot_ne_m(&self, id: VehicleId) -> Vector2<f64> {
        self.slots_ne_m.get(usize::from(id.get()) - 1).copied().unwrap_or_default()
    }
}

impl Law for DisplacementConsensus {
    fn update(&mut self, observation: &Observation<'_>) -> LawOutput {
        let own_ne_m = observation.position.horizontal() - self.slot_ne_m(observation.own);
        let apart_m = |id, place: Vector2<f64>| own_ne_m - (place - self.slot_ne_m(id));
        let received =
            observation.neighbours.iter().map(|neighbour| apart_m(neighbour.id, neighbour.position.horizontal()));
        let (sum_m, worst_m) = received
            .fold((Vector2::zeros(), 0.0_f64), |(sum, worst), apart_m| (sum + apart_m, worst.max(apart_m.norm())));
        let from_goal_m = own_ne_m - observation.goal.centre.horizontal();
        let command = observation.goal.centre_velocity.horizontal()
            - sum_m * self.gain_per_s
            - from_goal_m * self.goal_gain_per_s;
        // Distance from the own slot; without a goal gain, the largest displacement error to a received neighbour.
        let off_m = if self.goal_gain_per_s > 0.0 { from_goal_m.norm() } else { worst_m };
        LawOutput { command: LawCommand::level(command), reached: is_in_slot(off_m) && observation.is_slow() }
    }
}

#[cfg(test)]
mod tests;
