//! Everything that one node is given, but the program: configuration, scenario, aircraft, rules, keys.
//!
//! The same cluster gives the same bytes, whoever makes them and wherever its files are: so that a second `install` changes
//! nothing.

mod files;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// The file of the scenario.
pub const SCENARIO: &str = "scenario.toml";

/// A node's files, by their path below its folder: relative, of plain names, with `/` between them.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bundle {
    /// Path to file.
    pub files: BTreeMap<String, BundleFile>,
}

/// One file.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct BundleFile {
    /// Nobody but its owner may read it (0600).
    pub is_secret: bool,
    /// It is a program: an external law's.
    pub is_executable: bool,
    /// Its bytes.
    pub content: Vec<u8>,
}

impl std::fmt::Debug for BundleFile {
    /// Never what is in it.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} bytes{}", self.content.len(), if self.is_secret { ", secret" } else { "" })
    }
}

impl Bundle {
    /// Names this content and no other: the first 16 hexadecimal digits of a SHA-256 over paths, modes and bytes.
    pub fn id(&self) -> String {
        let mut digest = ring::digest::Context::new(&ring::digest::SHA256);
        for (path, file) in &self.files {
            let mode = [u8::from(file.is_secret), u8::from(file.is_executable)];
            for part in [path.as_bytes(), &mode, &file.content] {
                digest.update(&(part.len() as u64).to_le_bytes());
                digest.update(part);
            }
        }
        digest.finish().as_ref().iter().take(8).map(|byte| format!("{byte:02x}")).collect()
    }
}

#[cfg(test)]
mod tests;
