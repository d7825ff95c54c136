//! Steps many worlds at once for learning: observations and actions are arrays of numpy that Rust reads and fills in
//! place.

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use nalgebra::{Vector2, Vector3};
use numpy::{PyReadonlyArray3, PyReadwriteArray1, PyReadwriteArray2, PyReadwriteArray3};
use pyo3::prelude::*;
use skein_core::formation::external::{LawQuery, LawReply, ReplyCommand};
use skein_core::helicopter::TICK_S;
use skein_core::plant::Controls;
use skein_host::external::protocol::Time;
use skein_lab::external::{LawPool, Trial};
use skein_lab::metrics::{AIRBORNE_ABOVE_M, Metrics};
use skein_lab::prepare::prepare;
use skein_lab::scenario::ScenarioArgs;
use skein_lab::study::{Batch, Pilot, Replaced, Study};
use skein_lab::world::World;

use crate::error::{exception, refused};

/// Features of a vehicle's own state, in every observation.
const OWN: [&str; 8] = [
    "north_m",
    "east_m",
    "down_m",
    "velocity_north_m_s",
    "velocity_east_m_s",
    "velocity_down_m_s",
    "heading_rad",
    "radius_m",
];
/// Features that only a pilot of the controls needs.
const ATTITUDE: [&str; 5] = ["roll_rad", "pitch_rad", "roll_rate_rad_s", "pitch_rate_rad_s", "yaw_rate_rad_s"];
/// Features of a neighbour.
const NEIGHBOUR: [&str; 7] =
    ["present", "north_m", "east_m", "down_m", "velocity_north_m_s", "velocity_east_m_s", "velocity_down_m_s"];

/// What an action replaces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Action {
    /// Nothing: the scenario's own law flies.
    None,
    /// The law's answer: a velocity north, east, down, m/s.
    Velocity,
    /// The law's answer: a field north, east.
    Field,
    /// The helicopter's controls: roll, pitch, yaw, collective.
    Controls,
}

impl Action {
    fn named(name: Option<&str>) -> Option<Self> {
        match name {
            None => Some(Self::None),
            Some("velocity") => Some(Self::Velocity),
            Some("field") => Some(Self::Field),
            Some("controls") => Some(Self::Controls),
            Some(_) => None,
        }
    }

    /// Numbers of an action.
    fn size(self) -> usize {
        match self {
            Self::None => 0,
            Self::Velocity => 3,
            Self::Field => 2,
            Self::Controls => 4,
        }
    }

    /// What an action replaces in a world.
    fn replaces(self) -> Replaced {
        match self {
            Self::None => Replaced::Nothing,
            Self::Velocity | Self::Field => Replaced::Law,
            Self::Controls => Replaced::Controls,
        }
    }

    /// Whether an action answers the agents' queries.
    fn answers(self) -> bool {
        matches!(self, Self::Velocity | Self::Field)
    }
}

/// Names of the features of an observation, in order.
#[pyfunction]
pub(crate) fn observation_names(action: Option<&str>, neighbours: usize) -> Vec<String> {
    let attitude = ATTITUDE.iter().filter(|_| action == Some("controls"));
    let own = OWN.iter().chain(attitude).map(|name| (*name).to_owned());
    let of_each = (1..=neighbours).flat_map(|nth| NEIGHBOUR.map(|name| format!("neighbour_{nth}_{name}")));
    own.chain(of_each).collect()
}

/// What acts on one world.
#[derive(Debug)]
struct Actor {
    action: Action,
    /// Numbers of every vehicle's action, in the order of ids.
    actions: Vec<f64>,
    /// The newest query of every vehicle, and whether it waits for the next action.
    queries: Vec<Option<(LawQuery, bool)>>,
    /// Ticks until the step is over.
    ticks_left: u64,
    /// Ticks that the scenario's own agents fly before the first observation, and those that they have flown.
    warm_up: u64,
    ticks: u64,
}

impl Actor {
    fn reply(&self, nth: usize, query: &LawQuery) -> LawReply {
        let size = self.action.size();
        let numbers = &self.actions[nth * size..][..size];
        let command = match *numbers {
            [north, east, down] => ReplyCommand::VelocityNed(Vector3::new(north, east, down)),
            _ => ReplyCommand::FieldNe(Vector2::new(numbers[0], numbers[1])),
        };
        let (vehicle, tick) = (query.vehicle, query.tick);
        LawReply { vehicle, tick, command, heading_rad: None, reached: None, log: Vec::new() }
    }
}

