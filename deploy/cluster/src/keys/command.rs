//! `skein cluster keys`: creates the swarm's authority and the certificates that it signs: two for each node (its vehicle and
//! its observer), one for the operator's observer, one for the operator. The key that signs orders belongs to the operator.
//!
//! A second run changes nothing. A revocation issues the certificate again under another name and with another key. Agents
//! accept only the names and keys in `names.toml`, so a revocation takes effect with the next `install`.

use std::path::Path;
use std::str::FromStr;

use serde::Serialize;
use serde_json::json;
use skein_agent::link::signature::{SigningKey, VerificationKey};
use time::OffsetDateTime;

use crate::FileArgs;
use crate::findings;
use crate::inventory::{Inventory, SecurityKind};
use crate::keys::certificate::{self, Authority, CertificateSpec, Unfit, expires, unfit};
use crate::keys::folder::{
    self, AUTHORITY, AUTHORITY_KEY, Folder, NAMES, ORDERS_KEY, ORDERS_PUBLIC, certificate_file, key_file,
};
use crate::keys::{Role, certificate_spec, day, name_of, roles};
use crate::os;
use skein_host::clock;
use skein_lab::error::Error;

/// `skein cluster keys`
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  skein cluster keys\n  skein cluster keys -f cluster.toml")]
pub struct KeysArgs {
    /// The cluster.
    #[command(flatten)]
    pub file: FileArgs,
    /// Issue certificates anew, under the same names: all of them, those of a vehicle's node, `observer` or `operator`
    #[arg(long, value_name = "WHOSE", num_args = 0..=1, default_missing_value = "all", conflicts_with = "revoke")]
    pub renew: Option<Whose>,
    /// Issue a certificate under a new name and with a new key, so that no message signed with the present one is
    /// accepted any more; `N`: that of the vehicle and that of its node's observer; `operator`: also the key that signs orders
    #[arg(long, value_name = "N|observer|operator")]
    pub revoke: Option<Whose>,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// The certificates to issue again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Whose {
    /// All certificates.
    All,
    /// The certificate of one role; with a vehicle's also that of its node's observer.
    One(Role),
}

impl Whose {
    /// Whether the certificate of this role is one of them.
    fn includes(self, role: Role) -> bool {
        match (self, role) {
            (Self::All, _) => true,
            (Self::One(Role::Vehicle(id)), Role::NodeObserver(node)) => id == node,
            (Self::One(one), role) => one == role,
        }
    }
}

impl FromStr for Whose {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "all" => Ok(Self::All),
            "observer" => Ok(Self::One(Role::Observer)),
            "operator" => Ok(Self::One(Role::Operator)),
            id => match id.parse() {
                Ok(id) => Ok(Self::One(Role::Vehicle(id))),
                Err(_) => Err("has to be a vehicle's number, in a fleet 3/7, or observer, operator or all".to_owned()),
            },
        }
    }
}

/// Result for one certificate or key.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct KeyFileLine {
    /// Its owner.
    pub who: String,
    /// Its common name.
    pub name: String,
    /// The address that it is valid for.
    pub address: Option<String>,
    /// The last day of its validity; keys of orders have none.
    pub expires: Option<String>,
    /// The change that was made, and why.
    pub done: Option<String>,
}

/// Creates what is missing and prints all keys and certificates.
///
/// # Errors
/// If the cluster has no security, others can read the folder, or a file cannot be written.
pub fn run(args: &KeysArgs) -> Result<(), Error> {
    let path = args.file.path();
    let inventory = Inventory::read(&path)?;
    let lines = make(&inventory, args.renew, args.revoke, clock::utc())?;
    let changed = lines.iter().any(|line| line.done.is_some());
    if args.json {
        let object = json!({ "keys": inventory.keys, "changed": changed, "certificates": lines });
        skein_lab::terminal::say(&skein_lab::terminal::json(&object));
    } else {
        skein_lab::terminal::say(&as_table(&lines));
        let next = if changed { next(args.revoke, &path) } else { "nothing had to be done".to_owned() };
        skein_lab::terminal::say(&format!("keys are in {}; {next}\n", inventory.keys.display()));
    }
    Ok(())
}

/// Returns the commands that put new keys into effect. A vehicle with a new key is refused by peers that know only the
/// old one: restarted one by one, a part of the swarm would fly without it.
fn next(revoke: Option<Whose>, path: &Path) -> String {
    let file = path.display();
    match revoke {
        Some(Whose::One(Role::Vehicle(_))) => {
            format!("next: skein cluster down, install, up, each with -f {file}: in flight some peers would refuse it")
        }
        _ => format!("next: skein cluster install -f {file}"),
    }
}

