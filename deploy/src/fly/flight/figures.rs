//! The figures of a flight: how they are measured and written.

use std::time::Instant;

use skein_common::id::{FleetVehicle, VehicleId};
use skein_common::message::Trace;
use skein_common::state::PeerStatus;
use skein_core::peers::FRESH_S;
use skein_core::plant::{Controls, GroundTruth};

use super::{Flight, fresh};
use crate::fly::plan::Plan;
use skein_cluster::display::status::Stage;
use skein_cluster::mesh::observe::VehicleView;
use skein_lab::faults::InjectedFault;
use skein_lab::metrics::{Report, Totals, VehicleNow, VehicleTraffic, Wall};
use skein_lab::scenario::quoted;
use skein_lab::terminal::what_next;

impl Flight {
    /// Updates the figures that depend on a single step.
    pub(super) fn take_step(&mut self, now: Instant, step: &Trace) {
        if let Some(restarted) = self.ground.received(now, step) {
            self.fault(now, &restarted);
        }
        if self.stage == Stage::Flying {
            let received = step.peers.iter().filter(|peer| peer.standing != PeerStatus::Lost);
            received.for_each(|peer| self.metrics.observe_age(peer.age_s));
            step.step_us.into_iter().for_each(|step_us| self.metrics.observe_step(step_us));
        }
    }

    /// Passes the newest step of every running agent to the metrics. The position of a dead agent's helicopter is unknown.
    pub(super) fn measure(&mut self, now: Instant) {
        let t_s = self.flown_s(now);
        self.ground.due(now).iter().for_each(|fault| self.fault(now, fault));
        let steps: Vec<&Trace> = self.steps(now).collect();
        let vehicles: Vec<VehicleNow> = steps.iter().copied().map(vehicle_now).collect();
        let settings: Vec<_> = steps.iter().map(|step| (step.header.sender, step.settings.clone())).collect();
        settings.iter().for_each(|(id, settings)| self.metrics.set_values(*id, settings));
        self.metrics.observe(t_s, &vehicles);
        let steps = self.observer.vehicles().values().filter_map(|seen| seen.trace.as_ref());
        let living = steps.filter(|step| self.ground.lives(step));
        self.metrics.set_totals(living.fold(self.ended, with_counts));
    }

    /// Something was done to the swarm.
    fn fault(&mut self, now: Instant, fault: &InjectedFault) {
        self.metrics.fault(self.flown_s(now), fault);
        self.record_fault(now, fault);
    }

    /// The agent of this vehicle has ended.
    pub(super) fn count_out(&mut self, now: Instant, id: VehicleId) {
        let step = self.observer.vehicles().get(&id).and_then(|seen| seen.trace.as_ref());
        if let Some(last) = step.filter(|step| self.ground.lives(step)) {
            self.ended = with_counts(self.ended, last);
        }
        let died = self.ground.ended(id, step.map(|step| step.header.incarnation));
        self.fault(now, &died);
    }

    /// It has a new one, whose simulator's clock may begin anew.
    pub(super) fn count_in(&mut self, now: Instant, id: VehicleId) {
        let restarted = self.ground.restarted(id);
        self.fault(now, &restarted);
        if let Some(zero) = &mut self.zero {
            zero.plant_s.remove(&id);
        }
    }

    /// Closes the window and writes its figures: whatever comes later, they are there.
    pub(super) fn end_window(&mut self, now: Instant) {
        let wall_s = self.since_zero_s(now);
        self.record(|recorder| recorder.window_ends(now));
        let report = self.metrics.report(Wall { wall_s, real_time_factor: self.simulated_s(now) / wall_s.max(1e-9) });
        let path = self.plan.out.join("metrics.json");
        // A recording may have filled the disk.
        self.room = None;
        if let Err(error) = skein_lab::out::write(&path, skein_lab::terminal::json(&report)) {
            self.fail(error.to_string());
        }
        self.report = Some(report);
        self.traffic = self.received_per_vehicle();
    }

    /// The messages that each vehicle of a team has received so far, by the report of its agent.
    fn received_per_vehicle(&self) -> Vec<VehicleTraffic> {
        let Some(team) = self.plan.scenario().team else { return Vec::new() };
        let row = |(vehicle, seen): (&VehicleId, &VehicleView)| {
            let health = seen.health.as_ref()?;
            let per_s = |count: u64| count as f64 / health.uptime_s.max(1e-9);
            Some(VehicleTraffic {
                vehicle: FleetVehicle { team: team.id, vehicle: *vehicle }.to_string(),
                counted_s: health.uptime_s,
                links: Some(health.links),
                messages_per_s: per_s(health.received.messages),
                bytes_per_s: per_s(health.received.bytes),
                others_messages_per_s: None,
                others_bytes_per_s: None,
            })
        };
        self.observer.vehicles().iter().filter_map(row).collect()
    }

