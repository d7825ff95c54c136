//! The time of each stage of a vehicle's frame: a [`Swarm`] records a second of its flight, each stage replays that
//! second in a loop of its own, and so on to the end. A stage alone finds its data in the cache, so that its time is a
//! lower bound.

use std::hint::black_box;

use nalgebra::Vector2;
use skein_common::id::VehicleId;
use skein_common::scenario::Scenario;
use skein_core::builtin::BuiltInPlant;
use skein_core::control::Controller;
use skein_core::estimate::{Estimate, Estimator};
use skein_core::formation::Formation;
use skein_core::helicopter::TICK_S;
use skein_core::mission::{MissionGoal, Task};
use skein_core::peers::{Broadcast, Peers, SharedRecords};
use skein_core::setpoint::Setpoint;
use skein_host::blocks::Blocks;
use skein_lab::metrics::{Metrics, Run};
use skein_lab::study::{Study, measure};
use skein_lab::world::World;

use crate::swarm::{RecordedFrame, Swarm, helicopters, plants};
use crate::virtual_time::{SEED, SIZES};
use crate::{FLIGHT_S, hover_in_one_ring, on_the_ring, print_table, processor_time_s, row};

/// Frames that are recorded at once: a second.
const FRAMES: usize = 50;

/// Processor time over a whole flight, s.
#[derive(Default)]
struct Times {
    flight_model: f64,
    estimate: f64,
    control: f64,
    peers: f64,
    messages: f64,
    /// All of the world's tick.
    world: f64,
    /// The world's tick and the figures of a study.
    study: f64,
}

/// The stages of every vehicle, each by itself.
struct Stages {
    plants: Vec<BuiltInPlant>,
    blocks: Blocks,
    estimators: Vec<Estimator>,
    controllers: Vec<Controller>,
    records: SharedRecords,
    peers: Vec<Peers>,
    reach_m: f64,
    estimates: Vec<Estimate>,
}

impl Stages {
    fn new(study: &Study, swarm: &Swarm) -> Self {
        let (scenario, aircraft) = (&study.scenario, &study.aircraft[0]);
        let roster = u8::try_from(scenario.swarm.vehicles).expect("a swarm's size");
        let plan = scenario.plan_hash();
        let controller = |_| Controller::new(scenario, study.rules.clone(), aircraft.trim, aircraft.gains);
        Self {
            plants: plants(study),
            blocks: Blocks::default(),
            estimators: scenario.ids().map(|_| Estimator::new(swarm.origin, &scenario.sensing)).collect(),
            controllers: scenario.ids().map(controller).collect(),
            records: SharedRecords::new(scenario),
            peers: scenario.ids().map(|id| Peers::new(id, roster, plan, &scenario.network)).collect(),
            reach_m: reach_m(scenario),
            estimates: Vec::new(),
        }
    }

    fn flight_model(&mut self, frames: &[RecordedFrame]) {
        for frame in frames {
            self.plants.iter().for_each(|plant| _ = black_box(plant.frame()));
            self.blocks.advance(helicopters(&mut self.plants, &frame.commands));
        }
    }

    fn estimate(&mut self, frames: &[RecordedFrame]) {
        self.estimates.clear();
        for frame in frames {
            let vehicles = self.estimators.iter_mut().zip(&frame.measurements);
            let estimate =
                |(estimator, measurement): (&mut Estimator, _)| estimator.update(frame.now, Some(measurement));
            self.estimates.extend(vehicles.filter_map(estimate));
        }
    }

    fn control(&mut self) {
        let setpoint = Setpoint {
            relative_velocity_ne_m_s: Vector2::new(0.5, -0.3),
            feedforward_ne_m_s: Vector2::zeros(),
            altitude_m: 30.0,
            heading_rad: 0.1,
        };
        for estimates in self.estimates.chunks(self.controllers.len()) {
            for (controller, estimate) in self.controllers.iter_mut().zip(estimates) {
                black_box(controller.step(TICK_S, estimate, &setpoint));
            }
        }
    }