impl Pilot for Actor {
    fn begin(&mut self) {
        self.queries.iter_mut().for_each(|query| *query = None);
        (self.ticks_left, self.ticks) = (0, 0);
    }

    fn before(&mut self, world: &mut World, ticks: u64) {
        self.ticks_left = ticks;
        if self.action == Action::Controls {
            let ids: Vec<_> = world.frames().map(|(id, ..)| id).collect();
            for (id, numbers) in ids.into_iter().zip(self.actions.chunks_exact(4)) {
                let axis = |nth: usize| numbers[nth].clamp(-1.0, 1.0);
                let collective = numbers[3].clamp(0.0, 1.0);
                let controls = Controls { roll: axis(0), pitch: axis(1), yaw: axis(2), collective };
                world.set_controls(id, Some(controls));
            }
        }
        for nth in 0..self.queries.len() {
            if let Some((query, true)) = &self.queries[nth] {
                world.answer(self.reply(nth, query));
            }
            self.queries[nth].iter_mut().for_each(|(_, waits)| *waits = false);
        }
    }

    fn after_tick(&mut self, world: &mut World) {
        self.ticks += 1;
        self.ticks_left = self.ticks_left.saturating_sub(1);
        if !self.action.answers() {
            return;
        }
        for query in world.take_asks() {
            let nth = usize::from(query.vehicle.get()) - 1;
            // A vehicle whose period begins within a step flies the last action on.
            let waits = self.ticks_left == 0;
            if !waits {
                world.answer(self.reply(nth, &query));
            }
            if let Some(place) = self.queries.get_mut(nth) {
                *place = Some((query, waits));
            }
        }
    }

    fn is_ready(&self) -> bool {
        let asks = self.queries.iter().flatten().next().is_some();
        self.ticks >= self.warm_up && (asks || !self.action.answers())
    }
}

/// Many worlds of one scenario.
#[pyclass]
pub(crate) struct Worlds {
    /// Locked by none but its owner: a class of Python has to be shareable between threads.
    batch: Mutex<Batch>,
    actors: Vec<Actor>,
    action: Action,
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

/// What `skein.Env` makes its worlds of.
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

/// Flat parts of the arrays that belong to one world.
struct Room<'a> {
    observations: &'a mut [f64],
    positions: &'a mut [f64],
    velocities: &'a mut [f64],
    separations: &'a mut [f64],
    crashed: &'a mut [bool],
}

#[pymethods]
impl Worlds {
    #[new]
    fn new(py: Python<'_>, settings: Settings) -> PyResult<Self> {
        let Some(action) = Action::named(settings.action.as_deref()) else {
            return Err(refused(py, "action is None, \"velocity\", \"field\" or \"controls\""));
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
        let max_speed_m_s = scenario.formation.external.max_speed_m_s;
        let step_s = scenario.formation.external.period_s;
        let ticks = (step_s / TICK_S).round() as u64;
        if ticks == 0 || (ticks as f64 * TICK_S - step_s).abs() > 1e-9 {
            return Err(refused(
                py,
                format!("formation.external.period_s is {step_s}, but a step has whole frames of {TICK_S} s"),
            ));
        }
        let actor = || Actor {
            action,
            actions: vec![0.0; vehicles * action.size()],
            queries: (0..vehicles).map(|_| None).collect(),
            ticks_left: 0,
            warm_up: (settings.warm_up_s / TICK_S).round().max(0.0) as u64,
            ticks: 0,
        };
        let laws = LawPool::default();
        let study = Study { scenario, aircraft: ready.aircraft, rules: ready.rules, laws };
        let threads = NonZeroUsize::new(settings.threads).unwrap_or(NonZeroUsize::MIN);
        Ok(Self {
            batch: Mutex::new(Batch::new(study, settings.worlds, threads, action.replaces())),
            actors: (0..settings.worlds).map(|_| actor()).collect(),
            action,
            neighbours: settings.neighbours.unwrap_or(vehicles.saturating_sub(1).min(6)),
            ticks,
            vehicles,
            step_s,
            seed,
            max_speed_m_s,
        })
    }

    /// Neighbours in an observation.
    #[getter]
    fn neighbours(&self) -> usize {
        self.neighbours
    }

    /// Begins new flights in the worlds that have a seed here, and fills the arrays.
    fn reset(
        &mut self,
        py: Python<'_>,
        seeds: Vec<Option<u64>>,
        mut observations: PyReadwriteArray3<'_, f64>,
        mut truths: Truths<'_>,
    ) -> PyResult<()> {
        let mut arrays = Arrays::of(&mut observations, &mut truths)?;
        let flown = py.detach(|| {
            batch(&mut self.batch).begin(&seeds, &mut self.actors)?;
            self.fill(&mut arrays);
            Ok(())
        });
        flown.map_err(|error: skein_lab::study::StudyError| refused(py, error))
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
        let mut arrays = Arrays::of(&mut observations, &mut truths)?;
        let flown = py.detach(|| {
            batch(&mut self.batch).tick(self.ticks, &mut self.actors)?;
            self.fill(&mut arrays);
            Ok(())
        });
        flown.map_err(|error: skein_lab::study::StudyError| refused(py, error))
    }

    /// Ends the flight of this world and gives its figures as JSON, as in `metrics.json`; `None` before it begins.
    fn report(&mut self, py: Python<'_>, world: usize) -> PyResult<Option<String>> {
        let report = batch(&mut self.batch).report(world).map_err(|error| refused(py, error))?;
        report.map(|report| serde_json::to_string(&report).map_err(|error| refused(py, error))).transpose()
    }
}

/// All arrays, flat.
struct Arrays<'a> {
    observations: &'a mut [f64],
    positions: &'a mut [f64],
    velocities: &'a mut [f64],
    separations: &'a mut [f64],
    crashed: &'a mut [bool],
    terminated: &'a mut [bool],
    truncated: &'a mut [bool],
}

