//! Measures the figures of a run, with one definition for live runs, recordings and studies.
//!
//! Every figure uses the ground truth of the vehicles ([`VehicleNow::truth`]) and the faults that were really injected
//! ([`InjectedFault`]), never the agents' own estimates. The two exceptions are the formation's centre and the mission step:
//! each vehicle has its own, and no other source knows them.
//!
//! * A **live member** is an active member whose agent runs. Figures of the formation use live members; separations use
//!   all vehicles.
//! * **Settling** figures (`at_altitude_s`, `in_band_s`, `even_*_s`) are the first time after which the condition holds
//!   to the end of the window, or until the first member is at the mission's landing, in the formation of each vehicle's
//!   own step. A condition that never settles gives `null`, and its key is in `never`. In a mission of more than one place it
//!   only gives `null`, because there the swarm has to move on.
//! * Values that an operator sets in flight count from the time at which they take effect: the figures are those of the formation
//!   as each vehicle flies it.
//! * **Steady** figures use the last [`STEADY_S`] of the window and are `null` in a shorter one. Figures of the network
//!   (`union`, `connectivity`, `connected_share`) use all of it.
//! * Separations, collisions, crashes, tilt, and who is a member, in contact or at which step are observed at every step of the
//!   run, fifty times a second; the formation, flocking, the network's graph and effort ten times a second.
//! * Figures of handling (`heading_error_rms_deg`, `max_turn_rate_deg_s`, `stick_saturation`) are those of the vehicle where
//!   each is largest, over its time as a live member in the air in the last [`STEADY_S`] of the window, or in its second half
//!   if that is shorter. A vehicle keeps the heading that its agent found at the start; an external law may turn it,
//!   so that the heading has no error there.
//! * Separations and collisions count pairs of which both vehicles are higher than [`AIRBORNE_ABOVE_M`].
//! * **A centre moves** while a vehicle places it on a path between its two ends. `max_centre_distance_m` is measured
//!   while the member's own centre moves. Under the flocking laws (`flock`, `olfati-saber`, `vasarhelyi`), so is
//!   `band_occupancy`, there the share with ρ ≤ R*. Under these laws `centroid_lag_m`, separations and collisions count
//!   from the first movement on, if the mission has a path: random starts lie closer together and farther out than a
//!   flock may be.
//! * Slots in a line, a V, a grid or a list have neither a distance from the centre nor even angles: those figures are
//!   `null` there. A law of your own is measured like a ring.
//! * `polarization`, `order` and `velocity_correlation` leave out vehicles slower than 0.2 m/s, and instants at which
//!   fewer than two vehicles are faster. SwarmLab counts a vehicle without neighbours as perfectly ordered; here it is
//!   left out.
//! * `collision_risk` is the share of all pairs that are in a collision, averaged over time; `safety` counts the pairs
//!   without a collision in the whole window.
//! * **A step is open** from the moment when every live member has reached or passed it, or when the last member that
//!   had not died. `advance_latency_s` is the longest delay of a member in entering the next step. `setpoints_reached`
//!   are the steps that were open at the end. A member that is carried forward over several steps is late for none of
//!   them.
//! * **Detection**: `detection_s` is the time from a death or a cut until every running agent that had been in contact
//!   with the sender counts it as lost. `rejoin_s` is the time from a restart, or from the end of a detected cut, until
//!   the sender is received again and an active member. A fault that ends before it is detected does not count. A fault
//!   that is not detected within 30 s counts as never detected. A `false_suspicion` is the loss of a sender that lives,
//!   has not left, and has no cut link with the receiver in either direction; the 2 s after a restart or a healed cut
//!   are left out. `response_s` is the time from a vehicle's own failure until that vehicle reports one.
//! * `transient_s` (of evenly spread formations) is the time from a change of the live members, or from a healed cut,
//!   until all are in formation, at their altitude, in the band and even to 10°, and stay so until the next change, cut or step. A formation that has
//!   not settled when the swarm moves on may settle at the next place. A formation that had more than 120 s and did not
//!   settle counts as never settled; with less time it does not count.
//! * A **crash** is a vehicle that was in the air and touches the ground too fast, too far from upright, or without an
//!   agent that lands it (`crashes`); each vehicle counts once. The plant decides how the vehicle moves afterwards;
//!   damage is not modelled.
//! * Otherwise `null` means that a figure does not apply to this run.

