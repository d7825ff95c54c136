//! Reads the scenario of a command and checks that this build can fly it.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use skein_common::scenario::{self, Described, Loaded, Scenario, Source, Vehicle, load_any};
use skein_core::aircraft::Aircraft;
use skein_core::control::Rules;
use skein_core::formation;
use skein_core::helicopter::Start;
use skein_core::start::starts;
use skein_core::tuning;
use skein_host::external;
use skein_host::files::{self, FileError};

use crate::error::Error;
use crate::shipped::{self, HOVER};

/// The command-line arguments that choose a scenario.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct ScenarioArgs {
    /// Scenario file, or the name of a shipped scenario such as flock (`skein files scenarios` lists them) [default: hover]
    #[arg(value_name = "SCENARIO")]
    pub scenario: Option<PathBuf>,
    /// Override a key of the scenario file, such as formation.radius_m=50; the last value wins
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,
}

impl ScenarioArgs {
    /// Reads the scenario and applies the `--set` options and then `more` of them.
    ///
    /// Paths in the scenario become absolute, because another working directory may fly it.
    ///
    /// # Errors
    /// The file cannot be read, or the file or a set is invalid.
    pub fn read(&self, more: Vec<String>) -> Result<Loaded, Error> {
        let described = self.read_any(more)?;
        let teams = described.all().len();
        let refused = || format!("{}: this is a fleet of {teams} teams; this command takes one swarm", self.name());
        described.into_team(None).ok_or_else(|| Error::Refused(refused()))
    }

    /// Reads a scenario or a fleet, as [`Self::read`] does a scenario.
    ///
    /// # Errors
    /// The same as of [`Self::read`].
    pub fn read_any(&self, more: Vec<String>) -> Result<Described, Error> {
        let mut sets = [self.sets.clone(), more].concat();
        let name = self.name();
        let text = self.text()?;
        let load = |sets: &[String]| {
            load_any(&Source { name: &name, text: &text }, sets)
                .map_err(|fault| Error::Scenario { fault: fault.into(), text: text.clone() })
        };
        let described = load(&sets)?;
        let given = sets.len();
        let of_teams = described.all().iter().map(|team| self.absolute_paths(&team.scenario));
        let of_teams = of_teams.collect::<Result<Vec<_>, _>>()?;
        if of_teams.windows(2).all(|two| two[0] == two[1]) {
            sets.extend(of_teams.into_iter().next().unwrap_or_default());
        } else {
            let own = of_teams.into_iter().enumerate();
            sets.extend(own.flat_map(|(nth, sets)| sets.into_iter().map(move |set| format!("team.{}.{set}", nth + 1))));
        }
        if sets.len() > given { load(&sets) } else { Ok(described) }
    }

    /// Options that make the relative paths of a scenario absolute.
    fn absolute_paths(&self, scenario: &Scenario) -> Result<Vec<String>, Error> {
        let mut sets = Vec::new();
        let refused = |key: &str, error: io::Error| Error::Refused(format!("{key}: {error}"));
        if let scenario::Rules::Folder(rules) = &scenario.control.rules
            && rules.is_relative()
        {
            let rules = std::path::absolute(self.folder().join(rules)).map_err(|e| refused("control.rules", e))?;
            sets.push(format!("control.rules={}", toml::Value::String(rules.display().to_string())));
        }
        if let Some(command) = &scenario.formation.external.command {
            let key = "formation.external.command";
            let resolved = external::resolve(command, self.folder()).map_err(|error| refused(key, error))?;
            let changed = (resolved != *command).then(|| format!("{key}={}", toml::Value::from(resolved)));
            sets.extend(changed);
        }
        Ok(sets)
    }

    /// Checks that agents of this build can fly a scenario from [`ScenarioArgs::read`], and reads the files that it
    /// needs.
    ///
    /// # Errors
    /// A sentence with the reason why the scenario cannot fly.
    pub fn ready(&self, scenario: &Scenario) -> Result<Ready, Error> {
        let refused = |why: String| Error::Refused(format!("{}: {why}", self.name()));
        formation::check(scenario).map_err(|error| refused(error.to_string()))?;
        formation::check_airspace(scenario).map_err(|error| refused(error.to_string()))?;
        scenario.check_scripted_settings(|tuned| tuning::check(scenario, tuned)).map_err(|(index, setting, why)| {
            refused(format!("mission.events[{index}]: {setting} cannot be flown: {why}"))
        })?;
        external::LawTransport::of(scenario).map_err(|error| refused(error.to_string()))?;
        let (mut aircraft, mut aircraft_files) = (Vec::new(), BTreeMap::new());
        for vehicle in &scenario.vehicle {
            let (parameters, text) = aircraft_of(vehicle, self.folder(), &self.name())?;
            aircraft.push(parameters);
            aircraft_files.insert(vehicle.aircraft.clone(), text);
        }
        let rules = files::rules(&scenario.control.rules, self.folder());
        let (rules, _) = rules.map_err(|error| refused(format!("control.rules: {error}")))?;
        let starts = starts(scenario).map_err(|error| refused(error.to_string()))?;
        Ok(Ready { starts, aircraft, aircraft_files, rules })
    }

