//! `skein xplane check`: what would stop an agent at one X-Plane, each fault with its remedy.

mod web;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde_json::json;
use skein_agent::plant::xplane::client::RANDOM_FAILURES;
use skein_agent::plant::xplane::discovery::FoundSimulator;
use skein_agent::plant::xplane::placing::{LEVEL_WITHIN_M, NEAR_ORIGIN_M, from_origin_m};
use skein_common::frame::Origin;
use skein_common::scenario::{Scenario, Vehicle};
use skein_core::aircraft::Profile;
use skein_lab::error::Error;
use skein_lab::out;
use skein_lab::scenario::ScenarioArgs;
use skein_lab::terminal;

use crate::new::discover;
use skein_cluster::bundle::hex;
use skein_cluster::findings::{self, Line, verdict};
use skein_cluster::os;
use skein_cluster::place;
use skein_cluster::ports::HostPort;
use skein_cluster::simulators::reset::CRASHED;
use skein_cluster::simulators::survey::{ACF, SILENT, Survey, Surveyor, VERSION, version_text};
use skein_cluster::simulators::web::WebChoice;

/// `skein xplane check`
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  skein xplane check --xplane 127.0.0.1:49000\n  skein xplane check my-lab.toml --xplane 10.0.0.7 --report found.json"
)]
pub struct XplaneCheckArgs {
    /// The scenario, whose aircraft and origin count if it is named.
    #[command(flatten)]
    pub scenario: ScenarioArgs,
    /// The X-Plane
    #[arg(long, value_name = "HOST[:PORT]")]
    pub xplane: HostPort,
    /// Its Web API, or off; without it that of vehicle.N.web, or of this PC if the X-Plane is on this PC
    #[arg(long, value_name = "HOST[:PORT]")]
    pub web: Option<WebChoice>,
    /// A file for all that was found and a minute of datagrams, to be sent with a question
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Print it as JSON
    #[arg(long)]
    pub json: bool,
}

/// Time for which positions are watched, and time for which a report gathers datagrams.
const WATCHED: Duration = Duration::from_secs(5);
const REPORTED: Duration = Duration::from_secs(60);
/// Positions a second that an agent asks for; below the second number, which allows for the measurement, it flies, but not as
/// well; below the third not at all.
const WANTED_HZ: u32 = 50;
const WELL_FROM_HZ: f64 = 49.5;
const FLIES_FROM_HZ: f64 = 20.0;
/// Longest time between two positions that is no interruption, s.
const LONGEST_GAP_S: f64 = 0.1;
/// Characters of the aircraft's path that are read, one dataref for each.
const PATH_CHARACTERS: usize = 80;

const PAUSED: &str = "sim/time/paused";
const REPLAY: &str = "sim/time/is_in_replay";
const SPEED: &str = "sim/time/sim_speed_actual";
const PERIOD: &str = "sim/operation/misc/frame_rate_period";

fn path_element(nth: usize) -> String {
    format!("{ACF}[{nth}]")
}

/// Checks the X-Plane and prints a line for each thing; with `--report`, gathers a minute of datagrams into that file too.
///
/// # Errors
/// If a fault prevents a flight, or the report cannot be written.
pub(crate) fn run(args: &XplaneCheckArgs) -> Result<(), Error> {
    let names_a_scenario = args.scenario.scenario.is_some() || !args.scenario.sets.is_empty();
    let (scenario, profile) = flown(&args.scenario)?;
    let web = WebChoice::or_of(args.web.as_ref(), web_of(&scenario, &args.xplane), &args.xplane);
    let address = args.xplane.to_string();
    let surveyor = Surveyor::open(&address)?;
    let lines = lines(&address, &surveyor, &profile, names_a_scenario.then_some(&scenario), &web)?;
    if let Some(path) = &args.report {
        write_report(path, &surveyor, &profile, &lines, REPORTED)?;
    }
    terminal::say(&if args.json { terminal::json(&lines) } else { findings::as_table(&lines, false) });
    verdict(&lines)
}

