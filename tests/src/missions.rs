//! Random missions: swarms of every size and law fly to random places and along random paths, in wind, over a lossy
//! network, inside a fence, with up to four faults, of which some also cost the vehicle its agent. Every healthy vehicle has to come to the mission's end, to land there, and
//! to keep clear of all others and of the fence. A broken vehicle has to do nothing: one whose collective is stuck in a climb cannot descend. A mission
//! that fails is made as small as possible before it is printed.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::ops::Range;

use skein_common::id::VehicleId;
use skein_common::message::{EventKind, Failure};
use skein_common::scenario::{EventAction, Fault, Scenario, Source, load};
use skein_common::state::Activity;
use skein_core::agent::Agent;
use skein_core::formation::laws::built_in;
use skein_core::random::{self, Purpose};
use skein_lab::faults::failure_of;
use skein_lab::metrics::{AIRBORNE_ABOVE_M, COLLISION_M, Metrics, Run};
use skein_lab::study::measure;
use skein_lab::world::World;

use crate::{airborne_pairs, in_parallel, median_and_worst, of_scenario};

/// Time after which a mission that has not ended counts as stuck, s.
const LIMIT_S: f64 = 1800.0;
/// Largest wind, m/s.
const STRONGEST_M_S: f64 = 10.0;
/// Largest radius of a formation, m.
const MOST_RADIUS_M: f64 = 110.0;
/// Distance of a fence from the centre's places with which the widest formation is inside, with the airspace's margin, m.
const FENCE_M: f64 = MOST_RADIUS_M + 30.0;
const STARTS: [&str; 3] = ["random", "ring", "line"];
/// Names of the faults, in the order in which they are drawn.
const FAULTS: [&str; 9] =
    ["engine_out", "servo_stuck", "gyro_off", "gps_frozen", "kill", "simulator_freeze", "cut", "delay", "clock_jump"];

/// Names of the faults that break a vehicle for good: it leaves the swarm.
const BREAKING: [&str; 4] = ["engine_out", "servo_stuck", "gyro_off", "gps_frozen"];

/// A random mission, in parts that can be left out.
#[derive(Clone, Debug, PartialEq)]
pub struct Mission {
    seed: u64,
    vehicles: u8,
    /// Keys of the scenario other than those of the mission, each a line of TOML.
    keys: Vec<String>,
    /// The steps before the landing; there is at least one.
    steps: Vec<String>,
    /// Faults, each a table of TOML.
    faults: Vec<String>,
}

/// Evenly distributed random numbers and choices, and the places drawn so far, north and east, m.
struct Draws {
    generator: rand_chacha::ChaCha8Rng,
    places_ne_m: Vec<[f64; 2]>,
}

impl Draws {
    fn between(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * random::uniform(&mut self.generator)
    }

    /// A whole number of this range.
    fn whole(&mut self, from: u8, to: u8) -> u8 {
        self.between(f64::from(from), f64::from(to) + 1.0) as u8
    }

    fn one_of<T: Copy>(&mut self, all: &[T]) -> T {
        all[self.between(0.0, all.len() as f64) as usize]
    }

    fn is_so(&mut self, share: f64) -> bool {
        self.between(0.0, 1.0) < share
    }

    /// A place within 150 m of the origin in each direction, whole metres.
    fn place(&mut self) -> String {
        let [north_m, east_m] = [(); 2].map(|()| self.between(-150.0, 150.0).round());
        self.places_ne_m.push([north_m, east_m]);
        format!("[{north_m:.0}, {east_m:.0}]")
    }
}

impl Mission {
    /// The mission of this seed.
    pub fn random(seed: u64) -> Self {
        let generator = random::generator(seed, None, Purpose::Study);
        let mut draws = Draws { generator, places_ne_m: Vec::new() };
        let vehicles = draws.whole(3, 12);
        let mut keys = random_keys(&mut draws, vehicles);
        let steps = (0..draws.whole(1, 4)).map(|_| random_step(&mut draws)).collect();
        let faults: Vec<_> = (0..draws.whole(0, 4)).map(|_| random_fault(&mut draws, vehicles)).collect();
        keys.extend(random_airspace(&mut draws));
        let faults = faults.into_iter().map(|fault| with_restart(&mut draws, fault)).collect();
        Self { seed, vehicles, keys, steps, faults }
    }

