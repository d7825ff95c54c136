//! The records of an agent's last step: the trace for metrics and recordings, the summary for displays, and the events of what
//! has changed.

use alloc::vec::Vec;

use skein_common::id::VehicleId;
use skein_common::message::{EventKind, PeerAge, PeerContact, SimulatorFault, Standstill, Trace, VehicleFacts};
use skein_common::state::{Activity, Membership};
use skein_common::time::{Now, PlantTime};

use super::{Agent, OwnEstimate};
use crate::estimate::Estimate;
use crate::failsafe::{Condition, Conditions};
use crate::formation::FormationOutput;
use crate::formation::external::External;
use crate::peers::PeerEstimate;
use crate::plant::{Command, GroundTruth, PlantStatus};

/// Results of the last step: the only path from a later stage to an earlier one.
#[derive(Clone, Debug, Default)]
pub(super) struct LastStep {
    /// The missing data or peers as last reported.
    pub(super) missing: Option<Condition>,
    pub(super) standstill: Option<Standstill>,
    pub(super) simulator_faults: Vec<SimulatorFault>,
    pub(super) membership: Membership,
    pub(super) activity: Activity,
    pub(super) is_released: bool,
    pub(super) plant_time: Option<PlantTime>,
    pub(super) estimate: Option<Estimate>,
    pub(super) output: Option<FormationOutput>,
    /// Time for which the vehicle has been in formation without interruption, s.
    pub(super) in_place_s: Option<f64>,
    pub(super) command: Option<Command>,
}

impl Agent {
    /// The record of this step for metrics and displays; `truth` is the plant's true state, which the agent itself
    /// never uses.
    pub fn trace(&mut self, now: Now, truth: &GroundTruth) -> Trace {
        let peers = self.peers.estimates().map(|PeerEstimate { id, standing, age_s, delay_s, .. }| PeerAge {
            id,
            standing,
            age_s,
            delay_s,
            delivered_age_s: 0.0,
        });
        Trace {
            position: truth.position,
            height_m: truth.height_m,
            velocity: truth.velocity,
            attitude: truth.attitude,
            power_w: truth.power_w,
            peers: peers.collect(),
            safety_activations: self.formation.safety_activations(),
            law_misses: self.law_misses(),
            fallback_flies: self.fallback_flies(),
            law_log: self.formation.external.as_ref().map_or(&[][..], External::log).to_vec(),
            state_messages: self.schedule.states.messages,
            state_bytes: self.schedule.states.bytes,
            ..Trace::new(self.schedule.header_of_trace(now.local), now.plant, self.own_facts())
        }
    }

    /// The beliefs of the vehicle after this step, for displays. The caller fills in what only real time has: the time flown,
    /// the power that the plant reports and the energy left, and the figures of the process.
    pub fn facts(&self) -> VehicleFacts {
        VehicleFacts {
            failures: self.failures(),
            peers: self.peers.estimates().map(|peer| PeerContact::new(peer.id, peer.age_s, peer.standing)).collect(),
            ..self.own_facts()
        }
    }

    /// The facts that a trace and a summary share.
    fn own_facts(&self) -> VehicleFacts {
        let LastStep { membership, activity, estimate, output, command, .. } = &self.last;
        let setpoint = output.as_ref().map(|output| &output.setpoint);
        VehicleFacts {
            activity: *activity,
            membership: *membership,
            step: self.mission.at(),
            reached: self.mission.reached(),
            in_place_s: self.in_place_s(),
            settings: self.settings().to_vec(),
            live: self.formation.live().min(usize::from(VehicleId::MAX)) as u8,
            position: estimate.map(|estimate| estimate.position),
            velocity: estimate.map(|estimate| estimate.velocity).unwrap_or_default(),
            attitude: estimate.map(|estimate| estimate.attitude).unwrap_or_default(),
            centre_ne_m: self.centre_ne_m().into(),
            altitude_setpoint_m: setpoint.map(|setpoint| setpoint.altitude_m),
            field_ne: output.as_ref().map(|output| output.field_ne.into()),
            error_ne_m: setpoint.map(|setpoint| setpoint.error_ne_m().into()),
            controls: controls(*command),
            ..VehicleFacts::default()
        }
    }

    /// Compares with the last step and reports the changes.
    pub(super) fn report_changes(
        &mut self,
        own: &OwnEstimate,
        status: &PlantStatus,
        conditions: Conditions,
        events: &mut Vec<EventKind>,
    ) {
        const MISSING: [Condition; 4] =
            [Condition::SimulatorStopped, Condition::SimulatorLost, Condition::OwnDataStale, Condition::AllPeersLost];
        const BLIND: [Condition; 3] = [Condition::SimulatorStopped, Condition::SimulatorLost, Condition::OwnDataStale];
        let is_blind = |missing: Option<Condition>| missing.is_some_and(|missing| BLIND.contains(&missing));
        if status.standstill != self.last.standstill {
            events.extend(status.standstill.map(EventKind::SimulatorStopped));
        }
        if status.faults != self.last.simulator_faults {
            let is_new = |fault: &&SimulatorFault| !self.last.simulator_faults.contains(fault);
            events.extend(status.faults.iter().filter(is_new).copied().map(EventKind::SimulatorFault));
            self.last.simulator_faults.clone_from(&status.faults);
        }
        let missing = MISSING.into_iter().find(|&condition| conditions.contains(condition));
        let was_blind = is_blind(self.last.missing);
        if missing != self.last.missing {
            match missing {
                Some(Condition::SimulatorLost) => events.push(EventKind::SimulatorLost),
                Some(Condition::OwnDataStale) => events.push(EventKind::OwnDataStale),
                Some(Condition::AllPeersLost) if !was_blind => events.push(EventKind::AllPeersLost),
                _ if was_blind && self.last.estimate.is_some() => events.push(EventKind::OwnDataBack),
                _ => {}
            }
        }
        let (membership, activity) = (self.mission.membership(), self.mission.activity);
        if membership == Membership::Active && self.last.membership == Membership::Joining {
            events.push(EventKind::BecameActive);
        }
        if activity != self.last.activity {
            match (self.last.activity, activity) {
                (Activity::TakingOff, Activity::Formation) => events.push(EventKind::AtAltitude),
                (_, Activity::Landed) => events.push(EventKind::Landed),
                _ => {}
            }
        }
        let is_released = activity == Activity::Released;
        if is_released != self.last.is_released {
            events.push(if is_released { EventKind::ControlsReleased } else { EventKind::ControlsTakenBack });
        }
        // The estimate of the last step was needed up to here: the first data ever are not reported as back.
        self.last.estimate = own.estimate;
        self.last.missing = missing;
        self.last.standstill = status.standstill;
        self.last.membership = membership;
        self.last.is_released = is_released;
        self.last.activity = if is_blind(missing) && self.last.estimate.is_some() { Activity::Blind } else { activity };
        // A vehicle that does not know where it is does not know that it is in its place.
        self.last.in_place_s = self.last.in_place_s.filter(|_| self.last.activity == Activity::Formation);
    }
}

fn controls(command: Option<Command>) -> Option<[f64; 4]> {
    let controls = command.and_then(Command::controls)?;
    Some([controls.roll, controls.pitch, controls.yaw, controls.collective])
}
