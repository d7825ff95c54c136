//! Writes a vehicle's summary as MAVLink, in its units, frames and signs. Velocities and headings are local there: they refer to
//! the meridian of the vehicle's position. What a summary does not have is sent as unknown.

use mavlink::dialects::common::{
    ATTITUDE_DATA, EXTENDED_SYS_STATE_DATA, GLOBAL_POSITION_INT_DATA, HEARTBEAT_DATA, HOME_POSITION_DATA, MavAutopilot,
    MavMessage, MavSeverity, MavType, MavVtolState, STATUSTEXT_DATA, SYS_STATUS_DATA, VFR_HUD_DATA,
};
use skein_common::frame::{Convergence, Geodetic, Origin};
use skein_common::math;
use skein_common::message::{Severity, VehicleFacts};

use super::modes::{self, Mode};

/// Longest text in one message, bytes.
const TEXT: usize = 50;

/// The heartbeat: kind, mode and state.
pub(super) fn heartbeat(sample: &VehicleFacts) -> MavMessage {
    MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        custom_mode: Mode::of(sample.activity).custom(),
        mavtype: MavType::MAV_TYPE_HELICOPTER,
        autopilot: MavAutopilot::MAV_AUTOPILOT_PX4,
        base_mode: modes::flags(sample.activity),
        system_status: modes::state(sample),
        mavlink_version: 3,
    })
}

/// Position and velocity. Altitudes are above the ellipsoid, and above the swarm's origin, which is the home position.
pub(super) fn position(sample: &VehicleFacts, origin: &Origin, home: &Geodetic, time_boot_ms: u32) -> MavMessage {
    let (place, convergence) = origin.place(sample.place());
    let [north_m_s, east_m_s, down_m_s] = <[f64; 3]>::from(convergence.velocity_to_local(sample.velocity));
    MavMessage::GLOBAL_POSITION_INT(GLOBAL_POSITION_INT_DATA {
        time_boot_ms,
        lat: degrees_e7(place.latitude_rad),
        lon: degrees_e7(place.longitude_rad),
        alt: millimetres(place.altitude_m),
        relative_alt: millimetres(place.altitude_m - home.altitude_m),
        vx: centimetres(north_m_s),
        vy: centimetres(east_m_s),
        vz: centimetres(down_m_s),
        hdg: (heading_deg(sample, &convergence) * 100.0).round() as u16,
    })
}

/// Attitude: body axes forward, right, down against north, east, down. Rates are unknown.
pub(super) fn attitude(sample: &VehicleFacts, origin: &Origin, time_boot_ms: u32) -> MavMessage {
    let (_, convergence) = origin.place(sample.place());
    MavMessage::ATTITUDE(ATTITUDE_DATA {
        time_boot_ms,
        roll: sample.attitude.roll_rad as f32,
        pitch: sample.attitude.pitch_rad as f32,
        yaw: convergence.heading_to_local(sample.attitude.heading_rad) as f32,
        rollspeed: f32::NAN,
        pitchspeed: f32::NAN,
        yawspeed: f32::NAN,
    })
}

/// The figures of a head-up display. Airspeed is unknown; the throttle is the collective, 0 without one.
pub(super) fn hud(sample: &VehicleFacts, origin: &Origin) -> MavMessage {
    let (place, convergence) = origin.place(sample.place());
    let [north_m_s, east_m_s, down_m_s] = <[f64; 3]>::from(sample.velocity);
    let collective = sample.controls.map_or(0.0, |[.., collective]| collective);
    MavMessage::VFR_HUD(VFR_HUD_DATA {
        airspeed: f32::NAN,
        groundspeed: math::hypot(north_m_s, east_m_s) as f32,
        alt: place.altitude_m as f32,
        climb: -down_m_s as f32,
        heading: heading_deg(sample, &convergence) as i16,
        throttle: (collective * 100.0).round().clamp(0.0, 100.0) as u16,
    })
}

/// State of the systems: the energy left, in per cent. Voltage, current and load are unknown.
pub(super) fn system_status(sample: &VehicleFacts) -> MavMessage {
    MavMessage::SYS_STATUS(SYS_STATUS_DATA {
        voltage_battery: u16::MAX,
        current_battery: -1,
        battery_remaining: sample.energy_left.map_or(-1, |left| (left * 100.0).round().clamp(0.0, 100.0) as i8),
        ..SYS_STATUS_DATA::DEFAULT
    })
}

/// Whether it is on the ground.
pub(super) fn extended_state(sample: &VehicleFacts) -> MavMessage {
    MavMessage::EXTENDED_SYS_STATE(EXTENDED_SYS_STATE_DATA {
        vtol_state: MavVtolState::MAV_VTOL_STATE_UNDEFINED,
        landed_state: modes::landed(sample.activity),
    })
}

/// The home position: the origin of the swarm.
pub(super) fn home(home: &Geodetic) -> MavMessage {
    MavMessage::HOME_POSITION(HOME_POSITION_DATA {
        latitude: degrees_e7(home.latitude_rad),
        longitude: degrees_e7(home.longitude_rad),
        altitude: millimetres(home.altitude_m),
        q: [f32::NAN; 4],
        ..HOME_POSITION_DATA::DEFAULT
    })
}

/// The severity of an event.
pub(super) fn severity(severity: Severity) -> MavSeverity {
    match severity {
        Severity::Info => MavSeverity::MAV_SEVERITY_INFO,
        Severity::Warning => MavSeverity::MAV_SEVERITY_WARNING,
        Severity::Error => MavSeverity::MAV_SEVERITY_CRITICAL,
    }
}

/// A text, in pieces if it is long; `number` separates the pieces of one text from those of another, and is not 0.
pub(super) fn text(severity: MavSeverity, text: &str, number: u16) -> Vec<MavMessage> {
    let mut pieces = vec![String::new()];
    for letter in text.chars() {
        if pieces.last().is_some_and(|piece| piece.len() + letter.len_utf8() > TEXT) {
            pieces.push(String::new());
        }
        if let Some(piece) = pieces.last_mut() {
            piece.push(letter);
        }
    }
    // A last piece without room for its end would be waited for.
    if pieces.len() > 1 && pieces.last().is_some_and(|piece| piece.len() == TEXT) {
        pieces.push(String::new());
    }
    let id = if pieces.len() > 1 { number } else { 0 };
    let message = |(nth, piece): (usize, &String)| {
        MavMessage::STATUSTEXT(STATUSTEXT_DATA { severity, text: piece.as_str().into(), id, chunk_seq: nth as u8 })
    };
    pieces.iter().take(usize::from(u8::MAX)).enumerate().map(message).collect()
}

fn degrees_e7(angle_rad: f64) -> i32 {
    (angle_rad.to_degrees() * 1e7).round() as i32
}

fn millimetres(length_m: f64) -> i32 {
    (length_m * 1e3).round() as i32
}

fn centimetres(speed_m_s: f64) -> i16 {
    (speed_m_s * 1e2).round() as i16
}

/// The heading from the local north, 0 to less than 360 degrees.
fn heading_deg(sample: &VehicleFacts, convergence: &Convergence) -> f64 {
    let heading_deg = convergence.heading_to_local(sample.attitude.heading_rad).to_degrees().rem_euclid(360.0);
    // To the hundredth that is sent: 359.996 is north.
    let rounded = (heading_deg * 100.0).round() / 100.0;
    if rounded >= 360.0 { 0.0 } else { rounded }
}
