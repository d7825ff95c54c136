//! The flight of a request: what a stand-in can do of X-Plane's flight initialization.

use serde_json::{Map, Value as Json};

use super::Fault;
use crate::plant::xplane::server::{Flight, SEVERE_W20_M_S, Setting};
use skein_core::helicopter::Weather;

const SECONDS_OF_AN_HOUR: f64 = 3600.0;
const NOON_H: f64 = 12.0;
/// Ways to say the time, of which a flight has one at most.
const TIMES: [&str; 4] = ["use_system_time", "local_time", "gmt_time", "time_enum"];
/// Number of payload stations and of tanks, and most of a weight, kg.
const MOST_WEIGHTS: usize = 9;
const HEAVIEST_KG: f64 = 1e6;
const M_S_PER_KNOT: f64 = 1852.0 / 3600.0;
/// Keys of a flight beside its start and time; another one is refused.
const OTHERS: [&str; 10] = [
    "aircraft",
    "weight",
    "engine_status",
    "weapons",
    "failures",
    "ai_aircraft",
    "formation_aircraft",
    "incursion",
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
    let given = conditions(flight)?;
    // What a new flight does not say is as by default: noon, and an aircraft without payload and fuel.
    let noon = (Setting::LocalTime, NOON_H * SECONDS_OF_AN_HOUR);
    let mut settings = vec![noon, (Setting::Payload, 0.0), (Setting::Fuel, 0.0)];
    settings.extend(given.settings);
    Ok(Flight { place_deg: Some(place_deg), settings, ..given })
}

/// Reads a change of the current flight.
pub(super) fn changed(data: &Json) -> Result<Flight, Fault> {
    let flight = object(data)?;
    if let Some(fixed) = STARTS.iter().chain(&["aircraft"]).find(|key| flight.contains_key(**key)) {
        return Err(invalid(fixed));
    }
    conditions(flight)
}

/// The part that new flights and changes have in common.
fn conditions(flight: &Map<String, Json>) -> Result<Flight, Fault> {
    let mut settings = time(flight)?;
    settings.extend(weights(flight)?);
    Ok(Flight { place_deg: None, weather: weather(flight)?, settings })
}

/// The local time of day, s, and the date, counted from 0.
fn time(flight: &Map<String, Json>) -> Result<Vec<(Setting, f64)>, Fault> {
    let mut given = TIMES.into_iter().filter_map(|key| Some((key, flight.get(key)?)));
    let (Some((key, value)), None) = (given.next(), given.next()) else {
        let none = TIMES.iter().all(|key| !flight.contains_key(*key));
        return if none { Ok(Vec::new()) } else { Err(invalid("time: at most one is permitted, it")) };
    };
    match key {
        "time_enum" if value == "day" => Ok(vec![(Setting::LocalTime, NOON_H * SECONDS_OF_AN_HOUR)]),
        "local_time" => {
            let value = value.as_object().ok_or_else(|| invalid(key))?;
            let day = value.get("day_of_year").and_then(Json::as_u64).filter(|day| (1..=366).contains(day));
            let day = day.ok_or_else(|| invalid("day_of_year"))? - 1;
            let hours = decimal(value, "time_in_24_hours", (0.0, 24.0))?;
            Ok(vec![(Setting::LocalTime, hours * SECONDS_OF_AN_HOUR), (Setting::LocalDate, day as f64)])
        }
        // Nothing flies by these here.
        _ => Ok(Vec::new()),
    }
}

/// The weights of payload and fuel, kg.
fn weights(flight: &Map<String, Json>) -> Result<Vec<(Setting, f64)>, Fault> {
    let mut sums = Vec::new();
    let Some(weight) = flight.get("weight") else { return Ok(sums) };
    let weight = weight.as_object().ok_or_else(|| invalid("weight"))?;
    for (key, setting) in
        [("payload_weight_in_kilograms", Setting::Payload), ("fueltank_weight_in_kilograms", Setting::Fuel)]
    {
        let Some(parts) = weight.get(key) else { continue };
        let parts = parts.as_array().filter(|parts| (1..=MOST_WEIGHTS).contains(&parts.len()));
        let part = |part: &Json| {
            let kg = Some(part).filter(|part| part.is_f64()).and_then(Json::as_f64);
            kg.filter(|kg| (0.0..=HEAVIEST_KG).contains(kg)).ok_or_else(|| invalid(key))
        };
        sums.push((setting, parts.ok_or_else(|| invalid(key))?.iter().map(part).sum::<Result<f64, _>>()?));
    }
    Ok(sums)
}

fn object(data: &Json) -> Result<&Map<String, Json>, Fault> {
    let flight = data.as_object().ok_or_else(|| invalid("data"))?;
    let is_known = |key: &str| STARTS.contains(&key) || TIMES.contains(&key) || OTHERS.contains(&key);
    match flight.keys().find(|key| !is_known(key)) {
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
