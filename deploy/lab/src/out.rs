//! Chooses the folder that a run writes into.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};

use crate::error::Error;
use skein_host::clock;

/// The environment variable that names the folder of runs without an `--out`.
const RUNS_VARIABLE: &str = "SKEIN_RUNS";

/// The absolute path of `out`, or of a new folder named after `name` and the UTC time in the folder that `SKEIN_RUNS`
/// names, without it in `skein-runs`. Creates nothing.
///
/// # Errors
/// The folder contains files, or the path is not a folder: a command never overwrites the output of a run.
pub fn folder(out: Option<&Path>, name: &str) -> Result<PathBuf, Error> {
    let out = match out {
        Some(out) => out.to_owned(),
        None => fresh(&runs().join(format!("{name}-{}", clock::utc_name()))),
    };
    let out = std::path::absolute(&out).map_err(|error| Error::Refused(format!("{}: {error}", out.display())))?;
    let refused = |why: &str| Err(Error::Refused(format!("--out {}: {why}", out.display())));
    match fs::read_dir(&out).map(|mut entries| entries.next().is_some()) {
        Ok(true) => refused("the folder already contains files; choose another folder"),
        Ok(false) => Ok(out),
        Err(_) if out.exists() => refused("not a folder that can be written to"),
        Err(_) => Ok(out),
    }
}

/// Creates a folder for what is written.
///
/// # Errors
/// If it cannot be created: the reason, and how to choose another.
pub fn create(out: &Path) -> Result<(), Error> {
    fs::create_dir_all(out).map_err(|error| {
        Error::Failed(format!(
            "{}: the folder cannot be created: {error}; choose another with --out, or with the environment variable {RUNS_VARIABLE}",
            out.display()
        ))
    })
}

/// The folder of the runs without an `--out`: the one that `SKEIN_RUNS` names, without it `skein-runs`.
pub fn runs() -> PathBuf {
    let runs = env::var_os(RUNS_VARIABLE).filter(|runs| !runs.is_empty());
    runs.map_or_else(|| PathBuf::from("skein-runs"), PathBuf::from)
}

/// The path itself if it is free, otherwise the path with the first number behind it that makes it new.
fn fresh(path: &Path) -> PathBuf {
    let numbered = |number: u32| {
        let mut name = path.as_os_str().to_owned();
        name.push(format!("-{number}"));
        PathBuf::from(name)
    };
    if path.exists() { (2..).map(numbered).find(|path| !path.exists()).unwrap_or_default() } else { path.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_with_files_is_refused() {
        let temporary = tempfile::tempdir().unwrap();
        assert_eq!(folder(Some(temporary.path()), "x").unwrap(), temporary.path(), "an empty folder is accepted");
        let file = temporary.path().join("x");
        fs::write(&file, "").unwrap();
        assert_eq!(folder(Some(temporary.path()), "x").unwrap_err().exit_code(), 2);
        assert_eq!(folder(Some(&file), "x").unwrap_err().exit_code(), 2);
    }

    #[test]
    fn two_runs_in_a_second_have_two_folders() {
        let temporary = tempfile::tempdir().unwrap();
        let path = temporary.path().join("hover-1");
        assert_eq!(fresh(&path), path);
        fs::create_dir(&path).unwrap();
        assert_eq!(fresh(&path), temporary.path().join("hover-1-2"));
    }
}
