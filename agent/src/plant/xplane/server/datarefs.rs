//! The stand-in's datarefs: their names, their values, and which can be written.

use std::collections::HashMap;
use std::sync::{Arc, LazyLock};

use super::air::{Air, FEET_PER_M, Flow};
use super::settings::{AIRCRAFT, ENGINES, Setting, Settings};
use crate::plant::xplane::convert::rpm_from_rad_s;
use crate::plant::xplane::wire::aircraft::Move;
use crate::plant::xplane::wire::rpos::Position;
use serde::Serialize;
use skein_common::frame::{Attitude, Geodetic, TangentPlane};
use skein_common::math;
use skein_core::aircraft::name_and_element;
use skein_core::helicopter::Weather;

/// Number of layers of wind in X-Plane 12; X-Plane 11 has three.
const LAYERS: usize = 13;
/// Beginning of the datarefs that only the R22 of X-Plane 12 has.
const OF_THE_R22: &str = "laminar/r22/";
/// Number of the functions that an axis of a joystick can have, as far as a helicopter needs them. The functions are
/// numbered from 1: pitch, roll, yaw, throttle, collective.
const AXES: usize = 8;
/// Length of a text, whose bytes are read one by one.
const TEXT: usize = 512;

/// State of the simulation from which values are computed.
pub(super) struct Situation {
    pub(super) position: Position,
    /// Attitude against the Earth right below the aircraft.
    pub(super) true_attitude: Attitude,
    pub(super) rotor_speed_rad_s: f64,
    /// Specific force in body axes, forward, right, down, as a multiple of gravity.
    pub(super) specific_force_g: [f64; 3],
    /// Place in the local frame, m: east, up, south of the reference at sea level.
    pub(super) local_m: [f64; 3],
    pub(super) reference: Geodetic,
    pub(super) running_s: f64,
    pub(super) flight_s: f64,
    pub(super) frame_period_s: f64,
    /// Simulated seconds per real second.
    pub(super) speed: f64,
    pub(super) version: i32,
    pub(super) is_paused: bool,
    pub(super) surroundings: Surroundings,
    /// Poses of the other aircraft; `None` for one that no client has moved.
    pub(super) others: Others,
}

/// Poses of the other aircraft, the first of which is number 1.
pub(super) type Others = [Option<Move>; AIRCRAFT - 1];

/// The surroundings, which flying does not change: the aircraft's file and the weather.
#[derive(Clone, Debug)]
pub struct Surroundings {
    /// Path of the aircraft's file, relative to X-Plane's folder.
    pub acf: Arc<str>,
    /// Wind and turbulence.
    pub weather: Weather,
}

impl Surroundings {
    /// Mean wind velocity towards east, up and south, m/s.
    fn wind_m_s(&self) -> [f64; 3] {
        let (sin, cos) = math::sin_cos(self.weather.wind_from_rad);
        [-self.weather.wind_m_s * sin, 0.0, self.weather.wind_m_s * cos]
    }
}

impl Default for Surroundings {
    fn default() -> Self {
        Self { acf: DEFAULT_ACF.into(), weather: Weather::default() }
    }
}

/// The aircraft file that a stand-in pretends to have loaded.
pub const DEFAULT_ACF: &str = "Aircraft/Skein/xcell60/xcell60.acf";

/// The point at sea level below the place, where X-Plane's local frame has its origin.
pub(super) fn reference_below(place: &Geodetic) -> TangentPlane {
    TangentPlane::new(Geodetic { altitude_m: 0.0, ..*place })
}

impl Situation {
    /// The air where the aircraft is.
    pub(super) fn air(&self) -> Air {
        Air::at(self.position.elevation_m)
    }

    /// The motion of the aircraft over the ground and through the air.
    pub(super) fn flow(&self) -> Flow {
        Flow::of(&self.position, self.surroundings.wind_m_s(), self.air())
    }

    /// A number of the aircraft `number`, 0 if no client has moved it.
    fn other(&self, number: usize, read: fn(&Move) -> f64) -> f64 {
        self.others[number - 1].as_ref().map_or(0.0, read)
    }

    /// Place of the aircraft `number` in the local frame, m: east, up, south.
    fn other_local_m(&self, number: usize) -> [f64; 3] {
        let Some(moved) = &self.others[number - 1] else { return [0.0; 3] };
        let place = Geodetic::from_degrees(moved.latitude_deg, moved.longitude_deg, moved.elevation_m);
        let local = TangentPlane::new(self.reference).ned_from_geodetic(&place);
        [local.y, -local.z, -local.x]
    }
}

