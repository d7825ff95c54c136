//! The scenario as typed values: complete and checked, one field for every key.
//!
//! Names and units of fields are those of the keys: angles are in degrees here.
//! `keys!` declares each key with its field: range, default, meaning.

mod airspace;
mod laws;
mod mission;
mod network;
mod plant;
mod sensing;
mod setting;

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::key::keys;
use super::law::BUILT_IN;
use crate::frame::Geodetic;
use crate::id::{SwarmName, TeamId, VehicleId};

pub use super::law::Law;
pub use airspace::{Airspace, StaticObstacle};
pub use laws::{DisplacementConsensus, OlfatiSaber, Pattern, Slots, Vasarhelyi};
pub(in crate::scenario) use mission::{EVENT_KEYS, FAULT_RULES, ORDER_RULES, STEP_KEYS};
pub use mission::{
    EventAction, Fault, Mission, Partition, ScriptedEvent, ScriptedOrder, ScriptedVerb, Servo, Step, Target,
};
pub use network::{Graph, LinkChange, Network, Quality, SendMode};
pub use plant::{
    CommandKind, ModelKind, PlantKind, PlantSpec, PlayedFailures, PointMassLimits, Simulator, VehicleModel,
};
pub(in crate::scenario) use sensing::SENSOR_ERROR_KEYS;
pub use sensing::{PositionSensing, Sensing, SensorErrors, VelocitySensing};
pub use setting::{Setting, TunableKey};

