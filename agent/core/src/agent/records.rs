//! What an agent reports of its last step: the trace for metrics and recordings, the summary for displays.

use skein_common::id::VehicleId;
use skein_common::message::{PeerAge, PeerContact, Trace, VehicleFacts};
use skein_common::time::Now;

use super::{Agent, LastStep};
use crate::peers::PeerEstimate;
use crate::plant::{Command, GroundTruth};

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
            law_log: self.formation.law_log().to_vec(),
            state_messages: self.schedule.state_messages(),
            state_bytes: self.schedule.state_bytes(),
            ..Trace::new(self.schedule.header_of_trace(now.local), now.plant, self.own_facts())
        }
    }

    /// What the vehicle believes after this step, for displays. The caller fills in what only real time has: the time flown,
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
            live: self.live(),
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

    /// Number of live members that the agent counts, itself included.
    fn live(&self) -> u8 {
        self.formation.live().min(usize::from(VehicleId::MAX)) as u8
    }
}

fn controls(command: Option<Command>) -> Option<[f64; 4]> {
    let controls = command.and_then(Command::controls)?;
    Some([controls.roll, controls.pitch, controls.yaw, controls.collective])
}