    /// The mission with these keys, steps and faults, each as TOML. A landing follows the steps.
    pub fn of(seed: u64, vehicles: u8, keys: &[&str], steps: &[&str], faults: &[&str]) -> Self {
        let owned = |texts: &[&str]| texts.iter().map(|&text| text.to_owned()).collect();
        Self { seed, vehicles, keys: owned(keys), steps: owned(steps), faults: owned(faults) }
    }

    /// The number of faults.
    pub fn faults(&self) -> usize {
        self.faults.len()
    }

    /// The mission's scenario file.
    pub fn text(&self) -> String {
        let Self { seed, vehicles, keys, steps, faults } = self;
        let list = |items: &[String]| items.iter().map(|item| format!("  {item},\n")).collect::<String>();
        format!(
            "name = \"mission\"\nseed = {seed}\nswarm.vehicles = {vehicles}\n{}\n[mission]\nsteps = [\n{}  {{ land = true }},\n]\nevents = [\n{}]\n",
            keys.join("\n"),
            list(steps),
            list(faults)
        )
    }

    /// The mission's scenario.
    ///
    /// # Panics
    /// If the mission is not a valid scenario.
    pub fn scenario(&self) -> Scenario {
        let text = self.text();
        let loaded = load(&Source { name: "mission", text: &text }, &[]);
        loaded.unwrap_or_else(|error| panic!("{error}\n{text}")).scenario
    }

    /// Every mission that lacks one part of this one.
    fn smaller(&self) -> Vec<Self> {
        let mut all = Vec::new();
        all.extend((0..self.faults.len()).map(|nth| without(self, nth, |mission| &mut mission.faults)));
        all.extend((0..self.steps.len()).map(|nth| without(self, nth, |mission| &mut mission.steps)));
        all.extend((0..self.keys.len()).map(|nth| without(self, nth, |mission| &mut mission.keys)));
        all.retain(|mission| !mission.steps.is_empty());
        all
    }

    /// The smallest mission that still fails: no part of it can be left out.
    #[must_use]
    pub fn minimal(&self) -> Self {
        let mut mission = self.clone();
        while let Some(smaller) = mission.smaller().into_iter().find(|smaller| !fly(smaller).is_sound()) {
            mission = smaller;
        }
        mission
    }
}

fn without(mission: &Mission, nth: usize, part: fn(&mut Mission) -> &mut Vec<String>) -> Mission {
    let mut smaller = mission.clone();
    part(&mut smaller).remove(nth);
    smaller
}

fn random_keys(draws: &mut Draws, vehicles: u8) -> Vec<String> {
    let wind_m_s = draws.between(0.0, STRONGEST_M_S);
    // The area of a flock has room for all vehicles at the distance that its law keeps.
    let least_radius_m = 20.0 + 15.0 * f64::from(vehicles).sqrt();
    let mut keys = vec![
        format!("formation.law = \"{}\"", draws.one_of(&built_in())),
        format!("formation.radius_m = {:.0}", draws.between(least_radius_m, MOST_RADIUS_M)),
        format!("formation.altitude_m = {:.0}", draws.between(15.0, 60.0)),
        format!("start.pattern = \"{}\"", draws.one_of(&STARTS)),
        format!("world.wind_m_s = {wind_m_s:.1}"),
        format!("world.wind_from_deg = {:.0}", draws.between(0.0, 360.0)),
        format!("world.gust_w20_m_s = {:.1}", draws.between(0.0, wind_m_s)),
    ];
    if draws.is_so(0.5) {
        keys.push(format!("network.loss = {:.2}", draws.between(0.0, 0.3)));
        if draws.is_so(0.5) {
            keys.push(format!("network.burst_s = {:.1}", draws.between(0.1, 1.0)));
        }
    }
    if draws.is_so(0.5) {
        keys.push(format!("network.delay_s = {:.2}", draws.between(0.0, 0.3)));
        keys.push(format!("network.jitter_s = {:.2}", draws.between(0.0, 0.2)));
    }
    keys
}

