//! The folder of keys: the names of its files, and the check that only its owner can read the secrets.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use crate::keys::Role;
use rcgen::{KeyPair, PKCS_ED25519};
use serde::{Deserialize, Serialize};
use skein_agent::link::security::{PeerIdentity, by_vehicle};
use skein_agent::link::signature::{NotAKey, SigningKey, VerificationKey};
use skein_common::id::VehicleName;
use skein_host::atomic_file::{self, Durability};

use super::certificate::{Pair, shows};
use crate::os;
use skein_lab::error::Error;

/// Files of the authority, of the key that signs orders, and of the valid names.
pub(crate) const AUTHORITY: &str = "authority.pem";
pub(crate) const AUTHORITY_KEY: &str = "authority.key";
pub(crate) const ORDERS_KEY: &str = "orders.key";
pub(crate) const ORDERS_PUBLIC: &str = "orders.pub";
pub(crate) const NAMES: &str = "names.toml";

/// File name of a role without extension. It does not depend on the name in the certificate.
pub(crate) fn stem(role: Role) -> String {
    match role {
        Role::Vehicle(id) => format!("vehicle-{}", id.dashed()),
        Role::Observer => "observer".to_owned(),
        Role::NodeObserver(id) => format!("observer-{}", id.dashed()),
        Role::Operator => "operator".to_owned(),
    }
}

/// The role of a node whose certificate has this file name, if it is one of a node's two.
fn role_at_node(file_name: &str) -> Option<Role> {
    let (kind, id) = file_name.strip_suffix(".pem")?.split_once('-')?;
    let id = VehicleName::from_dashed(id)?;
    match kind {
        "vehicle" => Some(Role::Vehicle(id)),
        "observer" => Some(Role::NodeObserver(id)),
        _ => None,
    }
}

/// Whether this is a common name of the role: `vehicle-3`, or `vehicle-3.2` after one revocation, ...
fn is_name_of(role: Role, name: &str) -> bool {
    name.strip_prefix(&stem(role)).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}

/// File name of a role's certificate.
pub(crate) fn certificate_file(role: Role) -> String {
    stem(role) + ".pem"
}

/// File name of a role's private key.
pub(crate) fn key_file(role: Role) -> String {
    stem(role) + ".key"
}

/// Contents of `names.toml`: the valid common names, and the public keys of the vehicles' signatures. A certificate
/// issued after a revocation has another name and another key.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Names {
    pub(crate) observer: String,
    pub(crate) operator: String,
    /// The names of the nodes' observers. Folders of earlier versions have none.
    #[serde(default, deserialize_with = "by_vehicle")]
    pub(crate) observers: BTreeMap<VehicleName, String>,
    #[serde(deserialize_with = "by_vehicle")]
    pub(crate) vehicles: BTreeMap<VehicleName, PeerIdentity>,
}

/// The folder of one cluster's keys.
#[derive(Clone, Debug)]
pub(crate) struct Folder(pub(crate) PathBuf);

impl Folder {
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    /// Checks that only its owner can read the secrets in the folder.
    ///
    /// # Errors
    /// If others can: a text with the remedy.
    pub(crate) fn check_private(&self) -> Result<(), Error> {
        check_private(&self.0, "700")?;
        let files = fs::read_dir(&self.0).into_iter().flatten().flatten().map(|entry| entry.path());
        let secrets = files.filter(|path| path.extension().is_some_and(|extension| extension == "key"));
        secrets.into_iter().try_for_each(|path| check_private(&path, "600"))
    }

    /// Checks that only its owner can read this file.
    ///
    /// # Errors
    /// The errors of [`Self::check_private`].
    pub(crate) fn check_private_file(&self, name: &str) -> Result<(), Error> {
        check_private(&self.path(name), "600")
    }

    /// Reads a file; `None` if it does not exist.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub(crate) fn read(&self, name: &str) -> Result<Option<String>, Error> {
        match fs::read_to_string(self.path(name)) {
            Ok(text) => Ok(Some(text)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(self.bad(name, error)),
        }
    }

    /// Reads a file that must exist.
    ///
    /// # Errors
    /// If it does not exist: a text with the remedy.
    pub(crate) fn need(&self, name: &str) -> Result<String, Error> {
        self.read(name)?.ok_or_else(|| {
            Error::Refused(format!("{} does not exist: `skein cluster keys` creates it", self.path(name).display()))
        })
    }

