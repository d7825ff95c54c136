//! `skein place`: puts an X-Plane's aircraft to its vehicle's start, in the scenario's weather.
//!
//! A command does this, before a flight, and not the agent: a flight that loads takes a minute, its outcome is for a person
//! to see, and an agent that needs nothing but UDP flies the same on every PC.

mod weather;

use std::time::Duration;

use serde_json::json;
use skein_agent::plant::xplane::wire::prel::Placement;
use skein_common::frame::{Geodetic, Origin, PositionNed};
use skein_common::id::VehicleId;
use skein_common::scenario::Scenario;
use skein_lab::error::Error;
use skein_lab::scenario::ScenarioArgs;
use skein_lab::terminal;

use crate::cluster::check::{Line, State, verdict};
use crate::doctor;
use crate::simulators::HostPort;
use crate::simulators::survey::{SILENT, Surveyor};
use crate::simulators::web::{WebApi, WebChoice, WebError};
pub(crate) use weather::{WIND_NOW, compared};

/// `skein place`
#[derive(Clone, Debug, clap::Args)]
#[command(
    long_about = "Puts the aircraft of an X-Plane to the start of its vehicle, with its engines running and the scenario's wind, and says \
                  what came of it. X-Plane 12.4 and later starts a flight there through its Web API; an older one is placed by UDP.",
    after_help = "Examples:\n  skein place --xplane 127.0.0.1\n  skein place hover --xplane 10.0.0.7 --vehicle 2 --weather-only"
)]
pub struct PlaceArgs {
    /// The scenario.
    #[command(flatten)]
    pub scenario: ScenarioArgs,
    /// The X-Plane
    #[arg(long, value_name = "HOST[:PORT]")]
    pub xplane: HostPort,
    /// The vehicle that flies there
    #[arg(long, value_name = "N", default_value = "1")]
    pub vehicle: VehicleId,
    /// Its Web API, or off; without it that of this PC, if the X-Plane is on this PC
    #[arg(long, value_name = "HOST[:PORT]")]
    pub web: Option<WebChoice>,
    /// Leave the aircraft where it is
    #[arg(long)]
    pub weather_only: bool,
    /// Print it as JSON
    #[arg(long)]
    pub json: bool,
}

/// How long a flight may take to load, and how far from the start an aircraft may be, m: X-Plane puts it some metres ahead.
const LOADED_WITHIN: Duration = Duration::from_secs(60);
const NEAR_M: f64 = 30.0;
const WATCHED: Duration = Duration::from_secs(1);
const ACF: &str = "sim/aircraft/view/acf_relative_path";

/// Places the aircraft, sets the weather, and prints what the simulator's state then says.
///
/// # Errors
/// If the scenario has no such vehicle, the X-Plane does not answer, or the aircraft is not at its start.
pub fn run(args: &PlaceArgs) -> Result<(), Error> {
    let scenario = args.scenario.read(Vec::new())?.scenario;
    let ready = args.scenario.ready(&scenario)?;
    let nth = scenario.ids().position(|id| id == args.vehicle);
    let Some(start) = nth.and_then(|nth| ready.starts.get(nth)) else {
        return Err(Error::Refused(format!("--vehicle {}: {} has no such vehicle", args.vehicle, scenario.name)));
    };
    let origin = Origin::new(scenario.origin.geodetic());
    let place = origin.geodetic_from_ned(PositionNed::new(start.north_m, start.east_m, 0.0));
    let web = match WebChoice::or_of(args.web.as_ref(), &args.xplane) {
        WebChoice::Off => None,
        WebChoice::At(at) => Some(WebApi::open(&at)),
    };
    let surveyor = Surveyor::open(&format!("{}:{}", args.xplane.host, args.xplane.port))?;
    let lines = placed(&surveyor, web, &scenario, (!args.weather_only).then_some((place, start.heading_rad)))?;
    terminal::say(&if args.json { terminal::json(&lines) } else { doctor::as_table(&lines) });
    verdict(&lines)
}