enum Source {
    /// Computed and read-only. An array has the value in its first element and zeros in the others.
    Computed(fn(&Situation) -> f64),
    /// A text, read byte by byte.
    Text(fn(&Situation) -> &str),
    /// Writable, each element by itself.
    Kept(Setting),
    /// Writable, one value for all elements.
    All(Setting),
    /// A setting that this dataref only shows.
    Read(Setting),
}

/// Type of a dataref's value in X-Plane, named as in the Web API.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ValueType {
    /// An integer of 32 bits.
    Int,
    /// A number of single precision.
    Float,
    /// A number of double precision.
    Double,
    /// Several integers.
    IntArray,
    /// Several numbers of single precision.
    FloatArray,
    /// Bytes.
    Data,
}

/// A dataref: its name, its type, and where its value comes from.
pub struct Dataref {
    /// Its name.
    pub path: &'static str,
    /// Number of its elements, 1 unless it is an array; `None` for as many as there are engines.
    elements: Option<usize>,
    /// Its type.
    pub value_type: ValueType,
    source: Source,
}

impl Dataref {
    /// Whether a simulator with this aircraft has it: aircraft bring datarefs of their own.
    pub fn is_in(&self, acf: &str) -> bool {
        !self.path.starts_with(OF_THE_R22) || acf.contains("R22")
    }

    /// Whether a client can write it.
    pub fn is_writable(&self) -> bool {
        matches!(self.source, Source::Kept(_) | Source::All(_))
    }

    /// Number of its elements, 1 unless it is an array; `engines` is the length of per-engine arrays.
    pub fn elements(&self, engines: usize) -> usize {
        self.elements.unwrap_or(engines.min(ENGINES))
    }

    /// Whether it has elements that can be read and written one by one.
    pub fn is_array(&self) -> bool {
        matches!(self.value_type, ValueType::IntArray | ValueType::FloatArray | ValueType::Data)
    }
}

/// Functions that make a dataref of one type and length.
macro_rules! kinds {
    ($($kind:ident: $value_type:ident, $elements:expr;)*) => {
        $(const fn $kind(path: &'static str, source: Source) -> Dataref {
            Dataref { path, elements: $elements, value_type: ValueType::$value_type, source }
        })*
    };
}

kinds! {
    scalar: Float, Some(1);
    double: Double, Some(1);
    int: Int, Some(1);
    per_engine: FloatArray, None;
    int_per_engine: IntArray, None;
    per_aircraft: IntArray, Some(AIRCRAFT);
    layers: FloatArray, Some(LAYERS);
    axes: FloatArray, Some(AXES);
}

const fn text(path: &'static str, read: fn(&Situation) -> &str) -> Dataref {
    Dataref { path, elements: Some(TEXT), value_type: ValueType::Data, source: Source::Text(read) }
}

/// All these datarefs, and those of the other aircraft with these numbers.
macro_rules! with_aircraft {
    ([$($own:expr,)*] $($number:literal)*) => {
        [
            $($own,)*
            $(
                double(concat!("sim/multiplayer/position/plane", $number, "_x"), Computed(|s| s.other_local_m($number)[0])),
                double(concat!("sim/multiplayer/position/plane", $number, "_y"), Computed(|s| s.other_local_m($number)[1])),
                double(concat!("sim/multiplayer/position/plane", $number, "_z"), Computed(|s| s.other_local_m($number)[2])),
                double(concat!("sim/multiplayer/position/plane", $number, "_lat"), Computed(|s| s.other($number, |p| p.latitude_deg))),
                double(concat!("sim/multiplayer/position/plane", $number, "_lon"), Computed(|s| s.other($number, |p| p.longitude_deg))),
                double(concat!("sim/multiplayer/position/plane", $number, "_el"), Computed(|s| s.other($number, |p| p.elevation_m))),
                scalar(concat!("sim/multiplayer/position/plane", $number, "_psi"), Computed(|s| s.other($number, |p| p.heading_deg.into()))),
                scalar(concat!("sim/multiplayer/position/plane", $number, "_the"), Computed(|s| s.other($number, |p| p.pitch_deg.into()))),
                scalar(concat!("sim/multiplayer/position/plane", $number, "_phi"), Computed(|s| s.other($number, |p| p.roll_deg.into()))),
            )*
        ]
    };
}

