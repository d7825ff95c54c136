//! `[security]` of a node's own file: its keys, and who everybody is.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use skein_common::id::VehicleId;

use crate::link::Security;
use crate::link::seal::SealKey;
use crate::link::security::{Known, Tls, known_by_vehicle};

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
    /// The key that orders are sealed with.
    pub orders: SealKey,
    /// The common name of observers' certificates.
    pub observer: String,
    /// The common name of the operator's.
    pub operator: String,
    /// By what each vehicle is known.
    #[serde(deserialize_with = "known_by_vehicle")]
    pub vehicles: BTreeMap<VehicleId, Known>,
}

impl SecurityTable {
    /// The same with paths relative to nothing, and the key that orders are sealed with.
    pub fn of(self, folder: &Path) -> (Security, SealKey) {
        let Self { authority, certificate, key, orders, observer, operator, vehicles } = self;
        let [authority, certificate, key] = [authority, certificate, key].map(|file| folder.join(file));
        (Security::Tls(Tls { authority, certificate, key, vehicles, observer, operator }), orders)
    }
}
