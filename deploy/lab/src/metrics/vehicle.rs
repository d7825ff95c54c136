//! The state of a vehicle at one instant, from which the figures are computed.

use nalgebra::Vector2;
use skein_common::id::{VehicleId, VehicleSet};
use skein_common::state::Membership;
use skein_core::plant::{Controls, GroundTruth};

/// One vehicle at one instant.
#[derive(Clone, Copy, Debug)]
pub struct VehicleNow {
    /// The vehicle.
    pub id: VehicleId,
    /// Whether its agent runs. If not, only `truth` is meaningful.
    pub runs: bool,
    /// Membership in the swarm.
    pub membership: Membership,
    /// Ground truth of the vehicle.
    pub truth: GroundTruth,
    /// Controls of the vehicle; `None` if no agent holds them.
    pub controls: Option<Controls>,
    /// The mission step of the vehicle, counted from 0.
    pub step: u32,
    /// The highest step that the vehicle reached since its agent started.
    pub reached: Option<u32>,
    /// The vehicle's own estimate of the formation's centre, north and east, m.
    pub centre_ne_m: Vector2<f64>,
    /// Peers that the vehicle does not count as lost.
    pub in_contact: VehicleSet,
    /// Peers whose newest state arrived less than 0.5 s ago, however long it was in flight. Only some observations look at
    /// it ([`Metrics::observes_formation`](super::Metrics::observes_formation)).
    pub fresh: VehicleSet,
    /// Whether the fallback flies in the place of an external law; `None` where it flies by no external law.
    pub fallback_flies: Option<bool>,
}

impl VehicleNow {
    /// A vehicle without a running agent: other vehicles only have to avoid it.
    pub fn dead(id: VehicleId, truth: GroundTruth) -> Self {
        Self {
            id,
            runs: false,
            membership: Membership::Joining,
            truth,
            controls: None,
            step: 0,
            reached: None,
            centre_ne_m: Vector2::zeros(),
            in_contact: VehicleSet::default(),
            fresh: VehicleSet::default(),
            fallback_flies: None,
        }
    }

    /// Whether the vehicle is a live member: an active member whose agent runs.
    pub fn is_live_member(&self) -> bool {
        self.runs && self.membership == Membership::Active
    }
}

/// The facts of a vehicle that change only now and then.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Standing {
    id: VehicleId,
    is_live_member: bool,
    runs: bool,
    step: u32,
    reached: Option<u32>,
    in_contact: VehicleSet,
}

impl Standing {
    pub(super) fn of(vehicle: &VehicleNow) -> Self {
        let VehicleNow { id, runs, step, reached, in_contact, .. } = *vehicle;
        Self { id, is_live_member: vehicle.is_live_member(), runs, step, reached, in_contact }
    }
}