pub mod across;
mod ages;
mod crashes;
mod detection;
pub mod figures;
mod fleet;
mod flock;
mod graph;
mod handling;
mod histogram;
pub mod limits;
mod measured;
mod mission;
mod report;
mod run;
mod separation;
mod series;
mod shape;
mod steady;
mod traffic;
mod transient;
mod vehicle;

use std::f64::consts::TAU;
use std::sync::Arc;

use nalgebra::Vector2;
use skein_common::frame::PositionNed;
use skein_common::id::{VehicleId, VehicleSet};
use skein_common::math;
use skein_common::message::EventKind;
use skein_common::scenario::{self, ControlMode, Law, Pattern, Scenario, Setting, Target, Vertical};

use crate::faults::InjectedFault;
use ages::AgeSampling;
pub(crate) use crashes::CrashDetector;
use detection::Detection;
pub use figures::{Direction, Report, VehicleReport, WALL_CLOCK_KEYS};
pub use fleet::{FleetReport, FleetTraffic};
use flock::{Alignment, Following};
pub(crate) use graph::Components;
use graph::Graph;
use handling::Handling;
use histogram::Histogram;
pub use measured::{Measured, Outcome, is_worse, worst_and_median};
use mission::Steps;
pub(crate) use run::spelling;
pub use run::{Run, Wall};
use separation::Separations;
use series::Settling;
pub(crate) use shape::StepShape;
use steady::{Column, MemberSums, SwarmSeries, VehicleSeries};
pub use traffic::{TRAFFIC_FILE, VehicleTraffic, read_traffic, traffic_csv};
use transient::Transients;
use vehicle::Standing;
pub use vehicle::VehicleNow;

/// Length of the end of the window that steady figures use, s.
pub const STEADY_S: f64 = 100.0;
/// Height above which a vehicle counts as airborne, m.
pub const AIRBORNE_ABOVE_M: f64 = 2.0;
/// Distance below which a pair has collided, m.
pub const COLLISION_M: f64 = 2.0;
/// Least time between two observations of the formation, s: half a frame of 50 Hz less than 0.1 s, so that it is observed ten
/// times a second.
const FORMATION_PERIOD_S: f64 = 0.09;
/// The figures of when the formation has settled.
const SETTLING: [&str; 4] = ["at_altitude_s", "in_band_s", "even_10deg_s", "even_5deg_s"];
/// Age of a peer's state, ms, and duration of a step, us, from which on all count as equal.
const LARGEST_AGE_MS: u32 = 10_000;
const LARGEST_STEP_US: u32 = 100_000;
/// Error of the altitude, as a share of it, within which a vehicle is at its altitude.
const ALTITUDE_TOLERANCE: f64 = 0.1;

/// Measures a run while it flies.
#[derive(Debug)]
pub struct Metrics {
    run: Run,
    /// Whether a central controller flies all vehicles: then peers' messages have no age.
    is_central: bool,
    is_flock: bool,
    /// Whether the formation defines a distance from the centre.
    is_radial: bool,
    /// Whether the formation is a ring, or slots on a ring: seen from above, evenly spread about the centre.
    is_round: bool,
    has_altitude: bool,
    /// The formation in each step of the mission.
    shapes: Vec<StepShape>,
    /// The scenario as written, without the parts on which no formation depends.
    written: Box<Scenario>,
    /// The formations of the vehicles that fly values which an operator has set, by their places in the order of ids.
    tuned: Vec<Option<Tuned>>,
    /// Number of mission steps that are not a landing.
    places: usize,
    /// The mission step that is a landing.
    landing: Option<usize>,
    t_s: f64,
    /// Earliest time of the next observation of the formation, s.
    next_formation_s: f64,
    /// Time of the last observation of the formation, s.
    formation_s: f64,
    /// In the order of [`SETTLING`].
    settling: [Settling; SETTLING.len()],
    series: SwarmSeries,
    vehicle_series: VehicleSeries,
    following: Following,
    alignment: Alignment,
    graph: Graph,
    steps: Steps,
    forced_advances: u64,
    detection: Detection,
    transients: Transients,
    crashes: Vec<CrashDetector>,
    handling: Handling,
    separations: Separations,
    max_tilt_rad: f64,
    stick_square: series::Mean,
    effort: Vec<Effort>,
    ages_ms: Histogram,
    sampling: AgeSampling,
    steps_us: Histogram,
    /// The vehicles' standings at the last observation.
    standings: Vec<Standing>,
    /// Indices of the live members among the vehicles at the last observation.
    members: Vec<usize>,
    /// Bearings of the members from their centres, if the formation is round, rad.
    bearings: Vec<f64>,
    totals: Totals,
}

