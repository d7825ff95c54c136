//! The keys of a scenario file, in the order in which the complete file is written, the keys of one table together.
//!
//! The last argument of a key is its meaning, followed by the reason for its default. `skein files explain` prints it for
//! readers who have never seen the code.

use super::Kind::{
    Address, Edges, Free, Id, Ids, Integer, Name, OneOf, Path, Point, Points, Tables, Text, Texts, TomlName, True,
};
use super::Literal::{Bool, Nothing, Required, Same};
use super::{Key, Kind, Literal, Range, Removed};
use crate::scenario::law;
use crate::scenario::model::{PlantKind, TunableKey};

const fn key(path: &'static str, kind: Kind, default: Literal, about: &'static str) -> Key {
    Key::new(path, kind, default, about)
}

/// A number from `min` to `max`.
const fn from(min: f64, max: f64) -> Kind {
    Kind::Number(Range { min, max, min_included: true })
}

/// A number from `min` to `max`, or a text.
const fn from_or(choice: &'static str, min: f64, max: f64) -> Kind {
    Kind::NumberOr(choice, Range { min, max, min_included: true })
}

/// A number above zero, up to `max`.
const fn above_zero(max: f64) -> Kind {
    Kind::Number(Range { min: 0.0, max, min_included: false })
}

/// A number above zero, up to `max`, or a text.
const fn above_zero_or(choice: &'static str, max: f64) -> Kind {
    Kind::NumberOr(choice, Range { min: 0.0, max, min_included: false })
}

const fn number(value: f64) -> Literal {
    Literal::Number(value)
}

const fn text(value: &'static str) -> Literal {
    Literal::Text(value)
}

/// The laws that can be the fallback of an external one.
const BUILT_IN_LAWS: &[&str] = match law::NAMES.split_last() {
    Some((_external, built_in)) => built_in,
    None => &[],
};

