//! Puts an X-Plane's aircraft to its vehicle's start, in the scenario's weather: `skein xplane place`, and `skein fly` before its
//! agents begin.
//!
//! A command does this and not the agent: a flight that loads takes a minute, its outcome is for a person to see, and an
//! agent that needs nothing but UDP flies the same on every PC.

mod setup;
mod weather;

use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;

use serde_json::{Map, Value, json};
use skein_agent::plant::xplane::placing::{Placing, PlacingState, is_flying, start_of};
use skein_agent::plant::xplane::wire::prel::Placement;
use skein_agent::plant::xplane::wire::rpos::Position;
use skein_common::frame::Geodetic;
use skein_common::id::VehicleId;
use skein_common::scenario::{Scenario, StartPattern};
use skein_lab::error::Error;
use skein_lab::scenario::ScenarioArgs;
use skein_lab::terminal;

use crate::findings::{Line, State, as_table, verdict};
use crate::ports::HostPort;
use crate::simulators::survey::{ACF, SILENT, Surveyor};
use crate::simulators::web::{WebApi, WebChoice, WebError};
pub use setup::{SETUP, compared as setup_compared};
pub use weather::{WIND_NOW, compared, local};

/// `skein xplane place`
#[derive(Clone, Debug, clap::Args)]
#[command(
    long_about = "Puts the aircraft of an X-Plane to the start of its vehicle, with its engines running and the scenario's wind, and says \
                  what came of it. X-Plane 12.4 and later starts a flight there through its Web API; an older one is placed by UDP.",
    after_help = "Examples:\n  skein xplane place --xplane 127.0.0.1\n  skein xplane place hover --xplane 10.0.0.7 --vehicle 2 --weather-only"
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
    /// Its Web API, or off; without it that of vehicle.N.web, or of this PC if the X-Plane is on this PC
    #[arg(long, value_name = "HOST[:PORT]")]
    pub web: Option<WebChoice>,
    /// Leave the aircraft where it is
    #[arg(long)]
    pub weather_only: bool,
    /// Print it as JSON
    #[arg(long)]
    pub json: bool,
}

/// Time limit for a flight to load, and largest distance of an aircraft from its start, m: X-Plane puts it some metres ahead.
const LOADED_WITHIN: Duration = Duration::from_secs(60);
const NEAR_M: f64 = 30.0;
const WATCHED: Duration = Duration::from_secs(1);
/// Interval between two looks whether a flight is still wanted.
const LOOK: Duration = Duration::from_millis(100);

/// Places the aircraft, sets the weather, and prints what the simulator's state then says.
///
/// # Errors
/// If the scenario has no such vehicle, the X-Plane does not answer, or the aircraft is not at its start.
pub fn run(args: &PlaceArgs) -> Result<(), Error> {
    let scenario = args.scenario.read(Vec::new())?.scenario;
    // Refuses starts for which there is no room.
    args.scenario.ready(&scenario)?;
    let Some(start) = start_of(&scenario, args.vehicle) else {
        return Err(Error::Refused(format!("--vehicle {}: {} has no such vehicle", args.vehicle, scenario.name)));
    };
    let written = scenario.vehicle(args.vehicle).and_then(|vehicle| vehicle.web.as_deref());
    let web = WebChoice::or_of(args.web.as_ref(), written, &args.xplane).open();
    let surveyor = Surveyor::open(&args.xplane.to_string())?;
    let lines = placed(&surveyor, web, &scenario, |_| (!args.weather_only).then_some(start))?;
    terminal::say(&if args.json { terminal::json(&lines) } else { as_table(&lines, false) });
    verdict(&lines)
}

