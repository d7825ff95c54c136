//! The runs that a folder holds, however deep: every folder with a `metrics.json` and a `scenario.toml`.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use toml::Value as Toml;

use crate::error::Error;
use crate::metrics::Measured;

/// One run as it lies there.
#[derive(Clone, Debug)]
pub struct Flown {
    /// Its folder.
    pub folder: PathBuf,
    /// Its figures.
    pub measured: Measured,
    /// Every value of its scenario but the seed, by its key.
    pub scenario: BTreeMap<String, String>,
}

impl Flown {
    /// The command that flies it again.
    pub fn replay(&self) -> String {
        let path = self.folder.join("scenario.toml").display().to_string();
        let is_plain = |c: char| c.is_ascii_alphanumeric() || "/\\.:_-+".contains(c);
        let path = if path.chars().all(is_plain) { path } else { format!("'{}'", path.replace('\'', r"'\''")) };
        format!("skein {} {path}", self.text("target").unwrap_or("study"))
    }

    /// One of the texts that describe the run, such as its target or plant.
    pub fn text(&self, key: &str) -> Option<&str> {
        self.measured.texts.get(key).map(String::as_str)
    }
}

/// All runs of a folder.
#[derive(Clone, Debug)]
pub struct Folder {
    /// Its path, as it was named.
    pub path: PathBuf,
    /// In the order of their folders' names, numbers in them as numbers.
    pub runs: Vec<Flown>,
    /// A study that has not come to its end.
    pub is_unfinished: bool,
    /// The keys that the study swept, if it was one.
    pub swept: Vec<String>,
}

/// The error of a folder of runs that cannot be read.
pub(crate) fn unreadable(path: &Path, error: &io::Error) -> Error {
    let remedy = match error.kind() {
        io::ErrorKind::NotFound => "; without --out, runs are written into new folders below skein-runs",
        _ => "",
    };
    Error::Refused(format!("{}: {error}{remedy}", path.display()))
}

impl Folder {
    /// Reads all runs.
    ///
    /// # Errors
    /// If the folder holds no runs, or a run cannot be read.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let mut folders = Vec::new();
        find(path, &mut folders).map_err(|error| unreadable(path, &error))?;
        if folders.is_empty() {
            let why = "no runs in it: a run is a folder with metrics.json and scenario.toml";
            return Err(Error::Refused(format!("{}: {why}", path.display())));
        }
        folders.sort_by_cached_key(|folder| natural(&folder.display().to_string()));
        let study: serde_json::Value = fs::read_to_string(path.join("study.json"))
            .ok()
            .and_then(|text| serde_json::from_str(&text).ok())
            .unwrap_or_default();
        let sweeps =
            study["sweep"].as_array().into_iter().flatten().filter_map(|sweep| sweep.as_str()?.split_once('='));
        Ok(Self {
            path: path.to_owned(),
            is_unfinished: study.is_object() && !path.join("summary.json").exists(),
            swept: sweeps.map(|(key, _)| key.trim().to_owned()).collect(),
            runs: folders.into_iter().map(flown).collect::<Result<_, _>>()?,
        })
    }

    /// Keys at or below a key that a study swept, which may be a table or a list.
    pub fn below<'a>(swept: &str, keys: impl Iterator<Item = &'a str>) -> impl Iterator<Item = &'a str> {
        keys.filter(move |key| {
            key.strip_prefix(swept).is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
        })
    }

    /// Keys that are not the same in all runs.
    pub fn varying(&self) -> BTreeSet<&str> {
        let keys: BTreeSet<&str> = self.runs.iter().flat_map(|run| run.scenario.keys().map(String::as_str)).collect();
        keys.into_iter().filter(|key| self.constant(key).is_none()).collect()
    }

    /// The value of a key if it is the same in all runs; an inner `None` means that no run sets it.
    pub fn constant(&self, key: &str) -> Option<Option<&str>> {
        let mut values = self.runs.iter().map(|run| run.scenario.get(key).map(String::as_str));
        let first = values.next()?;
        values.all(|value| value == first).then_some(first)
    }

    /// All values that this text has in the runs.
    pub fn texts(&self, key: &str) -> BTreeSet<&str> {
        self.runs.iter().filter_map(|run| run.text(key)).collect()
    }
}

