//! Turns a swarm into messages for a ground station, and answers its requests: without a clock and without a socket.

use std::collections::BTreeMap;
use std::time::Duration;

use mavlink::MavHeader;
use mavlink::dialects::common::{
    AUTOPILOT_VERSION_DATA, COMMAND_ACK_DATA, MISSION_ACK_DATA, MISSION_COUNT_DATA, MavCmd, MavMessage,
    MavMissionResult, MavMissionType, MavParamType, MavProtocolCapability, MavResult, MavSeverity, PARAM_VALUE_DATA,
};
use ring::digest::{SHA256, digest};
use skein_common::frame::{Geodetic, Origin};
use skein_common::id::VehicleName;
use skein_common::message::{EventKind, Failure, Severity, VehicleFacts, Verb};
use skein_common::scenario::Target;
use skein_common::state::Activity;

use super::commands::{Meaning, VehicleCommand, Wanted};
use super::frames::COMPONENT;
use super::{AUTOPILOT_VERSION, telemetry};
use crate::snapshot::Team;
use skein_cluster::display::status::Known;

/// Last system id of a vehicle: those above belong to ground systems.
pub(super) const LAST_SYSTEM: u8 = 250;
/// Name of the only parameter of a vehicle: its system id.
const PARAMETER: &str = "MAV_SYS_ID";
/// Number of the message with the home position.
const HOME_POSITION: u32 = 242;
/// Time between two heartbeats of a vehicle.
const HEARTBEAT: Duration = Duration::from_secs(1);
/// Time between two head-up displays of a vehicle.
const HUD: Duration = Duration::from_millis(500);

/// Two arrivals that are observed within this time are of the same summary: a vehicle sends ten a second.
const SAME: Duration = Duration::from_millis(40);

/// A message of a vehicle, which its system id names.
pub(super) type Outgoing = (u8, MavMessage);

/// An order that a ground station gives to a vehicle.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Requested {
    pub(super) vehicle: VehicleName,
    pub(super) verb: Verb,
    system: u8,
    /// The command that is acknowledged; `None` for the message that sets a mode, which is not.
    command: Option<MavCmd>,
    /// System and component of the ground station.
    from: (u8, u8),
}

/// The answers to a message of the ground station, and the order that it gives.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Reaction {
    pub(super) answers: Vec<Outgoing>,
    pub(super) order: Option<Requested>,
}

/// A swarm or fleet as a ground station sees it.
pub(super) struct Bridge {
    vehicles: BTreeMap<u8, System>,
    /// The system id of each vehicle.
    systems: BTreeMap<VehicleName, u8>,
    takes_orders: bool,
    /// Number of the next long text.
    next_text: u16,
}

/// One vehicle as a system of MAVLink, with what was sent of it.
struct System {
    name: VehicleName,
    uid: [u8; UID],
    origin: Origin,
    home: Geodetic,
    /// The last step of the mission that lands.
    landing_step: Option<u32>,
    activity: Option<Activity>,
    step: u32,
    /// The step in which the vehicle was last reported to be in formation.
    placed: Option<u32>,
    failures: Vec<Failure>,
    /// The time at which the newest summary arrived.
    arrived: Option<Duration>,
    next_heartbeat: Duration,
    next_hud: Duration,
    /// The order that is being given.
    pending: Option<Verb>,
}

impl Bridge {
    /// A swarm, or the teams of a fleet. In a swarm the system id is the vehicle's id and the offset that the operator gives, so that
    /// a ground station can tell the vehicles of two swarms apart; in a fleet vehicles are numbered through.
    pub(super) fn new(teams: &[Team], takes_orders: bool, offset: u8) -> Self {
        let systems = teams.iter().flat_map(|team| team.scenario.ids().map(|id| System::new(team, team.name(id))));
        let vehicles: BTreeMap<u8, System> = (offset + 1..=LAST_SYSTEM).zip(systems).collect();
        let systems = vehicles.iter().map(|(system, vehicle)| (vehicle.name, *system)).collect();
        Self { vehicles, systems, takes_orders, next_text: 1 }
    }

    /// The messages about what was observed by `now`, the time since the start. A vehicle out of contact sends nothing.
    pub(super) fn step(&mut self, now: Duration, teams: &[Team], observed: &[Vec<Known>]) -> Vec<Outgoing> {
        let mut messages = Vec::new();
        for (team, vehicle) in teams.iter().zip(observed).flat_map(|(team, all)| all.iter().map(move |one| (team, one)))
        {
            let Some(system) = self.systems.get(&team.name(vehicle.id)).copied() else { continue };
            let Some(sender) = self.vehicles.get_mut(&system) else { continue };
            if let (Some(sample), Some((_, silent))) = (vehicle.flying(), &vehicle.newest) {
                let own = sender.step(now, sample, now.saturating_sub(*silent), &mut self.next_text);
                messages.extend(own.into_iter().map(|message| (system, message)));
            }
        }
        messages
    }