keys! {
    /// A scenario: one swarm, its mission and the flight conditions. Only [`load`](super::load) checks it: `Deserialize`
    /// reads the output of `Serialize` and checks only its structure. Both need a self-describing format (TOML or JSON, not
    /// postcard).
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct Scenario at "" {
        name: String = Name, text("swarm"),
            "name of the scenario: runs and folders are named after it";
        preset: Preset = OneOf(&["default", "paper"]), text("default"),
            "which defaults apply to keys that are not written: Skein's, or those of Garcia & Barnes 2010 (\"paper\")";
        seed: u64 = Integer(0, i64::MAX), whole(1),
            "seed of all random numbers: the same seed gives the same run; 1 is as good as any other", unit_is("1");
        duration_s: Option<f64> = above_zero_or("none", 1e6), text("none"),
            "when the flight ends; \"none\": when the mission ends or an operator ends it";
        /// The vehicles of the swarm.
        swarm: Swarm;
        /// The model of the built-in plant.
        plant: VehicleModel;
        /// Positions before take-off.
        start: Start;
        /// Origin of the local frame.
        origin: OriginSettings;
        /// The formation before a step changes it.
        formation: Formation;
        /// Steps and events of the mission.
        mission: Mission;
        /// The volume that the swarm may fly in.
        #[serde(default)]
        airspace: Airspace;
        /// The vehicle controller.
        control: Control;
        /// Sensors of the vehicles.
        sensing: Sensing;
        /// Wind and turbulence.
        world: World;
        /// The network between the vehicles, with its impairments.
        network: Network;
        /// Recording of runs.
        record: Record;
        /// Settings of each vehicle, by id: `vehicle[0]` is vehicle 1.
        vehicle: Vec<Vehicle>;
        /// The fleet of which the swarm is a team; `None` if it flies alone.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        team: Option<TeamInFleet>;
    }
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

    /// Number of vehicles, which is the number of the last id too.
    pub fn roster(&self) -> u8 {
        self.swarm.vehicles.min(VehicleId::MAX.into()) as u8
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

keys! {
    /// The vehicles of the swarm, `[swarm]`.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct Swarm at "swarm." {
        vehicles: usize = Integer(1, 250), Required,
            "number of vehicles; their ids are 1 to this number, at most 250 because MAVLink has no more", unit_is("vehicles");
        name: SwarmName = Name, Same("name"),
            "namespace of all messages: two swarms on one network need two names";
        plant: PlantKind = OneOf(PlantKind::NAMES), text("builtin"),
            "what is flown: the flight model inside the agent, the same model behind X-Plane's UDP protocol (\"standin\"), or X-Plane; \
             \"builtin\" needs nothing else installed";
        aircraft: String = TomlName, text("xcell60"),
            "aircraft file NAME.toml beside the scenario, or an aircraft that comes with the program; \
             \"xcell60\" is of the class that Garcia & Barnes 2010 simulated";
        trim_error_rms_deg: f64 = from(0.0, 5.0), number(0.3),
            "standard deviation of the unknown error of each vehicle's roll and pitch trim; no real helicopter is trimmed exactly";
    }

    /// Positions before take-off, `[start]`.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct Start at "start." {
        pattern: StartPattern = OneOf(&["random", "as_is", "ring", "line"]), text("random"),
            "where vehicles stand before take-off, around the origin; \"as_is\": where X-Plane or [vehicle.N] has them";
        square_m: f64 = from(0.0, 1e5), number(150.0),
            "side of the square of random starts, or diameter of a ring of starts; 150 m has room for 61 vehicles";
        separation_m: f64 = from(0.0, 1e4), number(15.0),
            "least distance between two starts; vehicles that start nearer could meet on the climb";
    }
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

keys! {
    /// Origin of the local north-east-down frame, `[origin]`.
    #[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
    pub struct OriginSettings at "origin." {
        latitude_deg: f64 = from(-90.0, 90.0), number(28.0),
            "latitude of the local frame's origin, positive north; the site in Florida of Garcia & Barnes 2010";
        longitude_deg: f64 = from(-180.0, 180.0), number(-82.0),
            "longitude of the local frame's origin, positive east; the site in Florida of Garcia & Barnes 2010";
        elevation_m: f64 = from(-500.0, 9000.0), number(0.0),
            "height of the local frame's origin above the WGS 84 ellipsoid; all altitudes are measured from here";
    }
}

impl OriginSettings {
    /// The origin as a geodetic position, in radians.
    pub fn geodetic(&self) -> Geodetic {
        Geodetic::from_degrees(self.latitude_deg, self.longitude_deg, self.elevation_m)
    }
}

keys! {
    /// A formation: that of `[formation]`, or with the changes of a step.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct Formation at "formation." {
        law: Law = Law, text("ring"),
            "control law that places the vehicles; \"ring\" is the ellipse of Garcia & Barnes 2010";
        radius_m: f64 = above_zero(1e5), number(100.0),
            "radius R* of the ring, or of the area that a flock keeps to; Garcia & Barnes 2010, Table 1", flock(number(50.0));
        gamma: f64 = from(0.01, 100.0), number(1.0),
            "shape of the ellipse: its semi-axes are R* north and R*/sqrt(gamma) east; 1 is a circle, Table 1", unit_is("1");
        gamma_z: f64 = from(0.01, 100.0), number(1.0),
            "shape of the ellipsoid under vertical = \"ellipsoid\": its vertical semi-axis is R*/sqrt(gamma_z); 1 is a sphere",
            unit_is("1");
        heading_deg: f64 = from(-360.0, 360.0), number(0.0),
            "direction of the ellipse's first axis and of the slots, clockwise from north";
        inner_width_m: f64 = above_zero(1e5), number(20.0),
            "width delta R_in of the band inside the ring: it reaches from R* minus this; Table 1";
        outer_width_m: f64 = above_zero(1e5), number(20.0),
            "width delta R_out of the band outside the ring: it reaches to R* plus this; Table 1", flock(number(10.0));
        edge_share: f64 = from(1e-6, 0.49), number(0.01),
            "epsilon: remainder of a limiting function one width from its middle; at 1 % the band ends", unit_is("1");
        edge_steepness_per_m: Option<f64> = above_zero_or("from_widths", 100.0), text("from_widths"),
            "steepness alpha_in = alpha_out of the band's edges; \"from_widths\": ln((1-epsilon)/epsilon)/width, soft enough that vehicles \
             do not oscillate";
        avoid_distance_m: AvoidDistance = above_zero_or("adaptive", 1e4), text("adaptive"),
            "distance delta R_avoid below which neighbours repel each other; \"adaptive\": R* sqrt(2) sin(pi/N) for N live vehicles, so that \
             the survivors of a loss space out again", paper(number(100.0)), flock(number(20.0));
        avoidance: Avoidance = OneOf(&["tangential", "full"]), text("tangential"),
            "which part of the avoidance acts inside the band: along the ring, or all of it; \"full\" pushes the ring out by 11 m",
            flock(text("full"));
        circulation: f64 = from(-2.0, 2.0), number(0.0),
            "weight w_circ of the field that turns the ring, positive clockwise from above; with 0 a hovering formation does not rotate",
            unit_is("1");
        altitude_m: f64 = from(3.5, 1e4), number(30.0),
            "altitude of the formation above the origin; below 3.5 m sideways control is not fully available";
        vertical: Vertical = OneOf(&["bands", "ellipsoid"]), text("bands"),
            "how vehicles are distributed over heights: a band for each rank, or by the field of an ellipsoid";
        band_step_m: f64 = from(0.0, 1e3), number(0.0),
            "difference of height delta h between neighbouring ranks; 0: all at one height, as in Garcia & Barnes 2010";
        conversion: Conversion = OneOf(&["linear", "nonlinear"]), text("nonlinear"),
            "how the field becomes a position error; \"nonlinear\" is fast far from the place and calm near it",
            paper(text("linear"));
        gain_m: f64 = above_zero(1e3), number(7.0),
            "gain c of the linear conversion, and c0 of the nonlinear one near the place; Garcia & Barnes 2010";
        far_gain_m: f64 = above_zero(1e3), number(28.0),
            "gain c1 of the nonlinear conversion far from the place; 56 m let vehicles come closer to each other";
        gain_knee: f64 = above_zero(10.0), number(0.3),
            "field strength v_b at which the nonlinear conversion changes from its near gain to its far gain", unit_is("1");
        feedforward: bool = Bool, flag(true),
            "add the velocity of the formation's centre to every setpoint; without it vehicles trail behind a moving centre",
            paper(flag(false));
        safety_filter: SafetyFilter = OneOf(&["none", "cbf"]), text("cbf"),
            "filter behind the law that keeps vehicles apart: a control barrier function, idle while all are far enough apart",
            paper(text("none"));
        safety_distance_m: f64 = above_zero(1e3), number(8.0),
            "least distance d_s that the safety filter keeps; 5 m of clearance and 3 m for the vehicle's lag";
        safety_rate_per_s: f64 = above_zero(100.0), number(0.5),
            "kappa: how fast the safety filter lets two vehicles close in, as a share of the remaining distance a second";
        /// Parameters of `law = "olfati-saber"`.
        olfati_saber: OlfatiSaber;
        /// Parameters of `law = "vasarhelyi"`.
        vasarhelyi: Vasarhelyi;
        /// Slots of the laws that have slots.
        slots: Slots;
        /// Parameters of `law = "displacement-consensus"`.
        displacement_consensus: DisplacementConsensus;
        parameters: toml::Table = Free, as_toml("{}"),
            "parameters of a law that a program of your own adds, handed to it unchanged";
        /// The program behind `law = "external"`.
        external: External;
    }
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

keys! {
    /// A law in another program, `[formation.external]`. Under [`Law::External`] exactly one of `command`, `listen` and
    /// `udp` is set.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct External at "formation.external." {
        command: Option<Vec<String>> = Texts, Nothing,
            "program and arguments that compute law = \"external\", one process a vehicle; give this, listen or udp";
        listen: Option<String> = Address("tcp/"), Nothing,
            "address on which your program listens: vehicle i connects to PORT + i; give this, command or udp";
        /// Addresses for binary vectors over UDP instead of lines of JSON.
        udp: Option<Udp>;
        period_s: f64 = from(0.02, 10.0), number(0.1),
            "time between two requests to the program; the vehicle controller keeps its own 50 Hz";
        deadline_s: f64 = above_zero(10.0), number(0.05),
            "real time after which a request without an answer is missed; half a period";
        fallback: Law = OneOf(BUILT_IN), text("ring"),
            "law that is flown while the program does not answer";
        misses: u32 = Integer(1, 1000), whole(3),
            "missed requests in a row after which the fallback law is flown; one or two can be a busy computer",
            unit_is("requests");
        max_speed_m_s: f64 = above_zero(50.0), number(5.0),
            "a faster velocity from the program is cut to this speed; 5 m/s suit the helicopter";
        parameters: toml::Table = Free, as_toml("{}"),
            "parameters for the program, handed to it unchanged";
    }

    /// UDP addresses of an external law, `formation.external.udp`.
    #[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
    pub struct Udp at "formation.external.udp." {
        ask: String = Address(""), Nothing,
            "address to which requests are sent, PORT + id for each vehicle; udp needs both ask and answer";
        answer: String = Address(""), Nothing,
            "address on which answers are received, PORT + id for each vehicle; udp needs both ask and answer";
    }

    /// The vehicle controllers, `[control]`.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct Control at "control." {
        auto_trim: bool = Bool, flag(true),
            "integrate the trims, which removes the position error that trim error and wind cause; without it that error is metres",
            paper(flag(false));
        rules: Rules = Text, text("shipped"),
            "folder of the four .fis rule bases of the vehicle controller; \"shipped\": those that come with the program";
        mode: ControlMode = OneOf(&["each", "central"]), text("each"),
            "where controllers run: on each vehicle, or all on one computer as in Garcia & Barnes 2010 (\"central\", in a study only)";
        central_step_s: f64 = from(0.0, 1.0), number(0.0001),
            "computing time of the central controller for one vehicle and frame; a live agent needs this time from frame to controls";
    }
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

