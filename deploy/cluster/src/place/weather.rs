//! The scenario's weather in an X-Plane, and what its air then is.

use std::time::Duration;

use serde_json::{Value, json};
use skein_agent::plant::xplane::server::{MOST_TURBULENT, SEVERE_W20_M_S};
use skein_common::frame::{Geodetic, Origin};
use skein_common::math;
use skein_common::scenario::{Scenario, World};
use skein_lab::error::Error;

use crate::findings::Line;
use crate::simulators::survey::{Survey, Surveyor, VERSION};

const M_S_PER_KNOT: f64 = 1852.0 / 3600.0;
const FEET_PER_M: f64 = 1.0 / 0.3048;
/// Altitudes of the layers, m above sea level: the wind of a scenario is the same at every height.
const LAYERS_M: [f64; 13] =
    [0.0, 250.0, 500.0, 1000.0, 1500.0, 2000.0, 3000.0, 4000.0, 5000.0, 6000.0, 8000.0, 10_000.0, 12_000.0];
/// Layers of X-Plane 11.
const LAYERS_11: usize = 3;
/// Value of `change_mode` for weather that does not change.
const STATIC: f32 = 3.0;
/// First version number with the weather of X-Plane 12.
const FIRST_12: f32 = 120_000.0;
/// Difference from the scenario's wind that is noted, m/s.
const NOTABLE_M_S: f64 = 1.0;
/// Time limit for an X-Plane to follow what was asked for.
pub(super) const FOLLOWS_WITHIN: Duration = Duration::from_secs(5);
/// Number of values that are written at once, and the time between: more fill X-Plane's receive buffer, and the last are lost.
const WRITTEN_AT_ONCE: usize = 10;
const BETWEEN_WRITES: Duration = Duration::from_millis(60);
/// Time limit for its answer.
pub(super) const ANSWER: Duration = Duration::from_secs(2);

/// The part of X-Plane's range of turbulence that stands for the scenario's gusts.
fn turbulence(world: &World) -> f64 {
    (world.gust_w20_m_s / SEVERE_W20_M_S).min(1.0)
}

/// Distance from the origin beyond which no vehicle of a scenario flies, m: an aircraft there has not been placed yet.
const FLOWN_WITHIN_M: f64 = 3e5;

/// The scenario with its wind's direction from the local north at a place, as a simulator there takes it; in the scenario it
/// is from the north of the swarm's frame.
pub fn local(scenario: &Scenario, at: &Geodetic) -> Scenario {
    let mut local = scenario.clone();
    let (from_origin, convergence) = Origin::new(scenario.origin.geodetic()).locate(at);
    if from_origin.horizontal().norm() > FLOWN_WITHIN_M {
        return local;
    }
    local.world.wind_from_deg = convergence.heading_to_local(scenario.world.wind_from_rad()).to_degrees();
    local
}

/// Weather of a flight of the Web API.
pub(super) fn of_flight(scenario: &Scenario, place: &Geodetic) -> Value {
    let world = &scenario.world;
    let layer = |altitude_m: f64| {
        json!({
            "altitude_in_feet_msl": altitude_m * FEET_PER_M,
            "speed_in_knots": world.wind_m_s / M_S_PER_KNOT,
            "direction_in_degrees_true": world.wind_from_deg.rem_euclid(360.0),
            "gust_increase_in_knots": 0.0,
            "shear_in_degrees": 0.0,
            "turbulence_ratio": turbulence(world),
        })
    };
    json!({
        "definition": {
            "latitude_in_degrees": place.latitude_deg(),
            "longitude_in_degrees": place.longitude_deg(),
            "elevation_in_meters": place.altitude_m,
            "visibility_in_kilometers": 50.0,
            "wind": LAYERS_M.map(layer),
        },
        "vertical_speed_in_thermal_in_feet_per_minute": 0.0,
        "wave_height_in_meters": 0.0,
        "wave_direction_in_degrees": 0.0,
        "terrain_state": "dry",
        "variation_across_region_percentage": 0.0,
        "evolution_over_time_enum": "static",
    })
}