/// Every key of a scenario file.
#[rustfmt::skip]
pub const KEYS: &[Key] = &[
    key("name", Name, text("swarm"),
        "name of the scenario: runs and folders are named after it"),
    key("preset", OneOf(&["default", "paper"]), text("default"),
        "which defaults apply to keys that are not written: Skein's, or those of Garcia & Barnes 2010 (\"paper\")"),
    key("seed", Integer(0, i64::MAX), Literal::Integer(1),
        "seed of all random numbers: the same seed gives the same run; 1 is as good as any other").unit_is("1"),
    key("duration_s", above_zero_or("none", 1e6), text("none"),
        "when the flight ends; \"none\": when the mission ends or an operator ends it"),

    key("swarm.vehicles", Integer(1, 250), Required,
        "number of vehicles; their ids are 1 to this number, at most 250 because MAVLink has no more").unit_is("vehicles"),
    key("swarm.name", Name, Same("name"),
        "namespace of all messages: two swarms on one network need two names"),
    key("swarm.plant", OneOf(PlantKind::NAMES), text("builtin"),
        "what is flown: the flight model inside the agent, the same model behind X-Plane's UDP protocol (\"standin\"), or X-Plane; \
         \"builtin\" needs nothing else installed"),
    key("swarm.aircraft", TomlName, text("xcell60"),
        "aircraft file NAME.toml beside the scenario, or an aircraft that comes with the program; \
         \"xcell60\" is of the class that Garcia & Barnes 2010 simulated"),
    key("swarm.trim_error_rms_deg", from(0.0, 5.0), number(0.3),
        "standard deviation of the unknown error of each vehicle's roll and pitch trim; no real helicopter is trimmed exactly"),

    key("plant.model", OneOf(&["helicopter", "point_mass"]), text("helicopter"),
        "what the built-in plant simulates: the helicopter of the aircraft file, or a point that follows velocities (\"point_mass\"), \
         for studies of laws at scale; a helicopter is nearer to flight"),
    key("plant.min_frame_rate_hz", from(0.0, 50.0), number(20.0),
        "frame rate below which a vehicle does not take off, 0 for none; Garcia & Barnes 2010 refuse less than 20 Hz, and X-Plane slows \
         its time below 19 Hz"),
    key("plant.show_peers", Integer(0, 19), Literal::Integer(0),
        "how many of its nearest peers each X-Plane draws as its other aircraft, at most 19; 0 leaves X-Plane's other aircraft alone, \
         each of which costs frame rate").unit_is("vehicles"),
    key("plant.peer_acf", Text, Nothing,
        "aircraft file that X-Plane loads to draw peers, its path below X-Plane's folder, as Aircraft/My/heli.acf; without it peers look \
         like the other aircraft that X-Plane has loaded"),
    key("plant.stick_release", above_zero_or("none", 1.0), text("none"),
        "deflection of the pilot's own stick, a share of its travel, beyond which a simulator's pilot takes the controls; never by \
         default: an uncentred stick would take them").unit_is("1"),
    key("plant.random_failures", Kind::Bool, Bool(false),
        "whether X-Plane's random failures are part of the flight: check and status then state that they are on, instead of a \
         fault; Skein does not turn them on"),
    key("plant.local_time_h", from_or("none", 0.0, 24.0), text("none"),
        "local time of day of an X-Plane, which the Web API of 12.4 sets; \"none\" changes nothing").unit_is("h"),
    key("plant.payload_kg", from_or("none", 0.0, 1e4), text("none"),
        "payload of an X-Plane's aircraft when it is placed, which the Web API of 12.4 sets; \"none\" leaves it to X-Plane").unit_is("kg"),
    key("plant.fuel_kg", from_or("none", 0.0, 1e4), text("none"),
        "fuel in the first tank of an X-Plane's aircraft when it is placed, which the Web API of 12.4 sets; \"none\" leaves it to X-Plane").unit_is("kg"),
    key("plant.point_mass.max_speed_m_s", above_zero(100.0), number(10.0),
        "largest horizontal speed of a point mass; 10 m/s are above the 7.5 m/s that a formation commands beside its centre's speed"),
    key("plant.point_mass.max_climb_m_s", above_zero(50.0), number(2.5),
        "largest climb rate and sink rate of a point mass; the built-in helicopter's controllers command 2.5 m/s"),
    key("plant.point_mass.max_acceleration_m_s2", above_zero_or("none", 1e3), number(3.0),
        "largest acceleration of a point mass, horizontal and vertical each; 3 m/s2 are a helicopter's at a lean of 17 degrees"),
    key("plant.point_mass.lag_s", from(0.0, 10.0), number(1.0),
        "time constant of a point mass's velocity; 1 s is the helicopter's lag. 0 with max_acceleration_m_s2 = \"none\" is a single integrator"),
    key("plant.point_mass.max_turn_deg_s", above_zero(720.0), number(60.0),
        "largest heading rate of a point mass"),
    key("plant.point_mass.turn_lag_s", from(0.0, 10.0), number(0.2),
        "time constant of a point mass's heading rate; the helicopter's gyro needs less"),

    key("start.pattern", OneOf(&["random", "as_is", "ring", "line"]), text("random"),
        "where vehicles stand before take-off, around the origin; \"as_is\": where X-Plane or [vehicle.N] has them"),
    key("start.square_m", from(0.0, 1e5), number(150.0),
        "side of the square of random starts, or diameter of a ring of starts; 150 m has room for 61 vehicles"),
    key("start.separation_m", from(0.0, 1e4), number(15.0),
        "least distance between two starts; vehicles that start nearer could meet on the climb"),

    key("origin.latitude_deg", from(-90.0, 90.0), number(28.0),
        "latitude of the local frame's origin, positive north; the site in Florida of Garcia & Barnes 2010"),
    key("origin.longitude_deg", from(-180.0, 180.0), number(-82.0),
        "longitude of the local frame's origin, positive east; the site in Florida of Garcia & Barnes 2010"),
    key("origin.elevation_m", from(-500.0, 9000.0), number(0.0),
        "height of the local frame's origin above the WGS 84 ellipsoid; all altitudes are measured from here"),

    key("formation.law", Kind::Law, text("ring"),
        "control law that places the vehicles; \"ring\" is the ellipse of Garcia & Barnes 2010"),
    key("formation.radius_m", above_zero(1e5), number(100.0),
        "radius R* of the ring, or of the area that a flock keeps to; Garcia & Barnes 2010, Table 1").flock(number(50.0)),
    key("formation.gamma", from(0.01, 100.0), number(1.0),
        "shape of the ellipse: its semi-axes are R* north and R*/sqrt(gamma) east; 1 is a circle, Table 1").unit_is("1"),
    key("formation.gamma_z", from(0.01, 100.0), number(1.0),
        "shape of the ellipsoid under vertical = \"ellipsoid\": its vertical semi-axis is R*/sqrt(gamma_z); 1 is a sphere").unit_is("1"),
    key("formation.heading_deg", from(-360.0, 360.0), number(0.0),
        "direction of the ellipse's first axis and of the slots, clockwise from north"),
    key("formation.inner_width_m", above_zero(1e5), number(20.0),
        "width delta R_in of the band inside the ring: it reaches from R* minus this; Table 1"),
    key("formation.outer_width_m", above_zero(1e5), number(20.0),
        "width delta R_out of the band outside the ring: it reaches to R* plus this; Table 1").flock(number(10.0)),
    key("formation.edge_share", from(1e-6, 0.49), number(0.01),
        "epsilon: remainder of a limiting function one width from its middle; at 1 % the band ends").unit_is("1"),
    key("formation.edge_steepness_per_m", above_zero_or("from_widths", 100.0), text("from_widths"),
        "steepness alpha_in = alpha_out of the band's edges; \"from_widths\": ln((1-epsilon)/epsilon)/width, soft enough that vehicles \
         do not oscillate"),
    key("formation.avoid_distance_m", above_zero_or("adaptive", 1e4), text("adaptive"),
        "distance delta R_avoid below which neighbours repel each other; \"adaptive\": R* sqrt(2) sin(pi/N) for N live vehicles, so that \
         the survivors of a loss space out again")
        .paper(number(100.0)).flock(number(20.0)),
    key("formation.avoidance", OneOf(&["tangential", "full"]), text("tangential"),
        "which part of the avoidance acts inside the band: along the ring, or all of it; \"full\" pushes the ring out by 11 m")
        .flock(text("full")),
    key("formation.circulation", from(-2.0, 2.0), number(0.0),
        "weight w_circ of the field that turns the ring, positive clockwise from above; with 0 a hovering formation does not rotate").unit_is("1"),
    key("formation.altitude_m", from(3.5, 1e4), number(30.0),
        "altitude of the formation above the origin; below 3.5 m sideways control is not fully available"),
    key("formation.vertical", OneOf(&["bands", "ellipsoid"]), text("bands"),
        "how vehicles are distributed over heights: a band for each rank, or by the field of an ellipsoid"),
    key("formation.band_step_m", from(0.0, 1e3), number(0.0),
        "difference of height delta h between neighbouring ranks; 0: all at one height, as in Garcia & Barnes 2010"),
    key("formation.conversion", OneOf(&["linear", "nonlinear"]), text("nonlinear"),
        "how the field becomes a position error; \"nonlinear\" is fast far from the place and calm near it").paper(text("linear")),
    key("formation.gain_m", above_zero(1e3), number(7.0),
        "gain c of the linear conversion, and c0 of the nonlinear one near the place; Garcia & Barnes 2010"),
    key("formation.far_gain_m", above_zero(1e3), number(28.0),
        "gain c1 of the nonlinear conversion far from the place; 56 m let vehicles come closer to each other"),
    key("formation.gain_knee", above_zero(10.0), number(0.3),
        "field strength v_b at which the nonlinear conversion changes from its near gain to its far gain").unit_is("1"),
    key("formation.feedforward", Kind::Bool, Bool(true),
        "add the velocity of the formation's centre to every setpoint; without it vehicles trail behind a moving centre")
        .paper(Bool(false)),
    key("formation.safety_filter", OneOf(&["none", "cbf"]), text("cbf"),
        "filter behind the law that keeps vehicles apart: a control barrier function, idle while all are far enough apart")
        .paper(text("none")),
    key("formation.safety_distance_m", above_zero(1e3), number(8.0),
        "least distance d_s that the safety filter keeps; 5 m of clearance and 3 m for the vehicle's lag"),
    key("formation.safety_rate_per_s", above_zero(100.0), number(0.5),
        "kappa: how fast the safety filter lets two vehicles close in, as a share of the remaining distance a second"),
    key("formation.parameters", Free, Literal::Toml("{}"),
        "parameters of a law that a program of your own adds, handed to it unchanged"),
    key("formation.slots.pattern", OneOf(&["circle", "line", "v", "grid", "list"]), text("circle"),
        "slots of the laws virtual-structure and displacement-consensus: on the ellipse, in a line abreast, in a V, in rows and columns, or as listed"),
    key("formation.slots.spacing_m", above_zero(1e4), number(20.0),
        "distance between neighbouring slots of a line, v or grid; more than twice safety_distance_m"),
    key("formation.slots.offsets_ne_m", Points, Nothing,
        "slots under pattern = \"list\", one for each vehicle: offsets from the centre, turned with heading_deg"),
    key("formation.displacement_consensus.gain_per_s", from(0.0, 10.0), number(0.05),
        "gain k of the differences to the neighbours; with 0.05 sixteen vehicles that all receive each other's state are as fast as a helicopter \
         can follow"),
    key("formation.displacement_consensus.goal_gain_per_s", from(0.0, 10.0), number(0.1),
        "gain k_g towards the own slot about the centre; at 0 the formation keeps its shape and does not follow the centre"),
    key("formation.olfati_saber.distance_m", above_zero(1e4), number(30.0),
        "distance d of neighbours in the lattice, 7 in Olfati-Saber 2006; 30 m suit a helicopter"),
    key("formation.olfati_saber.range_ratio", from(1.0, 10.0), number(1.2),
        "range of the interaction over the distance, r/d; Olfati-Saber 2006, section IX").unit_is("1"),
    key("formation.olfati_saber.epsilon", from(1e-3, 10.0), number(0.1),
        "epsilon of the sigma-norm; Olfati-Saber 2006").unit_is("1"),
    key("formation.olfati_saber.action_a", above_zero(1e3), number(5.0),
        "a of the action function: the strength of repulsion; Olfati-Saber 2006").unit_is("1"),
    key("formation.olfati_saber.action_b", above_zero(1e3), number(5.0),
        "b of the action function: the strength of attraction, at least action_a; Olfati-Saber 2006").unit_is("1"),
    key("formation.olfati_saber.bump_h", from(0.0, 0.99), number(0.2),
        "h: share of the range at which the bump function begins to fall; Olfati-Saber 2006").unit_is("1"),
    key("formation.olfati_saber.time_unit_s", above_zero(1e3), number(8.0),
        "length of the source's unit of time; 8 s slow the law down to what a helicopter can follow"),
    key("formation.olfati_saber.c1_per_s2", from(0.0, 10.0), number(0.004),
        "gain c1 towards the goal's position; 0.02 would press sixteen vehicles together until the lattice breaks"),
    key("formation.olfati_saber.c2_per_s", from(0.0, 10.0), number(0.13),
        "gain c2 towards the goal's velocity; 2 sqrt(c1) is critical damping"),
    key("formation.olfati_saber.horizon_s", above_zero(10.0), number(1.0),
        "time for which the law's acceleration is integrated to the velocity that is flown; 1 s is the helicopter's lag"),
    key("formation.olfati_saber.max_speed_m_s", above_zero(50.0), number(5.0),
        "largest commanded speed: a faster velocity is cut to it; 5 m/s suit the helicopter"),
    key("formation.vasarhelyi.flock_speed_m_s", above_zero(20.0), number(4.0),
        "v_flock: fastest homing speed; Vasarhelyi et al. 2018, the set evolved for 4 m/s"),
    key("formation.vasarhelyi.max_speed_m_s", above_zero(50.0), number(6.0),
        "v_max: largest commanded speed, a faster velocity is cut to it; Vasarhelyi et al. 2018"),
    key("formation.vasarhelyi.repulsion_range_m", above_zero(1e4), number(25.6),
        "r0_rep: nearer than this two vehicles repel each other; Vasarhelyi et al. 2018"),
    key("formation.vasarhelyi.repulsion_per_s", from(0.0, 10.0), number(0.13),
        "p_rep: gain of the repulsion; Vasarhelyi et al. 2018"),
    key("formation.vasarhelyi.friction_offset_m", from(0.0, 1e4), number(85.3),
        "r0_frict: distance at which the braking curve reaches zero speed; Vasarhelyi et al. 2018"),
    key("formation.vasarhelyi.friction_gain", from(0.0, 10.0), number(0.05),
        "C_frict: share of the excess velocity difference that is removed; Vasarhelyi et al. 2018").unit_is("1"),
    key("formation.vasarhelyi.friction_slack_m_s", from(0.0, 50.0), number(0.63),
        "v_frict: velocity difference that is always allowed; Vasarhelyi et al. 2018"),
    key("formation.vasarhelyi.friction_slope_per_s", above_zero(100.0), number(3.2),
        "p_frict: slope of the braking curve near its end; Vasarhelyi et al. 2018"),
    key("formation.vasarhelyi.friction_m_s2", above_zero(100.0), number(4.16),
        "a_frict: deceleration of the braking curve; Vasarhelyi et al. 2018"),
    key("formation.vasarhelyi.homing_per_s", from(0.0, 10.0), number(0.05),
        "gain towards the centre from half of R* on; it replaces the walls of the source"),
    key("formation.external.command", Texts, Nothing,
        "program and arguments that compute law = \"external\", one process a vehicle; give this, listen or udp"),
    key("formation.external.listen", Address("tcp/"), Nothing,
        "address on which your program listens: vehicle i connects to PORT + i; give this, command or udp"),
    key("formation.external.period_s", from(0.02, 10.0), number(0.1),
        "time between two requests to the program; the vehicle controller keeps its own 50 Hz"),
    key("formation.external.deadline_s", above_zero(10.0), number(0.05),
        "real time after which a request without an answer is missed; half a period"),
    key("formation.external.fallback", OneOf(BUILT_IN_LAWS), text("ring"),
        "law that is flown while the program does not answer"),
    key("formation.external.misses", Integer(1, 1000), Literal::Integer(3),
        "missed requests in a row after which the fallback law is flown; one or two can be a busy computer").unit_is("requests"),
    key("formation.external.max_speed_m_s", above_zero(50.0), number(5.0),
        "a faster velocity from the program is cut to this speed; 5 m/s suit the helicopter"),
    key("formation.external.parameters", Free, Literal::Toml("{}"),
        "parameters for the program, handed to it unchanged"),
    key("formation.external.udp.ask", Address(""), Nothing,
        "address to which requests are sent, PORT + id for each vehicle; udp needs both ask and answer"),
    key("formation.external.udp.answer", Address(""), Nothing,
        "address on which answers are received, PORT + id for each vehicle; udp needs both ask and answer"),

    key("mission.speed_m_s", above_zero(20.0), number(2.0),
        "speed of the centre on a path; without feed-forward vehicles can follow only the 1 m/s of Garcia & Barnes 2010")
        .paper(number(1.0)),
    key("mission.dwell_s", from(0.0, 600.0), number(3.0),
        "how long a vehicle has to be in place before it reports \"reached\", so that flying through the place does not count"),
    key("mission.progress_timeout_s", from(5.0, 1e6), number(60.0),
        "how long a vehicle may come no nearer to a step that others wait to leave, before it reports so, leaves the swarm and lands"),
    key("mission.partition", OneOf(&["continue", "quorum"]), text("continue"),
        "what a swarm does when the network splits it: every partition continues the mission, or only one with more than half the vehicles"),
    key("mission.steps", Tables, Literal::Toml("[{ centre_ne_m = [0.0, 0.0] }]"),
        "steps of the mission, flown one after the other; the swarm stays in the last one. By default it gathers at the origin"),
    key("mission.steps[N].name", Text, Nothing,
        "name of the step for people"),
    key("mission.steps[N].centre_ne_m", Point, Nothing,
        "place of the formation's centre; the step ends when every live vehicle has reached its place"),
    key("mission.steps[N].hold_s", above_zero(1e6), Nothing,
        "stay for this time, measured on each agent's own clock"),
    key("mission.steps[N].path_ne_m", Path, Nothing,
        "line along which the formation's centre moves"),
    key("mission.steps[N].land", True, Nothing,
        "land each vehicle where it is; only in the last step"),
    key("mission.steps[N].dwell_s", from(0.0, 600.0), Same("mission.dwell_s"),
        "mission.dwell_s for this step"),
    key("mission.steps[N].speed_m_s", above_zero(20.0), Same("mission.speed_m_s"),
        "mission.speed_m_s for this step"),
    key("mission.events", Tables, Nothing,
        "scheduled faults and orders; by default nothing happens"),
    key("mission.events[N].at_s", from(0.0, 1e6), Required,
        "when it happens, counted from each vehicle's own take-off"),
    key("mission.events[N].for_s", above_zero(1e6), Nothing,
        "how long it lasts; without it, to the end"),
    key("mission.events[N].fault", OneOf(FAULTS), Nothing,
        "fault to inject; an event has this or order"),
    key("mission.events[N].order", OneOf(ORDERS), Nothing,
        "order to give; an event has this or fault"),
    key("mission.events[N].vehicle", Id, Nothing,
        "vehicle that the fault affects"),
    key("mission.events[N].from", Ids, Nothing,
        "senders of a cut or delayed link"),
    key("mission.events[N].to", Ids, Nothing,
        "receivers of a cut or delayed link"),
    key("mission.events[N].both_ways", Kind::Bool, Bool(false),
        "the fault affects the other direction too; a radio often fails in one direction only"),
    key("mission.events[N].delay_s", above_zero(60.0), Nothing,
        "what fault = \"delay\" adds to the delay of the links"),
    key("mission.events[N].servo", OneOf(&["roll", "pitch", "collective"]), text("roll"),
        "servo that is stuck under fault = \"servo_stuck\""),
    key("mission.events[N].by_s", from(-1e9, 1e9), number(3600.0),
        "how far the clock jumps under fault = \"clock_jump\"; an hour, as a wrong time zone makes it"),
    key("mission.events[N].step", Integer(0, 10_000), Nothing,
        "step to which order = \"goto\" sends the swarm, counted from 0").unit_is("1"),
    key("mission.events[N].vehicles", Ids, Nothing,
        "vehicles that the order names; without it the whole swarm"),
    key("mission.events[N].key", OneOf(TUNABLE), Nothing,
        "key that order = \"set\" changes in flight"),
    key("mission.events[N].value", from(-1e6, 1e6), Nothing,
        "new value of that key, in its range").unit_is("in the key's unit"),

    key("control.auto_trim", Kind::Bool, Bool(true),
        "integrate the trims, which removes the position error that trim error and wind cause; without it that error is metres").paper(Bool(false)),
    key("control.rules", Text, text("shipped"),
        "folder of the four .fis rule bases of the vehicle controller; \"shipped\": those that come with the program"),
    key("control.mode", OneOf(&["each", "central"]), text("each"),
        "where controllers run: on each vehicle, or all on one computer as in Garcia & Barnes 2010 (\"central\", in a study only)"),
    key("control.central_step_s", from(0.0, 1.0), number(0.0001),
        "computing time of the central controller for one vehicle and frame; a live agent needs this time from frame to controls"),

    key("sensing.position", OneOf(&["exact", "f32_latlon"]), text("exact"),
        "precision of measured positions; \"f32_latlon\" rounds degrees to single precision, as in Garcia & Barnes 2010")
        .paper(text("f32_latlon")),
    key("sensing.velocity", OneOf(&["measured", "differenced"]), text("measured"),
        "source of the horizontal velocity: measured, or differenced from positions as a simple GPS receiver does"),
    key("sensing.differenced_tau_s", above_zero(60.0), number(1.0),
        "time constant tau of the filter under velocity = \"differenced\"; 1 s damps the steps of rounded positions"),
    key("sensing.latency_s", from(0.0, 2.0), number(0.0),
        "age at which a measurement reaches the agent, rounded up to whole frames; by default it is the present one"),
    key("sensing.dropout", from(0.0, 1.0), number(0.0),
        "share of frames without any measurement; by default none is missing").unit_is("1"),
    key("sensing.dropout_s", above_zero_or("none", 60.0), text("none"),
        "mean length of a dropout; \"none\": each frame is dropped independently"),
    key("sensing.correlation_s", above_zero_or("none", 1e4), text("none"),
        "correlation time of the noise of position and altitude, a first-order Gauss-Markov process; \"none\": white noise. A satellite \
         receiver's error drifts over tens of seconds"),
    key("sensing.noise.position_m", from(0.0, 100.0), number(0.0),
        "standard deviation of the noise of the position, north and east each; by default sensors are exact"),
    key("sensing.noise.altitude_m", from(0.0, 100.0), number(0.0),
        "standard deviation of the noise of the altitude; the height above the ground has a sensor of its own and stays exact"),
    key("sensing.noise.velocity_m_s", from(0.0, 10.0), number(0.0),
        "standard deviation of the white noise of each component of the velocity"),
    key("sensing.noise.attitude_deg", from(0.0, 10.0), number(0.0),
        "standard deviation of the white noise of roll and pitch"),
    key("sensing.noise.heading_deg", from(0.0, 10.0), number(0.0),
        "standard deviation of the white noise of the heading"),
    key("sensing.noise.rate_deg_s", from(0.0, 100.0), number(0.0),
        "standard deviation of the white noise of each body rate"),
    key("sensing.bias.position_m", from(0.0, 100.0), number(0.0),
        "standard deviation from which each vehicle's constant error of the position is drawn, north and east each; by default sensors are exact"),
    key("sensing.bias.altitude_m", from(0.0, 100.0), number(0.0),
        "standard deviation from which each vehicle's constant error of the altitude is drawn"),
    key("sensing.bias.velocity_m_s", from(0.0, 10.0), number(0.0),
        "standard deviation from which each vehicle's constant error of each component of the velocity is drawn"),
    key("sensing.bias.attitude_deg", from(0.0, 10.0), number(0.0),
        "standard deviation from which each vehicle's constant error of roll and pitch is drawn"),
    key("sensing.bias.heading_deg", from(0.0, 10.0), number(0.0),
        "standard deviation from which each vehicle's constant error of the heading is drawn"),
    key("sensing.bias.rate_deg_s", from(0.0, 100.0), number(0.0),
        "standard deviation from which each vehicle's constant error of each body rate is drawn"),

    key("airspace.fence_ne_m", Path, Nothing,
        "corners of a convex polygon that the vehicles stay inside; without it there is no fence"),
    key("airspace.ceiling_m", above_zero_or("none", 1e5), text("none"),
        "greatest altitude above the origin that a vehicle is sent to"),
    key("airspace.floor_m", above_zero_or("none", 1e5), text("none"),
        "least altitude above the origin that a vehicle is sent to unless it lands"),
    key("airspace.floor_above_ground_m", above_zero_or("none", 1e5), text("none"),
        "least height above the ground below it that a vehicle is sent to unless it lands, as it measures its height; it outranks the ceiling"),
    key("airspace.margin_m", from(0.0, 1e3), number(10.0),
        "horizontal distance that the vehicles keep from the fence and from obstacles; 10 m is for wind and for the lag of a vehicle"),
    key("airspace.obstacles", Tables, Nothing,
        "cylinders and boxes that stand on the ground and that the vehicles fly around"),
    key("airspace.obstacles[N].centre_ne_m", Point, Required,
        "middle of the obstacle"),
    key("airspace.obstacles[N].radius_m", above_zero(1e5), Nothing,
        "radius of a cylinder; an obstacle has this or size_ne_m"),
    key("airspace.obstacles[N].size_ne_m", Point, Nothing,
        "lengths of a box to the north and to the east; an obstacle has this or radius_m"),
    key("airspace.obstacles[N].top_m", above_zero(1e5), Nothing,
        "altitude of the top above the origin; vehicles 5 m above it fly over the obstacle. Without it none does"),

    key("world.wind_m_s", from(0.0, 50.0), number(0.0),
        "mean wind speed; by default the air is calm"),
    key("world.wind_from_deg", from(-360.0, 360.0), number(0.0),
        "direction that the wind comes from, clockwise from north"),
    key("world.gust_w20_m_s", from(0.0, 50.0), number(0.0),
        "strength of Dryden turbulence (MIL-F-8785C), as the wind speed at 20 ft that causes it; by default the air is calm"),

    key("network.send", OneOf(&["on_need", "every_frame"]), text("on_need"),
        "when a vehicle sends its state: when its peers' dead reckoning of it is off, or every frame")
        // Quantised positions step by 0.2 to 0.8 m: "on need" would be every frame anyway, at more cost.
        .implied("sensing.position", "f32_latlon", text("every_frame")),
    key("network.state_error_m", above_zero(1e3), number(0.1),
        "position error of the peers' dead reckoning from which on the state is sent; 0.1 m is far below any distance that matters"),
    key("network.state_error_m_s", above_zero(1e3), number(0.1),
        "velocity error of the peers' dead reckoning from which on the state is sent"),
    key("network.state_max_period_s", from(0.02, 10.0), number(0.2),
        "longest time between two states of a vehicle, whatever their error; the state is also the sign of life"),
    key("network.peer_stale_s", from(0.1, 600.0), number(2.0),
        "age T_stale from which on a peer's state is stale; 2 s make false suspicions rare at 30 % loss"),
    key("network.loss", from(0.0, 1.0), number(0.0),
        "share of messages that are lost; by default the network is perfect").unit_is("1"),
    key("network.burst_s", above_zero_or("none", 60.0), text("none"),
        "mean length of a burst of loss on each directed link; \"none\": each message is lost independently"),
    key("network.delay_s", from(0.0, 60.0), number(0.0),
        "delay of every message; by default the network is perfect"),
    key("network.jitter_s", from(0.0, 60.0), number(0.0),
        "random addition to the delay, 0 to this, drawn for every message: a later message may overtake"),
    key("network.reorder", from(0.0, 1.0), number(0.0),
        "share of messages that are held back by reorder_s").unit_is("1"),
    key("network.reorder_s", above_zero(60.0), number(0.3),
        "how long they are held back; above state_max_period_s, so that a later message overtakes"),
    key("network.duplicate", from(0.0, 1.0), number(0.0),
        "share of messages that are received twice, the second up to jitter_s after the first").unit_is("1"),
    key("network.bandwidth_bit_s", above_zero_or("none", 1e12), text("none"),
        "bandwidth of each directed link; one uplink that n peers share gives each link an n-th of it"),
    key("network.queue_s", from(0.0, 60.0), number(0.2),
        "a message that would wait longer for bandwidth is dropped; after 0.2 s the next state is due"),
    key("network.range_m", above_zero_or("none", 1e6), text("none"),
        "distance beyond which no message is received"),
    key("network.fade_m", above_zero_or("none", 1e6), text("none"),
        "distance from which on messages are lost, smoothly up to all at range_m; \"none\": none are lost before range_m"),
    key("network.graph", OneOf(&["all", "nearest", "edges"]), text("all"),
        "which vehicles receive whose state; agreement and orders reach all in any case"),
    key("network.neighbours", Integer(1, 249), Literal::Integer(6),
        "number of nearest vehicles whose state is received under graph = \"nearest\"; starlings heed six or seven").unit_is("vehicles"),
    key("network.edges", Edges, Nothing,
        "[sender, receiver] pairs under graph = \"edges\""),
    key("network.links", Tables, Nothing,
        "links that differ from the others; a later entry overrides an earlier one"),
    key("network.links[N].from", Ids, Nothing,
        "senders of these links; without it, all"),
    key("network.links[N].to", Ids, Nothing,
        "receivers of these links; without it, all"),
    key("network.links[N].both_ways", Kind::Bool, Bool(false),
        "the entry holds for the opposite direction too"),
    key("network.links[N].loss", from(0.0, 1.0), Nothing,
        "network.loss of these links").unit_is("1"),
    key("network.links[N].burst_s", above_zero(60.0), Nothing,
        "network.burst_s of these links"),
    key("network.links[N].delay_s", from(0.0, 60.0), Nothing,
        "network.delay_s of these links"),
    key("network.links[N].jitter_s", from(0.0, 60.0), Nothing,
        "network.jitter_s of these links"),
    key("network.links[N].reorder", from(0.0, 1.0), Nothing,
        "network.reorder of these links").unit_is("1"),
    key("network.links[N].reorder_s", above_zero(60.0), Nothing,
        "network.reorder_s of these links"),
    key("network.links[N].duplicate", from(0.0, 1.0), Nothing,
        "network.duplicate of these links").unit_is("1"),
    key("network.links[N].bandwidth_bit_s", above_zero(1e12), Nothing,
        "network.bandwidth_bit_s of these links"),
    key("network.links[N].queue_s", from(0.0, 60.0), Nothing,
        "network.queue_s of these links"),

    key("record.runs", OneOf(&["worst-and-median", "all", "none"]), text("worst-and-median"),
        "runs of a study whose recordings are kept: two show what is typical and what can happen"),
    key("record.hz", above_zero_or("auto", 1e3), text("auto"),
        "rate of recording; \"auto\": 10 Hz in a study, 50 Hz in real time"),
    key("record.inputs", Kind::Bool, Bool(false),
        "whether each live agent writes its inputs for skein replay in any case; by default only an agent that meets a fault leaves them"),

    key("vehicle.N.aircraft", TomlName, Same("swarm.aircraft"),
        "swarm.aircraft for this vehicle"),
    key("vehicle.N.start_ne_m", Point, Nothing,
        "where this vehicle stands before take-off, in place of start.pattern"),
    key("vehicle.N.heading_deg", from(-360.0, 360.0), Nothing,
        "where its nose points before take-off, clockwise from north"),
    key("vehicle.N.xplane", Address(""), Nothing,
        "address of this vehicle's X-Plane"),
    key("vehicle.N.web", Address(""), Nothing,
        "address of that X-Plane's Web API, for `skein xplane check --xplane` and `skein xplane place`; no flight depends on it"),
    key("vehicle.N.clock_offset_s", from(-1e6, 1e6), number(0.0),
        "how far its clock is ahead of the others'; the swarm does not rely on clocks that agree"),
    key("vehicle.N.clock_drift_ppm", from(-1e3, 1e3), number(0.0),
        "how much too fast its clock runs; quartz clocks are within 100 ppm"),
];

