//! The page's view of a swarm or fleet at one instant: the JSON of a snapshot, and the places of a large swarm as bytes.

use std::collections::BTreeSet;
use std::time::Duration;

use nalgebra::Vector2;
use serde::{Serialize, Serializer};
use serde_json::{Value, json};
use skein_common::frame::{Attitude, Origin, PositionNed, VelocityNed};
use skein_common::id::{TeamId, VehicleId, VehicleName};
use skein_common::message::{FactValues, VehicleFacts};
use skein_common::scenario::{Formation, SafetyFilter, Scenario};
use skein_common::state::{Activity, Membership, PeerStatus};
use skein_lab::record::PlayedPlace;

use skein_cluster::display::status::{self, Known, Row};

/// A swarm with more vehicles is shown by the places of all and the details of those that a page asks for.
pub(super) const LARGE: usize = 100;
/// A vehicle out of contact is dead-reckoned with its last velocity for at most this time, s.
const DEAD_RECKONED_S: f64 = 5.0;
/// In a swarm with more vehicles than this, distances to the nearest are left out: there are too many pairs.
const MOST_NEAREST: usize = 600;

/// A swarm, or a team of a fleet, with what does not change in flight.
pub(super) struct Team {
    /// The scenario that it flies.
    pub(super) scenario: Scenario,
    /// Origins of the team's frame and of the fleet's; `None` for a swarm that flies alone.
    frames: Option<(Origin, Origin)>,
}

impl Team {
    pub(super) fn new(scenario: &Scenario) -> Self {
        let origin = |settings: &skein_common::scenario::OriginSettings| Origin::new(settings.geodetic());
        let frames = scenario.team.map(|team| (origin(&scenario.origin), origin(&team.origin)));
        Self { scenario: scenario.clone(), frames }
    }

    /// The team's number; `None` for a swarm that flies alone.
    pub(super) fn id(&self) -> Option<TeamId> {
        self.scenario.team.map(|team| team.id)
    }

    pub(super) fn name(&self, vehicle: VehicleId) -> VehicleName {
        VehicleName { team: self.id(), vehicle }
    }

    /// A position of the team's frame in the frame of the page, which is the fleet's.
    pub(super) fn to_page(&self, position: PositionNed) -> PositionNed {
        let Some((own, fleet)) = &self.frames else { return position };
        fleet.ned_from_geodetic(&own.geodetic_from_ned(position))
    }

    /// Velocity and attitude of a vehicle at a position, all of the team's frame, in the frame of the page.
    fn motion_to_page(
        &self,
        position: PositionNed,
        velocity: VelocityNed,
        attitude: Attitude,
    ) -> (VelocityNed, Attitude) {
        let Some((own, fleet)) = &self.frames else { return (velocity, attitude) };
        let (place, of_team) = own.place(position);
        let of_fleet = fleet.convergence_at(&place);
        let velocity = of_fleet.velocity_from_local(of_team.velocity_to_local(velocity));
        (velocity, of_fleet.attitude_from_local(of_team.attitude_to_local(attitude)))
    }
}

/// The level of a status or of one of its reasons, from good to bad.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Level {
    Ok,
    Warn,
    Bad,
}

/// The status of a swarm.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Status {
    pub(super) level: Level,
    /// One line with the most important figures.
    pub(super) text: String,
    /// The reasons why the level is not [`Level::Ok`], the worst first.
    pub(super) reasons: Vec<String>,
}

impl Status {
    /// A status without figures.
    pub(super) fn plain(text: String) -> Self {
        Self { level: Level::Ok, text, reasons: Vec::new() }
    }
}

/// A swarm or fleet at one instant.
#[derive(Clone, Debug)]
pub(super) struct Snapshot {
    /// Time of the flight, s; `None` before its start.
    pub(super) t_s: Option<f64>,
    /// The server's time, ms since 1970.
    pub(super) at_ms: u64,
    /// The status of the swarm, in one line.
    pub(super) status: Status,
    /// All vehicles, in the order of the list that the page has received.
    pub(super) vehicles: Vec<Vehicle>,
    /// The teams of a fleet.
    pub(super) teams: Vec<TeamPlace>,
}

/// A team of a fleet at one instant.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct TeamPlace {
    id: TeamId,
    centre_ne_m: [f64; 2],
    step: Option<u32>,
    /// The formation of its step as an operator has changed it in flight; `None` as the scenario has it.
    #[serde(skip_serializing_if = "Option::is_none")]
    formation: Option<Value>,
}

