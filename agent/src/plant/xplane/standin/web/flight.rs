//! The flight of a request: what a stand-in can do of X-Plane's flight initialization.

use serde_json::{Map, Value as Json};

use super::Fault;
use crate::plant::xplane::server::{Flight, SEVERE_W20_M_S};
use skein_core::helicopter::Weather;

const M_S_PER_KNOT: f64 = 1852.0 / 3600.0;
/// Keys of a flight; another one is refused.
const KEYS: [&str; 19] = [
    "aircraft",
    "runway_start",
    "ramp_start",
    "lle_ground_start",
    "lle_air_start",
    "boat_start",
    "weight",
    "engine_status",
    "weapons",
    "failures",
    "ai_aircraft",
    "formation_aircraft",
    "incursion",
    "use_system_time",
    "local_time",
    "gmt_time",
    "time_enum",
    "weather",
    "special_events",
];
const STARTS: [&str; 5] = ["runway_start", "ramp_start", "lle_ground_start", "lle_air_start", "boat_start"];

fn invalid(field: &str) -> Fault {
    Fault::bad("invalid_value", format!("The value provided for {field} is not valid"))
}

/// A number with decimals within these limits: one version of X-Plane refuses whole numbers here.
fn decimal(object: &Map<String, Json>, field: &str, limits: (f64, f64)) -> Result<f64, Fault> {
    let value = object.get(field).filter(|value| value.is_f64()).and_then(Json::as_f64);
    value.filter(|value| (limits.0..=limits.1).contains(value)).ok_or_else(|| invalid(field))
}

/// Reads a new flight.
pub(super) fn started(data: &Json, acf: &str) -> Result<Flight, Fault> {
    let flight = object(data)?;
    let path = flight.get("aircraft").and_then(|aircraft| aircraft.get("path")).and_then(Json::as_str);
    let path = path.ok_or_else(|| invalid("aircraft"))?;
    if path != acf {
        return Err(Fault::bad("missing_aircraft", format!("Aircraft {path} doesn't exist")));
    }
    let mut starts = STARTS.iter().filter(|start| flight.contains_key(**start));
    let (Some(start), None) = (starts.next(), starts.next()) else {
        return Err(invalid("start location: exactly one is needed, it"));
    };
    let place = flight.get(*start).and_then(Json::as_object).ok_or_else(|| invalid(start))?;
    let is_air = *start == "lle_air_start";
    if is_air {
        decimal(place, "elevation_in_meters", (-500.0, 30_000.0))?;
        if place.contains_key("speed_in_meters_per_second") == place.contains_key("speed_enum") {
            return Err(invalid("speed_in_meters_per_second"));
        }
    }
    if !is_air && *start != "lle_ground_start" {
        return Err(Fault::bad("missing_scenery", "All or some scenery for the requested conditions is missing"));
    }
    let place_deg = [
        decimal(place, "latitude", (-90.0, 90.0))?,
        decimal(place, "longitude", (-180.0, 180.0))?,
        decimal(place, "heading_true", (0.0, 360.0))?,
    ];
    Ok(Flight { place_deg: Some(place_deg), weather: weather(flight)? })
}

/// Reads a change of the current flight.
pub(super) fn changed(data: &Json) -> Result<Flight, Fault> {
    let flight = object(data)?;
    if let Some(fixed) = STARTS.iter().chain(&["aircraft"]).find(|key| flight.contains_key(**key)) {
        return Err(invalid(fixed));
    }
    Ok(Flight { place_deg: None, weather: weather(flight)? })
}

fn object(data: &Json) -> Result<&Map<String, Json>, Fault> {
    let flight = data.as_object().ok_or_else(|| invalid("data"))?;
    match flight.keys().find(|key| !KEYS.contains(&key.as_str())) {
        Some(unknown) => Err(invalid(unknown)),
        None => Ok(flight),
    }
}

/// The wind and turbulence of the lowest layer, if there is one.
fn weather(flight: &Map<String, Json>) -> Result<Option<Weather>, Fault> {
    let Some(weather) = flight.get("weather") else { return Ok(None) };
    if weather == "use_real_weather" {
        return Ok(None);
    }
    let weather = weather.as_object().ok_or_else(|| invalid("weather"))?;
    decimal(weather, "variation_across_region_percentage", (0.0, 100.0))?;
    let definition = weather.get("definition").ok_or_else(|| invalid("definition"))?;
    let Some(definition) = definition.as_object() else { return Ok(None) };
    let layers = match definition.get("wind") {
        None => return Ok(Some(Weather::default())),
        Some(wind) => wind.as_array().filter(|layers| layers.len() <= 13).ok_or_else(|| invalid("wind"))?,
    };
    let mut lowest: Option<(f64, Weather)> = None;
    for layer in layers {
        let layer = layer.as_object().ok_or_else(|| invalid("wind"))?;
        let altitude = decimal(layer, "altitude_in_feet_msl", (-1000.0, 100_000.0))?;
        let turbulence = match layer.get("turbulence_ratio") {
            None => 0.0,
            Some(_) => decimal(layer, "turbulence_ratio", (0.0, 1.0))?,
        };
        let air = Weather {
            wind_m_s: decimal(layer, "speed_in_knots", (0.0, 200.0))? * M_S_PER_KNOT,
            wind_from_rad: decimal(layer, "direction_in_degrees_true", (0.0, 360.0))?.to_radians(),
            gust_w20_m_s: turbulence * SEVERE_W20_M_S,
        };
        if lowest.is_none_or(|(below, _)| altitude < below) {
            lowest = Some((altitude, air));
        }
    }
    Ok(Some(lowest.map_or_else(Weather::default, |(_, air)| air)))
}