    /// The text about an event of a vehicle; none about what goes as it should, or about a failure, which the vehicle's summary
    /// has.
    pub(super) fn event(&mut self, name: VehicleName, text: &str, severity: Severity) -> Vec<Outgoing> {
        let is_failure = Failure::ALL.iter().any(|failure| failure.to_string() == text);
        let Some(system) = self.systems.get(&name).copied().filter(|_| severity > Severity::Info && !is_failure) else {
            return Vec::new();
        };
        let text = format!("vehicle {name}: {text}");
        let texts = telemetry::text(telemetry::severity(severity), &text, count(&mut self.next_text));
        texts.into_iter().map(|message| (system, message)).collect()
    }

    /// Answers a message of a ground station.
    pub(super) fn receive(&mut self, header: MavHeader, message: &MavMessage) -> Reaction {
        let from = (header.system_id as u8, header.component_id);
        let Some((system, component)) = target(message) else { return Reaction::default() };
        if component != 0 && component != COMPONENT {
            return Reaction::default();
        }
        let addressed = self.vehicles.iter_mut().filter(|(id, _)| system == 0 || **id == system);
        let command = VehicleCommand::of(message);
        let mut reaction = Reaction::default();
        for (&id, addressee) in addressed {
            let Some(command) = command else {
                reaction.answers.extend(answer(id, from, message).map(|message| (id, message)));
                continue;
            };
            let meaning = command.meaning();
            // An order names its vehicle: one slip must not land a swarm.
            if system == 0 && !matches!(meaning, Meaning::Send(_)) {
                continue;
            }
            let command = command.is_acknowledged.then_some(command.command);
            let (result, why, order) = addressee.obey(id, meaning, self.takes_orders, command, from);
            if let Some(command) = command {
                reaction.answers.push((id, acknowledge(command, result, from)));
            }
            if let Meaning::Send(number) = meaning {
                reaction.answers.extend(addressee.requested(number).map(|message| (id, message)));
            }
            if let Some(why) = why {
                let texts = telemetry::text(MavSeverity::MAV_SEVERITY_WARNING, &why, count(&mut self.next_text));
                reaction.answers.extend(texts.into_iter().map(|message| (id, message)));
            }
            reaction.order = order;
        }
        reaction
    }

    /// The messages about an order that was given: the swarm's answer, or why it was not given.
    pub(super) fn ordered(&mut self, requested: &Requested, result: Result<&str, &str>) -> Vec<Outgoing> {
        if let Some(addressee) = self.vehicles.get_mut(&requested.system) {
            addressee.pending = None;
        }
        let (outcome, severity, text) = match result {
            Ok(text) => (MavResult::MAV_RESULT_ACCEPTED, MavSeverity::MAV_SEVERITY_NOTICE, text),
            Err(text) => (MavResult::MAV_RESULT_FAILED, MavSeverity::MAV_SEVERITY_ERROR, text),
        };
        let acknowledged = requested.command.map(|command| acknowledge(command, outcome, requested.from));
        let texts = telemetry::text(severity, text, count(&mut self.next_text));
        acknowledged.into_iter().chain(texts).map(|message| (requested.system, message)).collect()
    }
}

impl System {
    fn new(team: &Team, name: VehicleName) -> Self {
        let home = team.scenario.origin.geodetic();
        let lands = |target: &Target| matches!(target, Target::Land(_));
        let steps = &team.scenario.mission.steps;
        let landing_step = steps.iter().rposition(|step| lands(&step.target)).and_then(|nth| u32::try_from(nth).ok());
        Self {
            name,
            uid: uid(team.scenario.swarm.name.as_str(), name),
            origin: Origin::new(home),
            home,
            landing_step,
            activity: None,
            step: 0,
            placed: None,
            failures: Vec::new(),
            arrived: None,
            next_heartbeat: Duration::ZERO,
            next_hud: Duration::ZERO,
            pending: None,
        }
    }