/// One vehicle at one instant.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct Vehicle {
    pub(super) id: String,
    pub(super) contact: bool,
    pub(super) silent_s: Option<f64>,
    pub(super) phase: Option<String>,
    /// Time for which it has been in formation without interruption, s; `None` while it is not.
    pub(super) in_place_s: Option<f64>,
    pub(super) membership: Option<&'static str>,
    pub(super) step: Option<u32>,
    pub(super) reached: Option<u32>,
    pub(super) live: Option<u8>,
    pub(super) ne_m: Option<[f64; 2]>,
    pub(super) altitude_m: Option<f64>,
    pub(super) velocity_ned_m_s: Option<[f64; 3]>,
    pub(super) attitude_rad: Option<[f64; 3]>,
    pub(super) centre_ne_m: Option<[f64; 2]>,
    pub(super) distance_m: Option<f64>,
    pub(super) gap_deg: Option<f64>,
    pub(super) gap_error_deg: Option<f64>,
    pub(super) nearest_m: Option<f64>,
    pub(super) nearest: Option<String>,
    pub(super) setpoint_altitude_m: Option<f64>,
    pub(super) field_ne: Option<[f64; 2]>,
    pub(super) error_ne_m: Option<[f64; 2]>,
    pub(super) controls: Option<[f64; 4]>,
    #[serde(flatten, serialize_with = "for_the_page")]
    pub(super) facts: FactValues,
    pub(super) overruns: Option<u64>,
    pub(super) refused: Option<u64>,
    pub(super) unsent: Option<u64>,
    pub(super) failures: Vec<String>,
    pub(super) order: Option<String>,
    pub(super) peers: Vec<(String, u32, &'static str)>,
    /// The formation of its step as an operator has changed it in flight; `None` as the scenario has it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) formation: Option<Value>,
    /// Whether it is where it should be: in its formation, or on the ground after its mission.
    #[serde(skip)]
    is_in_place: bool,
    #[serde(skip)]
    is_landed: bool,
    #[serde(skip)]
    is_on_the_ground: bool,
}

fn for_the_page<S: Serializer>(facts: &FactValues, to: S) -> Result<S::Ok, S::Error> {
    let shown = facts.iter().filter(|(fact, _)| fact.on_page);
    to.collect_map(shown.map(|(fact, value)| (fact.key, value.map(rounded))))
}

/// The message with a snapshot.
#[derive(Serialize)]
#[serde(tag = "type", rename = "snapshot")]
struct Message<'a, F> {
    t_s: Option<f64>,
    at_ms: u64,
    status: &'a Status,
    vehicles: Vec<&'a Vehicle>,
    #[serde(skip_serializing_if = "<[_]>::is_empty")]
    teams: &'a [TeamPlace],
    #[serde(skip_serializing_if = "Option::is_none")]
    field: Option<F>,
}

impl Snapshot {
    /// The JSON message for a page: of a large swarm with the vehicles that it asked for, else with all. `field` is the answer to
    /// a page that asked for the field of a vehicle: `None` inside if the law cannot be evaluated alone.
    pub(super) fn to_json(&self, detail: &BTreeSet<String>, field: Option<&impl Serialize>) -> String {
        let is_wanted = |vehicle: &&Vehicle| self.vehicles.len() <= LARGE || detail.contains(&vehicle.id);
        let vehicles = self.vehicles.iter().filter(is_wanted).collect();
        let Self { t_s, at_ms, status, teams, .. } = self;
        let message = Message { t_s: t_s.map(rounded), at_ms: *at_ms, status, vehicles, teams, field };
        // Structs of numbers and texts always have a JSON form.
        serde_json::to_string(&message).unwrap_or_default()
    }

    /// The places of all vehicles of a large swarm as bytes, little-endian: the magic number, the count, the time in seconds, then
    /// of all vehicles north, east, altitude (m), heading (rad) and flags.
    pub(super) fn places(&self) -> Option<Vec<u8>> {
        if self.vehicles.len() <= LARGE {
            return None;
        }
        let mut bytes = Vec::with_capacity(16 + 17 * self.vehicles.len());
        bytes.extend(0x4e45_4b53_u32.to_le_bytes());
        bytes.extend((self.vehicles.len() as u32).to_le_bytes());
        bytes.extend(self.t_s.unwrap_or(f64::NAN).to_le_bytes());
        let columns: [fn(&Vehicle) -> Option<f64>; 4] = [
            |vehicle| vehicle.ne_m.map(|ne_m| ne_m[0]),
            |vehicle| vehicle.ne_m.map(|ne_m| ne_m[1]),
            |vehicle| vehicle.altitude_m,
            |vehicle| vehicle.attitude_rad.map(|attitude_rad| attitude_rad[2]),
        ];
        for column in columns {
            bytes.extend(
                self.vehicles.iter().flat_map(|vehicle| (column(vehicle).unwrap_or(f64::NAN) as f32).to_le_bytes()),
            );
        }
        bytes.extend(self.vehicles.iter().map(Vehicle::flags));
        Some(bytes)
    }
}