/// The scenario, and the datarefs of its first vehicle's aircraft.
fn flown(args: &ScenarioArgs) -> Result<(Scenario, Profile), Error> {
    let scenario = args.read_any(Vec::new())?.first().scenario.clone();
    let ready = args.ready(&scenario)?;
    let profile = ready.aircraft.into_iter().next().map(|aircraft| aircraft.xplane).unwrap_or_default();
    Ok((scenario, profile))
}

/// The address of the Web API that the scenario gives for the X-Plane of one of its vehicles.
fn web_of<'a>(scenario: &'a Scenario, simulator: &HostPort) -> Option<&'a str> {
    let address = simulator.to_string();
    let its = |vehicle: &&Vehicle| vehicle.xplane.as_ref() == Some(&address);
    scenario.ids().filter_map(|id| scenario.vehicle(id)).find(its)?.web.as_deref()
}

/// Checks the X-Plane at this address with the datarefs of this aircraft, against the scenario if one was named. Its Web API is looked
/// for where `web` says.
fn lines(
    place: &str,
    surveyor: &Surveyor,
    profile: &Profile,
    scenario: Option<&Scenario>,
    web: &WebChoice,
) -> Result<Vec<Line>, Error> {
    let beacon = std::thread::spawn(|| discover::heard(WATCHED));
    let survey = surveyor.survey(&wanted(profile), WANTED_HZ, WATCHED, false)?;
    let mut lines = Vec::new();
    if survey.has_answered() {
        lines.push(answer(place, &survey));
        lines.push(version(place, &survey));
        let web = web::WebChecks(web.open());
        lines.extend(web.lines(place, &survey, profile));
        // A thread that panicked has printed the reason.
        lines.extend(beacon.join().map(|heard| announces(place, surveyor.simulator.port(), heard)));
        lines.push(frames(place, &survey));
        let value = |path: &str| web.number(path).or_else(|| survey.value(path).map(f64::from));
        lines.extend(states(place, &value));
        lines.push(random_failures(place, &value, scenario.is_some_and(|scenario| scenario.plant.random_failures)));
        lines.push(aircraft(place, &survey, profile, web.aircraft()));
        lines.extend(datarefs(place, &survey, profile));
        lines.push(rotor(place, &survey, profile));
        lines.push(overrides(place, surveyor, &survey, profile)?);
        lines.extend(scenario.and_then(|scenario| origin(place, &survey, scenario)));
        let here = |scenario| place::here(scenario, survey.position.as_ref());
        let local = scenario.map(|scenario| place::local(scenario, &here(scenario)));
        lines.extend(local.iter().flat_map(|scenario| place::compared(place, &survey, scenario)));
        lines.extend(scenario.into_iter().flat_map(|scenario| place::setup_compared(place, &survey, scenario)));
        lines.push(load());
    } else {
        let found = format!("no answer within {} s", SILENT.as_secs());
        lines.push(Line::new(place, "answer", found).fault(
            "start X-Plane and load a flight; set Settings, Network, \"Accept incoming connections\"; let UDP through both ways",
        ));
    }
    Ok(lines)
}

/// All datarefs that are asked for.
fn wanted(profile: &Profile) -> Vec<String> {
    let states = [VERSION, PAUSED, REPLAY, SPEED, PERIOD, CRASHED].into_iter().chain(RANDOM_FAILURES);
    let own = profile.datarefs().into_iter().map(|dataref| dataref.as_str().to_owned());
    states
        .map(str::to_owned)
        .chain(own)
        .chain(place::WIND_NOW.map(str::to_owned))
        .chain(place::SETUP.map(str::to_owned))
        .chain((0..PATH_CHARACTERS).map(path_element))
        .collect()
}

