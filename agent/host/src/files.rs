//! The files that a scenario names: its aircraft and its rule bases.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use skein_common::scenario;
use skein_core::aircraft::{Aircraft, AircraftError};
use skein_core::control::{FisError, Rules};

/// Why a file that a scenario names cannot be used. Each is one sentence, and the user's to mend.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// A file that cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// An aircraft file that is none.
    #[error(transparent)]
    Aircraft(#[from] AircraftError),
    /// A rule base that is none.
    #[error(transparent)]
    Rules(#[from] FisError),
}

/// The text of a file.
///
/// # Errors
/// If it cannot be read, with its path.
pub fn read(path: &Path) -> Result<String, FileError> {
    fs::read_to_string(path).map_err(|source| FileError::Read { path: path.to_owned(), source })
}

/// The aircraft of this name and its file's text: one that comes with the program, or else `NAME.toml` in the scenario's
/// folder.
///
/// # Errors
/// If there is no such file, or it is no aircraft's.
pub fn aircraft(name: &str, folder: &Path) -> Result<(Aircraft, String), FileError> {
    let path = folder.join(format!("{name}.toml"));
    let (file, text) = match Aircraft::SHIPPED.iter().find(|(shipped, _)| *shipped == name) {
        Some((_, text)) => (name.to_owned(), (*text).to_owned()),
        None => (path.display().to_string(), read(&path)?),
    };
    Ok((Aircraft::from_text(&file, &text)?, text))
}

/// The rules that a scenario in this folder names: those that come with the program, or the four files of a folder.
///
/// # Errors
/// If a file cannot be read or is no rule base.
pub fn rules(rules: &scenario::Rules, folder: &Path) -> Result<Rules, FileError> {
    let scenario::Rules::Folder(rules) = rules else { return Ok(Rules::shipped()) };
    let paths = ["roll", "pitch", "heading", "collective"].map(|axis| folder.join(rules).join(format!("{axis}.fis")));
    let names = paths.each_ref().map(|path| path.display().to_string());
    let [roll, pitch, heading, collective] = paths.each_ref().map(|path| read(path));
    let texts = [roll?, pitch?, heading?, collective?];
    Ok(Rules::from_texts(std::array::from_fn(|axis| (names[axis].as_str(), texts[axis].as_str())))?)
}
