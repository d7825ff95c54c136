//! `skein study`: many flights of one scenario in virtual time.
//!
//! The same agents as in real time, stepped in one thread over a simulated network. Seeds run in parallel; what comes out
//! does not depend on how many at once.

mod command;
mod measured;
pub mod plan;
mod progress;
mod recorded;
mod summary;
pub mod sweep;
mod table;
mod verdict;

use std::num::NonZeroUsize;
use std::ops::Range;

use skein_common::scenario::{Scenario, Target};
use skein_common::state::{Membership, PeerStatus};
use skein_core::aircraft::Aircraft;
use skein_core::control::Rules;
use skein_core::helicopter::TICK_S;
use skein_core::peers::FRESH_S;

use crate::external::{LawError, LawPool};
use crate::metrics::{Metrics, Report, Run, VehicleNow, Wall};
use crate::recording::Watch;
use crate::world::{World, WorldError};
pub use command::{StudyArgs, run};
pub use measured::{Measured, Outcome, is_worse, worst_and_median};
pub use recorded::{RecordRunError, record_run};
use skein_host::clock::now;
use skein_host::parallel::in_parallel;
pub use summary::{FigureSummary, PointSummary, Summary, summarize, summary};
pub use table::rounded;

/// Virtual time after which joining has failed, s.
const JOIN_LIMIT_S: f64 = 60.0;
/// Without a duration in the scenario a study flies this long, s, and a mission that ends may take this long.
const DEFAULT_DURATION_S: f64 = 400.0;
const LONGEST_MISSION_S: f64 = 3600.0;

/// Why a study cannot be run.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// The scenario cannot be flown in virtual time.
    #[error(transparent)]
    World(#[from] WorldError),
    /// An external law.
    #[error(transparent)]
    Law(#[from] LawError),
    /// Some vehicles did not become active.
    #[error("not all vehicles are active after {JOIN_LIMIT_S} s")]
    NeverActive,
}

/// What every seed of a study shares.
#[derive(Debug)]
pub struct Study {
    /// What flies; its seed is replaced by each run's.
    pub scenario: Scenario,
    /// The aircraft of each vehicle, in the order of ids.
    pub aircraft: Vec<Aircraft>,
    /// The controllers' rules.
    pub rules: Rules,
    /// Where external laws wait for their next run.
    pub laws: LawPool,
}

impl Study {
    /// Flies one seed from the ground to the end of the window, or of the mission if that is earlier.
    ///
    /// # Errors
    /// If the scenario cannot be flown, a vehicle does not join, or an external law is silent or gone.
    pub fn fly(&self, seed: u64) -> Result<Report, StudyError> {
        self.fly_watched(seed, None)
    }

    /// Flies as [`Self::fly`] does, with an observer called at this rate, Hz. The observer does not affect the flight.
    ///
    /// # Errors
    /// As [`Self::fly`].
    pub fn fly_watched(&self, seed: u64, mut watch: Option<(&mut dyn Watch, f64)>) -> Result<Report, StudyError> {
        let started = now();
        let scenario = Scenario { seed, ..self.scenario.clone() };
        let mut world = World::new(&scenario, &self.aircraft, &self.rules)?;
        let mut laws = self.laws.take(&scenario)?;
        let mut metrics = Metrics::new(&scenario, Run::new(&scenario, "study"));
        let mut tick_with_laws = |world: &mut World| {
            world.tick();
            laws.as_mut().map_or(Ok(()), |laws| laws.serve(world))
        };
        while !world.all_active() {
            if world.t_s() > JOIN_LIMIT_S {
                return Err(StudyError::NeverActive);
            }
            tick_with_laws(&mut world)?;
        }
        let zero_s = world.t_s();
        let mut vehicles = Vec::with_capacity(scenario.swarm.vehicles);
        for tick in 0..(longest_s(&scenario) / TICK_S).round() as u64 {
            tick_with_laws(&mut world)?;
            measure(&world, zero_s, &mut metrics, &mut vehicles);
            if let Some((watch, rate_hz)) = &mut watch {
                let every = (1.0 / (TICK_S * *rate_hz)).round().max(1.0) as u64;
                show(&mut world, zero_s, *watch, tick % every == 0);
            }
            if world.has_finished() {
                break;
            }
        }
        metrics.set_totals(world.totals());
        // Laws of a run that failed are not kept.
        laws.into_iter().for_each(|laws| self.laws.put_back(laws));
        let wall_s = now().duration_since(started).as_secs_f64();
        Ok(metrics.report(Wall { wall_s, real_time_factor: world.t_s() / wall_s.max(1e-9) }))
    }

    /// Flies all seeds, `jobs` at a time, and hands each report on as it comes. Returns the reports in the order of seeds.
    ///
    /// # Errors
    /// The first error of a run, in the order of seeds.
    pub fn fly_all(
        &self,
        seeds: Range<u64>,
        jobs: NonZeroUsize,
        done: impl Fn(&Report) + Sync,
    ) -> Result<Vec<Report>, StudyError> {
        in_parallel((seeds.end - seeds.start) as usize, jobs, |nth| {
            let report = self.fly(seeds.start + nth as u64)?;
            done(&report);
            Ok(report)
        })
    }
}

/// The window's length if the mission does not end it, s.
fn longest_s(scenario: &Scenario) -> f64 {
    let last = scenario.mission.steps.last().map(|step| &step.target);
    let ends = matches!(last, Some(Target::Land(_)));
    scenario.duration_s.unwrap_or(if ends { LONGEST_MISSION_S } else { DEFAULT_DURATION_S })
}

/// Shows the world's last tick to the observer; the vehicles' steps only if they are `due`.
fn show(world: &mut World, zero_s: f64, watch: &mut dyn Watch, due: bool) {
    let t_s = world.t_s() - zero_s;
    world.faults().iter().for_each(|fault| watch.fault(t_s, fault));
    world.events().iter().for_each(|(sender, what)| watch.event(t_s, *sender, what));
    if due {
        world.traces().for_each(|trace| watch.step(t_s, &trace));
    }
}

/// Hands the world's last tick to the metrics; `vehicles` is only room to work in.
pub fn measure(world: &World, zero_s: f64, metrics: &mut Metrics, vehicles: &mut Vec<VehicleNow>) {
    let t_s = world.t_s() - zero_s;
    world.faults().iter().for_each(|fault| metrics.fault(t_s, fault));
    world.events().iter().for_each(|(sender, what)| metrics.observe_event(t_s, *sender, what));
    vehicles.clear();
    let needs_fresh = metrics.needs_fresh(t_s);
    for (id, agent, truth, controls) in world.all_vehicles() {
        let Some(agent) = agent else {
            vehicles.push(VehicleNow::dead(id, *truth));
            continue;
        };
        let received = || agent.peers().iter().filter(|peer| peer.standing != PeerStatus::Lost);
        received().for_each(|peer| metrics.observe_age(peer.age_s));
        let fresh = received().filter(|peer| needs_fresh && peer.silent_s() < FRESH_S).map(|peer| peer.id);
        vehicles.push(VehicleNow {
            id,
            runs: true,
            is_member: agent.membership() == Membership::Active,
            truth: *truth,
            controls,
            step: agent.at_step(),
            reached: agent.reached(),
            centre_ne_m: agent.centre_ne_m(),
            in_contact: agent.peers_in_contact(),
            fresh: fresh.collect(),
        });
    }
    metrics.observe(t_s, vehicles);
}