impl Vehicle {
    /// Whether it is in contact and off the ground, by its phase.
    pub(super) fn is_airborne(&self) -> bool {
        self.contact && !self.is_on_the_ground
    }

    /// The flags in the bytes of a large swarm, beside its place.
    fn flags(&self) -> u8 {
        let flags = [
            self.contact,
            self.membership == Some("active"),
            self.is_in_place,
            !self.failures.is_empty(),
            self.is_landed,
        ];
        flags.iter().enumerate().map(|(bit, is_set)| u8::from(*is_set) << bit).sum()
    }

    /// A vehicle of a fleet's recording, which has places only; `None` if it is not in the recording at this time.
    pub(super) fn of_place(name: VehicleName, played: Option<&PlayedPlace>) -> Self {
        let Some(PlayedPlace { place, velocity_ne_m_s }) = played else {
            return Self { id: name.to_string(), ..Self::default() };
        };
        let [north_m_s, east_m_s] = *velocity_ne_m_s;
        let is_moving = Vector2::from(*velocity_ne_m_s).norm() > 0.2;
        let heading_rad = if is_moving { skein_common::math::atan2(east_m_s, north_m_s) } else { 0.0 };
        Self {
            id: name.to_string(),
            contact: true,
            silent_s: Some(0.0),
            step: Some(place.step),
            ne_m: Some([rounded(place.north_m), rounded(place.east_m)]),
            altitude_m: Some(rounded(place.altitude_m)),
            velocity_ned_m_s: Some([rounded(north_m_s), rounded(east_m_s), 0.0]),
            attitude_rad: Some([0.0, 0.0, rounded(heading_rad)]),
            is_in_place: place.in_place,
            ..Self::default()
        }
    }
}

/// The vehicles of a team, and their rows in the table of `fly`.
pub(super) fn vehicles(team: &Team, observed: &[Known]) -> (Vec<Row>, Vec<Vehicle>) {
    let rows = status::rows(observed, &team.scenario);
    let vehicles = observed.iter().zip(&rows).map(|(vehicle, row)| of_sample(team, vehicle, row)).collect();
    (rows, vehicles)
}

fn of_sample(team: &Team, known: &Known, row: &Row) -> Vehicle {
    let id = team.name(known.id).to_string();
    let Some((sample, silent)) = &known.newest else {
        return Vehicle { id, phase: Some(row.phase.clone()), ..Vehicle::default() };
    };
    let contact = known.flying().is_some();
    let position = team.to_page(if contact { sample.place() } else { dead_reckoned(sample, *silent) });
    let [north_m, east_m] = sample.centre_ne_m;
    let centre = team.to_page(PositionNed::new(north_m, east_m, 0.0));
    let (velocity, attitude) = team.motion_to_page(sample.place(), sample.velocity, sample.attitude);
    let process = sample.process;
    // The formation of this vehicle's step, if an operator has changed it in flight.
    let formation = team.scenario.formation_with(sample.step, &sample.settings);
    let formation = formation.filter(|_| !sample.settings.is_empty());
    Vehicle {
        id,
        contact,
        silent_s: Some(rounded(silent.as_secs_f64())),
        phase: Some(sample.activity.to_string()),
        in_place_s: row.in_place_s.map(rounded),
        membership: Some(membership(sample.membership)),
        step: Some(sample.step),
        reached: sample.reached,
        live: Some(sample.live),
        ne_m: Some([rounded(position.north_m()), rounded(position.east_m())]),
        altitude_m: Some(rounded(sample.place().altitude_m())),
        velocity_ned_m_s: Some(<[f64; 3]>::from(velocity).map(rounded)),
        attitude_rad: Some([attitude.roll_rad, attitude.pitch_rad, attitude.heading_rad].map(rounded)),
        centre_ne_m: Some([rounded(centre.north_m()), rounded(centre.east_m())]),
        distance_m: row.from_centre_m.map(rounded),
        gap_deg: row.gap_deg.map(|(gap_deg, _)| rounded(gap_deg)),
        gap_error_deg: row.gap_deg.map(|(_, excess_deg)| rounded(excess_deg)),
        setpoint_altitude_m: sample.altitude_setpoint_m.map(rounded),
        field_ne: sample.field_ne.map(|field| field.map(rounded)),
        error_ne_m: sample.error_ne_m.map(|error| error.map(rounded)),
        controls: sample.controls.map(|controls| controls.map(rounded)),
        facts: FactValues::of(sample),
        overruns: process.map(|process| process.frame_overruns),
        refused: process.map(|process| process.dropped),
        unsent: process.map(|process| process.unsent),
        failures: sample.failures.iter().map(ToString::to_string).collect(),
        order: known.order.map(|verb| verb.to_string()),
        peers: sample
            .peers
            .iter()
            .map(|peer| (team.name(peer.id).to_string(), peer.age_ms, standing(peer.standing)))
            .collect(),
        formation: formation.map(|formation| drawn_formation(&formation)),
        // Filled in by `add_nearest`.
        nearest_m: None,
        nearest: None,
        is_in_place: sample.in_place_s.is_some() || sample.activity == Activity::Landed,
        is_landed: sample.activity == Activity::Landed,
        is_on_the_ground: matches!(sample.activity, Activity::Landed | Activity::Joining),
    }
}

