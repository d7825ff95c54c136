//! `skein check`: reports what would prevent a flight. It checks a scenario and prints every value with its origin, or
//! checks a cluster, or asks an X-Plane.

use std::path::PathBuf;

use serde_json::json;
use skein_common::scenario::{ControlMode, Explained, Loaded};

use crate::cluster;
use crate::fly::script;
use crate::prepare::{Prepared, Target, prepare};
use crate::simulators::{self, HostPort};
use skein_lab::error::Error;
use skein_lab::external::Trial;
use skein_lab::scenario::ScenarioArgs;

/// `skein check`
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  skein check --set formation.radius_m=50\n  skein check -f cluster.toml\n  skein check --xplane 127.0.0.1:49000"
)]
pub struct CheckArgs {
    /// The scenario.
    #[command(flatten)]
    pub scenario: ScenarioArgs,
    /// A cluster: its keys, hosts, clocks, disks, versions, simulators and ports, each fault with its remedy
    #[arg(short = 'f', long = "file", value_name = "CLUSTER.toml", conflicts_with_all = ["scenario", "sets"])]
    pub file: Option<PathBuf>,
    /// An X-Plane: what it answers to this PC
    #[arg(long, value_name = "HOST[:PORT]")]
    pub xplane: Option<HostPort>,
    /// Print it as JSON; of a scenario with what each key means
    #[arg(long)]
    pub json: bool,
}

/// Prints the results. For a scenario these are every value with its origin; then, on stderr, the events that `fly`
/// would skip and whatever would prevent a flight: the check starts the external law and asks the X-Planes. With only
/// `--xplane` given, it asks that X-Plane and no scenario is checked.
///
/// # Errors
/// If a file is wrong, the scenario is not supported in flight, or anything else would prevent a flight.
pub fn run(args: &CheckArgs) -> Result<(), Error> {
    if let Some(xplane) = &args.xplane {
        simulator(xplane, args.json)?;
    }
    match (&args.file, &args.xplane) {
        (Some(file), _) => cluster::check::run(file, args.json),
        (None, Some(_)) if args.scenario.scenario.is_none() && args.scenario.sets.is_empty() => Ok(()),
        (None, _) => scenario(args),
    }
}

fn simulator(xplane: &HostPort, json: bool) -> Result<(), Error> {
    let address = format!("{}:{}", xplane.host, xplane.port);
    let received = simulators::ask(&address)?;
    let text = format!("{address}: {received}\n");
    skein_lab::terminal::say(&if json {
        skein_lab::terminal::json(&json!({ "xplane": address, "heard": received }))
    } else {
        text
    });
    Ok(())
}

fn scenario(args: &CheckArgs) -> Result<(), Error> {
    let loaded = args.scenario.read(Vec::new())?;
    loaded.notes.iter().for_each(|note| eprintln!("{note}"));
    script::skipped(&loaded.scenario).iter().for_each(|skipped| eprintln!("{skipped}"));
    skein_lab::terminal::say(&if args.json { skein_lab::terminal::json(&as_json(&loaded)) } else { as_text(&loaded) });
    verdict(args, &loaded).map(drop)
}

/// Checks whether the scenario can fly.
pub(crate) fn verdict(args: &CheckArgs, loaded: &Loaded) -> Result<Prepared, Error> {
    prepare(&args.scenario, &loaded.scenario, target(args, loaded), &mut Trial::default())
}

/// The target to check for: a flight in real time, unless only a study can fly the scenario.
fn target<'a>(args: &'a CheckArgs, loaded: &Loaded) -> Target<'a> {
    match loaded.scenario.control.mode {
        ControlMode::Central => {
            eprintln!("control.mode = \"central\": checked for a study, because `skein fly` does not fly it");
            Target::Study
        }
        ControlMode::Each => Target::Fly { xplane: args.xplane.as_ref() },
    }
}

/// Formats a line for each key: key, value, origin.
fn as_text(loaded: &Loaded) -> String {
    let value = |line: &Explained| line.value.clone().unwrap_or_else(|| "-".to_owned());
    let widest = |width: fn(&Explained) -> usize| loaded.explain().iter().map(width).max().unwrap_or(0);
    let key_width = widest(|line| line.key.len());
    let value_width = widest(|line| line.value.as_ref().map_or(1, |value| value.chars().count())).min(24);
    let line = |line: &Explained| {
        format!("{:<key_width$}  {:<value_width$}  {}\n", line.key, value(line), line.origin.to_string().escape_debug())
    };
    loaded.explain().iter().map(line).collect()
}

fn as_json(loaded: &Loaded) -> serde_json::Value {
    let line = |line: &Explained| {
        let value = line.value.as_ref().map(|value| value.parse::<toml::Value>());
        json!({
            "key": line.key,
            "value": value.and_then(Result::ok),
            "origin": line.origin.to_string(),
            "about": line.about,
        })
    };
    loaded.explain().iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn loaded() -> Loaded {
        ScenarioArgs::default().read(vec!["formation.radius_m=80".to_owned()]).unwrap()
    }

    #[test]
    fn every_key_has_a_line_with_its_origin() {
        let text = as_text(&loaded());
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
    fn json_has_the_same_lines_with_typed_values() {
        let (loaded, json) = (loaded(), as_json(&loaded()));
        assert_eq!(json.as_array().unwrap().len(), loaded.explain().len());
        let radius = json.as_array().unwrap().iter().find(|line| line["key"] == "formation.radius_m").unwrap();
        assert_eq!((&radius["value"], &radius["origin"]), (&json!(80.0), &json!("--set")));
        assert!(radius["about"].as_str().unwrap().contains("R*"));
    }
}