/// The formations of a vehicle that flies values which an operator has set.
#[derive(Clone, Debug)]
struct Tuned {
    settings: Vec<Setting>,
    shapes: Arc<[StepShape]>,
}

/// Counters of all agents together since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Totals {
    /// State messages sent.
    pub state_messages: u64,
    /// Payload of those messages, bytes.
    pub state_bytes: u64,
    /// Number of times that safety filters have changed a command; `None` without filters.
    pub safety_activations: Option<u64>,
    /// Queries that external laws have not answered; `None` without such laws.
    pub law_misses: Option<u64>,
    /// Steps that ended after the next frame was due; under a central controller, the frames that it skipped.
    pub frame_overruns: u64,
}

/// Energy and control activity of one vehicle.
#[derive(Clone, Copy, Debug, Default)]
struct Effort {
    energy_j: Option<f64>,
    stick_square: series::Mean,
    /// Share of its observations as a live member with an external law in which the fallback flew in the place of that
    /// law.
    fallback: series::Mean,
}

impl Metrics {
    /// Metrics of a run that has not begun.
    pub fn new(scenario: &Scenario, run: Run) -> Self {
        let vehicles = scenario.swarm.vehicles;
        let steps = &scenario.mission.steps;
        let scenario::Formation { law, vertical, ref slots, .. } = scenario.formation;
        let is_radial = !law.has_slots() || slots.pattern == Pattern::Circle;
        Self {
            run,
            is_central: scenario.control.mode == ControlMode::Central,
            is_flock: law.is_flock(),
            is_radial,
            has_altitude: vertical == Vertical::Bands,
            is_round: !law.is_flock() && is_radial && vertical == Vertical::Bands,
            shapes: steps.iter().map(StepShape::new).collect(),
            written: Box::new(without_vehicles(scenario)),
            tuned: Vec::new(),
            places: steps.iter().filter(|step| !matches!(step.target, Target::Land(_))).count(),
            landing: steps.iter().position(|step| matches!(step.target, Target::Land(_))),
            t_s: 0.0,
            next_formation_s: 0.0,
            formation_s: 0.0,
            settling: Default::default(),
            series: SwarmSeries::default(),
            vehicle_series: VehicleSeries::new(vehicles, steps.first().map_or(0.0, |step| step.formation.radius_m)),
            following: Following::default(),
            alignment: Alignment::default(),
            graph: Graph::default(),
            steps: Steps::new(steps.len(), vehicles),
            forced_advances: 0,
            detection: Detection::new(vehicles, scenario.network.fade_m.or(scenario.network.range_m)),
            transients: Transients::default(),
            crashes: vec![CrashDetector::default(); vehicles],
            handling: Handling::new(vehicles, law != Law::External),
            separations: Separations::new(vehicles),
            max_tilt_rad: 0.0,
            stick_square: series::Mean::default(),
            effort: vec![Effort::default(); vehicles],
            ages_ms: Histogram::new(LARGEST_AGE_MS),
            sampling: AgeSampling::new(vehicles),
            steps_us: Histogram::new(LARGEST_STEP_US),
            standings: Vec::with_capacity(vehicles),
            members: Vec::with_capacity(vehicles),
            bearings: Vec::with_capacity(vehicles),
            totals: Totals::default(),
        }
    }

