//! The checked form: what a scenario file says, complete, typed, one value for every key.
//!
//! Names of fields are names of keys, so units are the file's: angles stay in degrees here and the `_rad` methods give
//! them to the code. What each key means, its range and its default stand in [`KEYS`](super::KEYS), once.

mod laws;
mod mission;
mod network;

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::frame::Geodetic;
use crate::id::{SwarmName, VehicleId};

pub use super::law::Law;
pub use laws::{DisplacementConsensus, OlfatiSaber, Pattern, Slots, Vasarhelyi};
pub use mission::{Event, Fault, Mission, Order, Partition, Servo, Step, Target, What};
pub use network::{Graph, LinkChange, Network, Quality, SendMode};

/// One swarm, for every target. Made by [`load`](super::load), which alone checks it: `Deserialize` reads back what
/// `Serialize` wrote and checks only the shape. Both need a format that says what it holds (TOML, JSON; not postcard).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scenario {
    /// What flies, in a word.
    pub name: String,
    /// The defaults below the file.
    pub preset: Preset,
    /// Where all randomness comes from.
    pub seed: u64,
    /// When the flight ends; without it, when somebody or the mission ends it.
    pub duration_s: Option<f64>,
    /// Who flies.
    pub swarm: Swarm,
    /// Where they stand before.
    pub start: Start,
    /// Where the local frame lies.
    pub origin: Origin,
    /// What the formation is before a step changes it.
    pub formation: Formation,
    /// What the swarm does.
    pub mission: Mission,
    /// The vehicle controller.
    pub control: Control,
    /// What a vehicle may know of itself.
    pub sensing: Sensing,
    /// The air.
    pub world: World,
    /// Who hears whom, when and how well.
    pub network: Network,
    /// What is kept of a run.
    pub record: Record,
    /// One for each vehicle, by id: `vehicle[0]` is vehicle 1.
    pub vehicle: Vec<Vehicle>,
}

impl Scenario {
    /// Ids of all vehicles, in order.
    pub fn ids(&self) -> impl Iterator<Item = VehicleId> + Clone {
        VehicleId::first(self.swarm.vehicles)
    }

    /// This vehicle's own settings, if it flies in this swarm.
    pub fn vehicle(&self, id: VehicleId) -> Option<&Vehicle> {
        self.vehicle.iter().find(|vehicle| vehicle.id == id)
    }
}

/// `preset`
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// What we recommend.
    Default,
    /// What Garcia & Barnes 2010 did, with tangential avoidance.
    Paper,
}

/// `[swarm]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Swarm {
    /// How many, 1 to 250.
    pub vehicles: usize,
    /// Namespace of all traffic.
    pub name: SwarmName,
    /// What moves.
    pub plant: PlantKind,
    /// Profile of those that [`Vehicle::aircraft`] says nothing else of.
    pub aircraft: String,
    /// Standard deviation of the hidden error of the roll and of the pitch trim.
    pub trim_error_rms_deg: f64,
}

impl Swarm {
    /// [`Swarm::trim_error_rms_deg`] in radians.
    pub fn trim_error_rms_rad(&self) -> f64 {
        self.trim_error_rms_deg.to_radians()
    }
}

/// `swarm.plant`
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PlantKind {
    /// The helicopter inside the agent.
    Builtin,
    /// The same helicopter behind X-Plane's UDP protocol.
    Standin,
    /// X-Plane.
    Xplane,
}

/// `[start]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Start {
    /// How they stand around the origin.
    pub pattern: StartPattern,
    /// Side of the square of random starts, diameter of a ring of starts.
    pub square_m: f64,
    /// Least distance between two random starts, distance of neighbours on a line.
    pub separation_m: f64,
}

/// `start.pattern`
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StartPattern {
    /// Anywhere in a square, with random headings.
    Random,
    /// Where the plants are (X-Plane), or where `[vehicle.N]` says.
    AsIs,
    /// Evenly on a circle, vehicle 1 in the north, clockwise.
    Ring,
    /// On a line from west to east.
    Line,
}

/// `[origin]`: where the local north-east-down frame touches the ellipsoid.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Origin {
    /// Positive north.
    pub latitude_deg: f64,
    /// Positive east.
    pub longitude_deg: f64,
    /// Above the ellipsoid.
    pub elevation_m: f64,
}