    /// Writes a file atomically.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub(crate) fn write(&self, name: &str, text: &str) -> Result<(), Error> {
        let is_secret = Path::new(name).extension().is_some_and(|extension| extension == "key");
        let path = self.path(name);
        atomic_file::write(&path, text.as_bytes(), Durability::of(is_secret))
            .map_err(|error| Error::Failed(format!("{}: {error}", path.display())))
    }

    /// Reads a certificate with its key; `None` if one of them does not exist.
    ///
    /// # Errors
    /// If one of them cannot be read.
    pub(crate) fn pair(&self, certificate: &str, key: &str) -> Result<Option<Pair>, Error> {
        let both = self.read(certificate)?.zip(self.read(key)?);
        Ok(both.map(|(certificate, key)| Pair { certificate, key }))
    }

    /// Reads the valid names; `None` if the file does not exist yet. Names of vehicles that have left the cluster are
    /// kept, so that a revoked name is not used again.
    ///
    /// # Errors
    /// If the file is not a valid `names.toml`.
    pub(crate) fn names(&self) -> Result<Option<Names>, Error> {
        let Some(text) = self.read(NAMES)? else { return Ok(None) };
        toml::from_str(&text).map(Some).map_err(|error: toml::de::Error| self.bad(NAMES, error.message()))
    }

    /// Collects the names from the certificates, for when `names.toml` is lost: a revoked name must not become valid
    /// again because of a lost file.
    ///
    /// # Errors
    /// If a certificate cannot be read.
    pub(crate) fn shown_names(&self) -> Result<Names, Error> {
        let shown = |role| {
            let of_role = |known: &PeerIdentity| is_name_of(role, &known.name);
            Ok::<_, Error>(self.read(&certificate_file(role))?.and_then(|text| shows(&text)).filter(of_role))
        };
        let name = |role| Ok::<_, Error>(shown(role)?.map(|known| known.name).unwrap_or_default());
        let mut names = Names { observer: name(Role::Observer)?, operator: name(Role::Operator)?, ..Names::default() };
        let files = fs::read_dir(&self.0).into_iter().flatten().flatten();
        for role in files.filter_map(|file| role_at_node(file.file_name().to_str()?)) {
            if let Some(PeerIdentity { name, key }) = shown(role)? {
                names.set(role, name, key);
            }
        }
        Ok(names)
    }

    /// Reads the public key that verifies the signatures of orders.
    ///
    /// # Errors
    /// If the file does not exist or has no key.
    pub(crate) fn orders_key(&self) -> Result<VerificationKey, Error> {
        self.need(ORDERS_PUBLIC)?.trim().parse().map_err(|error: NotAKey| self.bad(ORDERS_PUBLIC, error))
    }

    /// Reads the private key that signs orders; `public` is its public key.
    ///
    /// # Errors
    /// If others can read the file, or it does not exist or has another key.
    pub(crate) fn signing_key(&self, public: VerificationKey) -> Result<SigningKey, Error> {
        self.check_private_file(ORDERS_KEY)?;
        let key = SigningKey::from_pem(&self.need(ORDERS_KEY)?).map_err(|error| self.bad(ORDERS_KEY, error))?;
        let other = || self.bad(ORDERS_KEY, format_args!("not the private key of {ORDERS_PUBLIC}"));
        if key.key() == public { Ok(key) } else { Err(other()) }
    }

    /// The error about one of the files.
    pub(crate) fn bad(&self, name: &str, why: impl Display) -> Error {
        Error::Refused(format!("{}: {why}", self.path(name).display()))
    }

    /// Reads the valid names, which must exist.
    ///
    /// # Errors
    /// If they do not exist: a text with the remedy.
    pub(crate) fn need_names(&self) -> Result<Names, Error> {
        self.need(NAMES)?;
        Ok(self.names()?.unwrap_or_default())
    }
}

impl Names {
    /// Makes this the valid name of the role, and for a vehicle this key the one of its signatures.
    pub(crate) fn set(&mut self, role: Role, name: String, key: VerificationKey) {
        match role {
            Role::Vehicle(id) => _ = self.vehicles.insert(id, PeerIdentity { name, key }),
            Role::NodeObserver(id) => _ = self.observers.insert(id, name),
            Role::Observer => self.observer = name,
            Role::Operator => self.operator = name,
        }
    }

    /// Removes the names of vehicles and nodes' observers that are not to be accepted.
    pub(crate) fn retain(&mut self, is_accepted: impl Fn(VehicleName) -> bool) {
        self.vehicles.retain(|id, _| is_accepted(*id));
        self.observers.retain(|id, _| is_accepted(*id));
    }

    /// The names of all observers: the operator's, and one of each node.
    pub(crate) fn all_observers(&self) -> Vec<String> {
        std::iter::once(&self.observer).chain(self.observers.values()).cloned().collect()
    }

    /// Formats the names as the text of `names.toml`.
    pub(crate) fn to_toml(&self) -> String {
        let mut text =
            "# The valid common names, and the public keys that verify the vehicles' signatures. After a revocation, a\n\
                        # certificate has another name and another key.\n"
                .to_owned();
        text += &format!("observer = \"{}\"\noperator = \"{}\"\n\n[observers]\n", self.observer, self.operator);
        text.extend(self.observers.iter().map(|(id, name)| format!("{} = \"{name}\"\n", id.quoted())));
        text + "\n[vehicles]\n" + &vehicles_toml(&self.vehicles)
    }
}

/// Formats a line for each vehicle: `1 = { name = "vehicle-1", key = "..." }`, of a fleet `"3/7" = ...`.
pub(crate) fn vehicles_toml(vehicles: &BTreeMap<VehicleName, PeerIdentity>) -> String {
    vehicles
        .iter()
        .map(|(id, PeerIdentity { name, key })| format!("{} = {{ name = \"{name}\", key = \"{key}\" }}\n", id.quoted()))
        .collect()
}

fn check_private(path: &Path, mode: &str) -> Result<(), Error> {
    let shown = path.display();
    match os::is_private(path) {
        Ok(true) => Ok(()),
        Ok(false) => Err(Error::Refused(format!(
            "{shown} can be read by others: `chmod {mode} {shown}`; if it may have been read, `skein cluster keys --revoke` \
             its owner"
        ))),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(error) => Err(Error::Refused(format!("{shown}: {error}"))),
    }
}

/// Generates a new private key: Ed25519 in PKCS#8, PEM.
pub(crate) fn new_key() -> Result<String, rcgen::Error> {
    Ok(KeyPair::generate_for(&PKCS_ED25519)?.serialize_pem())
}