/// Creates what is missing, invalid, or to be renewed.
///
/// # Errors
/// The errors of [`run()`].
pub(crate) fn make(
    inventory: &Inventory,
    renew: Option<Whose>,
    revoke: Option<Whose>,
    now: OffsetDateTime,
) -> Result<Vec<KeyFileLine>, Error> {
    if inventory.security == SecurityKind::None {
        let path = inventory.path.display();
        return Err(Error::Refused(format!(
            "{path}: this cluster has no keys, because of security = \"none\"; delete that line first"
        )));
    }
    for whose in [renew, revoke].into_iter().flatten() {
        if let Whose::One(Role::Vehicle(id)) = whose
            && !inventory.nodes.contains_key(&id)
        {
            return Err(Error::Refused(format!("vehicle {id} is not in {}", inventory.path.display())));
        }
    }
    let folder = Folder(inventory.keys.clone());
    folder.check_private()?;
    os::private_folder(&folder.0).map_err(|error| Error::Refused(error.to_string()))?;
    if revoke == Some(Whose::All) {
        let why =
            "--revoke all is not possible: to start again, move the folder of keys away, then run `skein cluster keys`";
        return Err(Error::Refused(why.to_owned()));
    }
    Maker { inventory, folder, now }.make(renew, revoke)
}

/// Creates the keys of a cluster at a given time.
struct Maker<'a> {
    inventory: &'a Inventory,
    folder: Folder,
    now: OffsetDateTime,
}

