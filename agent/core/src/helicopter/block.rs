//! Eight vehicles stepped together, for studies: the same equations and the same bits as alone, in vector instructions.

use alloc::sync::Arc;

use super::dynamics::{Dynamics, ServoCommand, State};
use super::integration::Stages;
use super::vector::Vector;
use super::{BuiltInVehicle, Helicopter};
use crate::lanes::{LANES, Lanes, SetLane};
use crate::plant::Controls;

/// Room for eight vehicles side by side. A block has no vehicles of its own: each tick it is lent up to eight, and it
/// keeps only their constants, for the next tick.
///
/// How fast [`Block::compute`] is depends on the processor features for which its caller is compiled; its results do
/// not. A vehicle's state does not depend on its neighbours in the block.
#[derive(Debug, Default)]
pub struct Block {
    /// The vehicles' constants as they are in `dynamics`.
    known: [Option<Arc<Dynamics>>; LANES],
    dynamics: Dynamics<Lanes>,
    state: State<Lanes>,
    command: ServoCommand<Lanes>,
    wind: Vector<Lanes>,
    /// Room to work in.
    stages: Stages<Lanes>,
}

impl Block {
    /// Number of vehicles in a full block.
    pub const SIZE: usize = LANES;

    /// Advances the next vehicles by one tick, as [`BuiltInVehicle::advance`] does: up to [`Self::SIZE`] of them, each
    /// with its new controls. `compute` calls [`Self::compute`].
    pub fn advance<'a>(
        &mut self,
        vehicles: impl Iterator<Item = (&'a mut BuiltInVehicle, Option<Controls>)>,
        compute: impl FnOnce(&mut Self),
    ) {
        let mut flying: [Option<&mut Helicopter>; LANES] = [const { None }; LANES];
        for (lane, (vehicle, controls)) in vehicles.take(LANES).enumerate() {
            if self.load(lane, vehicle, controls) {
                flying[lane] = Some(&mut vehicle.helicopter);
            }
        }
        let Some(first) = flying.iter().position(Option::is_some) else { return };
        for lane in (0..LANES).filter(|lane| flying[*lane].is_none()) {
            self.idle(lane, first);
        }
        compute(self);
        for (lane, helicopter) in flying.into_iter().enumerate() {
            let Some(helicopter) = helicopter else { continue };
            for (own, lanes) in helicopter.state.0.iter_mut().zip(&self.state.0) {
                *own = lanes.0[lane];
            }
        }
    }

    /// Computes one tick of every lane.
    #[inline(always)]
    pub fn compute(&mut self) {
        self.state = self.dynamics.tick(&self.state, &self.command, self.wind, &mut self.stages);
    }

    /// Begins a vehicle's tick and, if it flies, sets a lane to it.
    fn load(&mut self, lane: usize, vehicle: &mut BuiltInVehicle, controls: Option<Controls>) -> bool {
        let Some((controls, wind)) = vehicle.begin_tick(controls) else { return false };
        let helicopter = &vehicle.helicopter;
        if !self.known[lane].as_ref().is_some_and(|known| Arc::ptr_eq(known, &helicopter.dynamics)) {
            self.dynamics.set_lane(lane, &helicopter.dynamics);
            self.known[lane] = Some(Arc::clone(&helicopter.dynamics));
        }
        self.state.0.set_lane(lane, &helicopter.state.0);
        self.command.set_lane(lane, &helicopter.controls.command(&controls));
        self.wind.set_lane(lane, &wind.0.into());
        true
    }

    /// Sets a lane without a vehicle to the state of another lane: a state left behind on the ground would cost all
    /// lanes the equations of the ground.
    fn idle(&mut self, lane: usize, other: usize) {
        for lanes in &mut self.state.0 {
            lanes.0[lane] = lanes.0[other];
        }
    }
}

#[cfg(test)]
mod tests;