/// All datarefs.
#[rustfmt::skip]
pub static DATAREFS: &[Dataref] = &{
    use Setting::*;
    use Source::{All, Computed, Kept, Read};
    with_aircraft! { [
        // Position and motion.
        double("sim/flightmodel/position/latitude", Computed(|s| s.position.latitude_deg)),
        double("sim/flightmodel/position/longitude", Computed(|s| s.position.longitude_deg)),
        double("sim/flightmodel/position/elevation", Computed(|s| s.position.elevation_m)),
        scalar("sim/flightmodel/position/y_agl", Computed(|s| s.position.height_m.into())),
        scalar("sim/flightmodel/position/local_vx", Computed(|s| s.position.velocity_east_m_s.into())),
        scalar("sim/flightmodel/position/local_vy", Computed(|s| s.position.velocity_up_m_s.into())),
        scalar("sim/flightmodel/position/local_vz", Computed(|s| s.position.velocity_south_m_s.into())),
        scalar("sim/flightmodel/position/groundspeed", Computed(groundspeed_m_s)),
        scalar("sim/flightmodel/position/true_airspeed", Computed(|s| s.flow().true_airspeed_m_s)),
        scalar("sim/flightmodel/position/equivalent_airspeed", Computed(|s| s.flow().equivalent_airspeed_kt())),
        scalar("sim/flightmodel/position/indicated_airspeed", Computed(|s| s.flow().equivalent_airspeed_kt())),
        scalar("sim/flightmodel/position/vh_ind", Computed(|s| s.position.velocity_up_m_s.into())),
        scalar("sim/flightmodel/position/vh_ind_fpm", Computed(|s| f64::from(s.position.velocity_up_m_s) * FEET_PER_M * 60.0)),
        scalar("sim/flightmodel/position/hpath", Computed(|s| s.flow().hpath_deg)),
        scalar("sim/flightmodel/position/vpath", Computed(|s| s.flow().vpath_deg)),
        scalar("sim/flightmodel/position/alpha", Computed(|s| s.flow().alpha_deg)),
        scalar("sim/flightmodel/position/beta", Computed(|s| s.flow().beta_deg)),
        // The axes of the accelerations: up, forward and right are positive. There is no magnetic variation.
        scalar("sim/flightmodel/forces/g_nrml", Computed(|s| -s.specific_force_g[2])),
        scalar("sim/flightmodel/forces/g_axil", Computed(|s| s.specific_force_g[0])),
        scalar("sim/flightmodel/forces/g_side", Computed(|s| s.specific_force_g[1])),
        scalar("sim/flightmodel/position/mag_psi", Computed(|s| s.position.heading_deg.into())),
        scalar("sim/flightmodel/position/magpsi", Computed(|s| s.position.heading_deg.into())),
        scalar("sim/flightmodel/position/magnetic_variation", Computed(|_| 0.0)),
        scalar("sim/flightmodel/position/theta", Computed(|s| s.position.pitch_deg.into())),
        scalar("sim/flightmodel/position/true_theta", Computed(|s| s.true_attitude.pitch_rad.to_degrees())),
        scalar("sim/flightmodel/position/phi", Computed(|s| s.position.roll_deg.into())),
        scalar("sim/flightmodel/position/true_phi", Computed(|s| s.true_attitude.roll_rad.to_degrees())),
        scalar("sim/flightmodel/position/psi", Computed(|s| s.position.heading_deg.into())),
        scalar("sim/flightmodel/position/true_psi", Computed(|s| s.true_attitude.heading_rad.to_degrees().rem_euclid(360.0))),
        scalar("sim/flightmodel/position/P", Computed(|s| f64::from(s.position.roll_rate_rad_s).to_degrees())),
        scalar("sim/flightmodel/position/Q", Computed(|s| f64::from(s.position.pitch_rate_rad_s).to_degrees())),
        scalar("sim/flightmodel/position/R", Computed(|s| f64::from(s.position.yaw_rate_rad_s).to_degrees())),
        scalar("sim/flightmodel/position/Prad", Computed(|s| s.position.roll_rate_rad_s.into())),
        scalar("sim/flightmodel/position/Qrad", Computed(|s| s.position.pitch_rate_rad_s.into())),
        scalar("sim/flightmodel/position/Rrad", Computed(|s| s.position.yaw_rate_rad_s.into())),
        double("sim/flightmodel/position/local_x", Computed(|s| s.local_m[0])),
        double("sim/flightmodel/position/local_y", Computed(|s| s.local_m[1])),
        double("sim/flightmodel/position/local_z", Computed(|s| s.local_m[2])),
        scalar("sim/flightmodel/position/lat_ref", Computed(|s| s.reference.latitude_deg())),
        scalar("sim/flightmodel/position/lon_ref", Computed(|s| s.reference.longitude_deg())),
        // The standard atmosphere.
        scalar("sim/weather/barometer_current_inhg", Computed(|s| s.air().pressure_inhg())),
        scalar("sim/weather/barometer_sealevel_inhg", Computed(|_| Air::at(0.0).pressure_inhg())),
        scalar("sim/weather/aircraft/barometer_current_pas", Computed(|s| s.air().pressure_pa)),
        scalar("sim/weather/aircraft/qnh_pas", Computed(|_| Air::at(0.0).pressure_pa)),
        scalar("sim/weather/region/sealevel_pressure_pas", Computed(|_| Air::at(0.0).pressure_pa)),
        scalar("sim/weather/rho", Computed(|s| s.air().density_kg_m3)),
        scalar("sim/weather/temperature_ambient_c", Computed(|s| s.air().temperature_c())),
        scalar("sim/weather/aircraft/temperature_ambient_deg_c", Computed(|s| s.air().temperature_c())),
        scalar("sim/cockpit2/gauges/indicators/altitude_ft_pilot", Computed(|s| s.position.elevation_m * FEET_PER_M)),
        // Aircraft and surroundings. The wind is the mean one, without gusts.
        text("sim/aircraft/view/acf_relative_path", |s| &s.surroundings.acf),
        scalar("sim/weather/aircraft/wind_now_x_msc", Computed(|s| s.surroundings.wind_m_s()[0])),
        scalar("sim/weather/aircraft/wind_now_y_msc", Computed(|s| s.surroundings.wind_m_s()[1])),
        scalar("sim/weather/aircraft/wind_now_z_msc", Computed(|s| s.surroundings.wind_m_s()[2])),
        scalar("sim/weather/wind_now_x_msc", Computed(|s| s.surroundings.wind_m_s()[0])),
        scalar("sim/weather/wind_now_y_msc", Computed(|s| s.surroundings.wind_m_s()[1])),
        scalar("sim/weather/wind_now_z_msc", Computed(|s| s.surroundings.wind_m_s()[2])),
        // Weather of X-Plane 12, taken over at the next update, and that of X-Plane 11, taken over at once. The lowest
        // layer is the wind at every height.
        int("sim/weather/region/change_mode", Kept(ChangeMode)),
        int("sim/weather/region/update_immediately", Kept(UpdateImmediately)),
        scalar("sim/weather/region/variability_pct", Kept(Variability)),
        layers("sim/weather/region/wind_altitude_msl_m", Kept(LayerAltitude)),
        layers("sim/weather/region/wind_speed_msc", Kept(LayerSpeed)),
        layers("sim/weather/region/wind_direction_degt", Kept(LayerFrom)),
        layers("sim/weather/region/turbulence", Kept(LayerTurbulence)),
        layers("sim/weather/region/shear_speed_msc", Kept(LayerShear)),
        int("sim/weather/use_real_weather_bool", Kept(RealWeather)),
        layers("sim/weather/wind_altitude_msl_m", Kept(LayerAltitude11)),
        layers("sim/weather/wind_speed_kt", Kept(LayerSpeed11)),
        layers("sim/weather/wind_direction_degt", Kept(LayerFrom11)),
        layers("sim/weather/turbulence", Kept(LayerTurbulence11)),
        layers("sim/weather/shear_speed_kt", Kept(LayerShear11)),
        // Rotor.
        per_engine("sim/cockpit2/engine/indicators/prop_speed_rpm", Computed(|s| rpm_from_rad_s(s.rotor_speed_rad_s))),
        per_engine("sim/flightmodel/engine/POINT_tacrad", Computed(|s| s.rotor_speed_rad_s)),
        int_per_engine("sim/flightmodel/engine/ENGN_running", Computed(|_| 1.0)),
        // Weight, which the helicopter does not feel here.
        scalar("sim/flightmodel/weight/m_fixed", Kept(Payload)),
        scalar("sim/flightmodel/weight/m_fuel_total", Read(Fuel)),
        // Time and version. The time of day stands still.
        scalar("sim/time/local_time_sec", Read(LocalTime)),
        int("sim/time/local_date_days", Kept(LocalDate)),
        scalar("sim/time/total_running_time_sec", Computed(|s| s.running_s)),
        scalar("sim/time/total_flight_time_sec", Computed(|s| s.flight_s)),
        int("sim/time/paused", Computed(|s| s.is_paused.into())),
        int("sim/time/is_in_replay", Read(Replay)),
        int("sim/time/sim_speed", Computed(|s| f64::from(!s.is_paused))),
        scalar("sim/time/sim_speed_actual", Computed(|s| s.speed)),
        int("sim/flightmodel2/misc/has_crashed", Read(Crash)),
        scalar("sim/operation/misc/frame_rate_period", Computed(|s| s.frame_period_s)),
        int("sim/version/xplane_internal_version", Computed(|s| s.version.into())),
        // No failure happens here at random, whatever is written. X-Plane 11 and 12 spell it differently.
        int("sim/operation/failures/enable_random_falures", Kept(RandomFailures)),
        int("sim/operation/failures/enable_random_failures", Kept(RandomFailures)),
        // Faults on order, which no X-Plane has.
        scalar("skein/standin/speed", Kept(Speed)),
        scalar("skein/standin/drop_share", Kept(DropShare)),
        scalar("skein/standin/freeze_s", Kept(Freeze)),
        scalar("skein/standin/restart_s", Kept(Restart)),
        scalar("skein/standin/load_s", Kept(LoadTime)),
        scalar("skein/standin/replay", Kept(Replay)),
        scalar("skein/standin/crash", Kept(Crash)),
        scalar("skein/standin/move_origin", Kept(MoveOrigin)),
        // Rows a second.
        int("sim/network/dataout/network_data_rate", Kept(DataRate)),
        // Controls.
        int("sim/operation/override/override_joystick", Kept(OverrideJoystick)),
        int("sim/operation/override/override_joystick_roll", Kept(OverrideRoll)),
        int("sim/operation/override/override_joystick_pitch", Kept(OverridePitch)),
        int("sim/operation/override/override_joystick_heading", Kept(OverrideYaw)),
        int("sim/joystick/has_joystick", Computed(|_| 0.0)),
        // The pilot's own stick, which a client moves here; X-Plane only reads it from its devices.
        axes("sim/joystick/joy_mapped_axis_value", Kept(Stick)),
        scalar("sim/joystick/yoke_roll_ratio", Kept(Roll)),
        scalar("sim/joystick/yoke_pitch_ratio", Kept(Pitch)),
        scalar("sim/joystick/yoke_heading_ratio", Kept(Yaw)),
        scalar("sim/cockpit2/engine/actuators/prop_ratio_all", All(Collective)),
        per_engine("sim/cockpit2/engine/actuators/prop_ratio", Kept(Collective)),
        scalar("laminar/r22/rotor_collective_ratio", All(Collective)),
        // The governor controls the throttle, whatever is written here.
        scalar("sim/cockpit2/engine/actuators/throttle_ratio_all", All(Throttle)),
        per_engine("sim/cockpit2/engine/actuators/throttle_ratio", Kept(Throttle)),
        int_per_engine("sim/cockpit2/engine/actuators/governor_on", Kept(Governor)),
        // The other aircraft: 1 while clients move one.
        per_aircraft("sim/operation/override/override_planepath", Kept(OverridePlanePath)),
    ] 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 }
};

