//! The scenario as typed values: complete and checked, one field for every key.
//!
//! Names and units of fields are those of the keys: angles are in degrees here, and the `_rad` methods convert them.
//! [`KEYS`](super::KEYS) has the meaning, range and default of each key.

mod airspace;
mod laws;
mod mission;
mod network;
mod plant;
mod sensing;
mod setting;

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::frame::Geodetic;
use crate::id::{SwarmName, TeamId, VehicleId};

pub use super::law::Law;
pub use airspace::{Airspace, StaticObstacle};
pub use laws::{DisplacementConsensus, OlfatiSaber, Pattern, Slots, Vasarhelyi};
pub use mission::{
    EventAction, Fault, Mission, Partition, ScriptedEvent, ScriptedOrder, ScriptedVerb, Servo, Step, Target,
};
pub use network::{Graph, LinkChange, Network, Quality, SendMode};
pub use plant::{
    CommandKind, ModelKind, PlantKind, PlantSpec, PlayedFailures, PointMassLimits, Simulator, VehicleModel,
};
pub use sensing::{PositionSensing, Sensing, SensorErrors, VelocitySensing};
pub use setting::{Setting, TunableKey};

/// A scenario: one swarm, its mission and the flight conditions. Only [`load`](super::load) checks it: `Deserialize`
/// reads the output of `Serialize` and checks only its structure. Both need a self-describing format (TOML or JSON, not
/// postcard).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scenario {
    /// Name of the scenario.
    pub name: String,
    /// Set of defaults for keys that are not written.
    pub preset: Preset,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Duration of the flight, s; `None`: the mission or an operator ends it.
    pub duration_s: Option<f64>,
    /// The vehicles of the swarm.
    pub swarm: Swarm,
    /// The model of the built-in plant.
    pub plant: VehicleModel,
    /// Positions before take-off.
    pub start: Start,
    /// Origin of the local frame.
    pub origin: OriginSettings,
    /// The formation before a step changes it.
    pub formation: Formation,
    /// Steps and events of the mission.
    pub mission: Mission,
    /// The volume that the swarm may fly in.
    #[serde(default)]
    pub airspace: Airspace,
    /// The vehicle controller.
    pub control: Control,
    /// Sensors of the vehicles.
    pub sensing: Sensing,
    /// Wind and turbulence.
    pub world: World,
    /// The network between the vehicles, with its impairments.
    pub network: Network,
    /// Recording of runs.
    pub record: Record,
    /// Settings of each vehicle, by id: `vehicle[0]` is vehicle 1.
    pub vehicle: Vec<Vehicle>,
    /// The fleet of which the swarm is a team; `None` if it flies alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub team: Option<TeamInFleet>,
}

/// The place of a team in its fleet.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TeamInFleet {
    /// The team's number.
    pub id: TeamId,
    /// Number of teams.
    pub teams: u16,
    /// The team's place, which is the origin of its local frame, north and east of the fleet's origin, m.
    pub place_ne_m: [f64; 2],
    /// The fleet's origin. The cells of the map count from it.
    pub origin: OriginSettings,
    /// Rate at which the recording of the fleet has the places of all vehicles, Hz.
    pub record_hz: f64,
    /// Whether all of the team is recorded, too.
    pub is_recorded: bool,
    /// The seed that the file gives to the team. The team's own seed follows from it and the team's number.
    pub seed: u64,
}

impl Scenario {
    /// Ids of all vehicles, in order.
    pub fn ids(&self) -> impl Iterator<Item = VehicleId> + Clone {
        VehicleId::first(self.swarm.vehicles)
    }

    /// Settings of this vehicle; `None` if it is not in the swarm.
    pub fn vehicle(&self, id: VehicleId) -> Option<&Vehicle> {
        self.vehicle.iter().find(|vehicle| vehicle.id == id)
    }
}

/// Set of defaults, `preset`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// The recommended defaults.
    Default,
    /// The defaults of Garcia & Barnes 2010, with tangential avoidance.
    Paper,
}

/// The vehicles of the swarm, `[swarm]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Swarm {
    /// Number of vehicles, 1 to 250.
    pub vehicles: usize,
    /// Name of the swarm: the namespace of all messages.
    pub name: SwarmName,
    /// The plant that is flown.
    pub plant: PlantKind,
    /// Aircraft of the vehicles, unless [`Vehicle::aircraft`] names another.
    pub aircraft: String,
    /// Standard deviation of the unknown error of the roll trim and of the pitch trim, °.
    pub trim_error_rms_deg: f64,
}

impl Swarm {
    /// [`Swarm::trim_error_rms_deg`] in radians.
    pub fn trim_error_rms_rad(&self) -> f64 {
        self.trim_error_rms_deg.to_radians()
    }
}

/// Positions before take-off, `[start]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Start {
    /// Arrangement around the origin.
    pub pattern: StartPattern,
    /// Side of the square of random starts, or diameter of a ring of starts, m.
    pub square_m: f64,
    /// Least distance between two random starts, or distance of neighbours on a line, m.
    pub separation_m: f64,
}