fn answer(place: &str, survey: &Survey) -> Line {
    let found = format!("{} positions, {} values", survey.positions_s.len(), survey.values.len());
    match (&survey.position, survey.malformed) {
        (_, malformed) if malformed > 0 => {
            Line::new(place, "answer", format!("{found}, {malformed} datagrams that are not X-Plane's")).warning(
                "another program answers at this port too, or X-Plane's version is not known: end it, or send a report",
            )
        }
        (None, _) => Line::new(place, "answer", found).fault("load a flight: X-Plane sends no position from its menus"),
        (Some(position), _) => Line::new(
            place,
            "answer",
            format!(
                "{found}; aircraft at {:.5}°, {:.5}°, {:.0} m, {:.1} m above the ground",
                position.latitude_deg, position.longitude_deg, position.elevation_m, position.height_m
            ),
        ),
    }
}

fn version(place: &str, survey: &Survey) -> Line {
    let Some(version) = survey.value(VERSION) else {
        return Line::new(place, "version", "not answered").unknown();
    };
    let number = version as u32;
    let line = Line::new(place, "version", version_text(number));
    if number >= 110_000 { line } else { line.warning("Skein is made for X-Plane 11 and 12") }
}

fn announces(place: &str, port: u16, heard: Result<Vec<FoundSimulator>, Error>) -> Line {
    match heard {
        Err(error) => Line::new(place, "beacon", error.to_string()).unknown(),
        Ok(found) => match found.iter().find(|found| found.port == port) {
            Some(found) => {
                let (version, over) = (version_text(found.version), discover::over(found));
                Line::new(place, "beacon", format!("{version} on {}{over}", found.computer))
            }
            None => {
                Line::new(place, "beacon", "not received; needed only to find X-Planes without an address").unknown()
            }
        },
    }
}

/// Rate of the positions, and how regular they are.
fn frames(place: &str, survey: &Survey) -> Line {
    let times_s = &survey.positions_s;
    let [first_s, .., last_s] = times_s[..] else {
        return Line::new(place, "frames", "fewer than two positions").fault("load a flight, and resume it");
    };
    let mut between_s: Vec<f64> = times_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    between_s.sort_by(f64::total_cmp);
    let rate_hz = between_s.len() as f64 / (last_s - first_s).max(1e-3);
    let longest_s = between_s.last().copied().unwrap_or_default();
    let p99_s = between_s[(between_s.len() - 1) * 99 / 100];
    let mut found = format!(
        "{rate_hz:.0} positions a second, 99 % within {:.0} ms, longest {:.0} ms",
        1e3 * p99_s,
        1e3 * longest_s
    );
    if let Some(period_s) = survey.value(PERIOD).filter(|period_s| *period_s > 0.0) {
        let _ = write!(found, "; {:.0} frames a second on its screen", 1.0 / period_s);
    }
    let line = Line::new(place, "frames", found);
    let slower = "lower the graphics settings, or the number of other aircraft";
    if rate_hz < FLIES_FROM_HZ {
        line.fault(format!("an agent needs {FLIES_FROM_HZ:.0} a second: {slower}"))
    } else if rate_hz < WELL_FROM_HZ || longest_s > LONGEST_GAP_S {
        line.warning(format!("an agent flies best with {WANTED_HZ} regular positions a second: {slower}"))
    } else {
        line
    }
}

/// The newest value of a dataref: that of the Web API where it answers, else that by UDP.
type Values<'a> = dyn Fn(&str) -> Option<f64> + 'a;

/// Whether the simulator simulates.
fn states(place: &str, value: &Values<'_>) -> Vec<Line> {
    let of = |what, path: &str, good: &str, is_good: fn(f64) -> bool, bad: &str, remedy: &str| match value(path) {
        None => Line::new(place, what, "not answered").unknown(),
        Some(value) if is_good(value) => Line::new(place, what, good),
        Some(value) => Line::new(place, what, format!("{bad} ({value})")).fault(remedy),
    };
    let is_zero = |value: f64| value == 0.0;
    let mut lines = vec![
        of("pause", PAUSED, "runs", is_zero, "paused", "resume it: P on X-Plane's keyboard"),
        of("replay", REPLAY, "not in replay", is_zero, "in replay", "leave the replay"),
        of("crash", CRASHED, "not crashed", is_zero, "the aircraft has crashed", "reset the flight"),
    ];
    lines.push(value(SPEED).map_or_else(
        || Line::new(place, "speed", "not answered").unknown(),
        |speed| {
            let line = Line::new(place, "speed", format!("{speed:.2} times real time"));
            match (speed - 1.0).abs() < 0.05 || value(PAUSED) == Some(1.0) {
                true => line,
                false => {
                    line.warning("X-Plane slows its time below 19 frames a second, and its settings can: set real time")
                }
            }
        },
    ));
    lines
}

