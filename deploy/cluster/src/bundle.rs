//! All files of one node except the program, as they travel to its host. [`crate::pack`] makes them.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Name of the scenario file.
pub const SCENARIO: &str = "scenario.toml";

/// A node's files, by their relative path below its folder: plain names with `/` between them.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bundle {
    /// The files by their paths.
    pub files: BTreeMap<String, BundleFile>,
}

/// A file of a node.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct BundleFile {
    /// Only its owner may read it (mode 600).
    pub is_secret: bool,
    /// It is executable: the program of an external law.
    pub is_executable: bool,
    /// Contents of the file.
    pub content: Vec<u8>,
}

impl std::fmt::Debug for BundleFile {
    /// Never shows the contents.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} bytes{}", self.content.len(), if self.is_secret { ", secret" } else { "" })
    }
}

/// Path of the certificate of the swarm's authority among a node's files.
pub const AUTHORITY_FILE: &str = "keys/authority.pem";

/// Identifies an authority by its certificate: the first 16 hexadecimal digits of a SHA-256 over its text.
pub fn authority_of(certificate: &[u8]) -> String {
    hex(&ring::digest::digest(&ring::digest::SHA256, certificate.trim_ascii()).as_ref()[..8])
}

/// Formats bytes as hexadecimal digits.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

impl Bundle {
    /// Identifies the authority that has issued the node's certificate; `None` where links are plain.
    pub fn authority(&self) -> Option<String> {
        self.files.get(AUTHORITY_FILE).map(|file| authority_of(&file.content))
    }

    /// Identifies these contents: the first 16 hexadecimal digits of a SHA-256 over paths, modes and bytes.
    pub fn id(&self) -> String {
        let mut digest = ring::digest::Context::new(&ring::digest::SHA256);
        for (path, file) in &self.files {
            let mode = [u8::from(file.is_secret), u8::from(file.is_executable)];
            for part in [path.as_bytes(), &mode, &file.content] {
                digest.update(&(part.len() as u64).to_le_bytes());
                digest.update(part);
            }
        }
        hex(&digest.finish().as_ref()[..8])
    }
}