    /// The command line of this `skein` command on this scenario, with these keys set on top and this seed, for a shell.
    pub fn command(&self, verb: &str, more: &[(String, String)], seed: Option<u64>) -> String {
        let file = self.scenario.as_ref().map(|path| path.display().to_string());
        let more = more.iter().map(|(key, value)| format!("{key}={value}"));
        let sets = self.sets.iter().cloned().chain(more).flat_map(|set| ["--set".to_owned(), set]);
        let seed = seed.into_iter().flat_map(|seed| ["--seed".to_owned(), seed.to_string()]);
        let arguments = file.into_iter().chain(sets).chain(seed);
        ["skein".to_owned(), verb.to_owned()]
            .into_iter()
            .chain(arguments)
            .map(|part| quoted(&part))
            .collect::<Vec<_>>()
            .join(" ")
    }

    /// The scenario that the program carries, if the arguments name one. A file with the same name comes first.
    fn shipped(&self) -> Option<Source<'static>> {
        match &self.scenario {
            None => Some(HOVER),
            Some(path) if path.is_file() => None,
            Some(path) => shipped::scenario(path.to_str()?),
        }
    }

    /// The text of the scenario.
    fn text(&self) -> Result<String, Error> {
        let (None, Some(path)) = (self.shipped(), &self.scenario) else {
            return Ok(self.shipped().unwrap_or(HOVER).text.to_owned());
        };
        if path.extension().is_some_and(|ending| ending == "mcap") {
            let shown = path.display();
            return Err(Error::Refused(format!(
                "{shown}: this is a recording, not a scenario; `skein report {shown}` draws it"
            )));
        }
        fs::read_to_string(path).map_err(|error| {
            let similar = path.to_str().filter(|_| error.kind() == io::ErrorKind::NotFound);
            let similar = similar.and_then(shipped::most_similar);
            let shown = path.display();
            Error::Refused(match (similar, error.kind()) {
                (Some(name), _) => format!("{shown}: {error}; did you mean the shipped scenario {name}?"),
                (None, io::ErrorKind::NotFound) => format!(
                    "{shown}: {error}; `skein files scenarios` lists the shipped scenarios, `skein files new scenario NAME` writes a file"
                ),
                (None, io::ErrorKind::IsADirectory) if path.join("scenario.toml").is_file() => {
                    format!("{shown} is a folder; the scenario of that run is {}", path.join("scenario.toml").display())
                }
                (None, io::ErrorKind::IsADirectory) => format!("{shown} is a folder, not a scenario file"),
                (None, io::ErrorKind::InvalidData) => format!("{shown}: not a text, so no scenario file"),
                (None, _) => format!("{shown}: {error}"),
            })
        })
    }

    /// The folder to which paths in the scenario file are relative.
    fn folder(&self) -> &Path {
        self.scenario.as_deref().and_then(Path::parent).unwrap_or(Path::new(""))
    }

    /// The name of the scenario file in messages.
    pub fn name(&self) -> String {
        let of_file = || self.scenario.as_ref().map(|path| path.display().to_string()).unwrap_or_default();
        self.shipped().map_or_else(of_file, |shipped| shipped.name.to_owned())
    }
}

/// Quotes an argument for a shell; on Windows for PowerShell, and where it can be for cmd.exe too.
pub fn quoted(argument: &str) -> String {
    let is_plain =
        |letter: char| letter.is_alphanumeric() || "-_=./:,+%@".contains(letter) || cfg!(windows) && letter == '\\';
    if !argument.is_empty() && argument.chars().all(is_plain) {
        return argument.to_owned();
    }
    if cfg!(windows) && !argument.contains(['"', '$', '`']) {
        return format!("\"{argument}\"");
    }
    format!("'{}'", argument.replace('\'', r"'\''"))
}

/// Everything that a flight of the scenario needs to start.
#[derive(Clone, Debug)]
pub struct Ready {
    /// Start place of each vehicle, in the order of ids.
    pub starts: Vec<Start>,
    /// Aircraft of each vehicle, in the order of ids.
    pub aircraft: Vec<Aircraft>,
    /// Texts of the aircraft files, by aircraft name.
    pub aircraft_files: BTreeMap<String, String>,
    /// Rules of the vehicle controllers.
    pub rules: Rules,
}

