//! The identity of a study: the same study of the same program resumes in its folder, every other one is refused there.

use std::fs::{self, File};
use std::hash::{DefaultHasher, Hasher};
use std::io::Read;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::super::sweep::Sweep;
use super::{Plan, UNRECORDED};
use crate::error::Error;
use crate::out;

impl Plan {
    /// The content of `study.json`. `fingerprint` is a hash of every value of every point, and of the files that they
    /// name.
    pub(super) fn describe(&self, name: &str, sweeps: &[Sweep], fingerprint: u64) -> Result<Value, Error> {
        let mut program = DefaultHasher::new();
        hash_file(&self.host.program, &mut program)?;
        Ok(json!({
            "scenario": name,
            "target": if self.is_live { "fly" } else { "study" },
            "version": crate::VERSION,
            "revision": crate::REVISION,
            "seeds": format!("{}..{}", self.seeds.start, self.seeds.end),
            "sweep": sweeps.iter().map(Sweep::to_string).collect::<Vec<_>>(),
            "points": self.points.len(),
            // A hash of the program's own file: the revision does not distinguish builds with uncommitted changes.
            "program": format!("{:016x}", program.finish()),
            "fingerprint": format!("{fingerprint:016x}"),
        }))
    }

    /// A new folder, or that of this very study if it has not come to its end.
    pub(super) fn folder_for(&self, study: &Value, out: Option<&Path>, name: &str) -> Result<PathBuf, Error> {
        // Whether a law in this process is still the same cannot be checked.
        let begun = out
            .filter(|_| !self.host.laws.is_local())
            .and_then(|out| Some((out, fs::read_to_string(out.join("study.json")).ok()?)));
        let kind = if self.is_live { "flights" } else { "study" };
        let Some((out, begun)) = begun else { return out::folder(out, &format!("{name}-{kind}")) };
        let refused =
            |why: String| Err(Error::Refused(format!("--out {}: {why}; choose another folder", out.display())));
        let begun: Value = serde_json::from_str(&begun).unwrap_or_default();
        let differs = |(key, here): &(&String, &Value)| begun.get(key.as_str()) != Some(*here);
        let differing: Vec<_> = study.as_object().into_iter().flatten().filter(differs).collect();
        match differing.iter().find(|(key, _)| *key != "fingerprint") {
            Some((key, here)) => {
                let there = begun.get(key.as_str()).unwrap_or(&Value::Null);
                return refused(format!("another study is there: its {key} is {there}, not {here}"));
            }
            None if differing.is_empty() => {}
            None => {
                return refused("another study is there: its scenario or a file that it names has changed".to_owned());
            }
        }
        // Flights in real time that failed are flown again.
        let is_whole = || !self.is_live || (0..self.runs()).all(|nth| self.run(nth).measured_in(out).is_some());
        let is_recorded = || !out.join(UNRECORDED).exists();
        if out.join("summary.json").exists() && is_whole() && is_recorded() {
            return refused("this study is there already, and finished".to_owned());
        }
        std::path::absolute(out).map_err(|error| Error::Refused(format!("{}: {error}", out.display())))
    }
}

/// Adds a file's content to the hash.
pub(super) fn hash_file(path: &Path, hasher: &mut impl Hasher) -> Result<(), Error> {
    let failed = |error| Error::Refused(format!("{}: {error}", path.display()));
    let mut file = File::open(path).map_err(failed)?;
    // A program's file is large: reading all of it at once would be the most memory that a study uses.
    let mut piece = vec![0; 1 << 16];
    let mut length = 0;
    loop {
        let read = file.read(&mut piece).map_err(failed)?;
        if read == 0 {
            break;
        }
        hasher.write(&piece[..read]);
        length += read;
    }
    hasher.write_usize(length);
    Ok(())
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::cli::{Cli, Command};

    #[test]
    #[cfg(unix)]
    fn only_the_very_same_study_goes_on() {
        // It answers every hello, and ends with its input.
        let script = |which: &str| {
            format!("# {which}\nwhile read -r line; do echo '{{\"say\":\"ready\",\"protocol\":1}}'; done\n")
        };
        let folder = tempfile::tempdir().unwrap();
        let (law, scenario) = (folder.path().join("law.sh"), folder.path().join("two.toml"));
        let text = "swarm.vehicles = 2\n[formation]\nlaw = 'external'\nexternal.command = ['sh', 'law.sh']\n";
        fs::write(&scenario, text).unwrap();
        fs::write(&law, script("first")).unwrap();
        let out = folder.path().join("out");
        let line = ["skein", "study", scenario.to_str().unwrap(), "--out", out.to_str().unwrap()];
        let Command::Study(args) = Cli::try_parse_from(line).unwrap().command else { panic!("a study") };
        let plan = || Plan::new(&args).map(|plan| plan.out).map_err(|error| error.to_string());
        assert_eq!(plan(), Ok(out.clone()));
        assert_eq!(plan(), Ok(out.clone()), "the study resumes");
        fs::write(&law, script("second")).unwrap();
        let why = plan().unwrap_err();
        assert!(why.contains("its scenario or a file that it names has changed"), "{why}");
        fs::write(&law, script("first")).unwrap();
        let there = fs::read_to_string(out.join("study.json")).unwrap();
        let mut study: Value = serde_json::from_str(&there).unwrap();
        study["program"] = "0123456789abcdef".into();
        fs::write(out.join("study.json"), study.to_string()).unwrap();
        let why = plan().unwrap_err();
        assert!(why.contains("another study is there: its program is \"0123456789abcdef\", not "), "{why}");
    }
}
