//! Checks of combinations of keys: each value is valid on its own, and together they cannot be flown.

use std::f64::consts::PI;

use super::Source;
use super::error::ScenarioError;
use super::keys::KEYS;
use super::kind::FileKind;
use super::model::{
    ControlMode, Conversion, EventAction, Fault, Formation, Graph, Law, ModelKind, Pattern, PlantKind, SafetyFilter,
    Scenario, ScriptedOrder, ScriptedVerb, Setting, StartPattern, Vertical,
};
use super::tree::{Node, Part, Place, Table, Texts, Value};
use crate::id::VehicleId;
use crate::math;

/// Largest share of the start square that discs around random starts may cover. Discs placed at random, one after the
/// other, jam when they cover 55 % (random sequential adsorption). Up to this share 2 to 250 vehicles find starts
/// within 2000 attempts, sometimes after a restart of the placement.
const RANDOM_COVER: f64 = 0.40;

/// Lowest height at which the vehicle controller uses its full sideways authority, m.
const LOWEST_M: f64 = 3.5;
/// Lowest height to which the field of an ellipsoid may guide a vehicle, m.
const LOWEST_ON_ELLIPSOID_M: f64 = 5.0;

/// Longest path of an aircraft file in X-Plane's messages, bytes.
const LONGEST_ACF: usize = 149;

/// Checks all combinations; the first contradiction is the error.
pub(super) fn check(texts: &Texts<'_>, written: &Node, scenario: &Scenario) -> Result<(), ScenarioError> {
    let check = Check { texts, written, scenario };
    check.vehicles()?;
    check.model()?;
    check.shown_peers()?;
    check.starts()?;
    check.network()?;
    check.formations()?;
    check.external()?;
    check.central()?;
    check.events()
}

impl Scenario {
    /// Checks the combinations of keys of all formations, and that they fit into the airspace, as [`super::load`] does.
    ///
    /// # Errors
    /// Why the scenario cannot be flown.
    pub fn check_formations(&self) -> Result<(), String> {
        let source = Source { name: "", text: "" };
        let texts = Texts { kind: FileKind::Scenario, keys: KEYS, source: &source, sets: &[], part: Part::Whole };
        let written = Node { place: Place::File(0..0), value: Value::Table(Table::new()) };
        let check = Check { texts: &texts, written: &written, scenario: self };
        check.formations().map_err(|error| error.message.into())
    }
}

/// Whether these corners, one after the other, are those of a convex polygon that is gone around once.
fn is_convex(corners: &[[f64; 2]]) -> bool {
    let count = corners.len();
    let side = |nth: usize| {
        let ([n0, e0], [n1, e1]) = (corners[nth % count], corners[(nth + 1) % count]);
        [n1 - n0, e1 - e0]
    };
    let turn = |nth: usize| {
        let ([n0, e0], [n1, e1]) = (side(nth), side(nth + 1));
        math::atan2(n0 * e1 - e0 * n1, n0 * n1 + e0 * e1)
    };
    let turns: Vec<f64> = (0..count).map(turn).collect();
    let is_one_way = turns.iter().all(|turn| *turn > 0.0) || turns.iter().all(|turn| *turn < 0.0);
    let has_length = (0..count).all(|nth| side(nth) != [0.0, 0.0]);
    // A star turns one way too, but more than once around.
    count >= 3 && has_length && is_one_way && (turns.iter().sum::<f64>().abs() - 2.0 * PI).abs() < 1e-6
}

struct Check<'a> {
    texts: &'a Texts<'a>,
    written: &'a Node,
    scenario: &'a Scenario,
}