/// Places the aircraft of a flight's X-Planes, in the order of ids, all at once, and sets their weather: a line for each
/// thing, until `is_over` says that the flight is not wanted any more. An aircraft that flies stays where it is, and so
/// does each if the scenario leaves them where they are. A fault does not stand against the flight: its agents place by UDP.
pub fn before_flight(scenario: &Scenario, xplanes: &[String], is_over: impl Fn() -> bool) -> Vec<Line> {
    let (sender, receiver) = channel();
    for (id, address) in scenario.ids().zip(xplanes) {
        let (sender, scenario, address) = (sender.clone(), scenario.clone(), address.clone());
        thread::spawn(move || {
            let lines = before_flight_of(&scenario, id, &address);
            // Without a receiver the flight is over.
            let _ = sender.send((id, lines));
        });
    }
    drop(sender);
    let mut lines = Vec::new();
    while !is_over() {
        match receiver.recv_timeout(LOOK) {
            Ok(placed) => lines.push(placed),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
    }
    lines.sort_by_key(|(id, _)| *id);
    lines.into_iter().flat_map(|(_, lines)| lines).collect()
}

/// Places the aircraft of one vehicle for a flight, as [`before_flight`] does for all.
pub(crate) fn before_flight_of(scenario: &Scenario, id: VehicleId, address: &str) -> Vec<Line> {
    begin_at_start(scenario, id, address).unwrap_or_else(|error| {
        vec![Line::new(address, "place", error.to_string()).fault("the agent places the aircraft by UDP")]
    })
}

fn begin_at_start(scenario: &Scenario, id: VehicleId, address: &str) -> Result<Vec<Line>, Error> {
    let xplane: HostPort = address.parse().map_err(|why| Error::Refused(format!("{address}: {why}")))?;
    let written = scenario.vehicle(id).and_then(|vehicle| vehicle.web.as_deref());
    let web = WebChoice::or_of(None, written, &xplane).open();
    // X-Plane 11 has none.
    let web = web.filter(|web| !matches!(web, Err(WebError::Absent(..))) || written.is_some());
    let start = start_of(scenario, id).filter(|_| scenario.start.pattern != StartPattern::AsIs);
    placed(&Surveyor::open(address)?, web, scenario, |position| start.filter(|_| !position.is_some_and(is_flying)))
}

/// Carries it out. `start` gives the start for an aircraft at this position, if it is known; without one only the weather is
/// set.
fn placed(
    surveyor: &Surveyor,
    web: Option<Result<WebApi, WebError>>,
    scenario: &Scenario,
    start: impl FnOnce(Option<&Position>) -> Option<Placement>,
) -> Result<Vec<Line>, Error> {
    let place = surveyor.simulator.to_string();
    let found = surveyor.survey(&[], 10, WATCHED, false)?;
    if !found.has_answered() {
        let silent = format!("no answer within {} s", SILENT.as_secs());
        let remedy = "start X-Plane and load a flight; set Settings, Network, \"Accept incoming connections\"";
        return Ok(vec![Line::new(place, "answer", silent).fault(remedy)]);
    }
    let mut lines = Vec::new();
    let is_missing = |error: &WebError| lines.push(Line::new(&place, "web API", error.to_string()).unknown());
    let web = web.and_then(|web| web.inspect_err(is_missing).ok());
    let flights = web.as_ref().filter(|web| web.starts_flights());
    let start = start(found.position.as_ref());
    let at = start.as_ref().map_or_else(|| here(scenario, found.position.as_ref()), geodetic);
    let scenario = &local(scenario, &at);
    let reply = match start {
        Some(start) => {
            let put = put(surveyor, flights, scenario, start, found.position.as_ref())?;
            lines.push(outcome(&place, put));
            if lines.iter().any(|line| line.state == State::Fault) {
                return Ok(lines);
            }
            None
        }
        // The aircraft is left alone.
        None => flights.and_then(|web| web.change_flight(&surroundings(web, scenario, &at).into()).err()),
    };
    lines.extend(reply.map(|error| Line::new(&place, "web API", format!("its reply: {error}")).unknown()));
    // Whether the Web API has set the weather is read from the air.
    if flights.is_none() || !weather::settled(surveyor, scenario)?.1 {
        weather::set(surveyor, scenario)?;
    }
    lines.extend(compared(&place, &weather::settled(surveyor, scenario)?.0, scenario));
    lines.extend(setup::followed(&place, surveyor, scenario)?);
    Ok(lines)
}

/// Puts the aircraft there: how it was asked, the reply, and the distance from the start at last, m. An aircraft that stands
/// there keeps its place, and the Web API changes its flight.
fn put(
    surveyor: &Surveyor,
    flights: Option<&WebApi>,
    scenario: &Scenario,
    start: Placement,
    found: Option<&Position>,
) -> Result<(&'static str, Option<WebError>, Option<f64>), Error> {
    let mut placing = Placing::at(start);
    let there = found.filter(|found| !is_flying(found) && placing.state(found) == PlacingState::There);
    if let (Some(web), Some(there)) = (flights, there) {
        let reply = web.change_flight(&prepared(web, scenario, &geodetic(&start)).into()).err();
        return Ok(("its flight changed by its Web API", reply, Some(placing.away_m(there))));
    }
    let aircraft = flights.and_then(|web| Some((web, web.text(ACF)?))).filter(|(_, path)| !path.is_empty());
    let (how, reply) = match &aircraft {
        Some((web, path)) => ("by its Web API", web.start_flight(&flight(web, path, scenario, &start)).err()),
        None => ("by UDP", None),
    };
    let until = skein_host::clock::now() + LOADED_WITHIN;
    loop {
        let position = surveyor.survey(&[], 10, WATCHED, false)?.position;
        let away_m = position.as_ref().map(|position| placing.away_m(position));
        let now = skein_host::clock::now();
        if away_m.is_some_and(|away_m| away_m < NEAR_M) || now >= until {
            return Ok((how, reply, away_m));
        }
        let due = if aircraft.is_none() { placing.due(position.as_ref(), now) } else { None };
        due.iter().for_each(|placement| surveyor.place(placement));
    }
}

fn geodetic(start: &Placement) -> Geodetic {
    Geodetic::from_degrees(start.latitude_deg, start.longitude_deg, start.elevation_m)
}

/// A new flight of the Web API with this aircraft, by day unless the scenario has a time, with the weight that X-Plane gives
/// it by default unless the scenario has one. Every number has decimals: one version of X-Plane refuses whole ones.
fn flight(web: &WebApi, path: &str, scenario: &Scenario, start: &Placement) -> Value {
    let mut flight = prepared(web, scenario, &geodetic(start));
    if scenario.plant.local_time_h.is_none() {
        flight.insert("time_enum".to_owned(), "day".into());
    }
    let &Placement { latitude_deg, longitude_deg, heading_deg, .. } = start;
    flight.insert("aircraft".to_owned(), json!({ "path": path }));
    let place = json!({ "latitude": latitude_deg, "longitude": longitude_deg, "heading_true": heading_deg });
    flight.insert("lle_ground_start".to_owned(), place);
    flight.into()
}

/// The part of a flight that makes an aircraft on the ground there ready for the scenario: engines, failures, weight, weather and time.
fn prepared(web: &WebApi, scenario: &Scenario, place: &Geodetic) -> Map<String, Value> {
    let failures = match scenario.plant.random_failures {
        // What X-Plane's own settings say about them remains.
        true => json!({ "fix_everything": true }),
        false => json!({ "fix_everything": true, "mean_time_between_failures_in_hours": 0.0 }),
    };
    let mut flight = surroundings(web, scenario, place);
    flight.insert("engine_status".to_owned(), json!({ "all_engines": { "running": true } }));
    flight.insert("failures".to_owned(), failures);
    flight.extend(setup::weight_of_flight(&scenario.plant));
    flight
}

/// The weather and the time of day around this place.
fn surroundings(web: &WebApi, scenario: &Scenario, place: &Geodetic) -> Map<String, Value> {
    let mut flight = setup::time_of_flight(&scenario.plant, web);
    flight.insert("weather".to_owned(), weather::of_flight(scenario, place));
    flight
}

/// The position of the aircraft; the scenario's origin if that is unknown.
pub fn here(scenario: &Scenario, found: Option<&Position>) -> Geodetic {
    let place = |found: &Position| Geodetic::from_degrees(found.latitude_deg, found.longitude_deg, found.elevation_m);
    found.map_or_else(|| scenario.origin.geodetic(), place)
}

fn outcome(place: &str, (how, reply, away_m): (&str, Option<WebError>, Option<f64>)) -> Line {
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
