//! Steps many worlds at once for learning: observations and actions are arrays of numpy that Rust reads and fills in
//! place.

mod actor;
pub(crate) mod observation;

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use numpy::{PyReadonlyArray3, PyReadwriteArray1, PyReadwriteArray2, PyReadwriteArray3};
use pyo3::prelude::*;
use skein_core::helicopter::TICK_S;
use skein_host::external::protocol::Time;
use skein_lab::external::{LawPool, Trial};
use skein_lab::prepare::prepare;
use skein_lab::scenario::ScenarioArgs;
use skein_lab::study::{Batch, Study, StudyError};

use crate::error::{exception, refused, wrong_argument};
use actor::{Action, Actor};
use observation::{Look, Room, features};

/// Many worlds of one scenario.
#[pyclass]
pub(crate) struct Worlds {
    /// Locked by none but its owner: a class of Python has to be shareable between threads.
    batch: Mutex<Batch>,
    actors: Vec<Actor>,
    action: Action,
    /// Neighbours in an observation.
    #[pyo3(get)]
    neighbours: usize,
    /// Frames in a step.
    ticks: u64,
    #[pyo3(get)]
    vehicles: usize,
    #[pyo3(get)]
    step_s: f64,
    #[pyo3(get)]
    seed: u64,
    #[pyo3(get)]
    max_speed_m_s: f64,
}

fn batch(batch: &mut Mutex<Batch>) -> &mut Batch {
    batch.get_mut().unwrap_or_else(PoisonError::into_inner)
}

/// The settings of which `skein.Env` makes its worlds.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Settings {
    scenario: Option<PathBuf>,
    sets: Vec<String>,
    worlds: usize,
    action: Option<String>,
    neighbours: Option<usize>,
    warm_up_s: f64,
    threads: usize,
}

/// Arrays of truth that every step fills besides the observations.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Truths<'py> {
    /// North, east, down in the scenario's frame, m.
    position_ned_m: PyReadwriteArray3<'py, f64>,
    /// m/s.
    velocity_ned_m_s: PyReadwriteArray3<'py, f64>,
    /// Distance to the nearest other vehicle in the air, m.
    separation_m: PyReadwriteArray2<'py, f64>,
    crashed: PyReadwriteArray2<'py, bool>,
    terminated: PyReadwriteArray1<'py, bool>,
    truncated: PyReadwriteArray1<'py, bool>,
}

#[pymethods]
impl Worlds {
    #[new]
    fn new(py: Python<'_>, settings: Settings) -> PyResult<Self> {
        let Some(action) = Action::named(settings.action.as_deref()) else {
            return Err(refused(py, "an action has to be \"velocity\", \"field\", \"controls\" or None"));
        };
        let args = ScenarioArgs { scenario: settings.scenario, sets: settings.sets };
        let made = py.detach(|| {
            let scenario = args.read(Vec::new())?.scenario;
            let ready = if action.answers() {
                args.ready(&scenario)?
            } else {
                prepare(&args, &scenario, Time::Virtual, &mut Trial::default())?
            };
            Ok((scenario, ready))
        });
        let (scenario, ready) = made.map_err(|error| exception(py, &error))?;
        let (vehicles, seed) = (scenario.swarm.vehicles, scenario.seed);
        let others = vehicles.saturating_sub(1);
        if let Some(wanted) = settings.neighbours.filter(|wanted| *wanted > others) {
            let why = format!("a vehicle of a swarm of {vehicles} has {others} neighbours at most");
            return Err(wrong_argument(py, format!("neighbours={wanted}: {why}; give fewer, or leave neighbours out")));
        }
        let max_speed_m_s = scenario.formation.external.max_speed_m_s;
        let step_s = scenario.formation.external.period_s;
        let ticks = (step_s / TICK_S).round() as u64;
        if ticks == 0 || (ticks as f64 * TICK_S - step_s).abs() > 1e-9 {
            return Err(refused(
                py,
                format!("formation.external.period_s is {step_s}, but a step has whole frames of {TICK_S} s"),
            ));
        }
        let warm_up = (settings.warm_up_s / TICK_S).round().max(0.0) as u64;
        let laws = LawPool::default();
        let study = Study { scenario, aircraft: ready.aircraft, rules: ready.rules, laws };
        let threads = NonZeroUsize::new(settings.threads).unwrap_or(NonZeroUsize::MIN);
        Ok(Self {
            batch: Mutex::new(Batch::new(study, settings.worlds, threads, action.replaces())),
            actors: (0..settings.worlds).map(|_| Actor::new(action, vehicles, warm_up)).collect(),
            action,
            neighbours: settings.neighbours.unwrap_or(others.min(6)),
            ticks,
            vehicles,
            step_s,
            seed,
            max_speed_m_s,
        })
    }

