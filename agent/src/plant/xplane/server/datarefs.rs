//! The stand-in's datarefs: their names, their values, and which can be written.

use crate::plant::xplane::convert::{self, rpm_from_rad_s};
use crate::plant::xplane::wire::rpos::Position;
use skein_common::math;
use skein_core::aircraft::name_and_element;
use skein_core::plant::Frame;

/// Number of elements of a per-engine array since X-Plane 12; X-Plane 11 has eight.
const ENGINES: usize = 16;

/// State of the simulation from which values are computed.
pub(super) struct Situation {
    pub(super) position: Position,
    pub(super) rotor_speed_rad_s: f64,
    pub(super) running_s: f64,
    pub(super) flight_s: f64,
    pub(super) frame_period_s: f64,
    pub(super) version: i32,
    pub(super) is_paused: bool,
}

impl Situation {
    pub(super) fn new(frame: &Frame, running_s: f64, frame_period_s: f64, version: i32) -> Self {
        Self {
            position: convert::position(&frame.measurement),
            rotor_speed_rad_s: frame.measurement.rotor_speed_rad_s.unwrap_or(0.0),
            running_s,
            flight_s: frame.time.seconds(),
            frame_period_s,
            version,
            is_paused: false,
        }
    }
}

/// A dataref that can be written and keeps its value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Setting {
    OverrideJoystick,
    OverrideRoll,
    OverridePitch,
    OverrideYaw,
    Roll,
    Pitch,
    Yaw,
    Collective,
    Throttle,
    Governor,
    DataRate,
}

impl Setting {
    const COUNT: usize = Self::DataRate as usize + 1;

    /// The number that X-Plane stores when this one is written.
    fn stored_value(self, value: f32) -> f32 {
        match self {
            // These are integers, so the fraction is cut off.
            Self::OverrideJoystick | Self::OverrideRoll | Self::OverridePitch | Self::OverrideYaw | Self::Governor => {
                value.trunc()
            }
            Self::Roll | Self::Pitch | Self::Yaw => value.clamp(-1.0, 1.0),
            Self::Collective | Self::Throttle => value.clamp(0.0, 1.0),
            Self::DataRate => value.trunc().clamp(1.0, 99.0),
        }
    }
}

/// Values of all settings, element by element.
#[derive(Clone, Debug)]
pub(super) struct Settings([[f32; ENGINES]; Setting::COUNT]);

impl Settings {
    /// A helicopter with a running engine, the collective down and free controls.
    pub(super) fn new() -> Self {
        let mut settings = Self([[0.0; ENGINES]; Setting::COUNT]);
        settings.0[Setting::Throttle as usize] = [1.0; ENGINES];
        settings.0[Setting::Governor as usize] = [1.0; ENGINES];
        settings.0[Setting::DataRate as usize] = [20.0; ENGINES];
        settings
    }

    /// Value of the setting's first element.
    pub(super) fn first(&self, setting: Setting) -> f32 {
        self.0[setting as usize][0]
    }

    pub(super) fn set_first(&mut self, setting: Setting, value: f32) {
        self.0[setting as usize][0] = value;
    }

    /// Stores what a client writes into an element.
    pub(super) fn store(&mut self, setting: Setting, element: usize, value: f32) {
        self.0[setting as usize][element] = setting.stored_value(value);
    }
}

enum Source {
    /// Computed and read-only. An array has the value in its first element and zeros in the others.
    Computed(fn(&Situation) -> f64),
    /// Writable, each element by itself.
    Kept(Setting),
    /// Writable, one value for all elements.
    All(Setting),
}

struct Dataref {
    path: &'static str,
    is_per_engine: bool,
    source: Source,
}

const fn scalar(path: &'static str, source: Source) -> Dataref {
    Dataref { path, is_per_engine: false, source }
}

const fn per_engine(path: &'static str, source: Source) -> Dataref {
    Dataref { path, is_per_engine: true, source }
}

