//! Every key of a scenario file, once: kind, range, defaults, meaning.
//!
//! The loader, the presets, `--set`, the messages and the complete file all read this table; a test holds it against the
//! fields of [`Scenario`](super::Scenario). What looks keys up takes the table: other files have their own.

use std::fmt;

/// A key: how it is spelled, what it takes and what it is when nobody says anything.
#[derive(Clone, Copy, Debug)]
pub struct Key {
    /// Dotted; `N` stands for an id, `[N]` for a place in a list. A step takes the keys of `formation` too.
    pub path: &'static str,
    /// What it takes.
    pub kind: Kind,
    /// Value below everything.
    pub default: Literal,
    /// Value under `preset = "paper"`, where it differs.
    pub paper: Option<Literal>,
    /// Value under `law = "flock"`, where it differs; the same in both presets.
    pub flock: Option<Literal>,
    /// What it means, and why the default is what it is.
    pub about: &'static str,
}

/// What a key takes.
#[derive(Clone, Copy, Debug)]
pub enum Kind {
    /// A finite number.
    Number(Range),
    /// A finite number or this word.
    NumberOr(&'static str, Range),
    /// A whole number, both ends included.
    Integer(i64, i64),
    /// true or false.
    Bool,
    /// Nothing but true.
    True,
    /// One of these texts.
    OneOf(&'static [&'static str]),
    /// A law's name.
    Law,
    /// 1 to 64 letters, digits, '-' or '_'.
    Name,
    /// The same as the name of a TOML file, whose ending may stand behind it and is cut off.
    TomlName,
    /// A text that is not empty.
    Text,
    /// HOST:PORT, behind this prefix.
    Address(&'static str),
    /// One text or more.
    Texts,
    /// A vehicle's id.
    Id,
    /// One vehicle id or more.
    Ids,
    /// Pairs of vehicle ids.
    Edges,
    /// North and east.
    Point,
    /// Two points or more.
    Path,
    /// One table or more; their keys stand in the table with `[N]`.
    Tables,
    /// A table of anything that JSON can say.
    Free,
}

/// Of numbers; the upper end is included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// Lower end.
    pub min: f64,
    /// Upper end.
    pub max: f64,
    /// Whether the lower end belongs to it.
    pub min_included: bool,
}

impl Range {
    /// Whether the number lies in it; NaN does not.
    pub fn contains(self, number: f64) -> bool {
        (if self.min_included { self.min <= number } else { self.min < number }) && number <= self.max
    }
}

impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.min_included {
            write!(f, "{} to {}", self.min, self.max)
        } else {
            write!(f, "above {}, at most {}", self.min, self.max)
        }
    }
}

