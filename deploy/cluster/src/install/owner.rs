//! Finds nodes that belong to another authority than the keys of this PC: another operator's swarm must not be flown by accident.

use skein_common::id::VehicleName;

use crate::bundle::authority_of;
use crate::inventory::{Inventory, SecurityKind};
use crate::keys::folder::{AUTHORITY, Folder};
use crate::nodes::{ChosenNodes, list};
use crate::protocol::Facts;
use crate::remote::Remote;
use crate::ssh::at_once;

/// The authority of this PC's keys; `None` where links are plain or no keys exist.
pub(crate) fn of(inventory: &Inventory) -> Option<String> {
    let path = Folder(inventory.keys.clone()).path(AUTHORITY);
    let is_secured = inventory.security == SecurityKind::Tls;
    std::fs::read(path).ok().filter(|_| is_secured).map(|certificate| authority_of(&certificate))
}

/// The authority of a node, if it is another than this PC's.
pub(crate) fn another<'a>(facts: &'a Facts, own: Option<&str>) -> Option<&'a str> {
    facts.authority.as_deref().filter(|owner| Some(*owner) != own)
}

/// Asks every chosen host. Returns why nothing may be changed because vehicles fly under another authority; empty if none does.
pub(super) fn flown_by_another(remote: &Remote<'_>, chosen: &ChosenNodes) -> String {
    let own = of(&chosen.inventory);
    let asked = at_once(&chosen.hosts(), |(host, nodes)| {
        let is_anothers = |facts: Facts| facts.agent.is_some() && another(&facts, own.as_deref()).is_some();
        // A host that cannot be asked is reported when its node is installed.
        let flying = nodes.iter().filter(|node| remote.facts(host, node).is_ok_and(is_anothers));
        flying.map(|node| node.id).collect::<Vec<_>>()
    });
    let flying: Vec<VehicleName> = asked.into_iter().flatten().collect();
    match flying.is_empty() {
        true => String::new(),
        false => format!(
            "node {} flies under another authority; its operator lands the swarm with `skein cluster down` before another \
             authority can have its nodes",
            list(&flying)
        ),
    }
}