/// Whether random failures are on if they are wanted, and off if they are not.
fn random_failures(place: &str, value: &Values<'_>, are_wanted: bool) -> Line {
    let line = |found: &str| Line::new(place, "random failures", found);
    let values = RANDOM_FAILURES.iter().filter_map(|path| value(path));
    match (values.map(|value| value != 0.0).reduce(|one, other| one || other), are_wanted) {
        (None, _) => line("not answered").unknown(),
        (Some(false), false) => line("off"),
        (Some(true), true) => line("on, as plant.random_failures wants"),
        (Some(true), false) => line("on").warning(
            "turn them off: Aircraft, Failures; or state in the scenario that they are wanted: plant.random_failures",
        ),
        (Some(false), true) => {
            line("off, but plant.random_failures wants them").warning("turn them on: Aircraft, Failures")
        }
    }
}

/// The file of the aircraft that is loaded, and whether it is the one that the profile is for.
fn aircraft(place: &str, survey: &Survey, profile: &Profile, by_web: Option<String>) -> Line {
    let mut bytes: Vec<u8> =
        (0..PATH_CHARACTERS).map_while(|nth| survey.value(&path_element(nth))).map(|value| value as u8).collect();
    let end = bytes.iter().position(|byte| *byte == 0);
    bytes.truncate(end.unwrap_or(PATH_CHARACTERS));
    let (path, is_whole) = match by_web {
        Some(path) if !path.is_empty() => (path, true),
        _ => (String::from_utf8_lossy(&bytes).into_owned(), end.is_some()),
    };
    if path.is_empty() {
        return Line::new(place, "aircraft", "its file was not answered: look which aircraft is loaded").unknown();
    }
    let line = Line::new(place, "aircraft", skein_common::printable::printable(&path, PATH_CHARACTERS));
    match &profile.acf {
        Some(acf) if !path.contains(acf.as_str()) && !is_whole => {
            line.warning(format!("the path is longer than what was answered: see that it is the aircraft for {acf}"))
        }
        Some(acf) if !path.contains(acf.as_str()) => {
            line.fault(format!("the aircraft's file is for {acf}: load that one, or name the file of this one"))
        }
        _ => line,
    }
}

/// Each dataref of the aircraft's file that does not answer.
fn datarefs(place: &str, survey: &Survey, profile: &Profile) -> Vec<Line> {
    let silent = |path: &str| {
        let found = format!("{path}: no answer within {} s", WATCHED.as_secs());
        let remedy =
            "this X-Plane or this aircraft has no such dataref: correct the table [xplane] of the aircraft's file";
        survey.value(path).is_none().then(|| Line::new(place, "dataref", found).fault(remedy))
    };
    let all_answer = |all| Line::new(place, "datarefs", format!("all {all} of the aircraft's file answer"));
    each_dataref(profile, silent, all_answer)
}

/// A line for each dataref of the aircraft's file that has a fault; without a fault one line about so many datarefs.
fn each_dataref(
    profile: &Profile,
    fault: impl Fn(&str) -> Option<Line>,
    are_good: impl Fn(usize) -> Line,
) -> Vec<Line> {
    let all = profile.datarefs();
    let faults: Vec<Line> = all.iter().filter_map(|dataref| fault(dataref.as_str())).collect();
    if faults.is_empty() { vec![are_good(all.len())] } else { faults }
}