    /// Begins new flights in the worlds that have a seed here, and fills the arrays.
    fn reset(
        &mut self,
        py: Python<'_>,
        seeds: Vec<Option<u64>>,
        mut observations: PyReadwriteArray3<'_, f64>,
        mut truths: Truths<'_>,
    ) -> PyResult<()> {
        self.fly(py, &mut observations, &mut truths, |batch, actors| batch.begin(&seeds, actors))
    }

    /// Flies all worlds for one step with these actions, and fills the arrays.
    fn step(
        &mut self,
        py: Python<'_>,
        actions: Option<PyReadonlyArray3<'_, f64>>,
        mut observations: PyReadwriteArray3<'_, f64>,
        mut truths: Truths<'_>,
    ) -> PyResult<()> {
        if let Some(actions) = &actions {
            let actions = actions.as_slice()?;
            if !actions.iter().all(|number| number.abs() <= 1e9) {
                return Err(refused(py, "an action has a number that is not finite or beyond 1e9"));
            }
            let size = self.vehicles * self.action.size();
            if size > 0 {
                self.actors
                    .iter_mut()
                    .zip(actions.chunks_exact(size))
                    .for_each(|(actor, its)| actor.actions.copy_from_slice(its));
            }
        }
        let ticks = self.ticks;
        self.fly(py, &mut observations, &mut truths, |batch, actors| batch.tick(ticks, actors))
    }

    /// Ends the flight of this world and gives its figures as JSON, as in `metrics.json`; `None` before it begins.
    fn report(&mut self, py: Python<'_>, world: usize) -> PyResult<Option<String>> {
        let report = batch(&mut self.batch).report(world).map_err(|error| refused(py, error))?;
        report.map(|report| serde_json::to_string(&report).map_err(|error| refused(py, error))).transpose()
    }
}

impl Worlds {
    /// Flies without the interpreter's lock, and fills the arrays.
    fn fly(
        &mut self,
        py: Python<'_>,
        observations: &mut PyReadwriteArray3<'_, f64>,
        truths: &mut Truths<'_>,
        fly: impl FnOnce(&mut Batch, &mut [Actor]) -> Result<(), StudyError> + Send,
    ) -> PyResult<()> {
        let room = Room {
            observations: observations.as_slice_mut()?,
            positions: truths.position_ned_m.as_slice_mut()?,
            velocities: truths.velocity_ned_m_s.as_slice_mut()?,
            separations: truths.separation_m.as_slice_mut()?,
            crashed: truths.crashed.as_slice_mut()?,
        };
        let over = [truths.terminated.as_slice_mut()?, truths.truncated.as_slice_mut()?];
        let flown = py.detach(|| {
            fly(batch(&mut self.batch), &mut self.actors)?;
            self.fill(room, over);
            Ok(())
        });
        flown.map_err(|error: StudyError| refused(py, error))
    }

    /// Fills the arrays from the present state of every world.
    fn fill(&mut self, room: Room<'_>, [terminated, truncated]: [&mut [bool]; 2]) {
        let (vehicles, features) = (self.vehicles, features(self.action, self.neighbours));
        let batch = batch(&mut self.batch);
        let steps = &batch.study.scenario.mission.steps;
        let goals: Vec<(f64, f64)> =
            steps.iter().map(|step| (step.formation.altitude_m, step.formation.radius_m)).collect();
        let worlds = room
            .observations
            .chunks_exact_mut(vehicles * features)
            .zip(room.positions.chunks_exact_mut(vehicles * 3))
            .zip(room.velocities.chunks_exact_mut(vehicles * 3))
            .zip(room.separations.chunks_exact_mut(vehicles))
            .zip(room.crashed.chunks_exact_mut(vehicles))
            .enumerate();
        for (nth, ((((observations, positions), velocities), separations), crashed)) in worlds {
            [terminated[nth], truncated[nth]] = batch.is_over(nth);
            let Some((world, metrics)) = batch.world(nth) else { continue };
            let room = Room { observations, positions, velocities, separations, crashed };
            let look = Look { goals: &goals, queries: &self.actors[nth].queries, neighbours: self.neighbours };
            look.fill(self.action, world, metrics, room);
        }
    }
}