impl Check<'_> {
    /// An error at one of these keys: the first that a `--set` changed, or else the first that is written in the file.
    fn fault(&self, paths: &[&str], message: String) -> ScenarioError {
        let written: Vec<_> = paths.iter().filter_map(|path| Some((*path, self.written.at(path)?))).collect();
        let blamed = written.iter().find(|(_, node)| node.is_set()).or(written.first());
        let (path, place) = blamed.map_or(("", Place::File(0..0)), |(path, node)| (*path, node.place.clone()));
        self.texts.fault(&place, path, message)
    }

    /// Refuses the scenario at one of these keys if `is_wrong`.
    fn refuse_if(&self, is_wrong: bool, paths: &[&str], message: impl FnOnce() -> String) -> Result<(), ScenarioError> {
        if is_wrong { Err(self.fault(paths, message())) } else { Ok(()) }
    }

    /// The error for the fault of this event, which does not fit the value of another key.
    fn fault_refused(&self, index: usize, other: &str, why: &str) -> ScenarioError {
        let (event, path) = (format!("mission.events[{index}]"), format!("mission.events[{index}].fault"));
        let fault = self.written.at(&path).map(Node::plain).unwrap_or(false.into());
        self.fault(&[&path, other], format!("`{event}`: fault = {fault} {why}"))
    }

    fn formations(&self) -> Result<(), ScenarioError> {
        self.formation(&self.scenario.formation, None)?;
        for (index, step) in self.scenario.mission.steps.iter().enumerate() {
            self.formation(&step.formation, Some(index))?;
        }
        self.airspace()
    }

    fn count(&self) -> usize {
        self.scenario.swarm.vehicles
    }

    /// Checks that the swarm has this vehicle.
    fn flies(&self, id: VehicleId, path: &str) -> Result<(), ScenarioError> {
        self.refuse_if(usize::from(id.get()) > self.count(), &[path], || self.not_in_swarm(id, path))
    }

    /// Checks that the swarm has the vehicles of the list at this path.
    fn all_fly(&self, ids: &[VehicleId], path: &str) -> Result<(), ScenarioError> {
        ids.iter().enumerate().try_for_each(|(place, id)| self.flies(*id, &format!("{path}[{place}]")))
    }

    fn not_in_swarm(&self, id: VehicleId, path: &str) -> String {
        format!("`{path}`: vehicle {id} is not in the swarm, which has vehicles 1 to {}", self.count())
    }

    fn vehicles(&self) -> Result<(), ScenarioError> {
        let Some(table) = self.written.at("vehicle").and_then(Node::table) else { return Ok(()) };
        for (name, (place, _)) in table {
            let path = format!("vehicle.{name}");
            match name.parse::<VehicleId>() {
                Ok(id) if usize::from(id.get()) <= self.count() => {}
                Ok(id) => return Err(self.texts.fault(place, &path, self.not_in_swarm(id, &path))),
                Err(error) => return Err(self.texts.fault(place, &path, format!("`{path}`: {error}"))),
            }
        }
        Ok(())
    }

    /// Checks the fence, and that the safety filter keeps the airspace in every step.
    fn airspace(&self) -> Result<(), ScenarioError> {
        let Scenario { airspace, mission, .. } = self.scenario;
        if airspace.is_unlimited() {
            return Ok(());
        }
        let unfiltered = mission.steps.iter().any(|step| step.formation.safety_filter == SafetyFilter::None);
        self.refuse_if(unfiltered, &["formation.safety_filter", "airspace"], || {
            "`airspace` has no effect under `formation.safety_filter` = \"none\": the safety filter keeps it; set it to \"cbf\""
                .to_owned()
        })?;
        if let (Some(floor_m), Some(ceiling_m)) = (airspace.floor_m, airspace.ceiling_m) {
            self.refuse_if(floor_m >= ceiling_m, &["airspace.floor_m", "airspace.ceiling_m"], || {
                format!("`airspace.floor_m` is {floor_m}, not below `airspace.ceiling_m`, which is {ceiling_m}")
            })?;
        }
        for (index, obstacle) in airspace.obstacles.iter().enumerate() {
            let path = format!("airspace.obstacles[{index}].size_ne_m");
            let is_flat = obstacle.size_ne_m.is_some_and(|size_ne_m| size_ne_m.iter().any(|length_m| *length_m <= 0.0));
            self.refuse_if(is_flat, &[&path], || format!("`{path}` has a length that is not above 0"))?;
        }
        let corners = &airspace.fence_ne_m;
        self.refuse_if(!corners.is_empty() && !is_convex(corners), &["airspace.fence_ne_m"], || {
            "`airspace.fence_ne_m` is not a convex polygon of three corners or more, one after the other around it: leave out the \
             corners that point inwards, or make them obstacles"
                .to_owned()
        })
    }

    /// Checks that the model flies in the plant, and that nothing is asked of a point mass that only a helicopter has.
    fn model(&self) -> Result<(), ScenarioError> {
        let Scenario { plant, swarm, world, mission, .. } = self.scenario;
        let model = format!("`plant.model` = \"{}\"", plant.model.name());
        let is_unknown = swarm.plant.spec().command_for(plant.model).is_none();
        self.refuse_if(is_unknown, &["swarm.plant", "plant.model"], || {
            let plants: Vec<_> = PlantKind::flown_by(plant.model).map(|spec| format!("{:?}", spec.name)).collect();
            let why =
                if plant.model == ModelKind::PointMass { ": X-Plane and its stand-in fly helicopters" } else { "" };
            format!("{model} needs `swarm.plant` = {}{why}", plants.join(" or "))
        })?;
        if plant.model == ModelKind::Helicopter {
            return Ok(());
        }
        let point_mass = model;
        for (path, strength_m_s) in [("world.wind_m_s", world.wind_m_s), ("world.gust_w20_m_s", world.gust_w20_m_s)] {
            self.refuse_if(strength_m_s > 0.0, &[path, "plant.model"], || {
                format!("`{path}` has no effect under {point_mass}: a point mass holds its velocity over the ground")
            })?;
        }
        for (index, event) in mission.events.iter().enumerate() {
            let part = match &event.what {
                EventAction::Fault(Fault::EngineOut { .. }) => "engine",
                EventAction::Fault(Fault::ServoStuck { .. }) => "servos",
                EventAction::Fault(Fault::GyroOff { .. }) => "gyro",
                _ => continue,
            };
            let why = format!("has no effect under {point_mass}, which has no {part}");
            return Err(self.fault_refused(index, "plant.model", &why));
        }
        Ok(())
    }

    /// Checks that X-Plane's message can carry the aircraft file of peers, and that peers are shown at all.
    fn shown_peers(&self) -> Result<(), ScenarioError> {
        let plant = &self.scenario.plant;
        let Some(path) = &plant.peer_acf else { return Ok(()) };
        self.refuse_if(path.len() > LONGEST_ACF || path.contains(char::is_control), &["plant.peer_acf"], || {
            format!("`plant.peer_acf` has to be at most {LONGEST_ACF} bytes long, without control characters")
        })?;
        self.refuse_if(plant.show_peers == 0, &["plant.peer_acf"], || {
            "`plant.peer_acf` has no effect without `plant.show_peers`, the number of peers that are shown".to_owned()
        })
    }

    fn starts(&self) -> Result<(), ScenarioError> {
        let start = &self.scenario.start;
        let (square_m, apart_m) = (start.square_m, start.separation_m);
        // The pattern gives every vehicle a start, then `[vehicle.N]` moves some.
        let all_given = self.scenario.vehicle.iter().all(|vehicle| vehicle.start_ne_m.is_some());
        let free = if all_given { 0 } else { self.count() };
        let paths = ["start.separation_m", "start.square_m", "start.pattern", "swarm.vehicles"];
        let covered = free as f64 * PI / 4.0 * math::square(apart_m / (square_m + apart_m));
        let chord_m = square_m * math::sin(PI / free as f64);
        match start.pattern {
            StartPattern::Random if free > 1 && apart_m > 0.0 && covered > RANDOM_COVER => {
                let enough_m = (apart_m * ((free as f64 * PI / 4.0 / RANDOM_COVER).sqrt() - 1.0)).ceil();
                Err(ScenarioError {
                    help: Some(format!("`start.square_m` = {enough_m} is enough").into()),
                    ..self.fault(
                        &paths,
                        format!("{free} random starts {apart_m} m apart do not fit in a square of {square_m} m"),
                    )
                })
            }
            StartPattern::Ring if free > 1 && chord_m < apart_m => Err(self
                .fault(&paths, format!("{free} starts on a ring {square_m} m wide are less than {apart_m} m apart"))),
            StartPattern::AsIs if free > 0 && !self.scenario.swarm.plant.spec().has_own_start => Err(self.fault(
                &["start.pattern"],
                "`start.pattern` = \"as_is\" is for X-Plane: with another plant every vehicle needs `start_ne_m` in `[vehicle.N]`".to_owned(),
            )),
            _ => self.given_starts(),
        }
    }

    /// Checks that no two starts of `[vehicle.N]` are too close.
    fn given_starts(&self) -> Result<(), ScenarioError> {
        let given: Vec<_> =
            self.scenario.vehicle.iter().filter_map(|vehicle| Some((vehicle.id, vehicle.start_ne_m?))).collect();
        for (later, (id, [north, east])) in given.iter().enumerate() {
            for (other, [other_north, other_east]) in &given[..later] {
                let (least_m, path) = (self.scenario.start.separation_m, format!("vehicle.{id}.start_ne_m"));
                let apart_m = math::hypot(north - other_north, east - other_east);
                self.refuse_if(apart_m < least_m, &[&path], || {
                    format!(
                        "vehicles {other} and {id} start {apart_m} m apart, less than `start.separation_m`, {least_m}"
                    )
                })?;
            }
        }
        Ok(())
    }

    fn network(&self) -> Result<(), ScenarioError> {
        let network = &self.scenario.network;
        self.refuse_if(network.graph == Graph::Edges && network.edges.is_empty(), &["network.graph"], || {
            "`network.graph` = \"edges\" needs `network.edges`".to_owned()
        })?;
        for (index, ends) in network.edges.iter().enumerate() {
            let path = format!("network.edges[{index}]");
            self.all_fly(ends, &path)?;
            let [from, to] = ends;
            self.refuse_if(from == to, &[&path], || format!("`{path}`: vehicle {from} cannot send to itself"))?;
        }
        for (index, change) in network.links.iter().enumerate() {
            self.all_fly(&change.from, &format!("network.links[{index}].from"))?;
            self.all_fly(&change.to, &format!("network.links[{index}].to"))?;
        }
        if let Some(fade_m) = network.fade_m
            && network.range_m.is_none_or(|range_m| fade_m > range_m)
        {
            let message = match network.range_m {
                Some(range_m) => format!("`network.fade_m` is {fade_m}, but may not be above `range_m`, {range_m}"),
                None => "`network.fade_m` needs `network.range_m`, the distance from which on all messages are lost"
                    .to_owned(),
            };
            return Err(self.fault(&["network.fade_m", "network.range_m"], message));
        }
        let (stale_s, period_s) = (network.peer_stale_s, network.state_max_period_s);
        self.refuse_if(stale_s <= period_s, &["network.peer_stale_s", "network.state_max_period_s"], || {
            format!(
                "`network.peer_stale_s` is {stale_s}, but has to be above `network.state_max_period_s`, {period_s}: \
                 otherwise every peer is stale"
            )
        })
    }

    /// Checks one formation: the base, or that of a step.
    fn formation(&self, formation: &Formation, step: Option<usize>) -> Result<(), ScenarioError> {
        self.field(formation, step)?;
        self.heights(formation, step)?;
        self.slots(formation, step)?;
        self.room(formation, step)
    }

    /// An error at one of these keys of a formation: at the key in the step, or else at the key in the base.
    fn formation_fault(&self, step: Option<usize>, names: [&str; 2], message: String) -> ScenarioError {
        let in_step = step
            .into_iter()
            .flat_map(|step| names.into_iter().map(move |name| format!("mission.steps[{step}].formation.{name}")));
        let base = names.into_iter().map(|name| format!("formation.{name}"));
        let paths: Vec<String> = in_step.chain(base).chain(["swarm.vehicles".to_owned()]).collect();
        self.fault(&paths.iter().map(String::as_str).collect::<Vec<_>>(), message)
    }

    /// Checks that the band is narrower than the ring and that the conversion is monotone.
    fn field(&self, formation: &Formation, step: Option<usize>) -> Result<(), ScenarioError> {
        let &Formation { radius_m, gain_m, far_gain_m, .. } = formation;
        let (name, width_m) = match formation.law {
            Law::Flock => ("outer_width_m", formation.outer_width_m),
            _ => ("inner_width_m", formation.inner_width_m),
        };
        if matches!(formation.law, Law::Ring | Law::Flock) && width_m >= radius_m {
            let message = format!("`formation.{name}` is {width_m}, but has to be below `radius_m`, {radius_m}");
            return Err(self.formation_fault(step, [name, "radius_m"], message));
        }
        if formation.conversion == Conversion::Nonlinear && far_gain_m < gain_m {
            let message = format!("`formation.far_gain_m` is {far_gain_m}, but has to be at least `gain_m`, {gain_m}");
            return Err(self.formation_fault(step, ["far_gain_m", "gain_m"], message));
        }
        Ok(())
    }

    /// Checks that the lowest band, or the lowest point of the ellipsoid, is high enough.
    fn heights(&self, formation: &Formation, step: Option<usize>) -> Result<(), ScenarioError> {
        let law = formation.law;
        let lowest_m = formation.altitude_m - formation.half_height_m(self.count());
        if formation.vertical == Vertical::Ellipsoid {
            let message = if !matches!(law, Law::Ring | Law::Flock) {
                "`formation.vertical` = \"ellipsoid\" needs law \"ring\" or \"flock\": no other law has a vertical field"
                    .to_owned()
            } else if lowest_m < LOWEST_ON_ELLIPSOID_M {
                format!(
                    "the ellipsoid reaches down to {lowest_m:.1} m, but has to end at {LOWEST_ON_ELLIPSOID_M} m at least"
                )
            } else {
                return Ok(());
            };
            return Err(self.formation_fault(step, ["vertical", "altitude_m"], message));
        }
        if lowest_m >= LOWEST_M {
            return Ok(());
        }
        let count = self.count();
        let message = format!("the lowest of {count} bands is at {lowest_m} m, but has to be at {LOWEST_M} m at least");
        Err(self.formation_fault(step, ["band_step_m", "altitude_m"], message))
    }

    /// Checks that every vehicle has a slot and that no two slots are too close.
    fn slots(&self, formation: &Formation, step: Option<usize>) -> Result<(), ScenarioError> {
        let slots = &formation.slots;
        if !formation.law.has_slots() || slots.pattern == Pattern::Circle {
            return Ok(());
        }
        let listed = slots.offsets_ne_m.as_deref().unwrap_or_default();
        if slots.pattern == Pattern::List && listed.len() < self.count() {
            let (listed, count) = (listed.len(), self.count());
            let message = format!("`formation.slots.offsets_ne_m` has {listed} slots for {count} vehicles");
            return Err(self.formation_fault(step, ["slots.offsets_ne_m", "slots.pattern"], message));
        }
        let is_flat = formation.band_step_m == 0.0;
        let apart_m = |[a, b]: [&[f64; 2]; 2]| math::hypot(a[0] - b[0], a[1] - b[1]);
        let pairs = listed.iter().enumerate().flat_map(|(nth, a)| listed[..nth].iter().map(move |b| [a, b]));
        let nearest_m = match slots.pattern {
            Pattern::List => pairs.map(apart_m).fold(f64::INFINITY, f64::min),
            _ => slots.spacing_m,
        };
        let least_m = formation.safety_distance_m;
        if formation.safety_filter == SafetyFilter::None || !is_flat || self.count() == 1 || nearest_m >= least_m {
            return Ok(());
        }
        let message =
            format!("two slots are {nearest_m:.1} m apart, less than `formation.safety_distance_m`, {least_m}");
        Err(self.formation_fault(step, ["slots.spacing_m", "slots.offsets_ne_m"], message))
    }

    /// Checks that neighbours on the ring keep the safety filter's distance. The condition is necessary, not
    /// sufficient: neighbours on an ellipse are never farther apart than on the circle around it.
    fn room(&self, formation: &Formation, step: Option<usize>) -> Result<(), ScenarioError> {
        let is_flat = formation.vertical == Vertical::Bands && formation.band_step_m == 0.0;
        let is_filtered = formation.safety_filter == SafetyFilter::Cbf;
        let widest_m = formation.radius_m * (1.0 / formation.gamma.sqrt()).max(1.0);
        let chord_m = 2.0 * widest_m * math::sin(PI / self.count() as f64);
        let least_m = formation.safety_distance_m;
        let is_ring = match formation.law {
            Law::Ring => true,
            law => law.has_slots() && formation.slots.pattern == Pattern::Circle,
        };
        if !is_ring || !is_flat || !is_filtered || self.count() == 1 || chord_m >= least_m {
            return Ok(());
        }
        let message = format!(
            "{} neighbours on this ring are {chord_m:.1} m apart, less than `formation.safety_distance_m`, {least_m}",
            self.count()
        );
        let enough_m = (formation.radius_m * least_m / chord_m).ceil();
        Err(ScenarioError {
            help: Some(format!("`radius_m` = {enough_m} is enough").into()),
            ..self.formation_fault(step, ["radius_m", "safety_distance_m"], message)
        })
    }

    fn external(&self) -> Result<(), ScenarioError> {
        let formation = &self.scenario.formation;
        let external = &formation.external;
        let transports = [external.command.is_some(), external.listen.is_some(), external.udp.is_some()];
        let transports = transports.iter().filter(|is_given| **is_given).count();
        let mut steps = self.scenario.mission.steps.iter();
        let step = steps.position(|step| step.formation.law == Law::External);
        if let Some(step) = step.filter(|_| transports != 1) {
            let in_step = format!("mission.steps[{step}].formation.law");
            return Err(self.fault(
                &["formation.external", &in_step, "formation.law"],
                "law \"external\" needs one of `command`, `listen`, `udp` in `[formation.external]`".to_owned(),
            ));
        }
        let (deadline_s, period_s) = (external.deadline_s, external.period_s);
        let keys = ["formation.external.deadline_s", "formation.external.period_s"];
        self.refuse_if(deadline_s > period_s, &keys, || {
            format!("`formation.external.deadline_s` is {deadline_s}, but may not be above `period_s`, {period_s}")
        })
    }

    /// Checks the events against the control mode: with central control vehicles have no computers and send each other
    /// nothing; without it the swarm has no central controller to kill.
    fn central(&self) -> Result<(), ScenarioError> {
        let is_central = self.scenario.control.mode == ControlMode::Central;
        let most = usize::from(VehicleId::MAX) - 1;
        self.refuse_if(is_central && self.count() > most, &["control.mode", "swarm.vehicles"], || {
            format!(
                "`control.mode` = \"central\" is for {most} vehicles at most: the central controller needs an id too"
            )
        })?;
        for (index, event) in self.scenario.mission.events.iter().enumerate() {
            let why = match &event.what {
                EventAction::Fault(Fault::KillControl) if !is_central => {
                    "needs `control.mode` = \"central\": this swarm has no central controller"
                }
                EventAction::Fault(Fault::Kill { .. }) if is_central => {
                    "has no effect under `control.mode` = \"central\": use \"kill_control\""
                }
                EventAction::Fault(Fault::ClockJump { .. }) if is_central => {
                    "has no effect under `control.mode` = \"central\": no vehicle has a clock of its own"
                }
                EventAction::Fault(Fault::Cut { .. } | Fault::Delay { .. }) if is_central => {
                    "has no effect under `control.mode` = \"central\": vehicles send each other nothing"
                }
                _ => continue,
            };
            return Err(self.fault_refused(index, "control.mode", why));
        }
        Ok(())
    }

    /// Checks the settings that events order, each together with those in force at its time.
    fn settings(&self) -> Result<(), ScenarioError> {
        let path = |index: usize| format!("mission.events[{index}].value");
        let settings = self.scenario.scripted_settings();
        if let Some((index, Setting { key, value })) = settings.into_iter().find(|(_, one)| !one.is_in_range()) {
            let path = path(index);
            let message = format!("`{path}` is {value}, out of the range of `{}`: {}", key.path(), key.range());
            return Err(self.fault(&[&path], message));
        }
        self.scenario.check_scripted_settings(Scenario::check_formations).map_err(|(index, setting, why)| {
            let path = path(index);
            self.fault(&[&path], format!("`{path}`: {setting} cannot be flown: {why}"))
        })
    }

    fn events(&self) -> Result<(), ScenarioError> {
        for (index, event) in self.scenario.mission.events.iter().enumerate() {
            let path = |name: &str| format!("mission.events[{index}].{name}");
            match &event.what {
                EventAction::Fault(Fault::Cut { from, to, .. } | Fault::Delay { from, to, .. }) => {
                    self.all_fly(from, &path("from"))?;
                    self.all_fly(to, &path("to"))?;
                }
                EventAction::Fault(fault) => {
                    fault.vehicle().map_or(Ok(()), |vehicle| self.flies(vehicle, &path("vehicle")))?;
                }
                EventAction::Order(ScriptedOrder { verb, vehicles }) => {
                    let last = self.scenario.mission.steps.len() - 1;
                    if let ScriptedVerb::Goto { step } = verb {
                        let path = path("step");
                        let message = || format!("`{path}` is {step}, but the last step is {last}");
                        self.refuse_if(*step > last, &[&path], message)?;
                    }
                    self.all_fly(vehicles.as_deref().unwrap_or_default(), &path("vehicles"))?;
                }
            }
        }
        self.settings()
    }
}
