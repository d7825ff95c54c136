//! The flight models of one or more worlds, stepped in blocks of eight with the widest vectors of this processor.

use multiversion::multiversion;
use skein_core::helicopter::{Block, BuiltInVehicle};
use skein_core::plant::Controls;

/// Blocks for the flight models that are stepped together. Which vehicle is in which block, and with which others, does
/// not change its flight.
#[derive(Debug, Default)]
pub struct Blocks(Vec<Block>);

impl Blocks {
    /// Number of vehicles in one block.
    pub const SIZE: usize = Block::SIZE;

    /// Advances each vehicle by one frame with its controls.
    pub fn advance<'a>(&mut self, vehicles: impl Iterator<Item = (&'a mut BuiltInVehicle, Option<Controls>)>) {
        let mut vehicles = vehicles.peekable();
        for nth in 0.. {
            if vehicles.peek().is_none() {
                return;
            }
            if nth == self.0.len() {
                self.0.push(Block::default());
            }
            self.0[nth].advance(&mut vehicles, compute);
        }
    }

    /// Whether blocks for this many vehicles have at most one lane in eight without a vehicle.
    pub fn are_full(vehicles: usize) -> bool {
        let lanes = vehicles.next_multiple_of(Block::SIZE);
        vehicles > 0 && 8 * (lanes - vehicles) <= lanes
    }
}

/// [`Block::compute`] with the widest vectors that this processor has: eight, four or two numbers in one instruction.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn compute(block: &mut Block) {
    block.compute();
}

#[cfg(test)]
mod tests;