    fn peers(&mut self, frames: &[RecordedFrame]) {
        for (frame, estimates) in frames.iter().zip(self.estimates.chunks(self.peers.len())) {
            let local = frame.now.local;
            self.records.update(local, &frame.received);
            let broadcast = Broadcast { messages: &frame.received, records: Some(&self.records), inbox: None };
            for (peers, estimate) in self.peers.iter_mut().zip(estimates) {
                peers.update(local, &[], broadcast);
                peers.near(estimate.position, self.reach_m).near.for_each(|peer| _ = black_box(peer));
            }
        }
    }
}

/// How far the ring and its safety filter look.
fn reach_m(scenario: &Scenario) -> f64 {
    let own = VehicleId::first(1).next().expect("vehicle 1");
    let centre_ne_m = Vector2::zeros();
    let goal = MissionGoal { step: 0, centre_ne_m, centre_velocity_ne_m_s: Vector2::zeros(), heading_rad: 0.0 };
    let mut formation = Formation::new(own, scenario).expect("the hover flies");
    formation.reach_m(&Task::Formation(goal), scenario.swarm.vehicles)
}

impl Times {
    /// Flies once.
    fn measure(study: &Study) -> Self {
        let mut times = Self::default();
        let mut swarm = Swarm::new(study);
        let mut stages = Stages::new(study, &swarm);
        let new_world = || World::new(&study.scenario, &study.aircraft, &study.rules).expect("the hover starts");
        let (mut alone, mut measured) = (new_world(), new_world());
        let mut metrics = Metrics::new(&study.scenario, Run::new(&study.scenario, "study"));
        let mut vehicles = Vec::new();
        for _ in 0..FLIGHT_S {
            let frames: Vec<_> = (0..FRAMES).map(|_| swarm.tick()).collect();
            times.flight_model += processor_time_s(|| stages.flight_model(&frames)).0;
            times.estimate += processor_time_s(|| stages.estimate(&frames)).0;
            times.control += processor_time_s(|| stages.control()).0;
            times.peers += processor_time_s(|| stages.peers(&frames)).0;
            let sent = || frames.iter().flat_map(|frame| &frame.sent);
            let wire = || sent().for_each(|message| _ = black_box(message.through_wire(&swarm.origin)));
            times.messages += processor_time_s(wire).0;
            times.world += processor_time_s(|| (0..FRAMES).for_each(|_| alone.tick())).0;
            let study = || {
                for _ in 0..FRAMES {
                    measured.tick();
                    measure(&measured, 0.0, &mut metrics, &mut vehicles);
                }
            };
            times.study += processor_time_s(study).0;
        }
        swarm.check_against_world(study);
        times
    }

    /// The row of the table: us per vehicle and frame.
    fn row(&self, name: &str, vehicles: usize) -> Vec<String> {
        let Self { flight_model, estimate, control, peers, messages, world, study } = self;
        let rest = world - flight_model - estimate - control - peers - messages;
        let frames = vehicles as f64 * FRAMES as f64 * f64::from(FLIGHT_S);
        let times = [*flight_model, *estimate, *control, *peers, *messages, rest, study - world, *study];
        let cells = times.map(|time_s| format!("{:.2}", time_s * 1e6 / frames));
        [name.to_owned(), vehicles.to_string()].into_iter().chain(cells).collect()
    }
}

/// Prints the table.
pub(super) fn print() {
    println!("Stages in the same rings, processor time in us per vehicle and frame of 20 ms.\n");
    let head =
        ["", "vehicles", "flight model", "estimate", "control", "peers", "messages", "the rest", "figures", "all"];
    let mut rows = vec![row(head)];
    for vehicles in SIZES {
        eprintln!("stages of {vehicles} vehicles");
        for (name, sets) in [("one ring", on_the_ring(vehicles).as_slice()), ("one ring, random starts", &[])] {
            let mut study = hover_in_one_ring(vehicles, sets);
            study.scenario.seed = SEED;
            rows.push(Times::measure(&study).row(name, vehicles));
        }
    }
    print_table(&rows);
    println!(
        "messages: each is encoded and decoded once.\n\
         The rest: mission, formation, diagnosis, outbox, delivery, and the memory that stages share.\n"
    );
}