/// The datarefs by their paths: a client writes several in each frame.
static BY_PATH: LazyLock<HashMap<&str, &Dataref>> =
    LazyLock::new(|| DATAREFS.iter().map(|dataref| (dataref.path, dataref)).collect());

pub(super) fn groundspeed_m_s(situation: &Situation) -> f64 {
    math::hypot(f64::from(situation.position.velocity_east_m_s), situation.position.velocity_south_m_s.into())
}

/// An existing dataref, or one element of it.
#[derive(Clone, Copy)]
pub(super) struct Handle {
    pub(super) dataref: &'static Dataref,
    pub(super) element: usize,
}

impl Handle {
    /// Finds a dataref of this aircraft by its path; `engines` is the length of per-engine arrays.
    pub(super) fn find(path: &str, engines: usize, acf: &str) -> Option<Self> {
        let (name, element) = name_and_element(path)?;
        let dataref = *BY_PATH.get(name).filter(|dataref| dataref.is_in(acf))?;
        (element < dataref.elements(engines)).then_some(Self { dataref, element })
    }

    /// Reads the value; over UDP every type is sent as f32.
    pub(super) fn read(&self, situation: &Situation, settings: &Settings) -> f64 {
        match self.dataref.source {
            Source::Computed(value) if self.element == 0 => value(situation),
            Source::Computed(_) => 0.0,
            Source::Kept(setting) => settings.get(setting, self.element).into(),
            Source::Text(text) => text(situation).as_bytes().get(self.element).map_or(0.0, |&byte| byte.into()),
            Source::All(setting) | Source::Read(setting) => settings.first(setting).into(),
        }
    }

    /// Writes a value and returns the setting that has changed; `None` for a read-only dataref.
    pub(super) fn write(&self, value: f32, settings: &mut Settings) -> Option<Setting> {
        let (Source::Kept(setting) | Source::All(setting)) = self.dataref.source else { return None };
        match self.dataref.source {
            Source::All(_) => settings.set_all(setting, value),
            _ => settings.store(setting, self.element, value),
        }
        Some(setting)
    }
}