    /// Observes all vehicles with a known state, in the order of ids, `t_s` seconds into the window.
    ///
    /// Call it about fifty times a second, after the faults and events until then.
    pub fn observe(&mut self, t_s: f64, vehicles: &[VehicleNow]) {
        self.t_s = t_s;
        self.sampling.next_step();
        let is_change = self.observe_standings(vehicles);
        if is_change || !self.detection.is_settled {
            self.detection.observe(t_s, vehicles);
        }
        if is_change {
            self.steps.observe(t_s, vehicles);
        }
        for vehicle in vehicles {
            self.crashes.get_mut(index(vehicle.id)).into_iter().for_each(|crash| crash.look_at(vehicle));
            if vehicle.runs {
                let attitude = &vehicle.truth.attitude;
                self.max_tilt_rad = self.max_tilt_rad.max(attitude.roll_rad.abs()).max(attitude.pitch_rad.abs());
            }
        }
        if self.observes_formation(t_s) {
            self.next_formation_s = t_s + FORMATION_PERIOD_S;
            self.observe_formation(t_s, vehicles);
        }
        let has_path = self.shapes.iter().any(|shape| shape.path_ends.is_some());
        self.separations.observe(vehicles, !self.is_flock || !has_path || self.following.has_begun);
    }

    /// Updates the figures of the formation, of flocking, of the network's graph and of effort.
    fn observe_formation(&mut self, t_s: f64, vehicles: &[VehicleNow]) {
        let since_s = t_s - std::mem::replace(&mut self.formation_s, t_s);
        self.series.begin(t_s);
        self.vehicle_series.begin(t_s);
        self.alignment.observe(&mut self.series, vehicles, &self.members);
        self.graph.observe(&mut self.series, vehicles, &self.members, &self.alignment.moving);
        self.observe_members(t_s, vehicles);
        self.handling.observe(t_s, vehicles);
        self.observe_effort(since_s, vehicles);
    }

    /// Observes a fault that was injected into the swarm.
    pub fn fault(&mut self, t_s: f64, fault: &InjectedFault) {
        match fault {
            InjectedFault::Died(id) => self.detection.died(t_s, *id),
            InjectedFault::Restarted(id) => {
                self.detection.restarted(t_s, *id);
                self.handling.restarted(*id);
            }
            InjectedFault::Failed(id, ..) => self.detection.failed(t_s, *id),
            InjectedFault::Cut { links } => self.detection.cut(t_s, links),
            InjectedFault::Healed { links } => self.detection.healed(t_s, links),
            InjectedFault::Delayed { .. } | InjectedFault::DelayOver { .. } => {}
        }
    }

    /// Observes an event that a vehicle reported of itself.
    pub fn observe_event(&mut self, t_s: f64, sender: VehicleId, what: &EventKind) {
        self.forced_advances += u64::from(matches!(what, EventKind::ForcedAdvance { .. }));
        self.detection.reported(t_s, sender, what);
    }

    /// The peers of which ages are to be observed at the next observation.
    pub fn sampled(&self) -> VehicleSet {
        self.sampling.now()
    }

    /// Whether the observation at this time also observes the formation: only then it looks at [`VehicleNow::fresh`].
    pub fn observes_formation(&self, t_s: f64) -> bool {
        t_s >= self.next_formation_s
    }

    /// Observes the age of a peer's newest state at one step, s, by the receiver's clock. Leave out lost peers.
    pub fn observe_age(&mut self, age_s: f64) {
        if !self.is_central {
            self.ages_ms.add(age_s * 1e3);
        }
    }

    /// Observes the time from a frame's arrival to its last control, µs.
    pub fn observe_step(&mut self, step_us: f64) {
        self.steps_us.add(step_us);
    }