/// The datarefs to write for this weather with their values, in this order.
pub(super) fn writes(world: &World, is_12: bool) -> Vec<(String, f32)> {
    let from_deg = world.wind_from_deg.rem_euclid(360.0);
    let turbulence = MOST_TURBULENT * turbulence(world);
    let (folder, layers, (speed, speed_name), shear) = if is_12 {
        ("sim/weather/region", LAYERS_M.len(), (world.wind_m_s, "wind_speed_msc"), "shear_speed_msc")
    } else {
        ("sim/weather", LAYERS_11, (world.wind_m_s / M_S_PER_KNOT, "wind_speed_kt"), "shear_speed_kt")
    };
    let mut writes = if is_12 {
        vec![(format!("{folder}/change_mode"), STATIC), (format!("{folder}/variability_pct"), 0.0)]
    } else {
        vec![(format!("{folder}/use_real_weather_bool"), 0.0)]
    };
    for (layer, altitude_m) in LAYERS_M.into_iter().enumerate().take(layers) {
        for (name, value) in [
            ("wind_altitude_msl_m", altitude_m),
            (speed_name, speed),
            ("wind_direction_degt", from_deg),
            ("turbulence", turbulence),
            (shear, 0.0),
        ] {
            writes.push((format!("{folder}/{name}[{layer}]"), value as f32));
        }
    }
    if is_12 {
        writes.push((format!("{folder}/update_immediately"), 1.0));
    }
    writes
}

/// Writes the scenario's weather by UDP.
pub(super) fn set(surveyor: &Surveyor, scenario: &Scenario) -> Result<(), Error> {
    let version = surveyor.survey(&[VERSION.to_owned()], 0, ANSWER, false)?.value(VERSION);
    let writes = writes(&scenario.world, version.is_none_or(|version| version >= FIRST_12));
    for some in writes.chunks(WRITTEN_AT_ONCE) {
        some.iter().for_each(|(path, value)| surveyor.write(path, *value));
        skein_host::clock::sleep(BETWEEN_WRITES);
    }
    Ok(())
}

/// Datarefs of the wind at the aircraft, towards east and south, in X-Plane 12 and before.
pub const WIND_NOW: [&str; 4] = [
    "sim/weather/aircraft/wind_now_x_msc",
    "sim/weather/aircraft/wind_now_z_msc",
    "sim/weather/wind_now_x_msc",
    "sim/weather/wind_now_z_msc",
];

/// The wind at the aircraft towards east and south, m/s.
fn wind_now(survey: &Survey) -> Option<(f64, f64)> {
    let both = |at: usize| Some((survey.value(WIND_NOW[at])?.into(), survey.value(WIND_NOW[at + 1])?.into()));
    both(0).or_else(|| both(2))
}

/// The scenario's mean wind towards east and south, m/s.
fn wanted(scenario: &Scenario) -> (f64, f64) {
    let (sin, cos) = math::sin_cos(scenario.world.wind_from_rad());
    (-scenario.world.wind_m_s * sin, scenario.world.wind_m_s * cos)
}

/// The air at the aircraft once it has become the scenario's, or after some seconds, and whether it has.
pub(super) fn settled(surveyor: &Surveyor, scenario: &Scenario) -> Result<(Survey, bool), Error> {
    let is_near = |survey: &Survey| wind_now(survey).is_some_and(|found| off(found, wanted(scenario)) < NOTABLE_M_S);
    surveyor.survey_until(&WIND_NOW.map(str::to_owned), ANSWER, FOLLOWS_WITHIN, is_near)
}

/// The air at the aircraft against the scenario's.
pub fn compared(place: &str, survey: &Survey, scenario: &Scenario) -> Vec<Line> {
    let (world, wanted) = (&scenario.world, wanted(scenario));
    let mut lines = vec![match wind_now(survey) {
        None => Line::new(place, "wind", "not answered: compare the weather on X-Plane's screen").unknown(),
        Some(found) if off(found, wanted) < NOTABLE_M_S => {
            Line::new(place, "wind", format!("{}, {:.1} m/s off the scenario's", described(found), off(found, wanted)))
        }
        Some(found) => {
            Line::new(place, "wind", format!("{}; the scenario has {}", described(found), described(wanted)))
                .warning("`skein xplane place --weather-only` sets it; switch real weather off in X-Plane")
        }
    }];
    if world.gust_w20_m_s > 0.0 {
        let found = format!(
            "W20 {:.1} m/s becomes {:.1} of X-Plane's 10; its turbulence is not the model of studies",
            world.gust_w20_m_s,
            MOST_TURBULENT * turbulence(world)
        );
        lines.push(Line::new(place, "gusts", found).unknown());
    }
    lines
}

fn off(found: (f64, f64), wanted: (f64, f64)) -> f64 {
    math::hypot(found.0 - wanted.0, found.1 - wanted.1)
}

/// A wind that blows towards east and south, as a text.
fn described((east_m_s, south_m_s): (f64, f64)) -> String {
    let from_deg = math::atan2(-east_m_s, south_m_s).to_degrees().rem_euclid(360.0);
    match math::hypot(east_m_s, south_m_s) {
        speed_m_s if speed_m_s < 0.05 => "no wind".to_owned(),
        speed_m_s => format!("{speed_m_s:.1} m/s from {from_deg:.0}°"),
    }
}
