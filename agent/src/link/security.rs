//! Decides which nodes may join a swarm: every link uses mutual TLS (`link/tunnel.rs`), with certificates of the
//! swarm's authority and known names. A link admits a node; signatures ([`super::signature`]) prove which vehicle sent
//! a message.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};
use skein_common::id::{SwarmName, VehicleName};
use x509_parser::certificate::X509Certificate;
use x509_parser::prelude::FromDer;
use zenoh::config::EndPoint;

use super::LinkError;
use super::signature::messages::KeyRing;
use super::signature::{SigningKey, VerificationKey};

/// The security of a session's links.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Security {
    /// Plain TCP: any program that reaches it can join. For the loopback, or if requested explicitly.
    Plain,
    /// Mutual TLS and signed messages.
    Tls(Tls),
}

/// Files and names for secured links: the table `[security]` of a node's own file, in which paths are relative to that file.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tls {
    /// File of the certificates of the swarm's authority, PEM.
    pub authority: PathBuf,
    /// File of the own certificate, PEM.
    pub certificate: PathBuf,
    /// File of its private key, PEM. A vehicle also signs its messages with this key.
    pub key: PathBuf,
    /// Public key that verifies orders.
    pub orders: VerificationKey,
    /// Vehicles of the swarm, or of the whole fleet: certificate name and public key of each.
    #[serde(deserialize_with = "by_vehicle")]
    pub vehicles: BTreeMap<VehicleName, PeerIdentity>,
    /// Common names in the certificates of observers: the operator's, and one of each node.
    pub observers: Vec<String>,
    /// Common name in the operator's certificate.
    pub operator: String,
}

/// The owner's name and key in a certificate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Certified {
    /// Common name.
    pub name: String,
    /// Public key, as its kind encodes it.
    pub key: Vec<u8>,
}

/// Reads a certificate (DER). Whether an authority signed it is not checked here.
///
/// # Errors
/// Why it cannot be read, or that it has no common name.
pub fn certified(certificate: &[u8]) -> Result<Certified, String> {
    let (_, certificate) = X509Certificate::from_der(certificate).map_err(|error| error.to_string())?;
    let name = certificate.subject().iter_common_name().next().and_then(|name| name.as_str().ok());
    let name = name.ok_or("a certificate without a common name")?.to_owned();
    Ok(Certified { name, key: certificate.public_key().subject_public_key.data.to_vec() })
}

/// Certificate name and public key of a vehicle.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PeerIdentity {
    /// Common name of its certificate; a replacement certificate has another name.
    pub name: String,
    /// Public key of its certificate and of its messages' signatures.
    pub key: VerificationKey,
}

/// Deserializes a table whose keys are the vehicles' names.
///
/// # Errors
/// If a key of the table does not name a vehicle.
pub fn by_vehicle<'de, T: Deserialize<'de>, D: Deserializer<'de>>(of: D) -> Result<BTreeMap<VehicleName, T>, D::Error> {
    let vehicles = BTreeMap::<String, T>::deserialize(of)?.into_iter();
    vehicles.map(|(name, known)| name.parse().map(|name| (name, known)).map_err(D::Error::custom)).collect()
}

impl Tls {
    /// The same with paths that start from this folder.
    pub fn in_folder(self, folder: &Path) -> Self {
        let [authority, certificate, key] =
            [&self.authority, &self.certificate, &self.key].map(|file| folder.join(file));
        Self { authority, certificate, key, ..self }
    }

    /// The common names in the certificates of observers and of the operator.
    pub(super) fn guests(&self) -> impl Iterator<Item = &String> {
        self.observers.iter().chain([&self.operator])
    }
}

impl Security {
    /// Checks the endpoints and the certificate names.
    pub(super) fn check(&self, listen: &[String], dial: &[String]) -> Result<(), LinkError> {
        let expected = if matches!(self, Self::Plain) { "tcp" } else { "tls" };
        for text in listen.iter().chain(dial) {
            let endpoint = EndPoint::from_str(text).map_err(|_| LinkError::Endpoint(text.clone()))?;
            if endpoint.protocol().as_str() != expected {
                return Err(LinkError::Protocol { endpoint: text.clone(), expected });
            }
        }
        let Self::Tls(tls) = self else { return Ok(()) };
        let names = || tls.vehicles.values().map(|known| &known.name).chain(tls.guests());
        match names().find(|name| name.trim().is_empty() || names().filter(|other| other == name).count() > 1) {
            Some(name) => Err(LinkError::Name(name.clone())),
            None => Ok(()),
        }
    }

    /// Key ring that verifies the senders of messages.
    pub fn key_ring(&self, swarm: &SwarmName) -> KeyRing {
        match self {
            Self::Plain => KeyRing::plain(swarm.clone()),
            Self::Tls(tls) => {
                let keys = tls.vehicles.iter().map(|(id, known)| (*id, known.key)).collect();
                KeyRing::signed(swarm.clone(), keys)
            }
        }
    }

    /// Signing key of this vehicle, where messages are signed.
    ///
    /// # Errors
    /// If the file has no Ed25519 key, or not the key that the swarm has for this vehicle.
    pub fn signing_key(&self, own: VehicleName) -> Result<Option<SigningKey>, LinkError> {
        let Self::Tls(tls) = self else { return Ok(None) };
        let fault = |source| LinkError::File(tls.key.clone(), source);
        let text = fs::read_to_string(&tls.key).map_err(fault)?;
        let signing_key =
            SigningKey::from_pem(&text).map_err(|error| fault(io::Error::new(io::ErrorKind::InvalidData, error)))?;
        match tls.vehicles.get(&own) {
            Some(known) if known.key == signing_key.key() => Ok(Some(signing_key)),
            _ => Err(LinkError::Key(own)),
        }
    }
}