/// For half of the missions a fence about all places so far, and for half of these a ceiling.
fn random_airspace(draws: &mut Draws) -> Vec<String> {
    let mut keys = Vec::new();
    if draws.is_so(0.5) {
        // The swarm takes off about the origin.
        draws.places_ne_m.push([0.0; 2]);
        let [[south_m, north_m], [west_m, east_m]] = [0, 1].map(|axis| {
            let along_m = draws.places_ne_m.iter().map(|place_ne_m| place_ne_m[axis]);
            let (least_m, most_m) = (along_m.clone().fold(0.0, f64::min), along_m.fold(0.0, f64::max));
            [least_m - FENCE_M - draws.between(0.0, 50.0), most_m + FENCE_M + draws.between(0.0, 50.0)].map(f64::round)
        });
        keys.push(format!(
            "airspace.fence_ne_m = [[{south_m}, {west_m}], [{south_m}, {east_m}], [{north_m}, {east_m}], [{north_m}, {west_m}]]"
        ));
        if draws.is_so(0.5) {
            keys.push(format!("airspace.ceiling_m = {:.0}", draws.between(75.0, 100.0)));
        }
    }
    keys
}

fn random_step(draws: &mut Draws) -> String {
    match draws.whole(0, 3) {
        0 => format!("{{ hold_s = {:.0} }}", draws.between(5.0, 40.0)),
        1 => {
            let points: Vec<_> = (0..draws.whole(2, 4)).map(|_| draws.place()).collect();
            format!("{{ path_ne_m = [{}], speed_m_s = {:.1} }}", points.join(", "), draws.between(1.0, 3.0))
        }
        2 => {
            let (place, altitude_m) = (draws.place(), draws.between(15.0, 60.0));
            format!("{{ centre_ne_m = {place}, formation = {{ altitude_m = {altitude_m:.0} }} }}")
        }
        _ => format!("{{ centre_ne_m = {} }}", draws.place()),
    }
}

fn random_fault(draws: &mut Draws, vehicles: u8) -> String {
    let name = draws.one_of(&FAULTS);
    let at_s = draws.between(0.0, 200.0);
    let vehicle = draws.whole(1, vehicles);
    let details = match name {
        "servo_stuck" => format!("vehicle = {vehicle}, servo = \"{}\"", draws.one_of(&["roll", "pitch", "collective"])),
        "kill" | "simulator_freeze" => format!("vehicle = {vehicle}, for_s = {:.0}", draws.between(3.0, 20.0)),
        "cut" | "delay" => {
            // The links of some vehicles to the rest.
            let is_some = |id, draws: &mut Draws| id == vehicle || draws.is_so(0.3);
            let (some, rest): (Vec<u8>, Vec<u8>) = (1..=vehicles).partition(|&id| is_some(id, draws));
            let (some, rest) = if rest.is_empty() { (vec![1], (2..=vehicles).collect()) } else { (some, rest) };
            let (some, rest) = if draws.is_so(0.5) { (some, rest) } else { (rest, some) };
            let both_ways = draws.is_so(0.5);
            let delay =
                if name == "delay" { format!(", delay_s = {:.1}", draws.between(0.1, 3.0)) } else { String::new() };
            let for_s = draws.between(3.0, 40.0);
            format!("from = {some:?}, to = {rest:?}, both_ways = {both_ways}, for_s = {for_s:.0}{delay}")
        }
        "clock_jump" => format!("vehicle = {vehicle}, by_s = {:.0}", draws.between(-3600.0, 3600.0)),
        _ => format!("vehicle = {vehicle}"),
    };
    format!("{{ at_s = {at_s:.0}, fault = \"{name}\", {details} }}")
}

/// For a third of the faults that break a vehicle for good, its agent is killed as well, before or after: the new one has to
/// find the fault anew.
fn with_restart(draws: &mut Draws, fault: String) -> String {
    let breaks = BREAKING.iter().any(|name| fault.contains(name));
    if !(breaks && draws.is_so(1.0 / 3.0)) {
        return fault;
    }
    let number = |name: &str| fault.split_once(name).map(|(_, after)| after.trim_start_matches(" = "));
    let vehicle = number("vehicle").and_then(|after| after.split([',', ' ']).next()).unwrap_or("1");
    let (at_s, for_s) = (draws.between(0.0, 240.0), draws.between(3.0, 20.0));
    format!("{fault},\n  {{ at_s = {at_s:.0}, fault = \"kill\", vehicle = {vehicle}, for_s = {for_s:.0} }}")
}

/// What a scenario's faults do to each vehicle.
#[derive(Clone, Debug, Default)]
struct Affected {
    /// Vehicles of which a part fails for good: they leave the swarm.
    broken: BTreeSet<VehicleId>,
    /// Vehicles without an agent or a simulator for a while: nothing controls them meanwhile.
    interrupted: BTreeSet<VehicleId>,
}

