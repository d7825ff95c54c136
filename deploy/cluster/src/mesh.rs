//! A live swarm as programs beside it know it: where it is reached, what its vehicles send, orders to them, and waiting until
//! they are ready or have left.

pub mod observe;
pub mod order;
pub mod reach;
pub mod ready;
