//! What an agent reports of its last step: the trace for metrics and recordings, the summary for displays.

use skein_common::id::VehicleId;
use skein_common::message::{Header, PeerAge, PeerContact, Summary, Trace};
use skein_common::time::Now;

use super::{Agent, LastStep};
use crate::peers::PeerEstimate;
use crate::plant::{Command, GroundTruth};
use crate::setpoint::Setpoint;

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
        let peers = peers.collect();
        let LastStep { membership, activity, estimate, output, command, .. } = &self.last;
        let output = output.as_ref();
        let setpoint: Option<&Setpoint> = output.map(|output| &output.setpoint);
        Trace {
            header: self.schedule.header_of_trace(now.local),
            plant_time: now.plant,
            membership: *membership,
            activity: *activity,
            live: self.live(),
            step: self.mission.at(),
            reached: self.mission.reached(),
            in_place_s: self.in_place_s(),
            settings: self.settings().to_vec(),
            centre_ne_m: self.centre_ne_m().into(),
            estimate: estimate.map(|estimate| estimate.position).unwrap_or_default(),
            position: truth.position,
            height_m: truth.height_m,
            velocity: truth.velocity,
            attitude: truth.attitude,
            power_w: truth.power_w,
            field_ne: output.map(|output| output.field_ne.into()).unwrap_or_default(),
            error_ne_m: setpoint.map(|setpoint| setpoint.error_ne_m().into()).unwrap_or_default(),
            altitude_setpoint_m: setpoint.map(|setpoint| setpoint.altitude_m).unwrap_or_default(),
            controls: controls(*command),
            peers,
            step_us: None,
            safety_activations: self.formation.safety_activations(),
            law_misses: self.law_misses(),
            fallback_flies: self.fallback_flies(),
            law_log: self.formation.law_log().to_vec(),
            frame_overruns: 0,
            state_messages: self.schedule.state_messages(),
            state_bytes: self.schedule.state_bytes(),
        }
    }

    /// What the vehicle believes after this step, for displays. The caller fills in what only real time has: the time flown,
    /// the power that the plant reports and the energy left, the timing and the count of dropped messages.
    pub fn summary(&self, header: Header, now: Now) -> Summary {
        let LastStep { membership, activity, estimate, output, command, .. } = &self.last;
        let setpoint = output.as_ref().map(|output| &output.setpoint);
        Summary {
            header,
            plant_time: now.plant,
            flown_s: None,
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
            power_w: None,
            energy_left: None,
            frame_rate_hz: 0.0,
            jitter_ms: 0.0,
            step_p99_us: 0.0,
            frame_overruns: 0,
            dropped: 0,
            unsent: 0,
            failures: self.failures(),
            peers: self.peers.estimates().map(|peer| PeerContact::new(peer.id, peer.age_s, peer.standing)).collect(),
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