/// Folders of runs at or below `path`; what lies inside a run is its own.
fn find(path: &Path, found: &mut Vec<PathBuf>) -> io::Result<()> {
    let entries: Vec<_> = fs::read_dir(path)?.collect::<Result<_, _>>()?;
    if entries.iter().any(|entry| entry.file_name() == "metrics.json") {
        found.push(path.to_owned());
        return Ok(());
    }
    // Links are not followed: they may lead round in a circle.
    entries
        .iter()
        .filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir()))
        .try_for_each(|e| find(&e.path(), found))
}

fn flown(folder: PathBuf) -> Result<Flown, Error> {
    let (metrics, scenario) = ("metrics.json", "scenario.toml");
    let refused = |name: &str, why: String| Error::Refused(format!("{}: {why}", folder.join(name).display()));
    let read = |name: &str| fs::read_to_string(folder.join(name)).map_err(|error| refused(name, error.to_string()));
    let measured = Measured::read(&read(metrics)?).map_err(|why| refused(metrics, why))?;
    let table: toml::Table =
        read(scenario)?.parse().map_err(|error: toml::de::Error| refused(scenario, error.message().to_owned()))?;
    let mut values = BTreeMap::new();
    flatten("", &Toml::Table(table), &mut values);
    values.remove("seed");
    Ok(Flown { measured, scenario: values, folder })
}

/// Every value by its key, spelled as `--set` takes it.
fn flatten(path: &str, value: &Toml, out: &mut BTreeMap<String, String>) {
    match value {
        Toml::Table(table) => table.iter().for_each(|(name, inner)| {
            let path = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
            flatten(&path, inner, out);
        }),
        Toml::Array(items) if items.iter().any(Toml::is_table) => {
            items.iter().enumerate().for_each(|(nth, item)| flatten(&format!("{path}[{nth}]"), item, out));
        }
        // 1 and 1.0 are the same to every key that takes numbers.
        Toml::Float(number) => _ = out.insert(path.to_owned(), number.to_string()),
        _ => _ = out.insert(path.to_owned(), value.to_string()),
    }
}

/// Orders `seed-10` behind `seed-9`.
fn natural(text: &str) -> String {
    let mut key = String::with_capacity(text.len() + 32);
    let mut rest = text;
    while let Some(start) = rest.find(|c: char| c.is_ascii_digit()) {
        let digits = rest[start..].find(|c: char| !c.is_ascii_digit()).map_or(rest.len(), |end| start + end);
        key += &rest[..start];
        key += &format!("{:0>20}", &rest[start..digits]);
        rest = &rest[digits..];
    }
    key + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_names_are_numbers() {
        let mut names = ["seed-10", "seed-9", "a", "point-2/seed-1", "point-10/seed-0"];
        names.sort_by_cached_key(|name| natural(name));
        assert_eq!(names, ["a", "point-2/seed-1", "point-10/seed-0", "seed-9", "seed-10"]);
    }

    #[test]
    fn values_are_found_under_the_names_that_a_set_takes() {
        let text = "seed = 3\nx = 1.0\n[mission]\nsteps = [{ land = true }, { name = 'a', path = [[0, 1], [2, 3]] }]";
        let mut values = BTreeMap::new();
        flatten("", &Toml::Table(text.parse().unwrap()), &mut values);
        let found: Vec<_> = values.iter().map(|(key, value)| format!("{key}={value}")).collect();
        let expected = [
            "mission.steps[0].land=true",
            "mission.steps[1].name=\"a\"",
            "mission.steps[1].path=[[0, 1], [2, 3]]",
            "seed=3",
            "x=1",
        ];
        assert_eq!(found, expected);
    }
}
