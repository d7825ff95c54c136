//! What the tests of several modules build: ids, headers, heartbeats.

use skein_common::id::{Incarnation, VehicleId};
use skein_common::message::{Header, Heartbeat};
use skein_common::state::Membership;
use skein_common::time::SenderStamp;

/// The vehicle of this number.
pub(crate) fn id(number: u8) -> VehicleId {
    VehicleId::new(number).unwrap()
}

/// Of a message that `sender` sent in its first life, when its clock showed 0.
pub(crate) fn header(sender: u8, sequence: u64) -> Header {
    Header { sender: id(sender), incarnation: Incarnation(1), sequence, stamp: SenderStamp::ZERO }
}

/// The heartbeat of an active member of plan 1 that is at the first step, has not reached it and knows no order.
pub(crate) fn heartbeat(header: Header) -> Heartbeat {
    let (membership, step) = (Membership::Active, 0);
    Heartbeat { header, plan: 1, membership, step, vouched: 0, reached: None, progress_m: 0.0, order: None, echo: None }
}