impl Affected {
    fn by(scenario: &Scenario) -> Self {
        let mut affected = Self::default();
        for event in &scenario.mission.events {
            let EventAction::Fault(fault) = &event.what else { continue };
            match (fault, failure_of(fault)) {
                (Fault::Kill { vehicle } | Fault::SimulatorFreeze { vehicle }, _) => {
                    affected.interrupted.insert(*vehicle)
                }
                (_, Some((vehicle, name))) if BREAKING.contains(&name) => affected.broken.insert(vehicle),
                _ => false,
            };
        }
        affected
    }

    fn is_healthy(&self, id: VehicleId) -> bool {
        !self.broken.contains(&id) && !self.interrupted.contains(&id)
    }
}

/// Why a healthy vehicle was grounded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Grounded {
    /// Its agent reported a failure that it did not have.
    Failed(Failure),
    /// It landed before the mission's landing.
    Early,
    /// It reached the ground otherwise than by a landing.
    Crashed,
}

/// Result of one mission.
#[derive(Clone, Debug, Default)]
pub struct MissionFlight {
    /// Pairs with at least one healthy vehicle that came closer than the collision distance, with the time, s.
    pub collisions: BTreeMap<(VehicleId, VehicleId), f64>,
    /// Least distance between two airborne vehicles of which one at least is healthy, m.
    pub closest_m: f64,
    /// Healthy vehicles that did not fly the whole mission, with the time, s.
    pub grounded: BTreeMap<(VehicleId, Grounded), f64>,
    /// Least distance of a healthy vehicle inside the fence, m, negative outside; infinite without a fence.
    pub inside_m: f64,
    /// Time from the beginning until every healthy vehicle had landed at the mission's end and every interrupted one was down,
    /// s.
    pub ended_s: Option<f64>,
}

impl MissionFlight {
    /// Whether the mission ended by landing, without a collision, and without a healthy vehicle grounded or outside the fence.
    pub fn is_sound(&self) -> bool {
        let is_safe = self.collisions.is_empty() && self.grounded.is_empty() && self.inside_m > 0.0;
        is_safe && self.ended_s.is_some()
    }
}

impl fmt::Display for MissionFlight {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for ((one, other), t_s) in &self.collisions {
            write!(f, "collision of vehicles {one} and {other} at {t_s:.1} s; ")?;
        }
        for ((id, why), t_s) in &self.grounded {
            write!(f, "vehicle {id} grounded at {t_s:.1} s: {why:?}; ")?;
        }
        if self.inside_m <= 0.0 {
            write!(f, "{:.1} m outside the fence; ", -self.inside_m)?;
        }
        match self.ended_s {
            Some(ended_s) => write!(f, "ended after {ended_s:.0} s"),
            None => write!(f, "did not end"),
        }
    }
}

/// Flies the mission from take-off until every vehicle is down.
///
/// # Panics
/// If the mission is not a valid scenario.
pub fn fly(mission: &Mission) -> MissionFlight {
    let study = of_scenario(mission.scenario());
    let mut world = World::new(&study.scenario, &study.aircraft, &study.rules).expect("a valid scenario");
    let affected = Affected::by(&study.scenario);
    let landing = study.scenario.mission.steps.len() as u32 - 1;
    let mut metrics = Metrics::new(&study.scenario, Run::new(&study.scenario, "study"));
    let mut vehicles = Vec::new();
    let fence_ne_m = &study.scenario.airspace.fence_ne_m;
    let mut flight = MissionFlight { closest_m: f64::INFINITY, inside_m: f64::INFINITY, ..MissionFlight::default() };
    while world.t_s() < LIMIT_S && flight.ended_s.is_none() {
        world.tick();
        let t_s = world.t_s();
        measure(&world, 0.0, &mut metrics, &mut vehicles);
        for (one, other, distance_m) in airborne_pairs(&world) {
            if affected.is_healthy(one) || affected.is_healthy(other) {
                flight.closest_m = flight.closest_m.min(distance_m);
                if distance_m < COLLISION_M {
                    flight.collisions.entry((one, other)).or_insert(t_s);
                }
            }
        }
        let mut ground = |id, why| {
            flight.grounded.entry((id, why)).or_insert(t_s);
        };
        for (id, what) in world.events() {
            if let (EventKind::Failed(failure), true) = (what, affected.is_healthy(id)) {
                ground(id, Grounded::Failed(failure));
            }
        }
        let mut all_down = true;
        for (nth, (id, agent, truth, _)) in world.all_vehicles().enumerate() {
            if affected.broken.contains(&id) {
                continue;
            }
            if affected.interrupted.contains(&id) {
                all_down &= truth.height_m <= AIRBORNE_ABOVE_M && agent.is_some();
                continue;
            }
            let at_ne_m = [truth.position.north_m(), truth.position.east_m()];
            flight.inside_m = flight.inside_m.min(inside_m(fence_ne_m, at_ne_m));
            if metrics.has_crashed(nth) {
                ground(id, Grounded::Crashed);
            }
            let has_landed = agent.is_some_and(|agent| agent.activity() == Activity::Landed);
            let at_end = agent.is_some_and(|agent| agent.at_step() == landing);
            if has_landed && !at_end {
                ground(id, Grounded::Early);
            }
            all_down &= has_landed;
        }
        // Before the first take-off every interrupted vehicle is down. A restarted agent of a broken one joins for ever.
        let joins = |agent: &Agent| agent.activity() == Activity::Joining;
        if all_down && !world.vehicles().any(|(id, agent, ..)| !affected.broken.contains(&id) && joins(agent)) {
            flight.ended_s = Some(t_s);
        }
    }
    flight
}