fn rotor(place: &str, survey: &Survey, profile: &Profile) -> Line {
    match survey.value(profile.rotor_speed_rpm.as_str()) {
        None => Line::new(place, "rotor", "its speed is not answered").unknown(),
        Some(rpm) if rpm > 1.0 => Line::new(place, "rotor", format!("{rpm:.0} rpm")),
        Some(_) => Line::new(place, "rotor", "does not turn")
            .warning("start the engine; an agent waits for the rotor before take-off"),
    }
}

/// Takes the overrides for a moment, if no one holds them, and gives them back.
fn overrides(place: &str, surveyor: &Surveyor, survey: &Survey, profile: &Profile) -> Result<Line, Error> {
    let paths: Vec<String> = profile.overrides.iter().map(|dataref| dataref.as_str().to_owned()).collect();
    let line = |found: &str| Line::new(place, "overrides", found);
    if paths.iter().any(|path| survey.value(path).is_none()) {
        return Ok(line("not answered").unknown());
    }
    if paths.iter().any(|path| survey.value(path) != Some(0.0)) {
        return Ok(line("held by another program").warning(
            "if an agent flies this aircraft, all is well; if its PC has died, `skein xplane release` gives the controls back",
        ));
    }
    let after = |value: f32| {
        paths.iter().for_each(|path| surveyor.write(path, value));
        surveyor.reads(&paths, value)
    };
    let (is_taken, is_back) = (after(1.0)?, after(0.0)?);
    Ok(match (is_taken, is_back) {
        (true, true) => line("taken and given back"),
        (false, _) => line("were written, but did not take").fault(
            "another program or plugin sets them; X-Plane's network settings may refuse writes: accept incoming connections",
        ),
        (true, false) => line("were taken, but not given back").fault("`skein xplane release` gives them back"),
    })
}

/// The line about the aircraft's distance from the scenario's origin; `None` without a position.
fn origin(place: &str, survey: &Survey, scenario: &Scenario) -> Option<Line> {
    let position = survey.position.as_ref()?;
    let (away_m, ground_m) = from_origin_m(&Origin::new(scenario.origin.geodetic()), position);
    let line = Line::new(
        place,
        "origin",
        format!("{away_m:.0} m from {}'s origin, on ground {ground_m:+.1} m against it", scenario.name),
    );
    let here = format!(
        "--set origin.latitude_deg={:.6} --set origin.longitude_deg={:.6} --set origin.elevation_m={:.1}",
        position.latitude_deg,
        position.longitude_deg,
        position.elevation_m - f64::from(position.height_m)
    );
    Some(if away_m > NEAR_ORIGIN_M || ground_m.abs() > LEVEL_WITHIN_M {
        line.warning(format!("move the aircraft there, or the origin here: {here}"))
    } else {
        line
    })
}

fn load() -> Line {
    let Some(load) = os::load() else { return Line::new("this PC", "load", "not reported by this system").unknown() };
    let line = Line::new("this PC", "load", format!("{load:.1} on {} cores", os::cores()));
    match load > os::cores() as f64 {
        true => line.warning("end other programs: an agent that comes late flies badly"),
        false => line,
    }
}

/// Gathers datagrams for this time and writes all of it, a JSON object a line: first the checks, then each datagram.
fn write_report(
    path: &Path,
    surveyor: &Surveyor,
    profile: &Profile,
    lines: &[Line],
    time: Duration,
) -> Result<(), Error> {
    terminal::complain(&format!("gathers datagrams for {} s", time.as_secs()));
    let survey = surveyor.survey(&wanted(profile), WANTED_HZ, time, true)?;
    let mut text = json!({ "skein": crate::version::line(), "checks": lines, "values": survey.values }).to_string();
    for (after_s, bytes) in &survey.datagrams {
        let _ = write!(text, "\n{}", json!({ "after_s": after_s, "datagram": hex(bytes) }));
    }
    text.push('\n');
    out::write(path, text)?;
    terminal::complain(&format!("{}: the checks and {} datagrams", path.display(), survey.datagrams.len()));
    Ok(())
}

#[cfg(test)]
mod tests;
