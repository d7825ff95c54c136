//! What the tests of several modules build: ids, headers, heartbeats.

use skein_common::frame::{Geodetic, Origin};
use skein_common::id::{Incarnation, VehicleId, VehicleSet};
use skein_common::message::{Header, Heartbeat, State};
use skein_common::scenario::{PositionSensing, Sensing, SensorErrors, VelocitySensing};
use skein_common::state::Membership;
use skein_common::time::SenderStamp;

use crate::peers::{PeerMessage, PeerProgress, ReceivedState, Report};

/// The vehicle of this number.
pub(crate) fn id(number: u8) -> VehicleId {
    VehicleId::new(number).unwrap()
}

/// Of a message that `sender` sent in its first life, when its clock showed 0.
pub(crate) fn header(sender: u8, sequence: u64) -> Header {
    Header { sender: id(sender), incarnation: Incarnation(1), sequence, stamp: SenderStamp::ZERO }
}

/// A peer's state as this process receives it.
pub(crate) fn received_state(message: State) -> PeerMessage {
    PeerMessage::State(ReceivedState::new(message, &origin()))
}

/// The origin of the shipped scenarios' frame.
pub(crate) fn origin() -> Origin {
    Origin::new(Geodetic::from_degrees(28.0, -82.0, 0.0))
}

/// The part of a heartbeat that the mission uses at every step.
pub(crate) fn progress(heartbeat: &Heartbeat) -> PeerProgress {
    let &Heartbeat { header, membership, step, vouched, reached, progress_m, .. } = heartbeat;
    PeerProgress { id: header.sender, membership, step, vouched, reached, progress_m }
}

/// The part of a heartbeat that the mission uses at its arrival.
pub(crate) fn report(heartbeat: &Heartbeat) -> Report {
    Report { id: heartbeat.header.sender, plan: heartbeat.plan, order: heartbeat.order }
}

/// The heartbeat of an active member of plan 1 that is at the first step, has not reached it and knows no order.
pub(crate) fn heartbeat(header: Header) -> Heartbeat {
    let (membership, step) = (Membership::Active, 0);
    Heartbeat {
        header,
        plan: 1,
        membership,
        step,
        vouched: 0,
        reached: None,
        progress_m: 0.0,
        order: None,
        orders: 0,
        echo: None,
        lost: VehicleSet::default(),
    }
}

/// Sensors with this precision and this source of the velocity, without any other error, latency or dropout.
pub(crate) fn sensing_without_errors(position: PositionSensing, velocity: VelocitySensing) -> Sensing {
    Sensing {
        position,
        velocity,
        differenced_tau_s: 1.0,
        latency_s: 0.0,
        dropout: 0.0,
        dropout_s: None,
        correlation_s: None,
        noise: SensorErrors::default(),
        bias: SensorErrors::default(),
    }
}