impl<'a> Arrays<'a> {
    fn of(observations: &'a mut PyReadwriteArray3<'_, f64>, truths: &'a mut Truths<'_>) -> PyResult<Self> {
        Ok(Self {
            observations: observations.as_slice_mut()?,
            positions: truths.position_ned_m.as_slice_mut()?,
            velocities: truths.velocity_ned_m_s.as_slice_mut()?,
            separations: truths.separation_m.as_slice_mut()?,
            crashed: truths.crashed.as_slice_mut()?,
            terminated: truths.terminated.as_slice_mut()?,
            truncated: truths.truncated.as_slice_mut()?,
        })
    }
}

impl Worlds {
    /// Fills the arrays from the present state of every world.
    fn fill(&mut self, arrays: &mut Arrays<'_>) {
        let (vehicles, features) = (self.vehicles, self.features());
        let batch = batch(&mut self.batch);
        let steps = &batch.study().scenario.mission.steps;
        let goals: Vec<(f64, f64)> =
            steps.iter().map(|step| (step.formation.altitude_m, step.formation.radius_m)).collect();
        let worlds = arrays
            .observations
            .chunks_exact_mut(vehicles * features)
            .zip(arrays.positions.chunks_exact_mut(vehicles * 3))
            .zip(arrays.velocities.chunks_exact_mut(vehicles * 3))
            .zip(arrays.separations.chunks_exact_mut(vehicles))
            .zip(arrays.crashed.chunks_exact_mut(vehicles))
            .enumerate();
        for (nth, ((((observations, positions), velocities), separations), crashed)) in worlds {
            [arrays.terminated[nth], arrays.truncated[nth]] = batch.is_over(nth);
            let Some((world, metrics)) = batch.world(nth) else { continue };
            let room = Room { observations, positions, velocities, separations, crashed };
            let look = Look { goals: &goals, queries: &self.actors[nth].queries, neighbours: self.neighbours };
            look.fill(self.action, world, metrics, room);
        }
    }

    /// Numbers of an observation of one vehicle.
    fn features(&self) -> usize {
        let attitude = if self.action == Action::Controls { ATTITUDE.len() } else { 0 };
        OWN.len() + attitude + self.neighbours * NEIGHBOUR.len()
    }
}

/// What an observation is made of.
struct Look<'a> {
    /// Altitude and radius of the formation in each step of the mission, m.
    goals: &'a [(f64, f64)],
    queries: &'a [Option<(LawQuery, bool)>],
    neighbours: usize,
}

/// Position and velocity, north, east, down, m and m/s.
type State = ([f64; 3], [f64; 3]);

