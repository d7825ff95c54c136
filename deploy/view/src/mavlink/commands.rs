//! The meaning of a ground station's commands for a vehicle of a swarm.

#![expect(deprecated, reason = "QGroundControl and MAVSDK still send what newer messages replace")]

use mavlink::dialects::common::{COMMAND_LONG_DATA, MavCmd, MavMessage};

use super::modes::Mode;

/// A command to a vehicle, from any message that carries one.
#[derive(Clone, Copy, Debug)]
pub(super) struct VehicleCommand {
    pub(super) command: MavCmd,
    parameters: [f32; 7],
    pub(super) system: u8,
    pub(super) component: u8,
    /// Whether the message that carries it is acknowledged.
    pub(super) is_acknowledged: bool,
}

/// An action that a ground station wants of a vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Wanted {
    /// Descend where it is.
    Land,
    /// Stay where it is.
    Hold,
    /// Fly on with the mission.
    Continue,
    /// Go to the step of the mission that lands.
    Return,
}

/// The meaning of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Meaning {
    /// An order.
    Order(Wanted),
    /// To send a message of this number.
    Send(u32),
    /// To start or stop the rotor, which only the vehicle's agent does.
    Arm(bool),
    /// To do what a vehicle of a swarm does not do; the reason.
    Refused(&'static str),
    /// Nothing.
    Unsupported,
}

impl VehicleCommand {
    /// The command in this message, if it carries one.
    pub(super) fn of(message: &MavMessage) -> Option<Self> {
        // The largest integer is an unset coordinate.
        let coordinate = |number: i32| if number == i32::MAX { f32::NAN } else { number as f32 };
        let (command, parameters, system, component) = match message {
            MavMessage::COMMAND_LONG(long) => {
                let COMMAND_LONG_DATA { param1, param2, param3, param4, param5, param6, param7, .. } = *long;
                let parameters = [param1, param2, param3, param4, param5, param6, param7];
                (long.command, parameters, long.target_system, long.target_component)
            }
            MavMessage::COMMAND_INT(int) => {
                let (x, y) = (coordinate(int.x), coordinate(int.y));
                let parameters = [int.param1, int.param2, int.param3, int.param4, x, y, int.z];
                (int.command, parameters, int.target_system, int.target_component)
            }
            MavMessage::SET_MODE(set) => {
                let (main, sub) = Mode::split(set.custom_mode);
                let parameters = [1.0, main as f32, sub as f32, 0.0, 0.0, 0.0, 0.0];
                (MavCmd::MAV_CMD_DO_SET_MODE, parameters, set.target_system, 0)
            }
            _ => return None,
        };
        let is_acknowledged = !matches!(message, MavMessage::SET_MODE(_));
        Some(Self { command, parameters, system, component, is_acknowledged })
    }

    /// The meaning of the command.
    pub(super) fn meaning(&self) -> Meaning {
        let [first, second, third, _, fifth, sixth, _] = self.parameters;
        match self.command {
            MavCmd::MAV_CMD_NAV_LAND => Meaning::Order(Wanted::Land),
            MavCmd::MAV_CMD_NAV_LOITER_UNLIM => Meaning::Order(Wanted::Hold),
            MavCmd::MAV_CMD_NAV_TAKEOFF | MavCmd::MAV_CMD_MISSION_START => Meaning::Order(Wanted::Continue),
            MavCmd::MAV_CMD_NAV_RETURN_TO_LAUNCH => Meaning::Order(Wanted::Return),
            MavCmd::MAV_CMD_DO_PAUSE_CONTINUE if first == 0.0 => Meaning::Order(Wanted::Hold),
            MavCmd::MAV_CMD_DO_PAUSE_CONTINUE if first == 1.0 => Meaning::Order(Wanted::Continue),
            MavCmd::MAV_CMD_DO_PAUSE_CONTINUE => {
                Meaning::Refused("its first parameter is 0 to pause and 1 to continue")
            }
            // Without a place: stay. This is how QGroundControl pauses a vehicle of PX4.
            MavCmd::MAV_CMD_DO_REPOSITION if fifth.is_nan() && sixth.is_nan() => Meaning::Order(Wanted::Hold),
            MavCmd::MAV_CMD_DO_REPOSITION => {
                Meaning::Refused("its place is that in the formation; an operator can hold it or land it")
            }
            MavCmd::MAV_CMD_DO_SET_MODE => mode(Mode::from_numbers(second as u32, third as u32)),
            MavCmd::MAV_CMD_COMPONENT_ARM_DISARM => Meaning::Arm(first != 0.0),
            MavCmd::MAV_CMD_REQUEST_MESSAGE => Meaning::Send(first as u32),
            MavCmd::MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES => Meaning::Send(super::AUTOPILOT_VERSION),
            _ => Meaning::Unsupported,
        }
    }
}

fn mode(mode: Option<Mode>) -> Meaning {
    match mode {
        Some(Mode::Land) => Meaning::Order(Wanted::Land),
        Some(Mode::Hold) => Meaning::Order(Wanted::Hold),
        Some(Mode::Takeoff | Mode::Mission) => Meaning::Order(Wanted::Continue),
        Some(Mode::Return) => Meaning::Order(Wanted::Return),
        Some(Mode::Manual) => Meaning::Refused("a human pilot gets its controls with `skein order release --vehicles`"),
        Some(Mode::Ready) | None => Meaning::Refused("it has the modes Takeoff, Mission, Hold, Return and Land"),
    }
}
