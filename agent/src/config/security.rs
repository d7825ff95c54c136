//! `[security]` of a node's own file: its keys, and who everybody is.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::de::Error;
use serde::{Deserialize, Deserializer};
use skein_common::id::VehicleId;

use crate::link::Security;
use crate::link::security::{Names, Role, Tls};

/// The table. Without it links are plain and orders are believed unsealed.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SecurityTable {
    /// Certificates of the swarm's authority, PEM; this path and the next two are relative to the node's file.
    pub authority: PathBuf,
    /// The node's certificate, PEM.
    pub certificate: PathBuf,
    /// Its private key, PEM.
    pub key: PathBuf,
    /// The Ed25519 public key that orders are sealed with, 64 hexadecimal digits.
    #[serde(deserialize_with = "hexadecimal")]
    pub orders: [u8; 32],
    /// The common name of observers.
    pub observer: String,
    /// The common name of the operator.
    pub operator: String,
    /// The common name of each vehicle.
    #[serde(deserialize_with = "by_vehicle")]
    pub vehicles: BTreeMap<VehicleId, String>,
}

impl SecurityTable {
    /// The same for links of vehicle `id`, with paths relative to nothing.
    pub fn of(self, id: VehicleId, folder: &Path) -> (Security, [u8; 32]) {
        let Self { authority, certificate, key, orders, observer, operator, vehicles } = self;
        let tls = Tls {
            authority: folder.join(authority),
            certificate: folder.join(certificate),
            key: folder.join(key),
            role: Role::Vehicle(id),
            names: Names { vehicles, observer, operator },
        };
        (Security::Tls(Box::new(tls)), orders)
    }
}

/// 32 bytes.
fn hexadecimal<'de, D: Deserializer<'de>>(of: D) -> Result<[u8; 32], D::Error> {
    let text = String::deserialize(of)?;
    let mut key = [0; 32];
    let is_one = text.len() == 2 * key.len() && text.bytes().all(|digit| digit.is_ascii_hexdigit());
    if is_one {
        for (byte, digits) in key.iter_mut().zip(0..) {
            *byte = u8::from_str_radix(&text[2 * digits..2 * digits + 2], 16).map_err(D::Error::custom)?;
        }
        return Ok(key);
    }
    Err(D::Error::custom("a key for orders has 64 hexadecimal digits"))
}

/// A table whose keys are ids.
fn by_vehicle<'de, D: Deserializer<'de>>(of: D) -> Result<BTreeMap<VehicleId, String>, D::Error> {
    let names = BTreeMap::<String, String>::deserialize(of)?.into_iter();
    names.map(|(id, name)| id.parse().map(|id| (id, name)).map_err(D::Error::custom)).collect()
}