/// The place where the controllers run, `control.mode`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ControlMode {
    /// Each vehicle has its own controller.
    Each,
    /// One central controller flies all vehicles; for comparison only.
    Central,
}

keys! {
    /// Wind and turbulence, `[world]`.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct World at "world." {
        wind_m_s: f64 = from(0.0, 50.0), number(0.0),
            "mean wind speed; by default the air is calm";
        wind_from_deg: f64 = from(-360.0, 360.0), number(0.0),
            "direction that the wind comes from, clockwise from north";
        gust_w20_m_s: f64 = from(0.0, 50.0), number(0.0),
            "strength of Dryden turbulence (MIL-F-8785C), as the wind speed at 20 ft that causes it; by default the air is calm";
    }
}

impl World {
    /// [`World::wind_from_deg`] in radians.
    pub fn wind_from_rad(&self) -> f64 {
        self.wind_from_deg.to_radians()
    }
}

keys! {
    /// Recording of runs, `[record]`.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct Record at "record." {
        runs: RecordRuns = OneOf(&["worst-and-median", "all", "none"]), text("worst-and-median"),
            "runs of a study whose recordings are kept: two show what is typical and what can happen";
        hz: RecordRate = above_zero_or("auto", 1e3), text("auto"),
            "rate of recording; \"auto\": 10 Hz in a study, 50 Hz in real time";
        inputs: bool = Bool, flag(false),
            "whether each live agent writes its inputs for skein replay in any case; by default only an agent that meets a fault leaves them";
    }
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

