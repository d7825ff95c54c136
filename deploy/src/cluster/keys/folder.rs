//! The folder of keys: which file is what, and that nobody else reads it.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use rcgen::{KeyPair, PKCS_ED25519, PublicKeyData};
use serde::{Deserialize, Serialize};
use skein_agent::link::security::{Names, Role};
use skein_common::id::VehicleId;

use super::certificate::Pair;
use crate::error::Error;
use crate::os;

/// Files of the authority, of the seal of orders, and of names.
pub(crate) const AUTHORITY: &str = "authority.pem";
pub(crate) const AUTHORITY_KEY: &str = "authority.key";
pub(crate) const ORDERS_KEY: &str = "orders.key";
pub(crate) const ORDERS_PUBLIC: &str = "orders.pub";
pub(crate) const NAMES: &str = "names.toml";

/// What its files are called: the same whatever name stands in the certificate.
pub(crate) fn stem(role: Role) -> String {
    match role {
        Role::Vehicle(id) => format!("vehicle-{id}"),
        Role::Observer => "observer".to_owned(),
        Role::Operator => "operator".to_owned(),
    }
}

/// File of the certificate.
pub(crate) fn certificate_file(role: Role) -> String {
    stem(role) + ".pem"
}

/// File of its private key.
pub(crate) fn key_file(role: Role) -> String {
    stem(role) + ".key"
}

/// `names.toml`: the common names that count. A certificate that was revoked has another.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct NamesFile {
    observer: String,
    operator: String,
    vehicles: BTreeMap<String, String>,
}

/// The folder of one cluster's keys.
#[derive(Clone, Debug)]
pub(crate) struct Folder(pub(crate) PathBuf);

impl Folder {
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    /// Makes sure that nobody but its owner gets at its secrets.
    ///
    /// # Errors
    /// With the remedy, if somebody does.
    pub(crate) fn check_private(&self) -> Result<(), Error> {
        check_private(&self.0, "700")?;
        let files = fs::read_dir(&self.0).into_iter().flatten().flatten().map(|entry| entry.path());
        let secrets = files.filter(|path| path.extension().is_some_and(|extension| extension == "key"));
        secrets.into_iter().try_for_each(|path| check_private(&path, "600"))
    }

    /// The same for one file.
    ///
    /// # Errors
    /// As [`Self::check_private`].
    pub(crate) fn check_private_file(&self, name: &str) -> Result<(), Error> {
        check_private(&self.path(name), "600")
    }

    /// A file's text, if it is there.
    ///
    /// # Errors
    /// If it cannot be read.
    pub(crate) fn read(&self, name: &str) -> Result<Option<String>, Error> {
        match fs::read_to_string(self.path(name)) {
            Ok(text) => Ok(Some(text)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(Error::Refused(format!("{}: {error}", self.path(name).display()))),
        }
    }

    /// As [`Self::read`], of a file that has to be there.
    ///
    /// # Errors
    /// With the remedy, if it is not.
    pub(crate) fn need(&self, name: &str) -> Result<String, Error> {
        self.read(name)?.ok_or_else(|| {
            Error::Refused(format!("{} is not there: `skein cluster keys` makes it", self.path(name).display()))
        })
    }

    /// Writes a file whole or not at all.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(crate) fn write(&self, name: &str, text: &str) -> Result<(), Error> {
        let is_secret = Path::new(name).extension().is_some_and(|extension| extension == "key");
        let path = self.path(name);
        os::write_whole(&path, text.as_bytes(), is_secret)
            .map_err(|error| Error::Failed(format!("{}: {error}", path.display())))
    }

    /// A certificate with its key, if both are there.
    ///
    /// # Errors
    /// If one of them cannot be read.
    pub(crate) fn pair(&self, certificate: &str, key: &str) -> Result<Option<Pair>, Error> {
        let both = self.read(certificate)?.zip(self.read(key)?);
        Ok(both.map(|(certificate, key)| Pair { certificate, key }))
    }

    /// As [`Self::pair`], of what has to be there.
    ///
    /// # Errors
    /// With the remedy, if it is not.
    pub(crate) fn need_pair(&self, certificate: &str, key: &str) -> Result<Pair, Error> {
        Ok(Pair { certificate: self.need(certificate)?, key: self.need(key)? })
    }

    /// The names that count, with first ones for these vehicles if they have none. Names of vehicles that are in the cluster
    /// no more are kept: a revoked one must not come back.
    ///
    /// # Errors
    /// If the file is none of ours.
    pub(crate) fn names(&self, vehicles: impl Iterator<Item = VehicleId>) -> Result<Names, Error> {
        let mut names = Names::first(vehicles);
        let Some(text) = self.read(NAMES)? else { return Ok(names) };
        let bad = |why: String| Error::Refused(format!("{}: {why}", self.path(NAMES).display()));
        let file: NamesFile = toml::from_str(&text).map_err(|error| bad(error.message().to_owned()))?;
        (names.observer, names.operator) = (file.observer, file.operator);
        for (id, name) in file.vehicles {
            let id = id.parse::<VehicleId>().map_err(|error| bad(error.to_string()))?;
            names.vehicles.insert(id, name);
        }
        Ok(names)
    }

    /// As text.
    pub(crate) fn names_text(names: &Names) -> String {
        let vehicles = names.vehicles.iter().map(|(id, name)| (id.to_string(), name.clone())).collect::<Vec<_>>();
        let mut text =
            "# The common names of the certificates that count. A certificate that was revoked has another.\n"
                .to_owned();
        text += &format!("observer = \"{}\"\noperator = \"{}\"\n\n[vehicles]\n", names.observer, names.operator);
        text += &vehicles.iter().map(|(id, name)| format!("{id} = \"{name}\"\n")).collect::<String>();
        text
    }
}

fn check_private(path: &Path, mode: &str) -> Result<(), Error> {
    let shown = path.display();
    match os::is_private(path) {
        Ok(true) => Ok(()),
        Ok(false) => Err(Error::Refused(format!(
            "{shown} can be read by others: `chmod {mode} {shown}`, and if somebody may have, `skein cluster keys --revoke` \
             whose it is"
        ))),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(error) => Err(Error::Refused(format!("{shown}: {error}"))),
    }
}

/// A new key that seals orders: PKCS#8, PEM.
pub(crate) fn new_orders_key() -> Result<String, rcgen::Error> {
    Ok(KeyPair::generate_for(&PKCS_ED25519)?.serialize_pem())
}

/// The public half of the key that seals orders, 64 hexadecimal digits; `None` for a text that is no such key.
pub(crate) fn public_of(orders_key: &str) -> Option<String> {
    let key = KeyPair::from_pem(orders_key).ok().filter(|key| key.algorithm() == &PKCS_ED25519)?;
    Some(key.der_bytes().iter().map(|byte| format!("{byte:02x}")).collect())
}