    /// Time on the clocks of live vehicles' simulators, s.
    pub(super) fn plant_s(&self, now: Instant) -> impl Iterator<Item = (VehicleId, f64)> {
        self.live().filter_map(move |(id, seen)| Some((id, fresh(seen?, now)?.plant_time.seconds())))
    }

    /// The time by which the simulators' clocks have moved since the window began, on average, s.
    fn simulated_s(&self, now: Instant) -> f64 {
        let since = |(id, plant_s)| Some(plant_s - self.zero.as_ref()?.plant_s.get(&id)?);
        let moved: Vec<f64> = self.plant_s(now).filter_map(since).collect();
        moved.iter().sum::<f64>() / moved.len().max(1) as f64
    }
}

/// Adds the counts of the agent that published this step to the earlier ones.
fn with_counts(before: Totals, step: &Trace) -> Totals {
    let activations = step.safety_activations.map(|more| more + before.safety_activations.unwrap_or(0));
    let misses = step.law_misses.map(|more| more + before.law_misses.unwrap_or(0));
    Totals {
        state_messages: before.state_messages + step.state_messages,
        state_bytes: before.state_bytes + step.state_bytes,
        safety_activations: activations.or(before.safety_activations),
        law_misses: misses.or(before.law_misses),
        frame_overruns: before.frame_overruns + step.frame_overruns,
    }
}

fn vehicle_now(step: &Trace) -> VehicleNow {
    let truth = GroundTruth {
        position: step.position,
        height_m: step.height_m,
        velocity: step.velocity,
        attitude: step.attitude,
        power_w: step.power_w,
    };
    let peers = || step.peers.iter().filter(|peer| peer.standing != PeerStatus::Lost);
    VehicleNow {
        runs: true,
        membership: step.membership,
        controls: step.controls.map(|[roll, pitch, yaw, collective]| Controls { roll, pitch, yaw, collective }),
        step: step.step,
        reached: step.reached,
        centre_ne_m: step.centre_ne_m.into(),
        in_contact: peers().map(|peer| peer.id).collect(),
        fallback_flies: step.fallback_flies,
        fresh: peers().filter(|peer| peer.silent_s() < FRESH_S).map(|peer| peer.id).collect(),
        ..VehicleNow::dead(step.header.sender, truth)
    }
}

/// The figures that a reader looks for first, and what to do next.
pub(super) fn summary(report: &Report, plan: &Plan) -> String {
    let figure = |value: Option<f64>, unit: &str| value.map_or_else(|| "-".to_owned(), |v| format!("{v:.2} {unit}"));
    let lines = [
        ("flown", figure(Some(report.duration_s), "s")),
        ("at altitude", figure(report.at_altitude_s, "s")),
        ("in the band", figure(report.in_band_s, "s")),
        ("even within 10°", figure(report.even_10deg_s, "s")),
        ("radial rms", figure(report.radial_rms_m, "m")),
        ("least separation", figure(report.min_separation_m, "m")),
        ("collisions", report.collisions.to_string()),
        ("crashes", report.crashes.to_string()),
        ("peer age p99", figure(report.peer_age_p99_ms, "ms")),
        ("step p50, p99", format!("{}, {}", figure(report.step_p50_us, "µs"), figure(report.step_p99_us, "µs"))),
        ("late frames", report.frame_overruns.map_or_else(|| "-".to_owned(), |late| late.to_string())),
    ];
    let share = report.fallback_share.map(|share| format!(", the fallback flew {:.0} % of the time", 100.0 * share));
    let of_law = report.law_misses.map(|misses| ("law misses", format!("{misses}{}", share.unwrap_or_default())));
    let files = ("files", plan.out.display().to_string());
    let lines = lines.into_iter().chain(of_law).chain([files]);
    let figures: String = lines.map(|(name, value)| format!("{name:<18}{value}\n")).collect();
    let next = [
        (format!("skein report {}", quoted(&plan.out.display().to_string())), "pictures and tables of this flight"),
        (plan.again.clone(), "the same flight again"),
        (plan.study.clone(), "many seeds of it in virtual time"),
    ];
    figures + "\n" + &what_next(&next)
}