impl Maker<'_> {
    /// Creates the keys in an order that survives a crash: first a key, then the valid name and public key, then the
    /// certificate that contains both. The next run finds and repairs what a crash has left.
    fn make(&self, renew: Option<Whose>, revoke: Option<Whose>) -> Result<Vec<KeyFileLine>, Error> {
        let (authority, authority_line) = self.authority()?;
        let is_revoked = |role| revoke.is_some_and(|whose| whose.includes(role));
        let orders_line = self.orders(is_revoked(Role::Operator))?;
        let mut names = match self.folder.names()? {
            Some(names) => names,
            None => self.folder.shown_names()?,
        };
        // Earlier versions gave the operator's observer's key to every node.
        let was_shared = names.observers.is_empty() && !names.observer.is_empty();
        let replaced = |role| match role {
            role if is_revoked(role) => Some("revoked"),
            Role::Observer if was_shared => Some("every node had its key"),
            _ => None,
        };
        for role in roles(self.inventory) {
            let key = self.key(&key_file(role), replaced(role).is_some())?;
            let name = match name_of(&names, role) {
                "" => folder::stem(role),
                name if replaced(role).is_some() => next_name(name),
                name => name.to_owned(),
            };
            names.set(role, name, key);
        }
        self.write_if_new(NAMES, &names.to_toml())?;
        let mut lines = vec![authority_line];
        for role in roles(self.inventory) {
            let certificate_spec = certificate_spec(self.inventory, &names, role);
            let asked = renew.is_some_and(|whose| whose.includes(role));
            lines.push(self.certificate(&authority, &certificate_spec, asked, replaced(role))?);
        }
        lines.push(orders_line);
        Ok(lines)
    }

    /// Returns the public key of the private key in this file. Creates a new private key if it was revoked, or is
    /// missing or invalid.
    fn key(&self, file: &str, revoked: bool) -> Result<VerificationKey, Error> {
        let there = self.folder.read(file)?.filter(|_| !revoked);
        if let Some(signing_key) = there.and_then(|text| SigningKey::from_pem(&text).ok()) {
            return Ok(signing_key.key());
        }
        let key = folder::new_key().map_err(failed)?;
        self.folder.write(file, &key)?;
        SigningKey::from_pem(&key).map(|signing_key| signing_key.key()).map_err(|why| self.folder.bad(file, why))
    }

    fn authority(&self) -> Result<(Authority, KeyFileLine), Error> {
        let there = (self.folder.read(AUTHORITY)?, self.folder.read(AUTHORITY_KEY)?);
        let swarm = self.inventory.swarm.as_str();
        let renewed = |key: &str, why: String| {
            let renewed = Authority::renewed(swarm, key, self.now);
            let (authority, pair) = renewed.map_err(|error| self.folder.bad(AUTHORITY_KEY, error))?;
            Ok::<_, Error>((authority, Some(pair), Some(format!("issued again: {why}"))))
        };
        let (authority, pair, done) = match there {
            (None, None) => {
                let (authority, pair) = Authority::new(swarm, self.now).map_err(failed)?;
                (authority, Some(pair), Some("made".to_owned()))
            }
            (Some(_), None) => {
                return Err(Error::Refused(format!(
                    "{} is missing, and nothing can be issued without it: put it back, or move the folder away and install \
                     all nodes again",
                    self.folder.path(AUTHORITY_KEY).display()
                )));
            }
            (None, Some(key)) => renewed(&key, "the file was missing".to_owned())?,
            (Some(certificate), Some(key)) => {
                let pair = certificate::Pair { certificate, key };
                match Authority::unfit(&pair, self.now) {
                    None => (Authority::read(&pair).map_err(|e| self.folder.bad(AUTHORITY, e))?, None, None),
                    Some(why @ (Unfit::Expiring | Unfit::ExpiringToday | Unfit::Expired)) => {
                        renewed(&pair.key, why.to_string())?
                    }
                    Some(unfit) => return Err(self.folder.bad(AUTHORITY, unfit)),
                }
            }
        };
        if let Some(pair) = pair {
            self.folder.write(AUTHORITY_KEY, &pair.key)?;
            self.folder.write(AUTHORITY, &pair.certificate)?;
        }
        let line = KeyFileLine {
            who: "authority".to_owned(),
            name: Authority::name(swarm),
            address: None,
            expires: expires(&authority.certificate).map(day),
            done,
        };
        Ok((authority, line))
    }

    /// Creates the key that signs orders, and writes its public key.
    fn orders(&self, revoked: bool) -> Result<KeyFileLine, Error> {
        let before = self.folder.read(ORDERS_KEY)?;
        if let Some(there) = &before
            && let Err(why) = SigningKey::from_pem(there)
        {
            // Report an invalid file instead of replacing the key, because the swarm would be affected.
            return Err(self.folder.bad(ORDERS_KEY, why));
        }
        let public = self.key(ORDERS_KEY, revoked)?.to_string();
        let done = match before {
            Some(_) => revoked.then_some("made again: revoked"),
            None => Some("made"),
        };
        self.write_if_new(ORDERS_PUBLIC, &format!("{public}\n"))?;
        let name = format!("{}…", &public[..8]);
        Ok(KeyFileLine {
            who: "orders' key".to_owned(),
            name,
            address: None,
            expires: None,
            done: done.map(str::to_owned),
        })
    }

    fn certificate(
        &self,
        authority: &Authority,
        certificate_spec: &CertificateSpec<'_>,
        asked: bool,
        replaced: Option<&str>,
    ) -> Result<KeyFileLine, Error> {
        let (certificate, key) = (certificate_file(certificate_spec.role), key_file(certificate_spec.role));
        let there = self.folder.pair(&certificate, &key)?;
        let unfit = there.as_ref().map(|pair| unfit(pair, certificate_spec, &authority.certificate, self.now));
        let done = match (unfit, replaced) {
            (None, _) => Some("made".to_owned()),
            (Some(_), Some(why)) => Some(format!("issued again: {why}")),
            (Some(Some(why)), None) => Some(format!("issued again: {why}")),
            (Some(None), None) => asked.then(|| "issued again".to_owned()),
        };
        let certificate = match there.filter(|_| done.is_none()) {
            Some(pair) => pair.certificate,
            None => {
                let issued = authority.issue(certificate_spec, &self.folder.need(&key)?, self.now).map_err(failed)?;
                self.folder.write(&certificate, &issued)?;
                issued
            }
        };
        Ok(KeyFileLine {
            who: who(certificate_spec.role),
            name: certificate_spec.name.to_owned(),
            address: certificate_spec.address.map(str::to_owned),
            expires: expires(&certificate).map(day),
            done,
        })
    }

    fn write_if_new(&self, name: &str, text: &str) -> Result<(), Error> {
        if self.folder.read(name)?.as_deref() == Some(text) { Ok(()) } else { self.folder.write(name, text) }
    }
}

fn failed(error: rcgen::Error) -> Error {
    Error::Failed(format!("no key can be made: {error}"))
}

/// Returns the next common name: `vehicle-3`, `vehicle-3.2`, `vehicle-3.3`, ...
fn next_name(name: &str) -> String {
    let (stem, number) = name.rsplit_once('.').unwrap_or((name, "1"));
    format!("{stem}.{}", number.parse::<u64>().unwrap_or(1) + 1)
}

fn who(role: Role) -> String {
    match role {
        Role::Vehicle(id) => format!("node {id}"),
        Role::Observer => "observer".to_owned(),
        Role::NodeObserver(id) => format!("observer at node {id}"),
        Role::Operator => "operator".to_owned(),
    }
}

fn as_table(lines: &[KeyFileLine]) -> String {
    let or_dash = |text: Option<String>| text.unwrap_or_else(|| "-".to_owned());
    let row = |line: &KeyFileLine| {
        let KeyFileLine { who, name, address, expires, done } = line.clone();
        vec![who, name, or_dash(address), or_dash(expires), or_dash(done)]
    };
    findings::table(&["who", "name", "address", "expires", "done"], lines.iter().map(row))
}

#[cfg(test)]
mod tests;
