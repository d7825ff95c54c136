//! `skein study`: many flights of one scenario in virtual time.
//!
//! The same agents as in real time, stepped in one thread over a simulated network. Seeds run in parallel; what comes out
//! does not depend on how many at once.

mod command;
mod summary;
pub mod world;

use std::fs;
use std::io::IsTerminal;
use std::num::NonZeroUsize;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use skein_agent::aircraft::Aircraft;
use skein_agent::control::Rules;
use skein_agent::peers::FRESH_S;
use skein_agent::plant::helicopter::TICK_S;
use skein_agent::start::TooFull;
use skein_agent::supported::NotFlown;
use skein_common::id::VehicleId;
use skein_common::scenario::{Scenario, Target};
use skein_common::state::{Membership, Standing};

use crate::clock::now;
use crate::error::Error;
use crate::metrics::{Metrics, Report, Run, VehicleNow, Wall};
pub use command::{StudyArgs, run};
pub use summary::{Summary, summarize};
use world::World;

/// Virtual time after which joining has failed, s.
const JOIN_LIMIT_S: f64 = 60.0;
/// Without a duration in the scenario a study flies this long, s, and a mission that ends may take this long.
const DEFAULT_DURATION_S: f64 = 400.0;
const LONGEST_MISSION_S: f64 = 3600.0;

/// Why a study cannot be run.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// The scenario asks for what is not flown.
    #[error(transparent)]
    NotFlown(#[from] NotFlown),
    /// The starts do not fit.
    #[error(transparent)]
    Starts(#[from] TooFull),
    /// This vehicle's aircraft has no flight model.
    #[error("vehicle {0}: its aircraft has no [helicopter] table, so only X-Plane can fly it")]
    NoModel(VehicleId),
    /// Not everybody became active.
    #[error("not everybody takes part after {JOIN_LIMIT_S} s")]
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
}

impl Study {
    /// Flies one seed from the ground to the end of the window, or of the mission if that is earlier.
    ///
    /// # Errors
    /// If the scenario is not flown, or not everybody joins.
    pub fn fly(&self, seed: u64) -> Result<Report, StudyError> {
        let started = now();
        let scenario = Scenario { seed, ..self.scenario.clone() };
        let mut world = World::new(&scenario, &self.aircraft, &self.rules)?;
        let mut metrics = Metrics::new(&scenario, Run::new(&scenario, "study"));
        while !world.all_active() {
            if world.t_s() > JOIN_LIMIT_S {
                return Err(StudyError::NeverActive);
            }
            world.tick();
        }
        let zero_s = world.t_s();
        let mut vehicles = Vec::with_capacity(scenario.swarm.vehicles);
        for _ in 0..(longest_s(&scenario) / TICK_S).round() as u64 {
            world.tick();
            measure(&world, zero_s, &mut metrics, &mut vehicles);
            if world.has_finished() {
                break;
            }
        }
        metrics.count(world.totals());
        let wall_s = now().duration_since(started).as_secs_f64();
        Ok(metrics.report(Wall { wall_s, real_time_factor: world.t_s() / wall_s.max(1e-9) }))
    }

    /// Flies all seeds, `jobs` at a time, and hands each report on as it comes; gives them in the order of seeds.
    pub fn fly_all(
        &self,
        seeds: Range<u64>,
        jobs: NonZeroUsize,
        done: impl Fn(&Report) + Sync,
    ) -> Result<Vec<Report>, StudyError> {
        let seeds: Vec<u64> = seeds.collect();
        let next = AtomicUsize::new(0);
        let reports = Mutex::new(Vec::with_capacity(seeds.len()));
        std::thread::scope(|scope| {
            for _ in 0..jobs.get().min(seeds.len()) {
                scope.spawn(|| {
                    while let Some(&seed) = seeds.get(next.fetch_add(1, Ordering::Relaxed)) {
                        let flown = self.fly(seed);
                        if let Ok(report) = &flown {
                            done(report);
                        } else {
                            // Nobody needs the seeds that are left.
                            next.store(seeds.len(), Ordering::Relaxed);
                        }
                        reports.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).push((seed, flown));
                    }
                });
            }
        });
        let mut reports = reports.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
        reports.sort_by_key(|(seed, _)| *seed);
        reports.into_iter().map(|(_, flown)| flown).collect()
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
    world.incidents().iter().for_each(|incident| metrics.incident(t_s, incident));
    world.happened().iter().for_each(|(speaker, what)| metrics.tell(t_s, *speaker, what));
    vehicles.clear();
    for (id, agent, truth, sticks) in world.everybody() {
        let mut vehicle = VehicleNow::dead(id, *truth);
        if let Some(agent) = agent {
            for peer in agent.peers().iter().filter(|peer| peer.standing != Standing::Lost) {
                metrics.observe_age(peer.age_s);
                if peer.age_s < FRESH_S {
                    vehicle.fresh.insert(peer.id);
                }
            }
            vehicle = VehicleNow {
                runs: true,
                is_member: agent.membership() == Membership::Active,
                sticks,
                step: agent.at_step(),
                reached: agent.reached(),
                centre_ne_m: agent.centre_ne_m(),
                hears: agent.hears(),
                ..vehicle
            };
        }
        vehicles.push(vehicle);
    }
    metrics.observe(t_s, vehicles);
}

/// Writes a study: `scenario.toml` and `metrics.json` of every run, and of the whole `runs.csv` and `summary.json`.
/// `as_flown` gives the complete scenario file of a seed.
pub fn write(out: &Path, as_flown: impl Fn(u64) -> Result<String, Error>, reports: &[Report]) -> Result<(), Error> {
    let to = |path: PathBuf, text: String| {
        let parent = path.parent().map_or(Ok(()), fs::create_dir_all);
        let written = parent.and_then(|()| fs::write(&path, text));
        written.map_err(|error| Error::Failed(format!("{}: {error}", path.display())))
    };
    for report in reports {
        let folder = match reports {
            [_] => out.to_owned(),
            _ => out.join(format!("seed-{}", report.run.seed)),
        };
        to(folder.join("scenario.toml"), as_flown(report.run.seed)?)?;
        to(folder.join("metrics.json"), crate::json(report))?;
    }
    to(out.join("runs.csv"), summary::csv(reports))?;
    to(out.join("summary.json"), crate::json(&summarize(reports)))
}

/// A bar on a terminal, silence elsewhere.
pub fn progress(runs: u64) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(runs), ProgressDrawTarget::stderr());
    if !std::io::stderr().is_terminal() {
        bar.set_draw_target(ProgressDrawTarget::hidden());
    }
    let style = ProgressStyle::with_template("{bar:40} {pos}/{len} runs, {elapsed} gone, {eta} left {msg}");
    bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}