impl Origin {
    /// The place in radians.
    pub fn geodetic(&self) -> Geodetic {
        Geodetic::from_degrees(self.latitude_deg, self.longitude_deg, self.elevation_m)
    }
}

/// `[formation]`, and what a step makes of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Formation {
    /// Which law.
    pub law: Law,
    /// R*, or the slots' or the goal's radius.
    pub radius_m: f64,
    /// γ: semi-axes are R* and R*/√γ.
    pub gamma: f64,
    /// γ_z of the ellipsoid: its vertical semi-axis is R*/√γ_z.
    pub gamma_z: f64,
    /// Of the ellipse's first axis, clockwise from north.
    pub heading_deg: f64,
    /// ΔR_in.
    pub inner_width_m: f64,
    /// ΔR_out.
    pub outer_width_m: f64,
    /// ε.
    pub edge_share: f64,
    /// α_in = α_out, where it does not follow from the widths and ε.
    pub edge_steepness_per_m: Option<f64>,
    /// ΔR_avoid.
    pub avoid_distance_m: AvoidDistance,
    /// Which part of the avoidance acts in the band.
    pub avoidance: Avoidance,
    /// w_circ, positive clockwise seen from above.
    pub circulation: f64,
    /// Of the formation's centre, above the origin.
    pub altitude_m: f64,
    /// How heights are shared out.
    pub vertical: Vertical,
    /// Δh between neighbouring ranks.
    pub band_step_m: f64,
    /// Field to position error.
    pub conversion: Conversion,
    /// c, c0.
    pub gain_m: f64,
    /// c1.
    pub far_gain_m: f64,
    /// v_b.
    pub gain_knee: f64,
    /// The centre's velocity is fed forward.
    pub feedforward: bool,
    /// What stands between the law and the controller.
    pub safety_filter: SafetyFilter,
    /// d_s.
    pub safety_distance_m: f64,
    /// κ.
    pub safety_rate_per_s: f64,
    /// Of `law = "olfati-saber"`.
    pub olfati_saber: OlfatiSaber,
    /// Of `law = "vasarhelyi"`.
    pub vasarhelyi: Vasarhelyi,
    /// Of the laws with slots.
    pub slots: Slots,
    /// Of `law = "displacement-consensus"`.
    pub displacement_consensus: DisplacementConsensus,
    /// Of a law that is none of Skein's.
    pub parameters: toml::Table,
    /// The program behind `law = "external"`.
    pub external: External,
}

impl Formation {
    /// [`Formation::heading_deg`] in radians.
    pub fn heading_rad(&self) -> f64 {
        self.heading_deg.to_radians()
    }

    /// How far above and below [`Formation::altitude_m`] so many vehicles fly, m.
    pub fn half_height_m(&self, vehicles: usize) -> f64 {
        match self.vertical {
            Vertical::Bands => vehicles.saturating_sub(1) as f64 / 2.0 * self.band_step_m,
            Vertical::Ellipsoid => self.radius_m / self.gamma_z.sqrt(),
        }
    }
}

/// `formation.avoid_distance_m`
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AvoidDistance {
    /// R*√2 sin(π/N), N the live members.
    Adaptive,
    /// The same for any N.
    #[serde(untagged)]
    Fixed(f64),
}

/// `formation.avoidance`
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Avoidance {
    /// In the band only the part along it.
    Tangential,
    /// All of it, everywhere.
    Full,
}

/// `formation.vertical`
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Vertical {
    /// One height a rank.
    Bands,
    /// The field has a vertical part.
    Ellipsoid,
}

/// `formation.conversion`
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Conversion {
    /// c·|V|.
    Linear,
    /// From slope c0 at zero to c1 far away.
    Nonlinear,
}

/// `formation.safety_filter`
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SafetyFilter {
    /// Nothing.
    None,
    /// Control barrier function.
    Cbf,
}

