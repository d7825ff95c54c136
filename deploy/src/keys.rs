//! The keys of a cluster: which there are, in which file, and what stands in each certificate.

pub(crate) mod certificate;
pub(crate) mod folder;
pub mod run;

use skein_common::id::VehicleId;
use time::OffsetDateTime;

use crate::inventory::Inventory;
use certificate::CertificateSpec;
use folder::Names;

/// Who takes part in a swarm's traffic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// A vehicle's agent: says what this vehicle may say.
    Vehicle(VehicleId),
    /// Says nothing.
    Observer,
    /// Gives orders.
    Operator,
}

/// Who has a certificate.
pub(crate) fn roles(inventory: &Inventory) -> impl Iterator<Item = Role> {
    inventory.nodes.keys().map(|id| Role::Vehicle(*id)).chain([Role::Observer, Role::Operator])
}

/// What the certificate of this one says.
pub(crate) fn certificate_spec<'a>(inventory: &'a Inventory, names: &'a Names, role: Role) -> CertificateSpec<'a> {
    let address = match role {
        Role::Vehicle(id) => inventory.nodes.get(&id).map(|node| node.address.as_str()),
        Role::Observer | Role::Operator => None,
    };
    CertificateSpec { role, name: name_of(names, role), address }
}

/// The common name that counts; empty if there is none yet.
pub(crate) fn name_of(names: &Names, role: Role) -> &str {
    match role {
        Role::Vehicle(id) => names.vehicles.get(&id).map_or("", |known| &known.name),
        Role::Observer => &names.observer,
        Role::Operator => &names.operator,
    }
}

/// `2026-11-21`.
pub(crate) fn day(at: OffsetDateTime) -> String {
    let (year, month, day) = at.to_calendar_date();
    format!("{year:04}-{:02}-{day:02}", u8::from(month))
}
