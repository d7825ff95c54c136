//! The keys of a cluster: which keys exist, in which files, and the contents of each certificate.

pub(crate) mod certificate;
pub(crate) mod folder;
pub mod run;

use skein_common::id::VehicleName;
use time::OffsetDateTime;

use crate::inventory::Inventory;
use certificate::CertificateSpec;
use folder::Names;

/// The roles of the nodes that connect to a swarm. Each role has a certificate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// A vehicle's agent: sends this vehicle's messages.
    Vehicle(VehicleName),
    /// An observer: receives all messages and sends none.
    Observer,
    /// The operator: sends orders.
    Operator,
}

/// All roles that have a certificate in this cluster.
pub(crate) fn roles(inventory: &Inventory) -> impl Iterator<Item = Role> {
    inventory.nodes.keys().map(|id| Role::Vehicle(*id)).chain([Role::Observer, Role::Operator])
}

/// The required contents of the certificate of this role.
pub(crate) fn certificate_spec<'a>(inventory: &'a Inventory, names: &'a Names, role: Role) -> CertificateSpec<'a> {
    let address = match role {
        Role::Vehicle(id) => inventory.nodes.get(&id).map(|node| node.address.as_str()),
        Role::Observer | Role::Operator => None,
    };
    CertificateSpec { role, name: name_of(names, role), address }
}

/// The valid common name of this role; empty if it has none yet.
pub(crate) fn name_of(names: &Names, role: Role) -> &str {
    match role {
        Role::Vehicle(id) => names.vehicles.get(&id).map_or("", |known| &known.name),
        Role::Observer => &names.observer,
        Role::Operator => &names.operator,
    }
}

/// Formats a date: `2026-11-21`.
pub(crate) fn day(at: OffsetDateTime) -> String {
    let (year, month, day) = at.to_calendar_date();
    format!("{year:04}-{:02}-{day:02}", u8::from(month))
}