/// Distance of a place from the sides of the rectangle with these corners, m, negative outside; infinite without corners.
fn inside_m(corners_ne_m: &[[f64; 2]], at_ne_m: [f64; 2]) -> f64 {
    let of_axis = |axis: usize| {
        let along_m = corners_ne_m.iter().map(move |corner| corner[axis]);
        let (least_m, most_m) =
            (along_m.clone().fold(f64::INFINITY, f64::min), along_m.fold(f64::NEG_INFINITY, f64::max));
        (at_ne_m[axis] - least_m).min(most_m - at_ne_m[axis])
    };
    if corners_ne_m.is_empty() { f64::INFINITY } else { of_axis(0).min(of_axis(1)) }
}

/// The table of the missions with these seeds, by the number of faults; then every mission that failed, as small as it can be.
pub fn table(seeds: Range<u64>) -> String {
    let flights = in_parallel(seeds, |seed| {
        let mission = Mission::random(seed);
        let flight = fly(&mission);
        (mission, flight)
    });
    let mut lines = vec![format!(
        "{:>6} {:>8} {:>8} {:>10} {:>9} {:>8} {:>8} {:>8} {:>17}",
        "faults", "missions", "vehicles", "collisions", "closest m", "fence m", "grounded", "ended", "mission s"
    )];
    let of = |faults| flights.iter().filter(move |(mission, _)| mission.faults() == faults);
    lines.extend((0..=4).map(|faults| row(&faults.to_string(), of(faults))));
    lines.push(row("all", flights.iter()));
    let unsound: Vec<_> = flights.iter().filter(|(_, flight)| !flight.is_sound()).collect();
    let smallest = in_parallel(0..unsound.len() as u64, |nth| unsound[nth as usize].0.minimal());
    for ((mission, flight), smallest) in unsound.iter().zip(smallest) {
        lines.push(format!("seed {}: {flight}; as small as it can be: {}", mission.seed, fly(&smallest)));
        lines.push(smallest.text());
    }
    lines.join("\n")
}

fn row<'a>(name: &str, flights: impl Iterator<Item = &'a (Mission, MissionFlight)>) -> String {
    let flights: Vec<_> = flights.collect();
    let sum = |count: fn(&(Mission, MissionFlight)) -> usize| flights.iter().map(|flight| count(flight)).sum::<usize>();
    let least_m =
        |of: fn(&MissionFlight) -> f64| flights.iter().map(|(_, flight)| of(flight)).fold(f64::INFINITY, f64::min);
    format!(
        "{name:>6} {:>8} {:>8} {:>10} {:>9.1} {:>8.1} {:>8} {:>8} {:>17}",
        flights.len(),
        sum(|(mission, _)| mission.vehicles.into()),
        sum(|(_, flight)| flight.collisions.len()),
        least_m(|flight| flight.closest_m),
        least_m(|flight| flight.inside_m),
        sum(|(_, flight)| flight.grounded.len()),
        sum(|(_, flight)| flight.ended_s.is_some().into()),
        median_and_worst(flights.iter().map(|(_, flight)| flight.ended_s)),
    )
}
