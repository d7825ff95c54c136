//! Reads the files that a scenario names: its aircraft and its rule bases.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use skein_common::scenario;
use skein_core::aircraft::{Aircraft, AircraftError, Profile};
use skein_core::control::{FisError, Rules};

/// The reason why a file that a scenario names cannot be used. Each error is one sentence that the user can act on.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The file cannot be read.
    #[error("cannot read {}: {}", .0.display(), .1)]
    Read(PathBuf, #[source] io::Error),
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
    fs::read_to_string(path).map_err(|source| FileError::Read(path.to_owned(), source))
}

/// Reads a text file that another program may have written in UTF-8, UTF-16 or Latin-1, with or without a byte order mark.
fn read_in_any_encoding(path: &Path) -> Result<String, FileError> {
    let bytes = fs::read(path).map_err(|source| FileError::Read(path.to_owned(), source))?;
    Ok(decoded(bytes))
}

/// The text of these bytes. A text without a byte order mark is UTF-16 if every second byte of its beginning is zero, else
/// UTF-8 if it is valid, else Latin-1.
fn decoded(bytes: Vec<u8>) -> String {
    let zeros = |first: usize| {
        let every_second = bytes.iter().take(64).skip(first).step_by(2);
        bytes.len() > 1 && every_second.clone().all(|byte| *byte == 0)
    };
    let utf16 = |unit: fn([u8; 2]) -> u16| {
        let units = bytes.chunks_exact(2).map(|pair| unit([pair[0], pair[1]]));
        char::decode_utf16(units).map(|letter| letter.unwrap_or(char::REPLACEMENT_CHARACTER)).collect()
    };
    match bytes.as_slice() {
        [0xff, 0xfe, ..] => utf16(u16::from_le_bytes),
        [0xfe, 0xff, ..] => utf16(u16::from_be_bytes),
        _ if zeros(1) => utf16(u16::from_le_bytes),
        _ if zeros(0) => utf16(u16::from_be_bytes),
        _ => String::from_utf8(bytes).unwrap_or_else(|error| error.into_bytes().into_iter().map(char::from).collect()),
    }
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
    let [roll, pitch, heading, collective] = paths.each_ref().map(|path| read_in_any_encoding(path));
    let texts = [roll?, pitch?, heading?, collective?];
    let rules = Rules::from_texts(std::array::from_fn(|axis| (names[axis].as_str(), texts[axis].as_str())))?;
    Ok((rules, Some(texts)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_is_read_in_every_encoding_of_windows_and_old_programs() {
        let text = "[System]\r\nName='Höhe'\r\n";
        let le: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
        let be: Vec<u8> = text.encode_utf16().flat_map(u16::to_be_bytes).collect();
        let latin: Vec<u8> = text.chars().map(|letter| letter as u8).collect();
        let with_mark = |mark: &[u8], bytes: &[u8]| [mark, bytes].concat();
        for bytes in [
            text.as_bytes().to_vec(),
            with_mark("\u{feff}".as_bytes(), text.as_bytes()),
            latin,
            with_mark(&[0xff, 0xfe], &le),
            with_mark(&[0xfe, 0xff], &be),
            le,
            be,
        ] {
            assert_eq!(decoded(bytes.clone()).trim_start_matches('\u{feff}'), text, "{bytes:?}");
        }
        assert_eq!((decoded(Vec::new()).as_str(), decoded(vec![0xe9]).as_str()), ("", "é"));
    }
}