keys! {
    /// Settings of one vehicle, `[vehicle.N]`, complete.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct Vehicle at "vehicle.N." {
        /// Id N of the vehicle.
        id: VehicleId;
        aircraft: String = TomlName, Same("swarm.aircraft"),
            "swarm.aircraft for this vehicle";
        start_ne_m: Option<[f64; 2]> = Point, Nothing,
            "where this vehicle stands before take-off, in place of start.pattern";
        heading_deg: Option<f64> = from(-360.0, 360.0), Nothing,
            "where its nose points before take-off, clockwise from north";
        xplane: Option<String> = Address(""), Nothing,
            "address of this vehicle's X-Plane";
        web: Option<String> = Address(""), Nothing,
            "address of that X-Plane's Web API, for `skein xplane check --xplane` and `skein xplane place`; no flight depends on it";
        clock_offset_s: f64 = from(-1e6, 1e6), number(0.0),
            "how far its clock is ahead of the others'; the swarm does not rely on clocks that agree";
        clock_drift_ppm: f64 = from(-1e3, 1e3), number(0.0),
            "how much too fast its clock runs; quartz clocks are within 100 ppm";
    }
}

impl Vehicle {
    /// [`Vehicle::heading_deg`] in radians.
    pub fn heading_rad(&self) -> Option<f64> {
        self.heading_deg.map(f64::to_radians)
    }
}