/// Carries it out; without a start only the weather.
fn placed(
    surveyor: &Surveyor,
    web: Option<Result<WebApi, WebError>>,
    scenario: &Scenario,
    start: Option<(Geodetic, f64)>,
) -> Result<Vec<Line>, Error> {
    let place = surveyor.simulator().to_string();
    if !surveyor.survey(&[], 10, WATCHED, false)?.has_answered() {
        let found = format!("no answer within {} s", SILENT.as_secs());
        let remedy = "start X-Plane and load a flight; set Settings, Network, \"Accept incoming connections\"";
        return Ok(vec![Line::new(place, "answer", found).fault(remedy)]);
    }
    let mut lines = Vec::new();
    let web = match web {
        None => None,
        Some(Ok(web)) => Some(web),
        Some(Err(error)) => {
            lines.push(Line::new(&place, "web API", error.to_string()).unknown());
            None
        }
    };
    if let Some(start) = start {
        let asked = ask(surveyor, web.as_ref(), scenario, start);
        let arrived = arrives(surveyor, &start.0)?;
        lines.push(outcome(&place, asked, arrived));
        if lines.iter().any(|line| line.state == State::Fault) {
            return Ok(lines);
        }
    }
    weather::set(surveyor, scenario)?;
    lines.extend(weather::followed(&place, surveyor, scenario)?);
    Ok(lines)
}

/// Asks the X-Plane to put the aircraft there; how, and what it replied.
fn ask(
    surveyor: &Surveyor,
    web: Option<&WebApi>,
    scenario: &Scenario,
    (place, heading_rad): (Geodetic, f64),
) -> (&'static str, Option<WebError>) {
    let heading_deg = heading_rad.to_degrees().rem_euclid(360.0);
    let aircraft = web.filter(|web| web.starts_flights()).and_then(|web| Some((web, web.text(ACF)?)));
    if let Some((web, path)) = aircraft.filter(|(_, path)| !path.is_empty()) {
        // Every number has decimals: one version of X-Plane refuses whole ones.
        let flight = json!({
            "aircraft": { "path": path },
            "lle_ground_start": {
                "latitude": place.latitude_deg(), "longitude": place.longitude_deg(), "heading_true": heading_deg,
            },
            "engine_status": { "all_engines": { "running": true } },
            "failures": { "fix_everything": true, "mean_time_between_failures_in_hours": 0.0 },
            "weather": weather::of_flight(scenario, &place),
        });
        return ("by its Web API", web.start_flight(&flight).err());
    }
    surveyor.place(&Placement {
        aircraft: 0,
        latitude_deg: place.latitude_deg(),
        longitude_deg: place.longitude_deg(),
        elevation_m: place.altitude_m,
        heading_deg,
        speed_m_s: 0.0,
    });
    ("by UDP", None)
}

/// Distance from the start when the aircraft has arrived, or at last, m.
fn arrives(surveyor: &Surveyor, place: &Geodetic) -> Result<Option<f64>, Error> {
    let until = skein_host::clock::now() + LOADED_WITHIN;
    loop {
        let position = surveyor.survey(&[], 10, WATCHED, false)?.position;
        let away_m = position.map(|position| {
            let at = Geodetic::from_degrees(position.latitude_deg, position.longitude_deg, place.altitude_m);
            Origin::new(*place).ned_from_geodetic(&at).horizontal().norm()
        });
        if away_m.is_some_and(|away_m| away_m < NEAR_M) || skein_host::clock::now() >= until {
            return Ok(away_m);
        }
    }
}

fn outcome(place: &str, (how, reply): (&str, Option<WebError>), away_m: Option<f64>) -> Line {
    let replied = reply.map_or_else(String::new, |error| format!("; its reply: {error}"));
    let remedy = "place it on X-Plane's map, and look at its Log.txt; is its aircraft loaded, and a flight running?";
    match away_m {
        Some(away_m) if away_m < NEAR_M => {
            Line::new(place, "place", format!("{away_m:.0} m from its start, {how}{replied}"))
        }
        Some(away_m) => {
            Line::new(place, "place", format!("{away_m:.0} m from its start, asked {how}{replied}")).fault(remedy)
        }
        None => Line::new(place, "place", format!("sends no position, asked {how}{replied}")).fault(remedy),
    }
}

#[cfg(test)]
mod tests;
