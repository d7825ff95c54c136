//! The vehicles of a swarm as senders.

use alloc::vec::Vec;

use skein_common::frame::PositionNed;
use skein_common::id::{VehicleId, VehicleSet};
use skein_common::scenario::Quality;
use skein_common::time::LocalTime;

use super::super::channel::Channel;

/// A vehicle as a sender.
#[derive(Clone, Debug, Default)]
pub(super) struct SwarmSender {
    /// Its position as last reported, and the time of that report, for the receivers of which it is known.
    pub(super) place: Option<(PositionNed, LocalTime)>,
    pub(super) placed: VehicleSet,
    /// The receivers to which its links have settings of their own.
    pub(super) particular: Vec<(VehicleId, Quality)>,
    pub(super) with_particular: VehicleSet,
    /// The receivers to which events ever cut or delay its messages.
    pub(super) with_events: VehicleSet,
    /// The state of the links to all receivers; empty if they have none.
    pub(super) channels: Vec<Channel>,
}
