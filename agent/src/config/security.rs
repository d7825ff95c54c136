//! `[security]` of a node's own file: its own keys, and the names and keys of the swarm's members.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use skein_common::id::VehicleName;

use crate::link::Security;
use crate::link::security::{PeerIdentity, Tls, by_vehicle};
use crate::link::signature::VerificationKey;

/// The `[security]` table. Without it links are plain and orders are accepted without a signature.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SecurityTable {
    /// Certificates of the swarm's authority, PEM. This path and the next two are relative to the node's file.
    pub authority: PathBuf,
    /// The node's certificate, PEM.
    pub certificate: PathBuf,
    /// The node's private key, PEM.
    pub key: PathBuf,
    /// Public key that verifies orders.
    pub orders: VerificationKey,
    /// Common names in the certificates of observers.
    pub observers: Vec<String>,
    /// Common name in the operator's certificate.
    pub operator: String,
    /// Certificate name and public key of each vehicle.
    #[serde(deserialize_with = "by_vehicle")]
    pub vehicles: BTreeMap<VehicleName, PeerIdentity>,
}

impl SecurityTable {
    /// Resolves the paths from `folder`, and splits off the key that verifies orders.
    pub fn of(self, folder: &Path) -> (Security, VerificationKey) {
        let Self { authority, certificate, key, orders, observers, operator, vehicles } = self;
        let [authority, certificate, key] = [authority, certificate, key].map(|file| folder.join(file));
        (Security::Tls(Tls { authority, certificate, key, vehicles, observers, operator }), orders)
    }
}