/// Arrangement before take-off, `start.pattern`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StartPattern {
    /// Random positions in a square, with random headings.
    Random,
    /// The present positions of the X-Planes, or the positions of `[vehicle.N]`.
    AsIs,
    /// Evenly on a circle, vehicle 1 in the north, then clockwise.
    Ring,
    /// On a line from west to east.
    Line,
}

/// Origin of the local north-east-down frame, `[origin]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OriginSettings {
    /// Latitude, °, positive north.
    pub latitude_deg: f64,
    /// Longitude, °, positive east.
    pub longitude_deg: f64,
    /// Height above the ellipsoid, m.
    pub elevation_m: f64,
}

impl OriginSettings {
    /// The origin as a geodetic position, in radians.
    pub fn geodetic(&self) -> Geodetic {
        Geodetic::from_degrees(self.latitude_deg, self.longitude_deg, self.elevation_m)
    }
}

/// A formation: that of `[formation]`, or with the changes of a step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Formation {
    /// The control law.
    pub law: Law,
    /// Radius R* of the ring, of the area of a flock, or of the slots, m.
    pub radius_m: f64,
    /// Shape γ of the ellipse: its semi-axes are R* and R*/√γ.
    pub gamma: f64,
    /// Shape γ_z of the ellipsoid: its vertical semi-axis is R*/√γ_z.
    pub gamma_z: f64,
    /// Direction of the ellipse's first axis, °, clockwise from north.
    pub heading_deg: f64,
    /// Width ΔR_in of the band inside the ring, m.
    pub inner_width_m: f64,
    /// Width ΔR_out of the band outside the ring, m.
    pub outer_width_m: f64,
    /// Remainder ε of a limiting function one width from its middle.
    pub edge_share: f64,
    /// Steepness α_in = α_out of the band's edges, 1/m; `None`: it follows from the widths and ε.
    pub edge_steepness_per_m: Option<f64>,
    /// Distance ΔR_avoid below which neighbours repel each other.
    pub avoid_distance_m: AvoidDistance,
    /// Part of the avoidance that acts in the band.
    pub avoidance: Avoidance,
    /// Weight w_circ of the circulation, positive clockwise from above.
    pub circulation: f64,
    /// Altitude of the formation's centre above the origin, m.
    pub altitude_m: f64,
    /// Distribution of the vehicles over heights.
    pub vertical: Vertical,
    /// Difference of height Δh between neighbouring ranks, m.
    pub band_step_m: f64,
    /// Conversion of the field to a position error.
    pub conversion: Conversion,
    /// Gain c of the linear conversion, c0 of the nonlinear one, m.
    pub gain_m: f64,
    /// Gain c1 of the nonlinear conversion far from the goal, m.
    pub far_gain_m: f64,
    /// Field strength v_b at which the nonlinear conversion changes its gain.
    pub gain_knee: f64,
    /// Whether the velocity of the centre is fed forward.
    pub feedforward: bool,
    /// Filter between the law and the vehicle controller.
    pub safety_filter: SafetyFilter,
    /// Least distance d_s that the safety filter keeps, m.
    pub safety_distance_m: f64,
    /// Approach rate κ of the safety filter, 1/s.
    pub safety_rate_per_s: f64,
    /// Parameters of `law = "olfati-saber"`.
    pub olfati_saber: OlfatiSaber,
    /// Parameters of `law = "vasarhelyi"`.
    pub vasarhelyi: Vasarhelyi,
    /// Slots of the laws that have slots.
    pub slots: Slots,
    /// Parameters of `law = "displacement-consensus"`.
    pub displacement_consensus: DisplacementConsensus,
    /// Parameters of a law that the user's program added.
    pub parameters: toml::Table,
    /// The program behind `law = "external"`.
    pub external: External,
}

impl Formation {
    /// [`Formation::heading_deg`] in radians.
    pub fn heading_rad(&self) -> f64 {
        self.heading_deg.to_radians()
    }

    /// Largest distance of this many vehicles above and below [`Formation::altitude_m`], m.
    pub fn half_height_m(&self, vehicles: usize) -> f64 {
        match self.vertical {
            Vertical::Bands => vehicles.saturating_sub(1) as f64 / 2.0 * self.band_step_m,
            Vertical::Ellipsoid => self.radius_m / self.gamma_z.sqrt(),
        }
    }
}

/// Distance below which neighbours repel each other, `formation.avoid_distance_m`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AvoidDistance {
    /// R*√2 sin(π/N) for N live members.
    Adaptive,
    /// This distance for any number of members, m.
    #[serde(untagged)]
    Fixed(f64),
}

/// Part of the avoidance that acts in the band, `formation.avoidance`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Avoidance {
    /// In the band only the part along the ring.
    Tangential,
    /// The whole avoidance, everywhere.
    Full,
}

/// Distribution of the vehicles over heights, `formation.vertical`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Vertical {
    /// One height for each rank.
    Bands,
    /// The field has a vertical part.
    Ellipsoid,
}

/// Conversion of the field to a position error, `formation.conversion`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Conversion {
    /// The error is c·|V|.
    Linear,
    /// The slope grows from c0 at zero to c1 for a strong field.
    Nonlinear,
}