/// The probable position of a vehicle that has been silent for this time.
fn dead_reckoned(sample: &VehicleFacts, silent: Duration) -> PositionNed {
    let moved = if sample.activity == Activity::Landed { 0.0 } else { silent.as_secs_f64().min(DEAD_RECKONED_S) };
    let mut position = sample.place() + sample.velocity.0 * moved;
    position.0.z = sample.place().0.z;
    position
}

/// Adds to each vehicle in contact which other one is the nearest.
pub(super) fn add_nearest(vehicles: &mut [Vehicle]) {
    let there = |vehicle: &Vehicle| {
        let ([north_m, east_m], altitude_m) = vehicle.ne_m.zip(vehicle.altitude_m)?;
        vehicle.contact.then_some(PositionNed::new(north_m, east_m, -altitude_m))
    };
    if vehicles.len() > MOST_NEAREST {
        return;
    }
    let places: Vec<(usize, PositionNed)> =
        vehicles.iter().enumerate().filter_map(|(nth, vehicle)| Some((nth, there(vehicle)?))).collect();
    for (nth, own) in &places {
        let others = places.iter().filter(|(other, _)| other != nth);
        let distances = others.map(|(other, place)| (*other, (*place - *own).norm()));
        if let Some((other, distance_m)) = distances.min_by(|one, other| one.1.total_cmp(&other.1)) {
            let id = vehicles[other].id.clone();
            (vehicles[*nth].nearest_m, vehicles[*nth].nearest) = (Some(rounded(distance_m)), Some(id));
        }
    }
}

/// The place of a team of a fleet: the centre that its first vehicle in contact follows, and the least step.
pub(super) fn team_place(team: &Team, vehicles: &[Vehicle]) -> Option<TeamPlace> {
    let id = team.id()?;
    let centre = vehicles.iter().filter(|vehicle| vehicle.contact).find_map(|vehicle| vehicle.centre_ne_m);
    let step = vehicles.iter().filter(|vehicle| vehicle.contact).filter_map(|vehicle| vehicle.step).min();
    let mean = || {
        let places: Vec<_> = vehicles.iter().filter_map(|vehicle| vehicle.ne_m).collect();
        let sum = |axis: usize| places.iter().map(|place| place[axis]).sum::<f64>();
        let count = places.len() as f64;
        (!places.is_empty()).then(|| [rounded(sum(0) / count), rounded(sum(1) / count)])
    };
    let leading = vehicles.iter().filter(|vehicle| vehicle.contact && vehicle.step == step);
    let formation = leading.filter_map(|vehicle| vehicle.formation.clone()).next();
    Some(TeamPlace { id, centre_ne_m: centre.or_else(mean)?, step, formation })
}

/// To three decimals: millimetres, milliseconds, milliradians.
pub(super) fn rounded(number: f64) -> f64 {
    (number * 1e3).round() / 1e3
}

fn membership(membership: Membership) -> &'static str {
    match membership {
        Membership::Joining => "joining",
        Membership::Active => "active",
        Membership::Left => "left",
    }
}

pub(super) fn standing(standing: PeerStatus) -> &'static str {
    match standing {
        PeerStatus::Fresh => "fresh",
        PeerStatus::Stale => "stale",
        PeerStatus::Lost => "lost",
    }
}

/// The figures of a formation that the page draws: as the scenario has it, or as an operator has changed it in flight.
pub(super) fn drawn_formation(formation: &Formation) -> Value {
    json!({
        "law": formation.law.name(),
        "radius_m": formation.radius_m,
        "gamma": formation.gamma,
        "heading_deg": formation.heading_deg,
        "inner_width_m": formation.inner_width_m,
        "outer_width_m": formation.outer_width_m,
        "altitude_m": formation.altitude_m,
        "safety_distance_m": safety_distance_m(formation),
    })
}

/// The distance that the safety filter keeps, m; `None` without a filter.
pub(super) fn safety_distance_m(formation: &Formation) -> Option<f64> {
    (formation.safety_filter == SafetyFilter::Cbf).then_some(formation.safety_distance_m)
}