    /// Takes the present values of the keys that operators have set in flight, as this vehicle flies them. From then on the
    /// figures are those of the formation with these values.
    pub fn set_values(&mut self, id: VehicleId, settings: &[Setting]) {
        let nth = index(id);
        let known = self.tuned.get(nth).and_then(Option::as_ref);
        if known.map_or(&[][..], |known| known.settings.as_slice()) == settings {
            return;
        }
        if self.tuned.len() <= nth {
            self.tuned.resize(nth + 1, None);
        }
        // Vehicles that know the same settings fly the same formation.
        let same = self.tuned.iter().flatten().find(|other| other.settings == settings).cloned();
        self.tuned[nth] = same.or_else(|| {
            let tuned = (!settings.is_empty()).then(|| self.written.with_settings(settings))?;
            let shapes = tuned.mission.steps.iter().map(StepShape::new).collect();
            Some(Tuned { settings: settings.to_vec(), shapes })
        });
    }

    /// Replaces the totals over all vehicles since the start.
    pub fn set_totals(&mut self, totals: Totals) {
        self.totals = totals;
    }

    /// Whether the vehicle at this place in the order of ids has crashed so far.
    pub fn has_crashed(&self, nth: usize) -> bool {
        self.crashes.get(nth).is_some_and(|crash| crash.has_crashed)
    }

    /// Time of the last observation, from the start of the window, s.
    pub fn t_s(&self) -> f64 {
        self.t_s
    }

    /// Updates the live members; returns whether the standing of any vehicle has changed since the last observation.
    fn observe_standings(&mut self, vehicles: &[VehicleNow]) -> bool {
        let standings = || vehicles.iter().map(Standing::of);
        if standings().eq(self.standings.iter().copied()) {
            return false;
        }
        self.standings.clear();
        self.standings.extend(standings());
        self.members.clear();
        self.members.extend((0..vehicles.len()).filter(|&nth| vehicles[nth].is_live_member()));
        true
    }

    /// Updates the figures that depend on the members' positions.
    fn observe_members(&mut self, t_s: f64, vehicles: &[VehicleNow]) {
        let members = || self.members.iter().map(|&nth| &vehicles[nth]);
        let count = self.members.len();
        let middle_rank = (count as f64 - 1.0) / 2.0;
        let (mut high, mut inside, mut sum_ne_m) = (true, true, Vector2::zeros());
        let mut sums = MemberSums::default();
        self.bearings.clear();
        for (rank, member) in members().enumerate() {
            let tuned = self.tuned.get(index(member.id)).and_then(Option::as_ref);
            let shapes = tuned.map_or(self.shapes.as_slice(), |tuned| &tuned.shapes);
            let Some(shape) = shapes.get(member.step as usize) else { continue };
            let centre = PositionNed::new(member.centre_ne_m.x, member.centre_ne_m.y, -shape.altitude_m);
            let from_centre_m = member.truth.position - centre;
            let from_centre_ne_m = from_centre_m.xy();
            let (rho_m, is_inside) = shape.level_and_inside(from_centre_m);
            let altitude_m = member.truth.position.altitude_m();
            let target_altitude_m = shape.altitude_m(rank as f64 - middle_rank);
            high &= target_altitude_m.is_some_and(|target_altitude_m| {
                (altitude_m - target_altitude_m).abs() <= ALTITUDE_TOLERANCE * target_altitude_m
            });
            inside &= is_inside;
            sum_ne_m += from_centre_ne_m;
            if self.is_round {
                self.bearings.push(math::atan2(from_centre_ne_m.y, from_centre_ne_m.x));
            }
            if shape.is_moving(member.centre_ne_m) {
                self.following.follow(from_centre_ne_m.norm(), is_inside);
            }
            let altitude_error_m = target_altitude_m.map(|target_altitude_m| altitude_m - target_altitude_m);
            sums.add(rho_m, shape.ring.radius_m, altitude_error_m, is_inside);
            self.vehicle_series.add(index(member.id), rho_m, shape.ring.radius_m);
        }
        if count > 0 {
            let lag_m = sum_ne_m.norm() / count as f64;
            self.series.set(Column::CentroidLag, lag_m);
            self.following.trail(lag_m);
        }
        self.series.set_members(&sums);
        let lands = self.lands(vehicles);
        self.settle(t_s, lands, [count > 0 && high, count > 0 && inside], members().map(|member| member.step).max());
    }