/// Reads the aircraft of a vehicle and returns it with the text of its file.
///
/// # Errors
/// The aircraft does not exist, or its file is invalid: then the error names the line.
pub fn aircraft_of(vehicle: &Vehicle, folder: &Path, scenario: &str) -> Result<(Aircraft, String), Error> {
    let Vehicle { id, aircraft: name, .. } = vehicle;
    files::aircraft(name, folder).map_err(|error| match error {
        FileError::Aircraft(fault) => Error::Refused(format!("{fault} (the aircraft of vehicle {id} in {scenario})")),
        error => {
            let known = Aircraft::SHIPPED.map(|(known, _)| known).join(", ");
            Error::Refused(format!(
                "{scenario}: vehicle {id}: no aircraft \"{name}\" ({error}); the program includes {known}"
            ))
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(sets: &[&str]) -> String {
        let args = ScenarioArgs::default();
        let sets = sets.iter().map(|&set| set.to_owned()).collect();
        args.ready(&args.read(sets).unwrap().scenario).unwrap_err().to_string()
    }

    #[test]
    fn without_a_file_the_hover_formation_is_read() {
        let loaded = ScenarioArgs::default().read(vec!["seed=9".to_owned()]).unwrap();
        assert_eq!((loaded.scenario.name.as_str(), loaded.scenario.seed), ("hover", 9));
        assert_eq!(ScenarioArgs::default().name(), "hover.toml");
    }

    fn named(name: &str) -> ScenarioArgs {
        ScenarioArgs { scenario: Some(name.into()), sets: Vec::new() }
    }

    #[test]
    fn a_shipped_scenario_flies_by_its_name_unless_a_file_has_it() {
        let args = named("tour");
        assert_eq!(
            (args.read(Vec::new()).unwrap().scenario.name.as_str(), args.name().as_str()),
            ("tour", "tour.toml")
        );
        assert_eq!(args.command("fly", &[], None), "skein fly tour");
        let refused = named("flok").read(Vec::new()).unwrap_err().to_string();
        assert!(refused.ends_with("; did you mean the shipped scenario flock?"), "{refused}");
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("tour");
        fs::write(&file, "name = 'mine'\nswarm.vehicles = 1").unwrap();
        assert_eq!(named(file.to_str().unwrap()).read(Vec::new()).unwrap().scenario.name, "mine");
    }

    #[test]
    fn a_later_set_overrides_an_earlier_one() {
        let args = ScenarioArgs { sets: vec!["seed=3".to_owned(), "duration_s=7".to_owned()], ..Default::default() };
        let scenario = args.read(vec!["seed=4".to_owned()]).unwrap().scenario;
        assert_eq!((scenario.seed, scenario.duration_s), (4, Some(7.0)));
    }

    #[test]
    fn a_command_line_is_quoted_for_a_shell() {
        let args = ScenarioArgs { scenario: Some("a b.toml".into()), sets: vec!["name=it's".to_owned()] };
        let more = [("mission.steps[0]".to_owned(), "{ hold_s = 1 }".to_owned())];
        let expected = r"skein study 'a b.toml' --set 'name=it'\''s' --set 'mission.steps[0]={ hold_s = 1 }' --seed 3";
        assert_eq!(args.command("study", &more, Some(3)), expected);
        assert_eq!(ScenarioArgs::default().command("fly", &[], None), "skein fly");
    }

    #[test]
    fn an_unsupported_scenario_is_refused() {
        let uneven = refused(&["formation.law=olfati-saber", "formation.olfati_saber.action_a=6"]);
        assert!(
            uneven.contains("`formation.olfati_saber.action_a` is 6, but may not be above `action_b`, 5"),
            "{uneven}"
        );
        let unknown = refused(&["vehicle.3.aircraft=r66"]);
        assert!(unknown.starts_with("hover.toml: vehicle 3: no aircraft \"r66\" (cannot read r66.toml"), "{unknown}");
        assert!(unknown.ends_with("the program includes xcell60"), "{unknown}");
    }

    #[test]
    fn the_rules_folder_is_relative_to_the_scenario_file() {
        let args = ScenarioArgs {
            scenario: Some("../scenarios/hover.toml".into()),
            sets: vec!["control.rules=../controllers".to_owned()],
        };
        let scenario = args.read(Vec::new()).unwrap().scenario;
        let scenario::Rules::Folder(folder) = &scenario.control.rules else { panic!("a folder") };
        assert!(folder.is_absolute(), "{folder:?}");
        assert!(args.ready(&scenario).is_ok());
        let nowhere = args.read(vec!["control.rules=nowhere".to_owned()]).unwrap().scenario;
        let refused = args.ready(&nowhere).unwrap_err().to_string();
        assert!(refused.contains("control.rules: ") && refused.contains("roll.fis"), "{refused}");
    }

    #[test]
    fn a_missing_scenario_file_is_refused() {
        let args = ScenarioArgs { scenario: Some("no/such.toml".into()), sets: Vec::new() };
        let error = args.read(Vec::new()).unwrap_err();
        assert!(error.to_string().starts_with("no/such.toml: "), "{error}");
        assert_eq!(error.exit_code(), 2);
    }
}