/// Keys of earlier versions, which were removed.
pub(in crate::scenario) const REMOVED: &[Removed] =
    &[Removed { path: "network.state_json_hz", reason: "the state for people will be published as `summary`" }];

/// Keys of an event besides `at_s` and `for_s`: the event's kind, its required keys, its optional keys.
pub(in crate::scenario) type Rule = (&'static str, &'static [&'static str], &'static [&'static str]);

const FAULT_RULES: [Rule; 11] = [
    ("kill", &["vehicle"], &[]),
    ("cut", &["from", "to"], &["both_ways"]),
    ("delay", &["from", "to", "delay_s"], &["both_ways"]),
    ("engine_out", &["vehicle"], &[]),
    ("simulator_freeze", &["vehicle"], &[]),
    ("servo_stuck", &["vehicle"], &["servo"]),
    ("gyro_off", &["vehicle"], &[]),
    ("gps_frozen", &["vehicle"], &[]),
    ("clock_jump", &["vehicle"], &["by_s"]),
    ("kill_control", &[], &[]),
    ("isolate", &[], &["both_ways"]),
];
const ORDER_RULES: [Rule; 6] = [
    ("hold", &[], &["vehicles"]),
    ("goto", &["step"], &["vehicles"]),
    ("land", &[], &["vehicles"]),
    ("abort", &[], &["vehicles"]),
    ("release", &["vehicles"], &[]),
    ("set", &["key", "value"], &[]),
];

/// Keys of each kind of fault.
pub(in crate::scenario) const FAULT_KEYS: &[Rule] = &FAULT_RULES;
/// Keys of each kind of order.
pub(in crate::scenario) const ORDER_KEYS: &[Rule] = &ORDER_RULES;
const FAULTS: &[&str] = &kinds(&FAULT_RULES);
const ORDERS: &[&str] = &kinds(&ORDER_RULES);
const TUNABLE: &[&str] = TunableKey::PATHS;

/// The kinds of these rules.
const fn kinds<const N: usize>(rules: &[Rule; N]) -> [&'static str; N] {
    let mut kinds = [""; N];
    let mut nth = 0;
    while nth < N {
        kinds[nth] = rules[nth].0;
        nth += 1;
    }
    kinds
}
