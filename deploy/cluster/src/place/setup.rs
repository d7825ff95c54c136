//! The time of day and the weight that a scenario asks for, in an X-Plane.

use serde_json::{Map, Value, json};
use skein_common::scenario::{Scenario, VehicleModel};
use skein_lab::error::Error;

use super::weather::{ANSWER, FOLLOWS_WITHIN};
use crate::findings::Line;
use crate::simulators::survey::{Survey, Surveyor};
use crate::simulators::web::WebApi;

const LOCAL_TIME: &str = "sim/time/local_time_sec";
const DATE: &str = "sim/time/local_date_days";
const PAYLOAD: &str = "sim/flightmodel/weight/m_fixed";
const FUEL: &str = "sim/flightmodel/weight/m_fuel_total";
/// Datarefs of the time of day and of the weight.
pub const SETUP: [&str; 3] = [LOCAL_TIME, PAYLOAD, FUEL];

const SECONDS_OF_AN_HOUR: f64 = 3600.0;
const SECONDS_OF_A_DAY: f64 = 86_400.0;
/// Days of a year that X-Plane has, and the one that is asked for if it does not report its own.
const DAYS: f64 = 365.0;
const MIDSUMMER: f64 = 171.0;
/// Difference of the time of day, s, and of a weight, kg, that is noted. An aircraft with running engines burns fuel.
const NOTABLE_S: f64 = 600.0;
const NOTABLE_KG: f64 = 2.0;
const REMEDY: &str =
    "`skein xplane place` sets it with the Web API of X-Plane 12.4; set it on X-Plane's screen otherwise";

/// The time of day for a flight; the date stays.
pub(super) fn time_of_flight(plant: &VehicleModel, web: &WebApi) -> Map<String, Value> {
    let Some(hours) = plant.local_time_h else { return Map::new() };
    // X-Plane counts its date from 0, and the days of a flight from 1.
    let day = web.number(DATE).filter(|day| (0.0..DAYS).contains(day)).unwrap_or(MIDSUMMER) as u32 + 1;
    let time = json!({ "day_of_year": day, "time_in_24_hours": hours });
    Map::from_iter([("local_time".to_owned(), time)])
}

/// The weight of a flight's aircraft.
pub(super) fn weight_of_flight(plant: &VehicleModel) -> Map<String, Value> {
    let entry = |key: &str, kg: Option<f64>| Some((key.to_owned(), json!([kg?])));
    let weight =
        [entry("payload_weight_in_kilograms", plant.payload_kg), entry("fueltank_weight_in_kilograms", plant.fuel_kg)];
    let weight: Map<String, Value> = weight.into_iter().flatten().collect();
    if weight.is_empty() { weight } else { Map::from_iter([("weight".to_owned(), weight.into())]) }
}

/// The time of day and the weight against the scenario's, some seconds after they were set.
pub(super) fn followed(place: &str, surveyor: &Surveyor, scenario: &Scenario) -> Result<Vec<Line>, Error> {
    if wanted(&scenario.plant).is_empty() {
        return Ok(Vec::new());
    }
    let is_as_wanted = |survey: &Survey| wanted(&scenario.plant).iter().all(|wanted| wanted.is_met(survey));
    let (survey, _) = surveyor.survey_until(&SETUP.map(str::to_owned), ANSWER, FOLLOWS_WITHIN, is_as_wanted)?;
    Ok(compared(place, &survey, scenario))
}

/// The time of day and the weight against what the scenario asks for; nothing if it asks for nothing.
pub fn compared(place: &str, survey: &Survey, scenario: &Scenario) -> Vec<Line> {
    let line = |wanted: &WantedValue| {
        let Some(found) = survey.value(wanted.path) else {
            return Line::new(place, wanted.what, "not answered").unknown();
        };
        let found = (wanted.shown)(found.into());
        if wanted.is_met(survey) {
            return Line::new(place, wanted.what, found);
        }
        Line::new(place, wanted.what, format!("{found}; the scenario has {}", (wanted.shown)(wanted.value)))
            .warning(REMEDY)
    };
    wanted(&scenario.plant).iter().map(line).collect()
}

/// A value that a scenario asks for.
struct WantedValue {
    what: &'static str,
    path: &'static str,
    value: f64,
    within: f64,
    shown: fn(f64) -> String,
}

impl WantedValue {
    fn is_met(&self, survey: &Survey) -> bool {
        let Some(found) = survey.value(self.path) else { return false };
        let off = (f64::from(found) - self.value).abs();
        // One minute before midnight is near one minute after it.
        let off = if self.path == LOCAL_TIME { off.min((SECONDS_OF_A_DAY - off).abs()) } else { off };
        off <= self.within
    }
}

fn wanted(plant: &VehicleModel) -> Vec<WantedValue> {
    let kg: fn(f64) -> String = |kg| format!("{kg:.1} kg");
    let time: fn(f64) -> String = |seconds| {
        let minutes = (seconds / 60.0).round() as i64;
        format!("{:02}:{:02} local time", minutes / 60, minutes % 60)
    };
    let of =
        |what, path, value: Option<f64>, within, shown| Some(WantedValue { what, path, value: value?, within, shown });
    let local_time_s = plant.local_time_h.map(|hours| hours * SECONDS_OF_AN_HOUR);
    let all = [
        of("time of day", LOCAL_TIME, local_time_s, NOTABLE_S, time),
        of("payload", PAYLOAD, plant.payload_kg, NOTABLE_KG, kg),
        of("fuel", FUEL, plant.fuel_kg, NOTABLE_KG, kg),
    ];
    all.into_iter().flatten().collect()
}
