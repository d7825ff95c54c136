//! The keys of a cluster: which keys exist, in which files, and the contents of each certificate.

pub(crate) mod certificate;
pub mod command;
pub(crate) mod folder;
pub mod run;

use skein_common::id::VehicleName;
use time::OffsetDateTime;

use crate::inventory::{Inventory, SecurityKind};
use certificate::{CertificateSpec, Pair, Unfit};
use folder::{AUTHORITY, Folder, NAMES, Names, certificate_file, key_file};
use skein_host::clock;
use skein_lab::error::Error;

/// The roles of the nodes that connect to a swarm. Each role has a certificate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// A vehicle's agent: sends this vehicle's messages.
    Vehicle(VehicleName),
    /// The observer at the operator's PC: receives all messages and sends none.
    Observer,
    /// The observer at a vehicle's node, with the rights of [`Self::Observer`].
    NodeObserver(VehicleName),
    /// The operator: sends orders.
    Operator,
}

/// All roles that have a certificate in this cluster.
pub(crate) fn roles(inventory: &Inventory) -> impl Iterator<Item = Role> {
    let of_nodes = |role: fn(VehicleName) -> Role| inventory.nodes.keys().copied().map(role);
    let observers = std::iter::once(Role::Observer).chain(of_nodes(Role::NodeObserver));
    of_nodes(Role::Vehicle).chain(observers).chain([Role::Operator])
}

/// The required contents of the certificate of this role.
pub(crate) fn certificate_spec<'a>(inventory: &'a Inventory, names: &'a Names, role: Role) -> CertificateSpec<'a> {
    let address = match role {
        Role::Vehicle(id) => inventory.nodes.get(&id).map(|node| node.address.as_str()),
        Role::Observer | Role::NodeObserver(_) | Role::Operator => None,
    };
    CertificateSpec { role, name: name_of(names, role), address }
}

/// Reads the certificate of this role with its key, checked that peers accept it, and the valid names.
///
/// # Errors
/// If one of them is missing, or peers reject the certificate: a text with the remedy.
pub(crate) fn accepted_pair(inventory: &Inventory, folder: &Folder, role: Role) -> Result<(Pair, Names), Error> {
    let file = certificate_file(role);
    let pair = Pair { certificate: folder.need(&file)?, key: folder.need(&key_file(role))? };
    let names = folder.need_names()?;
    let spec = certificate_spec(inventory, &names, role);
    match certificate::unfit(&pair, &spec, &folder.need(AUTHORITY)?, clock::utc()).filter(Unfit::is_fatal) {
        None => Ok((pair, names)),
        Some(why) => {
            let remedy = format!("`skein cluster keys -f {}` issues it again", inventory.path.display());
            Err(Error::Refused(format!("{} {why}: {remedy}", folder.path(&file).display())))
        }
    }
}

/// The valid common name of this role; empty if it has none yet.
pub(crate) fn name_of(names: &Names, role: Role) -> &str {
    match role {
        Role::Vehicle(id) => names.vehicles.get(&id).map_or("", |known| &known.name),
        Role::Observer => &names.observer,
        Role::NodeObserver(id) => names.observers.get(&id).map_or("", String::as_str),
        Role::Operator => &names.operator,
    }
}

/// The finding of `check` and `up` about nodes without an observer's key of their own, in a folder of keys of an earlier version;
/// `None` if every node has one.
pub(crate) fn shared_observer(inventory: &Inventory, names: &Names) -> Option<String> {
    let without = inventory.nodes.keys().filter(|id| !names.observers.contains_key(id)).map(VehicleName::to_string);
    let without = without.collect::<Vec<_>>().join(", ");
    let lacks = "has no key of its own, which a revocation of the node would revoke";
    (!without.is_empty()).then(|| format!("the observer at node {without} {lacks}"))
}

/// Refuses to begin a flight with certificates that expire within a day, because a vehicle that is restarted in flight needs
/// a new link and its peers refuse an expired certificate; and with nodes that share an observer's key.
///
/// # Errors
/// If a certificate of the cluster's folder expires that soon, a node has no key for its observer, or a file cannot be read.
pub(crate) fn check_for_flight(inventory: &Inventory, now: OffsetDateTime) -> Result<(), Error> {
    if inventory.security == SecurityKind::None {
        return Ok(());
    }
    let folder = Folder(inventory.keys.clone());
    let file = inventory.path.display();
    let remedy = format!("`skein cluster keys -f {file}`, then `skein cluster install -f {file}`");
    if let Some(found) = folder.names()?.and_then(|names| shared_observer(inventory, &names)) {
        return Err(folder.bad(NAMES, format_args!("{found}: {remedy}")));
    }
    let files = roles(inventory).map(certificate_file).chain([AUTHORITY.to_owned()]);
    let mut expiring = Vec::new();
    for file in files {
        // A second PC may have a part of the folder.
        let Some(certificate) = folder.read(&file)? else { continue };
        if certificate::expires(&certificate).is_some_and(|end| end < now + certificate::FLIGHT) {
            expiring.push(file);
        }
    }
    if expiring.is_empty() {
        return Ok(());
    }
    let all = expiring.join(", ");
    let why = "expires within 24 h, and a vehicle that restarts in flight could not join again";
    Err(Error::Refused(format!("{all} {why}: {remedy}")))
}

/// Formats a date: `2026-11-21`.
pub(crate) fn day(at: OffsetDateTime) -> String {
    at.date().to_string()
}