/// A default.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Literal {
    /// The file has to say it.
    Required,
    /// Absent.
    Nothing,
    /// Whatever this other key is.
    Same(&'static str),
    /// A number.
    Number(f64),
    /// A whole number.
    Integer(i64),
    /// true or false.
    Bool(bool),
    /// A text.
    Text(&'static str),
    /// Anything else, as TOML.
    Toml(&'static str),
}

use Kind::{Address, Edges, Free, Id, Ids, Integer, Name, OneOf, Path, Point, Tables, Text, Texts, TomlName, True};
use Literal::{Bool, Nothing, Required, Same};

const fn key(path: &'static str, kind: Kind, default: Literal, about: &'static str) -> Key {
    Key { path, kind, default, paper: None, flock: None, about }
}

impl Key {
    const fn paper(self, value: Literal) -> Self {
        Self { paper: Some(value), ..self }
    }

    const fn flock(self, value: Literal) -> Self {
        Self { flock: Some(value), ..self }
    }
}

/// From `min` to `max`.
const fn from(min: f64, max: f64) -> Kind {
    Kind::Number(Range { min, max, min_included: true })
}

/// Above zero, up to `max`.
const fn above_zero(max: f64) -> Kind {
    Kind::Number(Range { min: 0.0, max, min_included: false })
}

/// Above zero, up to `max`, or a word.
const fn above_zero_or(word: &'static str, max: f64) -> Kind {
    Kind::NumberOr(word, Range { min: 0.0, max, min_included: false })
}

const fn number(value: f64) -> Literal {
    Literal::Number(value)
}

const fn text(value: &'static str) -> Literal {
    Literal::Text(value)
}

const BUILT_IN_LAWS: &[&str] =
    &["ring", "flock", "olfati-saber", "vasarhelyi", "virtual-structure", "displacement-consensus"];

/// Every key there is. Tables stand together, in the order in which the complete file is written.
#[rustfmt::skip]
pub const KEYS: &[Key] = &[
    key("name", Name, text("swarm"), "what flies, in a word: names runs and folders"),
    key("preset", OneOf(&["default", "paper"]), text("default"), "the defaults below the file; \"paper\" is Garcia & Barnes 2010"),
    key("seed", Integer(0, i64::MAX), Literal::Integer(1), "where all randomness comes from; any number is as good"),
    key("duration_s", above_zero_or("none", 1e6), text("none"), "end of the flight; \"none\": flown until stopped or until the mission ends"),

    key("swarm.vehicles", Integer(1, 250), Required, "how many fly; ids 1 to this, as MAVLink allows"),
    key("swarm.name", Name, Same("name"), "namespace of all traffic: two swarms on one network need two"),
    key("swarm.plant", OneOf(&["builtin", "standin", "xplane"]), text("builtin"), "what moves; the built-in helicopter needs nothing else installed"),
    key("swarm.aircraft", TomlName, text("xcell60"), "the aircraft: NAME.toml beside this file, or one of the program's; of the class that the paper imitated"),
    key("swarm.trim_error_rms_deg", from(0.0, 5.0), number(0.3), "hidden error of roll and pitch trim: no real machine is trimmed exactly"),

    key("start.pattern", OneOf(&["random", "as_is", "ring", "line"]), text("random"), "how they stand before take-off, around the origin"),
    key("start.square_m", from(0.0, 1e5), number(150.0), "side of the square of random starts, diameter of a ring of starts"),
    key("start.separation_m", from(0.0, 1e4), number(15.0), "least distance of two starts; nearer ones would meet on the climb"),

    key("origin.latitude_deg", from(-90.0, 90.0), number(28.0), "of the local frame; the authors' site in Florida"),
    key("origin.longitude_deg", from(-180.0, 180.0), number(-82.0), "of the local frame; the authors' site in Florida"),
    key("origin.elevation_m", from(-500.0, 9000.0), number(0.0), "of the local frame above the ellipsoid; altitudes count from here"),

    key("formation.law", Kind::Law, text("ring"), "who goes where; the paper's ellipse"),
    key("formation.radius_m", above_zero(1e5), number(100.0), "R*; Garcia & Barnes 2010, Table 1").flock(number(50.0)),
    key("formation.gamma", from(0.01, 100.0), number(1.0), "semi-axes are R* north and R*/sqrt(gamma) east; Table 1"),
    key("formation.gamma_z", from(0.01, 100.0), number(1.0), "vertical semi-axis of an ellipsoid is R*/sqrt(gamma_z)"),
    key("formation.heading_deg", from(-360.0, 360.0), number(0.0), "of the ellipse's first axis, clockwise from north"),
    key("formation.inner_width_m", above_zero(1e5), number(20.0), "delta R_in: the band reaches from R* minus this; Table 1"),
    key("formation.outer_width_m", above_zero(1e5), number(20.0), "delta R_out: the band reaches to R* plus this; Table 1").flock(number(10.0)),
    key("formation.edge_share", from(1e-6, 0.49), number(0.01), "epsilon: share of a limiting function that is left one width from its middle"),
    key("formation.edge_steepness_per_m", above_zero_or("from_widths", 100.0), text("from_widths"), "alpha_in = alpha_out; else ln((1-e)/e)/width, soft enough not to cycle"),
    key("formation.avoid_distance_m", above_zero_or("adaptive", 1e4), text("adaptive"), "delta R_avoid; adaptive: R* sqrt(2) sin(pi/N), so that survivors re-space")
        .paper(number(100.0)).flock(number(20.0)),
    key("formation.avoidance", OneOf(&["tangential", "full"]), text("tangential"), "part of the avoidance that acts in the band; full pushes the ring out by 11 m").flock(text("full")),
    key("formation.circulation", from(-2.0, 2.0), number(0.0), "w_circ, clockwise: a hover formation must not rotate"),
    key("formation.altitude_m", from(3.5, 1e4), number(30.0), "of the formation above the origin; below 3.5 m sideways control is not all there"),
    key("formation.vertical", OneOf(&["bands", "ellipsoid"]), text("bands"), "how heights are shared out: by rank, or by the field"),
    key("formation.band_step_m", from(0.0, 1e3), number(0.0), "delta h between ranks; 0 as in the paper, all at one height"),
    key("formation.conversion", OneOf(&["linear", "nonlinear"]), text("nonlinear"), "field to position error; nonlinear is fast far away and calm near by").paper(text("linear")),
    key("formation.gain_m", above_zero(1e3), number(7.0), "c, c0: gain of the linear conversion and of the nonlinear one near by; the paper's"),
    key("formation.far_gain_m", above_zero(1e3), number(28.0), "c1: gain of the nonlinear conversion far away; 56 brings vehicles closer together"),
    key("formation.gain_knee", above_zero(10.0), number(0.3), "v_b: field at which the nonlinear conversion turns"),
    key("formation.feedforward", Kind::Bool, Bool(true), "the centre's velocity is fed forward; else vehicles trail behind it").paper(Bool(false)),
    key("formation.safety_filter", OneOf(&["none", "cbf"]), text("cbf"), "control barrier function behind the law: leaves it alone while all are apart").paper(text("none")),
    key("formation.safety_distance_m", above_zero(1e3), number(8.0), "d_s: 5 m and 3 m for the vehicle's lag"),
    key("formation.safety_rate_per_s", above_zero(100.0), number(0.5), "kappa: how fast the filter lets vehicles close in"),
    key("formation.parameters", Free, Literal::Toml("{}"), "of a law that is none of Skein's, handed over as they are"),
    key("formation.slots.pattern", OneOf(&["circle", "line", "v", "grid", "list"]), text("circle"), "of virtual-structure and displacement-consensus: the ellipse; or abreast, like geese, in rows, across the heading"),
    key("formation.slots.spacing_m", above_zero(1e4), number(20.0), "between neighbours in a line, v or grid"),
    key("formation.slots.offsets_ne_m", Path, Nothing, "from the centre, turned with the heading, one for each vehicle, under pattern = \"list\""),
    key("formation.displacement_consensus.gain_per_s", from(0.0, 10.0), number(0.05), "k; ours: sixteen who all hear each other are as fast as a helicopter can follow"),
    key("formation.displacement_consensus.goal_gain_per_s", from(0.0, 10.0), number(0.1), "k_g towards the own place about the centre; ours. 0: consensus alone, which goes nowhere"),
    key("formation.olfati_saber.distance_m", above_zero(1e4), number(30.0), "d, which the source calls 7; ours"),
    key("formation.olfati_saber.range_ratio", from(1.0, 10.0), number(1.2), "r/d; Olfati-Saber 2006, section IX"),
    key("formation.olfati_saber.epsilon", from(1e-3, 10.0), number(0.1), "of the sigma-norm; the source's"),
    key("formation.olfati_saber.action_a", above_zero(1e3), number(5.0), "of the action function; the source's"),
    key("formation.olfati_saber.action_b", above_zero(1e3), number(5.0), "of the action function, not below a; the source's"),
    key("formation.olfati_saber.bump_h", from(0.0, 0.99), number(0.2), "where the bump function begins to fall; the source's"),
    key("formation.olfati_saber.time_unit_s", above_zero(1e3), number(8.0), "what the source's unit of time is here; ours: a helicopter follows within a second"),
    key("formation.olfati_saber.c1_per_s2", from(0.0, 10.0), number(0.004), "towards the goal; ours: 0.02 presses sixteen together until the lattice breaks"),
    key("formation.olfati_saber.c2_per_s", from(0.0, 10.0), number(0.13), "towards its velocity; ours: 2 sqrt(c1)"),
    key("formation.olfati_saber.horizon_s", above_zero(10.0), number(1.0), "an acceleration is flown as the velocity that it leads to by then; ours: the helicopter's lag"),
    key("formation.olfati_saber.max_speed_m_s", above_zero(50.0), number(5.0), "a faster velocity is cut to this; ours"),
    key("formation.vasarhelyi.flock_speed_m_s", above_zero(20.0), number(4.0), "v_flock; Vasarhelyi et al. 2018, set evolved for 4 m/s"),
    key("formation.vasarhelyi.max_speed_m_s", above_zero(50.0), number(6.0), "v_max; the source's"),
    key("formation.vasarhelyi.repulsion_range_m", above_zero(1e4), number(25.6), "r0_rep; the source's"),
    key("formation.vasarhelyi.repulsion_per_s", from(0.0, 10.0), number(0.13), "p_rep; the source's"),
    key("formation.vasarhelyi.friction_offset_m", from(0.0, 1e4), number(85.3), "r0_frict; the source's"),
    key("formation.vasarhelyi.friction_gain", from(0.0, 10.0), number(0.05), "C_frict; the source's"),
    key("formation.vasarhelyi.friction_slack_m_s", from(0.0, 50.0), number(0.63), "v_frict; the source's"),
    key("formation.vasarhelyi.friction_slope_per_s", above_zero(100.0), number(3.2), "p_frict; the source's"),
    key("formation.vasarhelyi.friction_m_s2", above_zero(100.0), number(4.16), "a_frict; the source's"),
    key("formation.vasarhelyi.homing_per_s", from(0.0, 10.0), number(0.05), "towards the centre, from half of R* on; ours, in place of the source's walls"),
    key("formation.external.command", Texts, Nothing, "program and arguments of law = \"external\", one process a vehicle; this, listen or udp"),
    key("formation.external.listen", Address("tcp/"), Nothing, "tcp/HOST:PORT: vehicle i connects to PORT + i"),
    key("formation.external.period_s", from(0.02, 10.0), number(0.1), "between two asks; the vehicle controller keeps its own 50 Hz"),
    key("formation.external.deadline_s", above_zero(10.0), number(0.05), "real time until an ask is missed: half a period"),
    key("formation.external.fallback", OneOf(BUILT_IN_LAWS), text("ring"), "flies while the program does not answer"),
    key("formation.external.misses", Integer(1, 1000), Literal::Integer(3), "this many misses in a row, and the fallback flies"),
    key("formation.external.max_speed_m_s", above_zero(50.0), number(5.0), "a faster answer is cut to this"),
    key("formation.external.parameters", Free, Literal::Toml("{}"), "handed over as they are"),
    key("formation.external.udp.ask", Address(""), Nothing, "HOST:PORT the asks go to, PORT + id for each vehicle"),
    key("formation.external.udp.answer", Address(""), Nothing, "HOST:PORT the answers come to, PORT + id for each vehicle"),

    key("mission.speed_m_s", above_zero(20.0), number(2.0), "of a centre on a path; without feed-forward the paper's 1 m/s is what vehicles can follow").paper(number(1.0)),
    key("mission.dwell_s", from(0.0, 600.0), number(3.0), "how long a vehicle has to be in place before it says \"reached\""),
    key("mission.partition", OneOf(&["continue", "quorum"]), text("continue"), "what a split swarm does: each part goes on, or only one with more than half"),
    key("mission.steps", Tables, Literal::Toml("[{ centre_ne_m = [0.0, 0.0] }]"), "what is done one after the other; the last step is not left"),
    key("mission.steps[N].name", Text, Nothing, "for people"),
    key("mission.steps[N].centre_ne_m", Point, Nothing, "a place, left when every live vehicle reached it"),
    key("mission.steps[N].hold_s", above_zero(1e6), Nothing, "stay, on each agent's own clock"),
    key("mission.steps[N].path_ne_m", Path, Nothing, "the centre moves along this line"),
    key("mission.steps[N].land", True, Nothing, "land where they are; the last step"),
    key("mission.steps[N].dwell_s", from(0.0, 600.0), Same("mission.dwell_s"), "mission.dwell_s for this step"),
    key("mission.steps[N].speed_m_s", above_zero(20.0), Same("mission.speed_m_s"), "mission.speed_m_s for this step"),
    key("mission.events", Tables, Nothing, "what happens to the run: faults and orders"),
    key("mission.events[N].at_s", from(0.0, 1e6), Required, "counted from each vehicle's own take-off"),
    key("mission.events[N].for_s", above_zero(1e6), Nothing, "how long; without it, for good"),
    key("mission.events[N].fault", OneOf(FAULTS), Nothing, "what breaks"),
    key("mission.events[N].order", OneOf(ORDERS), Nothing, "what is ordered"),
    key("mission.events[N].vehicle", Id, Nothing, "whose fault"),
    key("mission.events[N].from", Ids, Nothing, "senders of a cut or delayed link"),
    key("mission.events[N].to", Ids, Nothing, "receivers of a cut or delayed link"),
    key("mission.events[N].both_ways", Kind::Bool, Bool(false), "the fault affects the other direction too"),
    key("mission.events[N].delay_s", above_zero(60.0), Nothing, "what fault = \"delay\" adds to the delay of the links"),
    key("mission.events[N].servo", OneOf(&["roll", "pitch", "collective"]), text("roll"), "which one sticks"),
    key("mission.events[N].by_s", from(-1e9, 1e9), number(3600.0), "how far the clock jumps; an hour, as clocks set wrong do"),
    key("mission.events[N].step", Integer(0, 10_000), Nothing, "where order = \"goto\" goes, counted from 0"),

    key("control.auto_trim", Kind::Bool, Bool(true), "integrates what trim error and wind leave: metres, without it").paper(Bool(false)),
    key("control.rules", Text, text("shipped"), "folder of .fis rule bases; \"shipped\": those of this build"),
    key("control.mode", OneOf(&["each", "central"]), text("each"), "where controllers run; central (study only) is the paper's one machine"),
    key("control.central_step_s", from(0.0, 1.0), number(0.0001), "that machine's time for one vehicle and frame; what a live agent of ours takes, frame in to controls out"),

    key("sensing.position", OneOf(&["exact", "f32_latlon"]), text("exact"), "f32_latlon rounds degrees to single precision, as the paper's vehicles did").paper(text("f32_latlon")),
    key("sensing.velocity", OneOf(&["measured", "differenced"]), text("measured"), "differenced: from positions, as a poor receiver does"),
    key("sensing.differenced_tau_s", above_zero(60.0), number(1.0), "tau of the differencing filter"),

    key("world.wind_m_s", from(0.0, 50.0), number(0.0), "mean wind"),
    key("world.wind_from_deg", from(-360.0, 360.0), number(0.0), "where the wind comes from, clockwise from north"),
    key("world.gust_w20_m_s", from(0.0, 50.0), number(0.0), "Dryden turbulence, MIL-F-8785C: the wind at 20 ft that it belongs to"),

    key("network.send", OneOf(&["on_need", "every_frame"]), text("on_need"), "when the state is sent; every_frame if sensing.position is f32_latlon"),
    key("network.state_error_m", above_zero(1e3), number(0.1), "error of the peers' dead reckoning that sends"),
    key("network.state_error_m_s", above_zero(1e3), number(0.1), "error of the peers' velocity that sends"),
    key("network.state_max_period_s", from(0.02, 10.0), number(0.2), "a state is sent at least this often"),
    key("network.peer_stale_s", from(0.1, 600.0), number(2.0), "T_stale: 2 s make false suspicions rare at 30 % loss"),
    key("network.loss", from(0.0, 1.0), number(0.0), "share of messages that never arrive"),
    key("network.burst_s", above_zero_or("none", 60.0), text("none"), "mean length of a burst of loss, of each directed link; \"none\": each message is lost on its own"),
    key("network.delay_s", from(0.0, 60.0), number(0.0), "of every message"),
    key("network.jitter_s", from(0.0, 60.0), number(0.0), "added to the delay, 0 to this, anew for every message: a later one may overtake it"),
    key("network.reorder", from(0.0, 1.0), number(0.0), "share of messages that are held back by reorder_s more"),
    key("network.reorder_s", above_zero(60.0), number(0.3), "how long; above state_max_period_s, so that a later message overtakes"),
    key("network.duplicate", from(0.0, 1.0), number(0.0), "share of messages that come once more, up to jitter_s after the first time"),
    key("network.bandwidth_bit_s", above_zero_or("none", 1e12), text("none"), "of each directed link; a speaker's one uplink to n others is an n-th of it"),
    key("network.queue_s", from(0.0, 60.0), number(0.2), "a message that would wait longer for the bandwidth is dropped; by then the next state is there"),
    key("network.range_m", above_zero_or("none", 1e6), text("none"), "farther apart, nobody hears"),
    key("network.fade_m", above_zero_or("none", 1e6), text("none"), "from here on messages are lost, smoothly up to all at range_m; \"none\": from range_m on, all at once"),
    key("network.graph", OneOf(&["all", "nearest", "edges"]), text("all"), "who hears whose state; agreement and orders go to everybody"),
    key("network.neighbours", Integer(1, 249), Literal::Integer(6), "how many under graph = \"nearest\"; starlings heed six or seven"),
    key("network.edges", Edges, Nothing, "[speaker, hearer] pairs under graph = \"edges\""),
    key("network.links", Tables, Nothing, "links that are not like the others; a later entry stands above an earlier one"),
    key("network.links[N].from", Ids, Nothing, "speakers; without it, everybody"),
    key("network.links[N].to", Ids, Nothing, "hearers; without it, everybody"),
    key("network.links[N].both_ways", Kind::Bool, Bool(false), "the entry holds for the other way too"),
    key("network.links[N].loss", from(0.0, 1.0), Nothing, "network.loss of these links"),
    key("network.links[N].burst_s", above_zero(60.0), Nothing, "network.burst_s of these links"),
    key("network.links[N].delay_s", from(0.0, 60.0), Nothing, "network.delay_s of these links"),
    key("network.links[N].jitter_s", from(0.0, 60.0), Nothing, "network.jitter_s of these links"),
    key("network.links[N].reorder", from(0.0, 1.0), Nothing, "network.reorder of these links"),
    key("network.links[N].reorder_s", above_zero(60.0), Nothing, "network.reorder_s of these links"),
    key("network.links[N].duplicate", from(0.0, 1.0), Nothing, "network.duplicate of these links"),
    key("network.links[N].bandwidth_bit_s", above_zero(1e12), Nothing, "network.bandwidth_bit_s of these links"),
    key("network.links[N].queue_s", from(0.0, 60.0), Nothing, "network.queue_s of these links"),
    key("network.state_json_hz", from(0.0, 50.0), number(0.0), "the state once more, as JSON for people; 0 is off"),

    key("record.runs", OneOf(&["worst-and-median", "all", "none"]), text("worst-and-median"), "of which runs of a study recordings are kept"),
    key("record.hz", above_zero_or("auto", 1e3), text("auto"), "how often is recorded; auto: 10 in a study, 50 live"),

    key("vehicle.N.aircraft", TomlName, Same("swarm.aircraft"), "swarm.aircraft for this vehicle"),
    key("vehicle.N.start_ne_m", Point, Nothing, "where it stands at first, whatever start.pattern says"),
    key("vehicle.N.heading_deg", from(-360.0, 360.0), Nothing, "where its nose points at first, clockwise from north"),
    key("vehicle.N.xplane", Address(""), Nothing, "HOST:PORT of its simulator"),
    key("vehicle.N.clock_offset_s", from(-1e6, 1e6), number(0.0), "how far its clock is ahead of the others'; nothing assumes that clocks agree"),
    key("vehicle.N.clock_drift_ppm", from(-1e3, 1e3), number(0.0), "how much too fast its clock runs; quartz is within 100"),
];

/// What an event of a kind takes besides `at_s` and `for_s`: the kind, what it needs, what it may have.
pub(super) const FAULT_KEYS: &[(&str, &[&str], &[&str])] = &[
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
];
const FAULTS: &[&str] = &[
    "kill",
    "cut",
    "delay",
    "engine_out",
    "simulator_freeze",
    "servo_stuck",
    "gyro_off",
    "gps_frozen",
    "clock_jump",
    "kill_control",
];

/// The same for orders.
pub(super) const ORDER_KEYS: &[(&str, &[&str], &[&str])] =
    &[("hold", &[], &[]), ("goto", &["step"], &[]), ("land", &[], &[]), ("abort", &[], &[])];
const ORDERS: &[&str] = &["hold", "goto", "land", "abort"];

/// What a name in a file stands for.
#[derive(Clone, Copy, Debug)]
pub(super) enum Meaning {
    /// A key.
    Key(&'static Key),
    /// A table that has keys below it.
    Table,
    /// Inside a list or a free table: the key around it knows what it takes.
    Inside,
}

/// Whether this dotted path is a key that takes whole numbers.
pub fn is_whole(path: &str) -> bool {
    matches!(meaning(KEYS, path), Some(Meaning::Key(key)) if matches!(key.kind, Integer(..) | Id))
}

/// What this dotted path stands for, if anything.
pub(super) fn meaning(known: &'static [Key], path: &str) -> Option<Meaning> {
    let pattern = pattern(known, path);
    let table = in_step(&pattern).unwrap_or(&pattern);
    let below = |key: &Key| key.path.strip_prefix(table).is_some_and(|rest| rest.starts_with(['.', '[']));
    if let Some(key) = key_at(known, &pattern) {
        return Some(Meaning::Key(key));
    }
    if known.iter().any(below) {
        return Some(Meaning::Table);
    }
    let mut around = pattern.as_str();
    while let Some(end) = around.rfind(['.', '[']) {
        around = &around[..end];
        match key_at(known, around) {
            Some(key) if matches!(key.kind, Free) => return Some(Meaning::Inside),
            Some(key) if pattern[around.len()..].replace("[N]", "").is_empty() && is_list(key.kind) => {
                return Some(Meaning::Inside);
            }
            _ => {}
        }
    }
    None
}

fn is_list(kind: Kind) -> bool {
    matches!(kind, Texts | Ids | Edges | Point | Path)
}

/// The table of the formation that is meant by one inside a step.
fn in_step(pattern: &str) -> Option<&str> {
    let table = pattern.strip_prefix("mission.steps[N].").filter(|table| table.split('.').next() == Some("formation"));
    // A step has no `formation.external`: one program flies the whole mission.
    table.filter(|table| table.split('.').nth(1) != Some("external"))
}

/// The key of this pattern, those of `formation` inside a step included.
fn key_at(known: &'static [Key], pattern: &str) -> Option<&'static Key> {
    match pattern.strip_prefix("mission.steps[N].formation.") {
        Some(rest) => known.iter().find(|key| key.path.strip_prefix("formation.") == Some(rest)),
        None => known.iter().find(|key| key.path == pattern),
    }
}

/// The key with this path, which stands in the scenario's table.
pub(super) fn find(path: &str) -> Option<&'static Key> {
    KEYS.iter().find(|key| key.path == path)
}

/// `mission.steps[3].name` to `mission.steps[N].name`, `vehicle.3.aircraft` to `vehicle.N.aircraft`.
fn pattern(known: &[Key], path: &str) -> String {
    let mut pattern = String::with_capacity(path.len());
    for (place, segment) in path.split('.').enumerate() {
        if place > 0 {
            pattern.push('.');
        }
        if place == 1 && has_ids(known, &pattern) {
            // What is not an id matches nothing, not even a literal N.
            let is_id = segment.parse::<u32>().is_ok_and(|id| id.to_string() == segment);
            pattern.push(if is_id { 'N' } else { '?' });
            continue;
        }
        let mut parts = segment.split('[');
        pattern.push_str(parts.next().unwrap_or_default());
        for _ in parts {
            pattern.push_str("[N]");
        }
    }
    pattern
}

/// Whether tables of ids stand below this one, `vehicle.`.
fn has_ids(known: &[Key], table: &str) -> bool {
    known.iter().any(|key| key.path.strip_prefix(table).is_some_and(|rest| rest.starts_with("N.")))
}

/// The table of ids that this path goes into with something that is no id.
pub(super) fn no_id<'p>(known: &[Key], path: &'p str) -> Option<&'p str> {
    let (table, name) = path.split_once('.')?;
    (!name.contains('.') && has_ids(known, &format!("{table}."))).then_some(table)
}

/// The valid path nearest to one that is not, if any is near: a letter or two off, or right but in another table.
pub(super) fn nearest(known: &[Key], path: &str) -> Option<String> {
    if path.len() > 100 {
        return None;
    }
    let (table, name) = path.rsplit_once('.').unwrap_or(("", path));
    let siblings = siblings(known, table);
    let close = |candidate: &str, to: &str| {
        let distance = edit_distance(candidate, to);
        (distance <= 1 + to.len() / 4).then_some(distance)
    };
    let beside = siblings.iter().filter_map(|sibling| Some((close(sibling, name)?, join(table, sibling))));
    let elsewhere = known.iter().filter(|key| !key.path.contains("N")).filter_map(|key| {
        let last = key.path.rsplit_once('.').map_or(key.path, |(_, last)| last);
        Some((1 + close(last, name)?, key.path.to_owned()))
    });
    let whole = known.iter().filter_map(|key| Some((close(key.path, path)?, key.path.to_owned())));
    beside.chain(elsewhere).chain(whole).min_by_key(|(distance, _)| *distance).map(|(_, path)| path)
}

/// Names of keys and tables directly inside a table.
fn siblings(known: &[Key], table: &str) -> Vec<&'static str> {
    let pattern = pattern(known, table);
    let prefix = in_step(&pattern).unwrap_or(&pattern);
    let mut names: Vec<&str> = known
        .iter()
        .filter_map(
            |key| if prefix.is_empty() { Some(key.path) } else { key.path.strip_prefix(prefix)?.strip_prefix('.') },
        )
        .filter_map(|rest| rest.split(['.', '[']).next())
        .collect();
    if pattern == "mission.steps[N]" {
        names.push("formation");
    }
    if pattern == "mission.steps[N].formation" {
        names.retain(|name| *name != "external");
    }
    names.dedup();
    names
}