    /// Whether a live member is at the mission's landing or, where none is left, another vehicle. A swarm that lands leaves its
    /// formation, however settled it was.
    fn lands(&self, vehicles: &[VehicleNow]) -> bool {
        let is_at_landing = |vehicle: &VehicleNow| vehicle.runs && Some(vehicle.step as usize) == self.landing;
        match self.members.as_slice() {
            [] => vehicles.iter().any(is_at_landing),
            members => members.iter().any(|&nth| is_at_landing(&vehicles[nth])),
        }
    }

    /// Updates the settling figures, unless the swarm `lands`, with the conditions that hold now: whether all are at their
    /// altitude, and in the band. `step` is the highest step of a member.
    fn settle(&mut self, t_s: f64, lands: bool, [high, inside]: [bool; 2], step: Option<u32>) {
        let deviation_deg = largest_gap_deviation_rad(&mut self.bearings).map(f64::to_degrees);
        let is_even_to = |most_deg: f64| deviation_deg.is_some_and(|deviation_deg| deviation_deg < most_deg);
        let holds = [high, inside && self.is_radial, is_even_to(10.0), is_even_to(5.0)];
        if !lands {
            self.settling.iter_mut().zip(holds).for_each(|(settling, holds)| settling.observe(t_s, holds));
        }
        self.series.set(Column::Spacing, deviation_deg);
        // A single vehicle has no gaps.
        let is_even = deviation_deg.is_none() || is_even_to(10.0);
        let (members, is_split) = (self.detection.members, self.detection.is_split());
        // On an ellipsoid any altitude is one of the formation's.
        let is_high = high || !self.has_altitude;
        self.transients.observe(t_s, members, is_split, step, is_high && inside && is_even);
    }

    /// Updates the figures of energy and control activity, with the power and the controls of the last `since_s`, s.
    fn observe_effort(&mut self, since_s: f64, vehicles: &[VehicleNow]) {
        for vehicle in vehicles.iter().filter(|vehicle| vehicle.runs) {
            let Some(effort) = self.effort.get_mut(index(vehicle.id)) else { continue };
            if let Some(power_w) = vehicle.truth.power_w {
                *effort.energy_j.get_or_insert(0.0) += power_w * since_s;
            }
            if let Some(controls) = vehicle.controls {
                let square =
                    (math::square(controls.roll) + math::square(controls.pitch) + math::square(controls.yaw)) / 3.0;
                effort.stick_square.add(square);
                self.stick_square.add(square);
            }
            if let Some(fallback_flies) = vehicle.fallback_flies.filter(|_| vehicle.is_live_member()) {
                effort.fallback.add(f64::from(fallback_flies));
            }
        }
    }
}

/// The scenario without the parts on which no formation depends.
fn without_vehicles(scenario: &Scenario) -> Scenario {
    let mut written = scenario.clone();
    (written.vehicle, written.mission.events) = (Vec::new(), Vec::new());
    written
}

/// Index of the vehicle in tables in the order of ids.
fn index(id: VehicleId) -> usize {
    usize::from(id.get()) - 1
}

/// Largest deviation of a gap between neighbouring bearings from the even gap, rad; `None` for fewer than two bearings.
///
/// Sorts the bearings.
pub fn largest_gap_deviation_rad(bearings_rad: &mut [f64]) -> Option<f64> {
    let count = bearings_rad.len();
    if count < 2 {
        return None;
    }
    bearings_rad.sort_unstable_by(f64::total_cmp);
    let even = TAU / count as f64;
    let across = bearings_rad[0] + TAU - bearings_rad[count - 1];
    let within = bearings_rad.windows(2).map(|pair| pair[1] - pair[0]);
    Some(within.chain([across]).map(|gap| (gap - even).abs()).fold(0.0, f64::max))
}

#[cfg(test)]
mod tests;