impl Look<'_> {
    fn fill(&self, action: Action, world: &World, metrics: &Metrics, room: Room<'_>) {
        let frames: Vec<_> = world.frames().collect();
        let truths: Vec<State> =
            frames.iter().map(|(_, _, frame)| (frame.truth.position.0.into(), frame.truth.velocity.0.into())).collect();
        let is_airborne = |nth: usize| frames[nth].2.truth.height_m > AIRBORNE_ABOVE_M;
        let features = room.observations.len() / frames.len().max(1);
        let mut near: Vec<(f64, State)> = Vec::with_capacity(frames.len());
        for (nth, (_, agent, frame)) in frames.iter().enumerate() {
            room.positions[3 * nth..][..3].copy_from_slice(&truths[nth].0);
            room.velocities[3 * nth..][..3].copy_from_slice(&truths[nth].1);
            room.crashed[nth] = metrics.has_crashed(nth);
            let others = || (0..frames.len()).filter(move |&other| other != nth);
            let apart = others().filter(|&other| is_airborne(nth) && is_airborne(other));
            let nearest = apart.map(|other| squared_m2(&truths[nth], &truths[other])).fold(f64::INFINITY, f64::min);
            room.separations[nth] = nearest.sqrt();
            let out = &mut room.observations[nth * features..][..features];
            near.clear();
            match self.queries.get(nth).and_then(Option::as_ref) {
                Some((query, _)) => {
                    let own = (query.own.position_ned_m, query.own.velocity_ned_m_s);
                    let goal = (query.goal.centre_ned_m, query.goal.centre_velocity_ned_m_s);
                    write_own(out, &own, &goal, [query.own.heading_rad, query.goal.radius_m]);
                    let peers = query.peers.iter().map(|peer| (peer.position_ned_m, peer.velocity_ned_m_s));
                    near.extend(peers.map(|peer| (squared_m2(&own, &peer), peer)));
                    write_neighbours(&mut out[OWN.len()..], &own, &mut near, self.neighbours);
                }
                None => {
                    let step = agent.map_or(0, |agent| agent.at_step() as usize);
                    let (altitude_m, radius_m) = self.goals.get(step).copied().unwrap_or_default();
                    let centre = agent.map(|agent| (agent.centre_ne_m(), agent.centre_velocity_ne_m_s()));
                    let (centre, velocity) = centre.unwrap_or_default();
                    let goal = ([centre.x, centre.y, -altitude_m], [velocity.x, velocity.y, 0.0]);
                    write_own(out, &truths[nth], &goal, [frame.truth.attitude.heading_rad, radius_m]);
                    let mut end = OWN.len();
                    if action == Action::Controls {
                        let (attitude, rates) = (&frame.truth.attitude, &frame.measurement.rates);
                        let five = [
                            attitude.roll_rad,
                            attitude.pitch_rad,
                            rates.roll_rad_s,
                            rates.pitch_rad_s,
                            rates.yaw_rad_s,
                        ];
                        out[end..][..5].copy_from_slice(&five);
                        end += 5;
                    }
                    near.extend(others().map(|other| (squared_m2(&truths[nth], &truths[other]), truths[other])));
                    write_neighbours(&mut out[end..], &truths[nth], &mut near, self.neighbours);
                }
            }
        }
    }
}

fn squared_m2(one: &State, other: &State) -> f64 {
    let [north, east, down] = difference(&other.0, &one.0);
    north * north + east * east + down * down
}

fn difference(one: &[f64; 3], other: &[f64; 3]) -> [f64; 3] {
    [one[0] - other[0], one[1] - other[1], one[2] - other[2]]
}

/// Writes a vehicle's own state against the goal, its heading and the formation's radius.
fn write_own(out: &mut [f64], own: &State, goal: &State, heading_and_radius: [f64; 2]) {
    out[..3].copy_from_slice(&difference(&own.0, &goal.0));
    out[3..6].copy_from_slice(&difference(&own.1, &goal.1));
    out[6..8].copy_from_slice(&heading_and_radius);
}

/// Writes the nearest neighbours, the nearest first, and zeros where there are no more.
fn write_neighbours(out: &mut [f64], own: &State, near: &mut [(f64, State)], neighbours: usize) {
    near.sort_by(|one, other| one.0.total_cmp(&other.0));
    let mut places = out.chunks_exact_mut(NEIGHBOUR.len()).take(neighbours);
    // The neighbours first: a place that no neighbour fills is left for the zeros.
    for ((_, state), place) in near.iter().zip(places.by_ref()) {
        place[0] = 1.0;
        place[1..4].copy_from_slice(&difference(&state.0, &own.0));
        place[4..7].copy_from_slice(&difference(&state.1, &own.1));
    }
    places.for_each(|place| place.fill(0.0));
}