    fn step(
        &mut self,
        now: Duration,
        sample: &VehicleFacts,
        arrived: Duration,
        next_text: &mut u16,
    ) -> Vec<MavMessage> {
        let mut messages = Vec::new();
        let is_new = self.arrived.is_none_or(|known| arrived > known + SAME);
        if is_new {
            self.arrived = Some(arrived);
            let time_boot_ms = u32::try_from(arrived.as_millis()).unwrap_or(u32::MAX);
            messages.push(telemetry::attitude(sample, &self.origin, time_boot_ms));
            messages.push(telemetry::position(sample, &self.origin, &self.home, time_boot_ms));
        }
        let has_changed = self.activity != Some(sample.activity);
        if now >= self.next_heartbeat || has_changed {
            self.next_heartbeat = now + HEARTBEAT;
            messages.push(telemetry::heartbeat(sample));
            messages.push(telemetry::system_status(sample));
            messages.push(telemetry::extended_state(sample));
            messages.push(telemetry::home(&self.home));
        }
        if now >= self.next_hud {
            self.next_hud = now + HUD;
            messages.push(telemetry::hud(sample, &self.origin));
        }
        let is_placed = sample.in_place_s.is_some();
        let doing = match sample.activity {
            // Whether it is in formation is a question of its place.
            Activity::Formation if is_placed => {
                (self.placed.replace(sample.step) != Some(sample.step)).then(|| "in formation".to_owned())
            }
            Activity::Formation => has_changed.then(|| "under way to its place in the formation".to_owned()),
            activity => has_changed.then(|| activity.to_string()),
        };
        self.placed = self.placed.filter(|_| sample.activity == Activity::Formation);
        if let Some(doing) = doing {
            let text = format!("vehicle {}: {doing}", self.name);
            messages.extend(telemetry::text(MavSeverity::MAV_SEVERITY_INFO, &text, count(next_text)));
        }
        for failure in sample.failures.iter().filter(|failure| !self.failures.contains(failure)) {
            let text = format!("vehicle {}: {failure}", self.name);
            let severity = telemetry::severity(EventKind::Failed(*failure).severity());
            messages.extend(telemetry::text(severity, &text, count(next_text)));
        }
        (self.activity, self.step) = (Some(sample.activity), sample.step);
        self.failures.clone_from(&sample.failures);
        messages
    }

    /// The result of a command, why it is refused, and the order to give.
    fn obey(
        &mut self,
        system: u8,
        meaning: Meaning,
        takes_orders: bool,
        command: Option<MavCmd>,
        from: (u8, u8),
    ) -> (MavResult, Option<String>, Option<Requested>) {
        let denied = |why: &str| (MavResult::MAV_RESULT_DENIED, Some(why.to_owned()), None);
        let accepted = (MavResult::MAV_RESULT_ACCEPTED, None, None);
        let wanted = match meaning {
            Meaning::Order(wanted) => wanted,
            Meaning::Send(AUTOPILOT_VERSION | HOME_POSITION) => return accepted,
            Meaning::Send(_) | Meaning::Unsupported => return (MavResult::MAV_RESULT_UNSUPPORTED, None, None),
            Meaning::Arm(true) => return denied("the agent starts the rotor when the swarm takes off"),
            Meaning::Arm(false) => return denied("the agent stops the rotor after landing: order it to land"),
            Meaning::Refused(why) => return denied(why),
        };
        if !takes_orders {
            return denied("orders are off: start `skein view` with --orders");
        }
        let verb = match wanted {
            Wanted::Land => Verb::Land,
            Wanted::Hold => Verb::Hold,
            Wanted::Continue => match self.activity {
                Some(Activity::Holding | Activity::Landing | Activity::Released) => Verb::Goto(self.step),
                Some(Activity::TakingOff | Activity::Formation) => return accepted,
                Some(Activity::Landed) => return denied("it has landed, and its flight has ended: fly again"),
                Some(Activity::Joining | Activity::Blind) | None => {
                    return denied("it takes off by itself as soon as its swarm is complete");
                }
            },
            Wanted::Return => match self.landing_step {
                Some(step) => Verb::Goto(step),
                None => return denied("no step of its mission lands: order it to land where it is"),
            },
        };
        match self.pending {
            // Sent again because the answer takes its time.
            Some(pending) if pending == verb => (MavResult::MAV_RESULT_IN_PROGRESS, None, None),
            Some(_) => (MavResult::MAV_RESULT_TEMPORARILY_REJECTED, None, None),
            None => {
                self.pending = Some(verb);
                let order = Requested { vehicle: self.name, verb, system, command, from };
                (MavResult::MAV_RESULT_IN_PROGRESS, None, Some(order))
            }
        }
    }

