//! Reads the files that a scenario names: its aircraft and its rule bases.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use skein_common::scenario;
use skein_core::aircraft::{Aircraft, AircraftError, Profile};
use skein_core::control::{FisError, Rules};

/// Why a file that a scenario names cannot be used. Each error is one sentence that the user can act on.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// The aircraft file is not valid.
    #[error(transparent)]
    Aircraft(#[from] AircraftError),
    /// A rule base is not valid.
    #[error(transparent)]
    Rules(#[from] FisError),
}

/// Reads a text file.
///
/// # Errors
/// If the file cannot be read; the error names its path.
pub fn read(path: &Path) -> Result<String, FileError> {
    fs::read_to_string(path).map_err(|source| FileError::Read { path: path.to_owned(), source })
}

/// Loads an aircraft and its file's text: one that comes with the program, or else `NAME.toml` in the scenario's
/// folder.
///
/// # Errors
/// If the file cannot be read or is not a valid aircraft.
pub fn aircraft(name: &str, folder: &Path) -> Result<(Aircraft, String), FileError> {
    let (file, text) = aircraft_text(name, folder)?;
    Ok((Aircraft::from_text(&file, &text)?, text))
}

/// Loads the datarefs of an aircraft, whether or not it has been fitted, and its file's text, as [`aircraft`] does.
///
/// # Errors
/// If the file cannot be read or is not a valid aircraft file.
pub fn profile(name: &str, folder: &Path) -> Result<(Profile, String), FileError> {
    let (file, text) = aircraft_text(name, folder)?;
    Ok((Profile::from_text(&file, &text)?, text))
}

/// Name for messages, and text, of the file of an aircraft.
fn aircraft_text(name: &str, folder: &Path) -> Result<(String, String), FileError> {
    let path = folder.join(format!("{name}.toml"));
    Ok(match Aircraft::shipped_text(name) {
        Some(text) => (name.to_owned(), text.to_owned()),
        None => (path.display().to_string(), read(&path)?),
    })
}

/// Loads the rules of a scenario in this folder: those that come with the program, or the four files of a folder, with
/// the texts of these files.
///
/// # Errors
/// If a file cannot be read or is not a rule base.
pub fn rules(rules: &scenario::Rules, folder: &Path) -> Result<(Rules, Option<[String; 4]>), FileError> {
    let scenario::Rules::Folder(rules) = rules else { return Ok((Rules::shipped(), None)) };
    let paths = ["roll", "pitch", "heading", "collective"].map(|axis| folder.join(rules).join(format!("{axis}.fis")));
    let names = paths.each_ref().map(|path| path.display().to_string());
    let [roll, pitch, heading, collective] = paths.each_ref().map(|path| read(path));
    let texts = [roll?, pitch?, heading?, collective?];
    let rules = Rules::from_texts(std::array::from_fn(|axis| (names[axis].as_str(), texts[axis].as_str())))?;
    Ok((rules, Some(texts)))
}
