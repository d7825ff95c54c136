//! `skein study`: many flights of one scenario in virtual time.
//!
//! The same agents as in real time, over a simulated network. Seeds run in parallel and side by side, and a fleet in several
//! threads; what comes out does not depend on how many at once.

mod batch;
mod command;
mod fleet;
mod flight;
pub mod flights;
pub mod plan;
mod planned;
mod progress;
mod recorded;
mod summary;
pub mod sweep;
mod table;
mod verdict;

use std::num::NonZeroUsize;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use skein_common::id::VehicleSet;
use skein_common::scenario::{Scenario, Target};
use skein_core::aircraft::Aircraft;
use skein_core::control::Rules;

use crate::external::{LawError, LawPool};
use crate::metrics::{Metrics, Report, VehicleNow};
use crate::record::RecordError;
use crate::recording::Watch;
use crate::world::{World, WorldError};
pub use batch::{Batch, Pilot, Replaced};
pub use command::{StudyArgs, run, seed};
pub use fleet::{FleetRecording, fly_fleet};
use flight::{SeedFlight, fly_side_by_side};
pub use planned::{FlownStudy, Progress, fly_planned, write_results};
pub use recorded::record_run;
pub use summary::{FigureSummary, PointSummary, Summary, summarize, summary};
pub(crate) use table::median_and_worst;
pub use table::rounded;
#[cfg(test)]
pub(crate) use verdict::tests::any_run;
pub use verdict::under_control;
pub(crate) use verdict::{achievements, detail, failures, list};

/// Virtual time after which joining has failed, s.
const JOIN_LIMIT_S: f64 = 60.0;
/// Without a duration in the scenario a study flies this long, s, and a mission that ends may take this long.
const DEFAULT_DURATION_S: f64 = 400.0;
const LONGEST_MISSION_S: f64 = 3600.0;

/// The reason why a study cannot be run.
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
    /// The recording cannot be written.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The study was stopped before this run was over.
    #[error("stopped")]
    Stopped,
}

/// Stops a study from another thread. All clones are one switch.
#[derive(Clone, Debug, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// Stops the study: no further run begins, and those that fly fail with [`StudyError::Stopped`].
    pub fn set(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether the study is to stop.
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// The swarm of a study, shared by all seeds.
#[derive(Debug)]
pub struct Study {
    /// The scenario that flies; its seed is replaced by each run's.
    pub scenario: Scenario,
    /// The aircraft of each vehicle, in the order of ids.
    pub aircraft: Vec<Aircraft>,
    /// The controllers' rules.
    pub rules: Rules,
    /// The pool in which external laws wait for their next run.
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
    /// The same as of [`Self::fly`].
    pub fn fly_watched(&self, seed: u64, watch: Option<(&mut dyn Watch, f64)>) -> Result<Report, StudyError> {
        SeedFlight::new(self, seed)?.fly(watch)
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
        let begin = |nth: usize| Ok(((), SeedFlight::new(self, seeds.start + nth as u64)?));
        fly_side_by_side((seeds.end - seeds.start) as usize, jobs, begin, |(), report| report.inspect(&done))
    }
}

/// The window's length if the mission does not end it, s.
fn longest_s(scenario: &Scenario) -> f64 {
    let last = scenario.mission.steps.last().map(|step| &step.target);
    let ends = matches!(last, Some(Target::Land(_)));
    scenario.duration_s.unwrap_or(if ends { LONGEST_MISSION_S } else { DEFAULT_DURATION_S })
}

/// Hands the world's last tick to the metrics; `vehicles` is only room to work in.
pub fn measure(world: &World, zero_s: f64, metrics: &mut Metrics, vehicles: &mut Vec<VehicleNow>) {
    let t_s = world.t_s() - zero_s;
    world.faults().iter().for_each(|fault| metrics.fault(t_s, fault));
    world.events().for_each(|(sender, what)| metrics.observe_event(t_s, sender, &what));
    vehicles.clear();
    let (sampled, needs_fresh) = (metrics.sampled(), metrics.observes_formation(t_s));
    for (id, agent, truth, controls) in world.all_vehicles() {
        let Some(agent) = agent else {
            vehicles.push(VehicleNow::dead(id, *truth));
            continue;
        };
        metrics.set_values(id, agent.settings());
        agent.peer_ages(sampled).for_each(|peer| metrics.observe_age(peer.age_s));
        vehicles.push(VehicleNow {
            id,
            runs: true,
            membership: agent.membership(),
            truth: *truth,
            controls,
            step: agent.at_step(),
            reached: agent.reached(),
            centre_ne_m: agent.centre_ne_m(),
            in_contact: agent.peers_in_contact(),
            fallback_flies: agent.fallback_flies(),
            fresh: if needs_fresh { agent.fresh_peers() } else { VehicleSet::default() },
        });
    }
    metrics.observe(t_s, vehicles);
}