/// `[formation.external]`; of `command`, `listen` and `udp` one is set under [`Law::External`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct External {
    /// Program and arguments, one process a vehicle.
    pub command: Option<Vec<String>>,
    /// `tcp/HOST:PORT`; vehicle i connects to PORT + i.
    pub listen: Option<String>,
    /// Vectors instead of lines.
    pub udp: Option<Udp>,
    /// Between two asks.
    pub period_s: f64,
    /// Real time until an ask is missed.
    pub deadline_s: f64,
    /// Flies while the program does not answer; never [`Law::External`].
    pub fallback: Law,
    /// This many in a row, and the fallback flies.
    pub misses: u32,
    /// A faster answer is cut to this.
    pub max_speed_m_s: f64,
    /// Handed over as they are.
    pub parameters: toml::Table,
}

/// `formation.external.udp`
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Udp {
    /// HOST:PORT the asks go to; PORT + id for each vehicle.
    pub ask: String,
    /// HOST:PORT the answers come to; PORT + id for each vehicle.
    pub answer: String,
}

/// `[control]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Control {
    /// The trims are integrated.
    pub auto_trim: bool,
    /// The rule bases.
    pub rules: Rules,
    /// Where the controllers run.
    pub mode: ControlMode,
    /// What the machine of [`ControlMode::Central`] takes for one vehicle and frame; 0 is infinitely fast.
    pub central_step_s: f64,
}

/// `control.rules`
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rules {
    /// Those of this build.
    Shipped,
    /// The `.fis` files of this folder, as the file spells it.
    #[serde(untagged)]
    Folder(PathBuf),
}

/// `control.mode`
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ControlMode {
    /// Every vehicle for itself.
    Each,
    /// One machine for all, for comparison only.
    Central,
}

/// `[sensing]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sensing {
    /// How exact a position is.
    pub position: PositionSensing,
    /// Where the horizontal velocity comes from.
    pub velocity: VelocitySensing,
    /// τ of the differencing filter.
    pub differenced_tau_s: f64,
}

/// `sensing.position`
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PositionSensing {
    /// As it is.
    Exact,
    /// Latitude and longitude in degrees, rounded to single precision.
    F32Latlon,
}

/// `sensing.velocity`
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VelocitySensing {
    /// As the plant says.
    Measured,
    /// Filtered difference of positions.
    Differenced,
}

/// `[world]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct World {
    /// Mean wind.
    pub wind_m_s: f64,
    /// Where it comes from, clockwise from north.
    pub wind_from_deg: f64,
    /// Dryden turbulence: the wind speed at 20 ft that it belongs to.
    pub gust_w20_m_s: f64,
}

impl World {
    /// [`World::wind_from_deg`] in radians.
    pub fn wind_from_rad(&self) -> f64 {
        self.wind_from_deg.to_radians()
    }
}

/// `[record]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Of which runs of a study.
    pub runs: RecordRuns,
    /// How often.
    pub hz: RecordRate,
}

/// `record.runs`
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RecordRuns {
    /// Two of each swept point.
    WorstAndMedian,
    /// Every one.
    All,
    /// Not one.
    None,
}

/// `record.hz`
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RecordRate {
    /// What the target is good for.
    Auto,
    /// This, everywhere.
    #[serde(untagged)]
    Hz(f64),
}

impl RecordRate {
    /// In virtual time: 10, unless the scenario says otherwise.
    pub fn in_study_hz(self) -> f64 {
        match self {
            Self::Auto => 10.0,
            Self::Hz(hz) => hz,
        }
    }

    /// In real time: 50, unless the scenario says otherwise.
    pub fn live_hz(self) -> f64 {
        match self {
            Self::Auto => 50.0,
            Self::Hz(hz) => hz,
        }
    }
}

/// `[vehicle.N]`, complete.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Vehicle {
    /// N.
    pub id: VehicleId,
    /// Profile.
    pub aircraft: String,
    /// Stands here (north, east) at first, whatever `start.pattern` says.
    pub start_ne_m: Option<[f64; 2]>,
    /// Stands with its nose there at first, clockwise from north.
    pub heading_deg: Option<f64>,
    /// HOST:PORT of its simulator, where the target does not know better.
    pub xplane: Option<String>,
    /// How far its clock is ahead of the others'.
    pub clock_offset_s: f64,
    /// How much too fast its clock runs, in millionths.
    pub clock_drift_ppm: f64,
}

impl Vehicle {
    /// [`Vehicle::heading_deg`] in radians.
    pub fn heading_rad(&self) -> Option<f64> {
        self.heading_deg.map(f64::to_radians)
    }
}
