//! The virtual structure: every vehicle has a slot of its own and flies there.
//!
//! After M. A. Lewis & K.-H. Tan, "High Precision Formation Control of Mobile Robots Using Virtual Structures", Autonomous
//! Robots 4 (1997), in its simplest form: nobody forms the structure by consensus, because slots follow from the centre and
//! the ranks among the live ids, which all agree on as soon as they hear the same vehicles. While they do not, two may fly
//! to one slot, and the safety filter keeps them apart. It is what even spacing can be at best.

use alloc::boxed::Box;
use alloc::string::String;

use super::law::{Answer, Law, Setup, Sight, Wanted};
use super::slots::{Slots, is_in_slot};

/// The slot of the own rank.
#[derive(Clone, Debug, PartialEq)]
struct VirtualStructure(Slots);

/// The law of a scenario.
pub(super) fn make(setup: &Setup<'_>) -> Result<Box<dyn Law>, String> {
    Ok(Box::new(VirtualStructure(Slots::of(setup.formation))))
}

impl Law for VirtualStructure {
    /// v = 0.5 (slot − p) + the centre's velocity; the vehicle controller asks for half its error, plus that.
    fn ask(&mut self, sight: &Sight<'_>) -> Answer {
        let Self(slots) = self;
        let slot_ne_m = slots.slot_ne_m(sight.rank(), sight.live());
        let way_ne_m = sight.goal.centre.horizontal() + slot_ne_m - sight.position.horizontal();
        Answer { wanted: Wanted::Way(way_ne_m), is_there: is_in_slot(way_ne_m.norm()) && sight.is_slow() }
    }
}