/// A table's path and a name in it, quoted where it has to be: so that no name passes for a path.
pub(super) fn join(table: &str, name: &str) -> String {
    let name = if is_bare(name) { name.to_owned() } else { format!("{name:?}") };
    if table.is_empty() { name } else { format!("{table}.{name}") }
}

/// Whether a name needs no quotes in TOML.
pub(super) fn is_bare(name: &str) -> bool {
    !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_')
}

/// The word nearest to one that is none of these, if any is near.
pub(super) fn nearest_of<'a>(words: impl Iterator<Item = &'a str>, word: &str) -> Option<&'a str> {
    let close = |known: &'a str| (edit_distance(known, word), known);
    let nearest = words.filter(|known| word.len() <= 2 * known.len()).map(close).min();
    nearest.filter(|(distance, known)| *distance <= 1 + known.len() / 4).map(|(_, known)| known)
}

/// Letters to insert, remove, replace or swap with their neighbour (optimal string alignment).
fn edit_distance(a: &str, b: &str) -> usize {
    let (a, b): (Vec<char>, Vec<char>) = (a.chars().collect(), b.chars().collect());
    let mut before_last = vec![0; b.len() + 1];
    let mut last: Vec<usize> = (0..=b.len()).collect();
    for i in 0..a.len() {
        let mut row = vec![i + 1; b.len() + 1];
        for j in 0..b.len() {
            let replaced = last[j] + usize::from(a[i] != b[j]);
            row[j + 1] = replaced.min(last[j + 1] + 1).min(row[j] + 1);
            if i > 0 && j > 0 && a[i] == b[j - 1] && a[i - 1] == b[j] {
                row[j + 1] = row[j + 1].min(before_last[j - 1] + 1);
            }
        }
        before_last = std::mem::replace(&mut last, row);
    }
    last[b.len()]
}