    /// A message that a ground station asks for by its number.
    fn requested(&self, number: u32) -> Option<MavMessage> {
        match number {
            AUTOPILOT_VERSION => Some(MavMessage::AUTOPILOT_VERSION(AUTOPILOT_VERSION_DATA {
                capabilities: MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MAVLINK2
                    | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_COMMAND_INT
                    | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST,
                uid: u64::from_le_bytes(std::array::from_fn(|nth| self.uid[nth])),
                uid2: self.uid,
                ..AUTOPILOT_VERSION_DATA::DEFAULT
            })),
            HOME_POSITION => Some(telemetry::home(&self.home)),
            _ => None,
        }
    }
}

/// Length of a unit id, bytes.
const UID: usize = 18;

/// The unit id of a vehicle: always the same for the same vehicle of the same swarm, and different for any two others.
fn uid(swarm: &str, vehicle: VehicleName) -> [u8; UID] {
    let digest = digest(&SHA256, format!("skein {swarm} {vehicle}").as_bytes());
    let mut uid = std::array::from_fn(|nth| digest.as_ref()[nth]);
    // Zero means unknown.
    uid[0] |= 1;
    uid
}

/// System and component that a request is for; `None` for any other message.
fn target(message: &MavMessage) -> Option<(u8, u8)> {
    if let Some(command) = VehicleCommand::of(message) {
        return Some((command.system, command.component));
    }
    match message {
        MavMessage::PARAM_REQUEST_LIST(request) => Some((request.target_system, request.target_component)),
        MavMessage::PARAM_REQUEST_READ(request) => Some((request.target_system, request.target_component)),
        MavMessage::PARAM_SET(set) => Some((set.target_system, set.target_component)),
        MavMessage::MISSION_REQUEST_LIST(request) => Some((request.target_system, request.target_component)),
        MavMessage::MISSION_COUNT(count) => Some((count.target_system, count.target_component)),
        MavMessage::MISSION_CLEAR_ALL(clear) => Some((clear.target_system, clear.target_component)),
        _ => None,
    }
}

/// The answer to a request for parameters or missions. There is one parameter, and there are no missions.
fn answer(system: u8, (target_system, target_component): (u8, u8), message: &MavMessage) -> Option<MavMessage> {
    let parameter = || {
        MavMessage::PARAM_VALUE(PARAM_VALUE_DATA {
            param_value: system.into(),
            param_count: 1,
            param_index: 0,
            param_id: PARAMETER.into(),
            param_type: MavParamType::MAV_PARAM_TYPE_REAL32,
        })
    };
    let refused = |mavtype: MavMissionResult, mission_type: MavMissionType| {
        MavMessage::MISSION_ACK(MISSION_ACK_DATA {
            target_system,
            target_component,
            mavtype,
            mission_type,
            ..MISSION_ACK_DATA::DEFAULT
        })
    };
    match message {
        MavMessage::PARAM_REQUEST_LIST(_) => Some(parameter()),
        MavMessage::PARAM_REQUEST_READ(request) => {
            let is_named = request.param_index == -1 && request.param_id.to_str() == Ok(PARAMETER);
            (is_named || request.param_index == 0).then(parameter)
        }
        // The value as it was: it cannot be set.
        MavMessage::PARAM_SET(set) => (set.param_id.to_str() == Ok(PARAMETER)).then(parameter),
        MavMessage::MISSION_REQUEST_LIST(request) => Some(MavMessage::MISSION_COUNT(MISSION_COUNT_DATA {
            target_system,
            target_component,
            mission_type: request.mission_type,
            ..MISSION_COUNT_DATA::DEFAULT
        })),
        MavMessage::MISSION_COUNT(count) => {
            Some(refused(MavMissionResult::MAV_MISSION_UNSUPPORTED, count.mission_type))
        }
        MavMessage::MISSION_CLEAR_ALL(clear) => Some(refused(MavMissionResult::MAV_MISSION_DENIED, clear.mission_type)),
        _ => None,
    }
}

fn acknowledge(command: MavCmd, result: MavResult, (target_system, target_component): (u8, u8)) -> MavMessage {
    let progress = if result == MavResult::MAV_RESULT_IN_PROGRESS { u8::MAX } else { 0 };
    MavMessage::COMMAND_ACK(COMMAND_ACK_DATA {
        command,
        result,
        progress,
        target_system,
        target_component,
        ..COMMAND_ACK_DATA::DEFAULT
    })
}

/// The next number, which is not 0.
fn count(next: &mut u16) -> u16 {
    let number = *next;
    *next = next.checked_add(1).unwrap_or(1);
    number
}
