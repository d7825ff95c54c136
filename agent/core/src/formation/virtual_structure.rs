//! The virtual structure: every vehicle has its own slot and flies to it.
//!
//! After M. A. Lewis & K.-H. Tan, "High Precision Formation Control of Mobile Robots Using Virtual Structures",
//! Autonomous Robots 4 (1997), in its simplest form: the structure is not formed by consensus, because slots follow
//! from the centre and the ranks among the live ids, which all vehicles agree on as soon as they receive the same
//! vehicles. Until then two may fly to one slot, and the safety filter keeps them apart. It is the best possible even
//! spacing.

use alloc::boxed::Box;
use alloc::string::String;

use super::law::{Law, LawCommand, LawOutput, Observation, Setup};
use super::slots::{Slots, is_in_slot};

/// The law: flies to the slot of the own rank.
#[derive(Clone, Debug, PartialEq)]
struct VirtualStructure(Slots);

/// Builds the law for a scenario.
pub(super) fn make(setup: &Setup<'_>) -> Result<Box<dyn Law>, String> {
    Ok(Box::new(VirtualStructure(Slots::of(setup.formation))))
}

impl Law for VirtualStructure {
    /// Command v = 0.5 (slot − p) + the centre's velocity: the vehicle controller flies half the displacement plus
    /// that.
    fn update(&mut self, observation: &Observation<'_>) -> LawOutput {
        let Self(slots) = self;
        let slot_ne_m = slots.slot_ne_m(observation.rank(), observation.live());
        let displacement_ne_m = observation.goal.centre.horizontal() + slot_ne_m - observation.position.horizontal();
        LawOutput {
            command: LawCommand::Displacement(displacement_ne_m),
            reached: is_in_slot(displacement_ne_m.norm()) && observation.is_slow(),
        }
    }

    /// The law uses the members' ids only.
    fn reach_m(&self, _: usize) -> f64 {
        0.0
    }
}
