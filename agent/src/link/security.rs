//! Who may join a swarm: mutual TLS on every link (`link/tunnel.rs`), with certificates of the swarm's authority and names
//! that count. Who may say what in it is told by seals ([`super::seal`]): a link lets in, and lets nobody speak for another.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::PathBuf;
use std::str::FromStr;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};
use skein_common::id::{SwarmName, VehicleId};
use zenoh::config::EndPoint;

use super::LinkError;
use super::seal::words::Voices;
use super::seal::{SealKey, Sealer};

/// How the links of a session are secured.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Security {
    /// Plain TCP: whoever reaches it takes part. For the loopback, and for who asks for it by name.
    Plain,
    /// Mutual TLS, and seals.
    Tls(Tls),
}

/// One end of secured links.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tls {
    /// File of the certificates of the swarm's authority, PEM.
    pub authority: PathBuf,
    /// File of the own certificate, PEM.
    pub certificate: PathBuf,
    /// File of its private key, PEM; a vehicle's seals its words too.
    pub key: PathBuf,
    /// Who flies in the swarm.
    pub vehicles: BTreeMap<VehicleId, Known>,
    /// The common name of observers' certificates.
    pub observer: String,
    /// The common name of the operator's.
    pub operator: String,
}

/// By what a vehicle is known.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Known {
    /// The common name of its certificate; one that was replaced has another.
    pub name: String,
    /// The key that its words are sealed with and its certificate is for.
    pub key: SealKey,
}

/// A table of what vehicles are known by, whose keys are ids.
///
/// # Errors
/// If one of them is no id.
pub fn known_by_vehicle<'de, D: Deserializer<'de>>(of: D) -> Result<BTreeMap<VehicleId, Known>, D::Error> {
    let vehicles = BTreeMap::<String, Known>::deserialize(of)?.into_iter();
    vehicles.map(|(id, known)| id.parse().map(|id| (id, known)).map_err(D::Error::custom)).collect()
}

impl Security {
    /// Whether endpoints and names are in order.
    pub(super) fn check(&self, listen: &[String], dial: &[String]) -> Result<(), LinkError> {
        let wanted = self.protocol();
        for text in listen.iter().chain(dial) {
            let endpoint = EndPoint::from_str(text).map_err(|_| LinkError::Endpoint(text.clone()))?;
            if endpoint.protocol().as_str() != wanted {
                return Err(LinkError::Protocol { endpoint: text.clone(), wanted });
            }
        }
        let Self::Tls(tls) = self else { return Ok(()) };
        let guests = [&tls.observer, &tls.operator];
        let names = || tls.vehicles.values().map(|known| &known.name).chain(guests);
        match names().find(|name| name.trim().is_empty() || names().filter(|other| other == name).count() > 1) {
            Some(name) => Err(LinkError::Name(name.clone())),
            None => Ok(()),
        }
    }

    /// By what one tells whose a word is.
    pub fn voices(&self, swarm: &SwarmName) -> Voices {
        match self {
            Self::Plain => Voices::plain(swarm.clone()),
            Self::Tls(tls) => {
                let keys = tls.vehicles.iter().map(|(id, known)| (*id, known.key)).collect();
                Voices::sealed(swarm.clone(), keys)
            }
        }
    }

    /// What seals this vehicle's words, where words are sealed.
    ///
    /// # Errors
    /// If the file has no such key, or one by which the others do not know this vehicle.
    pub fn sealer(&self, own: VehicleId) -> Result<Option<Sealer>, LinkError> {
        let Self::Tls(tls) = self else { return Ok(None) };
        let fault = |source| LinkError::File { path: tls.key.clone(), source };
        let text = fs::read_to_string(&tls.key).map_err(fault)?;
        let sealer =
            Sealer::from_pem(&text).map_err(|error| fault(io::Error::new(io::ErrorKind::InvalidData, error)))?;
        match tls.vehicles.get(&own) {
            Some(known) if known.key == sealer.key() => Ok(Some(sealer)),
            _ => Err(LinkError::Key(own)),
        }
    }

    /// What endpoints begin with.
    fn protocol(&self) -> &'static str {
        match self {
            Self::Plain => "tcp",
            Self::Tls(_) => "tls",
        }
    }
}
