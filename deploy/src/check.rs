//! `skein check`: reports what would prevent a flight. It checks a scenario and prints every value with its origin, or
//! checks a cluster, or this PC. `skein xplane check` asks an X-Plane.

mod pc;
pub(crate) mod xplane;

use std::path::PathBuf;
use std::time::Duration;

use serde_json::json;

use skein_common::scenario::{ControlMode, Explained, Loaded, Scenario};
use skein_core::formation::room;
use skein_core::hover::{self, Hover};

use skein_agent::config::fleet;

use crate::fly::script;
use crate::prepare::{self as flight, Prepared};
use skein_cluster::inventory::find;
use skein_cluster::nodes::is_seconds;
use skein_lab::error::Error;
use skein_lab::external::Trial;
use skein_lab::prepare;
use skein_lab::scenario::{Ready, ScenarioArgs};

/// `skein check`
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  skein check --set formation.radius_m=50\n  skein check -f cluster.toml\n  skein check --pc"
)]
pub struct CheckArgs {
    /// The scenario.
    #[command(flatten)]
    pub scenario: ScenarioArgs,
    /// A cluster: its keys, hosts, clocks, disks, versions, simulators and ports, each fault with its remedy. `skein check`
    /// alone checks the cluster of the file that the environment variable SKEIN_CLUSTER names, else of cluster.toml in this
    /// folder, if there is one; otherwise the shipped hover scenario
    #[arg(short = 'f', long = "file", value_name = "CLUSTER.toml", conflicts_with_all = ["scenario", "sets"])]
    pub file: Option<PathBuf>,
    /// This PC, for any scenario: ports, firewall, cores, clock, limits, disk, X-Plane's beacon, each fault with its remedy
    #[arg(long, conflicts_with_all = ["scenario", "sets", "file"])]
    pub pc: bool,
    /// With --pc: how long to listen to X-Plane's beacon, s
    #[arg(long, value_name = "S", default_value_t = 2.0, value_parser = is_seconds, requires = "pc")]
    pub wait: f64,
    /// Print it as JSON; of a scenario with what each key means
    #[arg(long)]
    pub json: bool,
}

/// Prints the results. For a scenario these are every value with its origin; then, on stderr, the events that `fly`
/// would skip and whatever would prevent a flight: the check starts the external law and asks the X-Planes. With nothing
/// given, it checks the cluster of this folder if there is one.
///
/// # Errors
/// If a file is wrong, the scenario is not supported in flight, or anything else would prevent a flight.
pub fn run(args: &CheckArgs) -> Result<(), Error> {
    if args.pc {
        return pc::run(Duration::from_secs_f64(args.wait), args.json);
    }
    if let Some(file) = &args.file {
        return skein_cluster::check::run(file, args.json);
    }
    let names_a_scenario = args.scenario.scenario.is_some() || !args.scenario.sets.is_empty();
    match if names_a_scenario { None } else { find::unnamed() } {
        Some(cluster) => {
            skein_lab::terminal::complain(&format!("checks {cluster}; `skein check SCENARIO` checks a scenario"));
            skein_cluster::check::run(&cluster.path, args.json)
        }
        None => scenario(args),
    }
}

fn scenario(args: &CheckArgs) -> Result<(), Error> {
    let described = args.scenario.read_any(Vec::new())?;
    let first = described.first();
    first.notes.iter().for_each(|note| eprintln!("{note}"));
    script::skipped(&first.scenario).iter().for_each(|skipped| eprintln!("{skipped}"));
    room::crowded_step(&first.scenario).iter().for_each(|why| eprintln!("{}: {why}", args.scenario.name()));
    let lines = lines(described.all());
    skein_lab::terminal::say(&if args.json { skein_lab::terminal::json(&as_json(&lines)) } else { as_text(&lines) });
    if let Err(why) = fleet::check_size(described.all()) {
        eprintln!("{}: {why}", args.scenario.name());
    }
    if let Ok(ready) = args.scenario.ready(&first.scenario) {
        rules_tried(&first.scenario, &ready).iter().for_each(|line| eprintln!("{line}"));
    }
    described.all().iter().try_for_each(|team| verdict(args, team).map(drop))
}

/// The lines about the scenario's own rule bases: what is unusual about them, and how they hover.
fn rules_tried(scenario: &Scenario, ready: &Ready) -> Vec<String> {
    let warnings = ready.rules.warnings.iter().map(|warning| format!("warning: {warning}"));
    let mut lines: Vec<String> = warnings.collect();
    for tried in prepare::try_rules(scenario, ready) {
        let line = |with: &str, hover: &Hover| {
            let verdict = hover.fault().map_or_else(|| "holds".to_owned(), |why| format!("does not hold: {why}"));
            format!("hover of {} with {with}: {verdict}; {hover}", tried.aircraft)
        };
        lines.push(line("these rules", &tried.all));
        let files = hover::AXES.iter().zip(&tried.each);
        lines.extend(files.map(|(axis, hover)| line(&format!("{axis}.fis and the shipped rules otherwise"), hover)));
    }
    lines
}

