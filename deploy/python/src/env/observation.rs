//! The observations of a world.

use pyo3::prelude::*;
use skein_core::formation::external::LawQuery;
use skein_lab::metrics::{AIRBORNE_ABOVE_M, Metrics};
use skein_lab::world::World;

use super::actor::Action;

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

/// Names of the features of an observation, in order.
#[pyfunction]
pub(crate) fn observation_names(action: Option<&str>, neighbours: usize) -> Vec<String> {
    let attitude = ATTITUDE.iter().filter(|_| action == Some("controls"));
    let own = OWN.iter().chain(attitude).map(|name| (*name).to_owned());
    let of_each = (1..=neighbours).flat_map(|nth| NEIGHBOUR.map(|name| format!("neighbour_{nth}_{name}")));
    own.chain(of_each).collect()
}

/// Numbers of an observation of one vehicle.
pub(super) fn features(action: Action, neighbours: usize) -> usize {
    let attitude = if action == Action::Controls { ATTITUDE.len() } else { 0 };
    OWN.len() + attitude + neighbours * NEIGHBOUR.len()
}

/// Flat arrays of all worlds, or their parts that belong to one.
pub(super) struct Room<'a> {
    pub(super) observations: &'a mut [f64],
    pub(super) positions: &'a mut [f64],
    pub(super) velocities: &'a mut [f64],
    pub(super) separations: &'a mut [f64],
    pub(super) crashed: &'a mut [bool],
}

/// The things that an observation is made of.
pub(super) struct Look<'a> {
    /// Altitude and radius of the formation in each step of the mission, m.
    pub(super) goals: &'a [(f64, f64)],
    pub(super) queries: &'a [Option<(LawQuery, bool)>],
    pub(super) neighbours: usize,
}

/// Position and velocity, north, east, down, m and m/s.
type State = ([f64; 3], [f64; 3]);

impl Look<'_> {
    /// Fills the room of one world.
    pub(super) fn fill(&self, action: Action, world: &World, metrics: &Metrics, room: Room<'_>) {
        // The frame at which the agents have stepped last, and so that of their estimates. A pilot of the controls acts in
        // place of an agent, on the frame that comes next.
        let frames: Vec<_> =
            if action == Action::Controls { world.frames().map(|(.., frame)| frame).collect() } else { Vec::new() };
        let vehicles: Vec<_> = world.all_vehicles().map(|(_, agent, truth, _)| (agent, truth)).collect();
        let truth = |nth: usize| frames.get(nth).map_or(vehicles[nth].1, |frame| &frame.truth);
        let truths: Vec<State> =
            (0..vehicles.len()).map(|nth| (truth(nth).position.0.into(), truth(nth).velocity.0.into())).collect();
        let is_airborne = |nth: usize| truth(nth).height_m > AIRBORNE_ABOVE_M;
        let features = room.observations.len() / vehicles.len().max(1);
        let mut near: Vec<(f64, State)> = Vec::with_capacity(vehicles.len());
        for (nth, (agent, _)) in vehicles.iter().enumerate() {
            room.positions[3 * nth..][..3].copy_from_slice(&truths[nth].0);
            room.velocities[3 * nth..][..3].copy_from_slice(&truths[nth].1);
            room.crashed[nth] = metrics.has_crashed(nth);
            let others = || (0..vehicles.len()).filter(move |&other| other != nth);
            let apart = others().filter(|&other| is_airborne(nth) && is_airborne(other));
            let nearest = apart.map(|other| squared_m2(&truths[nth], &truths[other])).fold(f64::INFINITY, f64::min);
            room.separations[nth] = nearest.sqrt();
            let out = &mut room.observations[nth * features..][..features];
            near.clear();
            match self.queries.get(nth).and_then(Option::as_ref) {
                Some((query, _)) => {
                    let own = (query.own.position.into(), query.own.velocity.into());
                    let goal = (query.goal.centre.into(), query.goal.centre_velocity.into());
                    write_own(out, &own, &goal, [query.own.heading_rad, query.goal.radius_m]);
                    let peers = query.peers.iter().map(|peer| (peer.position.into(), peer.velocity.into()));
                    near.extend(peers.map(|peer| (squared_m2(&own, &peer), peer)));
                    write_neighbours(&mut out[OWN.len()..], &own, &mut near, self.neighbours);
                }
                None => {
                    let step = agent.map_or(0, |agent| agent.at_step() as usize);
                    let (altitude_m, radius_m) = self.goals.get(step).copied().unwrap_or_default();
                    let centre = agent.map(|agent| (agent.centre_ne_m(), agent.centre_velocity_ne_m_s()));
                    let (centre, velocity) = centre.unwrap_or_default();
                    let goal = ([centre.x, centre.y, -altitude_m], [velocity.x, velocity.y, 0.0]);
                    write_own(out, &truths[nth], &goal, [truth(nth).attitude.heading_rad, radius_m]);
                    let mut end = OWN.len();
                    if let Some(frame) = frames.get(nth) {
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