/// Filter between the law and the vehicle controller, `formation.safety_filter`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SafetyFilter {
    /// No filter.
    None,
    /// A control barrier function.
    Cbf,
}

/// A law in another program, `[formation.external]`. Under [`Law::External`] exactly one of `command`, `listen` and
/// `udp` is set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct External {
    /// Program and arguments; one process for each vehicle.
    pub command: Option<Vec<String>>,
    /// Address of the program, `tcp/HOST:PORT`; vehicle i connects to PORT + i.
    pub listen: Option<String>,
    /// Addresses for binary vectors over UDP instead of lines of JSON.
    pub udp: Option<Udp>,
    /// Time between two requests, s.
    pub period_s: f64,
    /// Real time after which a request without an answer is missed, s.
    pub deadline_s: f64,
    /// Law that is flown while the program does not answer; never [`Law::External`].
    pub fallback: Law,
    /// Number of missed requests in a row after which the fallback law is flown.
    pub misses: u32,
    /// Largest speed that the program may command, m/s; a faster velocity is cut to it.
    pub max_speed_m_s: f64,
    /// Parameters for the program, passed unchanged.
    pub parameters: toml::Table,
}

/// UDP addresses of an external law, `formation.external.udp`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Udp {
    /// HOST:PORT to which requests are sent; PORT + id for each vehicle.
    pub ask: String,
    /// HOST:PORT on which answers are received; PORT + id for each vehicle.
    pub answer: String,
}

/// The vehicle controllers, `[control]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Control {
    /// Whether the controller integrates the trims.
    pub auto_trim: bool,
    /// The rule bases of the fuzzy controllers.
    pub rules: Rules,
    /// Where the controllers run.
    pub mode: ControlMode,
    /// Computing time of the central controller for one vehicle and frame, s; 0 is infinitely fast.
    pub central_step_s: f64,
}

/// The rule bases of the fuzzy controllers, `control.rules`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rules {
    /// The rule bases that come with the program.
    Shipped,
    /// The `.fis` files of this folder, spelled as in the scenario.
    #[serde(untagged)]
    Folder(PathBuf),
}

/// Where the controllers run, `control.mode`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ControlMode {
    /// Each vehicle has its own controller.
    Each,
    /// One central controller flies all vehicles; for comparison only.
    Central,
}

/// Wind and turbulence, `[world]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct World {
    /// Mean wind speed, m/s.
    pub wind_m_s: f64,
    /// Direction that the wind comes from, °, clockwise from north.
    pub wind_from_deg: f64,
    /// Strength of the Dryden turbulence as the wind speed at 20 ft that causes it, m/s.
    pub gust_w20_m_s: f64,
}

impl World {
    /// [`World::wind_from_deg`] in radians.
    pub fn wind_from_rad(&self) -> f64 {
        self.wind_from_deg.to_radians()
    }
}

/// Recording of runs, `[record]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Runs of a study whose recordings are kept.
    pub runs: RecordRuns,
    /// Rate of recording.
    pub hz: RecordRate,
    /// Whether each live agent writes all that enters and leaves its core, and not only after a fault.
    pub inputs: bool,
}

/// Runs of a study whose recordings are kept, `record.runs`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RecordRuns {
    /// The worst and the median run of each swept point.
    WorstAndMedian,
    /// All runs.
    All,
    /// No run.
    None,
}

/// Rate of recording, `record.hz`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RecordRate {
    /// 10 Hz in a study, 50 Hz in real time.
    Auto,
    /// This rate in studies and in real time, Hz.
    #[serde(untagged)]
    Hz(f64),
}

impl RecordRate {
    /// Rate in a study, Hz: 10, unless the scenario sets another.
    pub fn in_study_hz(self) -> f64 {
        match self {
            Self::Auto => 10.0,
            Self::Hz(hz) => hz,
        }
    }

    /// Rate in real time, Hz: 50, unless the scenario sets another.
    pub fn live_hz(self) -> f64 {
        match self {
            Self::Auto => 50.0,
            Self::Hz(hz) => hz,
        }
    }
}

/// Settings of one vehicle, `[vehicle.N]`, complete.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Vehicle {
    /// Id N of the vehicle.
    pub id: VehicleId,
    /// Name of the aircraft file.
    pub aircraft: String,
    /// Position before take-off, north and east, m; it overrides `start.pattern`.
    pub start_ne_m: Option<[f64; 2]>,
    /// Heading before take-off, °, clockwise from north.
    pub heading_deg: Option<f64>,
    /// HOST:PORT of the vehicle's X-Plane, unless another file or option gives it.
    pub xplane: Option<String>,
    /// HOST:PORT of that X-Plane's Web API, if it is not on the PC of the command that asks it. No agent does.
    pub web: Option<String>,
    /// How far the vehicle's clock is ahead of the others' clocks, s.
    pub clock_offset_s: f64,
    /// How much too fast the vehicle's clock runs, ppm.
    pub clock_drift_ppm: f64,
}

impl Vehicle {
    /// [`Vehicle::heading_deg`] in radians.
    pub fn heading_rad(&self) -> Option<f64> {
        self.heading_deg.map(f64::to_radians)
    }
}