/// Every value with its key; of the further teams of a fleet only what differs from team 1.
fn lines(teams: &[Loaded]) -> Vec<Explained> {
    let Some((first, others)) = teams.split_first() else { return Vec::new() };
    let mut lines = first.explain().to_vec();
    for team in others {
        let id = team.scenario.team.map_or_else(String::new, |team| team.id.to_string());
        let is_own =
            |line: &&Explained| !first.explain().iter().any(|one| (&one.key, &one.value) == (&line.key, &line.value));
        let own = team.explain().iter().filter(is_own).cloned();
        lines.extend(own.map(|line| Explained { key: format!("team.{id}.{}", line.key), ..line }));
    }
    lines
}

/// Checks whether the scenario can fly: in real time, unless only a study can fly it.
pub(crate) fn verdict(args: &CheckArgs, loaded: &Loaded) -> Result<Prepared, Error> {
    let is_live = loaded.scenario.control.mode == ControlMode::Each;
    if !is_live {
        eprintln!("control.mode = \"central\": checked for a study, because `skein fly` does not fly it");
    }
    flight::prepare(&args.scenario, &loaded.scenario, is_live.then_some(&[]), &mut Trial::default())
}

/// Formats a line for each key: key, value, origin.
fn as_text(lines: &[Explained]) -> String {
    let value = |line: &Explained| line.value.clone().unwrap_or_else(|| "-".to_owned());
    let widest = |width: fn(&Explained) -> usize| lines.iter().map(width).max().unwrap_or(0);
    let key_width = widest(|line| line.key.len());
    let value_width = widest(|line| line.value.as_ref().map_or(1, |value| value.chars().count())).min(24);
    let line = |line: &Explained| {
        format!("{:<key_width$}  {:<value_width$}  {}\n", line.key, value(line), line.origin.to_string().escape_debug())
    };
    lines.iter().map(line).collect()
}

fn as_json(lines: &[Explained]) -> serde_json::Value {
    let line = |line: &Explained| {
        let value = line.value.as_ref().map(|value| value.parse::<toml::Value>());
        json!({
            "key": line.key,
            "value": value.and_then(Result::ok),
            "origin": line.origin.to_string(),
            "about": line.about,
        })
    };
    lines.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use skein_common::scenario::{Source, load_any};

    use super::*;

    fn loaded() -> Loaded {
        ScenarioArgs::default().read(vec!["formation.radius_m=80".to_owned()]).unwrap()
    }

    #[test]
    fn every_key_has_a_line_with_its_origin() {
        let text = as_text(loaded().explain());
        let line = |key: &str| -> Vec<&str> {
            let line = text.lines().find(|line| line.starts_with(&format!("{key} "))).unwrap();
            line.split_whitespace().collect()
        };
        assert_eq!(line("formation.radius_m"), ["formation.radius_m", "80.0", "--set"]);
        assert_eq!(line("formation.altitude_m"), ["formation.altitude_m", "30.0", "hover.toml:15"]);
        assert_eq!(line("formation.gain_m"), ["formation.gain_m", "7.0", "default"]);
        assert_eq!(line("network.range_m")[1..], ["\"none\"", "default"]);
    }

    #[test]
    fn of_a_further_team_only_what_differs_is_printed() {
        let text = "fleet.teams = 3\nswarm.vehicles = 2\n[[team]]\nids = [3]\nformation.radius_m = 50\n";
        let described = load_any(&Source { name: "fleet.toml", text }, &[]).unwrap();
        let text = as_text(&lines(described.all()));
        let of_team_3: Vec<&str> = text.lines().filter(|line| line.starts_with("team.3.formation")).collect();
        assert!(of_team_3.len() == 1 && of_team_3[0].starts_with("team.3.formation.radius_m "), "{text}");
        assert!(text.contains("team.2.origin.longitude_deg") && !text.contains("team.2.formation"), "{text}");
    }

    #[test]
    fn json_has_the_same_lines_with_typed_values() {
        let (loaded, json) = (loaded(), as_json(loaded().explain()));
        assert_eq!(json.as_array().unwrap().len(), loaded.explain().len());
        let radius = json.as_array().unwrap().iter().find(|line| line["key"] == "formation.radius_m").unwrap();
        assert_eq!((&radius["value"], &radius["origin"]), (&json!(80.0), &json!("--set")));
        assert!(radius["about"].as_str().unwrap().contains("R*"));
    }
}