/// All datarefs; searched only when a client subscribes or writes.
#[rustfmt::skip]
static DATAREFS: &[Dataref] = &{
    use Setting::*;
    use Source::{All, Computed, Kept};
    [
        // Position and motion.
        scalar("sim/flightmodel/position/latitude", Computed(|s| s.position.latitude_deg)),
        scalar("sim/flightmodel/position/longitude", Computed(|s| s.position.longitude_deg)),
        scalar("sim/flightmodel/position/elevation", Computed(|s| s.position.elevation_m)),
        scalar("sim/flightmodel/position/y_agl", Computed(|s| s.position.height_m.into())),
        scalar("sim/flightmodel/position/local_vx", Computed(|s| s.position.velocity_east_m_s.into())),
        scalar("sim/flightmodel/position/local_vy", Computed(|s| s.position.velocity_up_m_s.into())),
        scalar("sim/flightmodel/position/local_vz", Computed(|s| s.position.velocity_south_m_s.into())),
        scalar("sim/flightmodel/position/groundspeed", Computed(groundspeed_m_s)),
        scalar("sim/flightmodel/position/theta", Computed(|s| s.position.pitch_deg.into())),
        scalar("sim/flightmodel/position/true_theta", Computed(|s| s.position.pitch_deg.into())),
        scalar("sim/flightmodel/position/phi", Computed(|s| s.position.roll_deg.into())),
        scalar("sim/flightmodel/position/true_phi", Computed(|s| s.position.roll_deg.into())),
        scalar("sim/flightmodel/position/psi", Computed(|s| s.position.heading_deg.into())),
        scalar("sim/flightmodel/position/true_psi", Computed(|s| s.position.heading_deg.into())),
        scalar("sim/flightmodel/position/P", Computed(|s| f64::from(s.position.roll_rate_rad_s).to_degrees())),
        scalar("sim/flightmodel/position/Q", Computed(|s| f64::from(s.position.pitch_rate_rad_s).to_degrees())),
        scalar("sim/flightmodel/position/R", Computed(|s| f64::from(s.position.yaw_rate_rad_s).to_degrees())),
        scalar("sim/flightmodel/position/Prad", Computed(|s| s.position.roll_rate_rad_s.into())),
        scalar("sim/flightmodel/position/Qrad", Computed(|s| s.position.pitch_rate_rad_s.into())),
        scalar("sim/flightmodel/position/Rrad", Computed(|s| s.position.yaw_rate_rad_s.into())),
        // Rotor.
        per_engine("sim/cockpit2/engine/indicators/prop_speed_rpm", Computed(|s| rpm_from_rad_s(s.rotor_speed_rad_s))),
        per_engine("sim/flightmodel/engine/POINT_tacrad", Computed(|s| s.rotor_speed_rad_s)),
        per_engine("sim/flightmodel/engine/ENGN_running", Computed(|_| 1.0)),
        // Time and version. The stand-in has no replay.
        scalar("sim/time/total_running_time_sec", Computed(|s| s.running_s)),
        scalar("sim/time/total_flight_time_sec", Computed(|s| s.flight_s)),
        scalar("sim/time/paused", Computed(|s| s.is_paused.into())),
        scalar("sim/time/is_in_replay", Computed(|_| 0.0)),
        scalar("sim/time/sim_speed_actual", Computed(|s| f64::from(!s.is_paused))),
        scalar("sim/operation/misc/frame_rate_period", Computed(|s| s.frame_period_s)),
        scalar("sim/version/xplane_internal_version", Computed(|s| s.version.into())),
        // Rows a second.
        scalar("sim/network/dataout/network_data_rate", Kept(DataRate)),
        // Controls.
        scalar("sim/operation/override/override_joystick", Kept(OverrideJoystick)),
        scalar("sim/operation/override/override_joystick_roll", Kept(OverrideRoll)),
        scalar("sim/operation/override/override_joystick_pitch", Kept(OverridePitch)),
        scalar("sim/operation/override/override_joystick_heading", Kept(OverrideYaw)),
        scalar("sim/joystick/yoke_roll_ratio", Kept(Roll)),
        scalar("sim/joystick/yoke_pitch_ratio", Kept(Pitch)),
        scalar("sim/joystick/yoke_heading_ratio", Kept(Yaw)),
        scalar("sim/cockpit2/engine/actuators/prop_ratio_all", All(Collective)),
        per_engine("sim/cockpit2/engine/actuators/prop_ratio", Kept(Collective)),
        // The governor controls the throttle, whatever is written here.
        scalar("sim/cockpit2/engine/actuators/throttle_ratio_all", All(Throttle)),
        per_engine("sim/cockpit2/engine/actuators/throttle_ratio", Kept(Throttle)),
        per_engine("sim/cockpit2/engine/actuators/governor_on", Kept(Governor)),
    ]
};

pub(super) fn groundspeed_m_s(situation: &Situation) -> f64 {
    math::hypot(f64::from(situation.position.velocity_east_m_s), situation.position.velocity_south_m_s.into())
}

/// An existing dataref, or one element of it.
#[derive(Clone, Copy)]
pub(super) struct Handle {
    dataref: &'static Dataref,
    element: usize,
}

impl Handle {
    /// Finds a dataref by its path; `engines` is the length of per-engine arrays.
    pub(super) fn find(path: &str, engines: usize) -> Option<Self> {
        let (name, element) = name_and_element(path)?;
        let dataref = DATAREFS.iter().find(|dataref| dataref.path == name)?;
        let elements = if dataref.is_per_engine { engines.min(ENGINES) } else { 1 };
        (element < elements).then_some(Self { dataref, element })
    }

    /// Reads the value; every type of dataref is sent as f32.
    pub(super) fn read(&self, situation: &Situation, settings: &Settings) -> f32 {
        match self.dataref.source {
            Source::Computed(value) if self.element == 0 => value(situation) as f32,
            Source::Computed(_) => 0.0,
            Source::Kept(setting) => settings.0[setting as usize][self.element],
            Source::All(setting) => settings.first(setting),
        }
    }

    /// Writes a value and returns the setting that has changed; `None` for a read-only dataref.
    pub(super) fn write(&self, value: f32, settings: &mut Settings) -> Option<Setting> {
        let setting = match self.dataref.source {
            Source::Computed(_) => return None,
            Source::Kept(setting) => {
                settings.store(setting, self.element, value);
                setting
            }
            Source::All(setting) => {
                settings.0[setting as usize] = [setting.stored_value(value); ENGINES];
                setting
            }
        };
        Some(setting)
    }
}
