//! Checks whether the keys exist, fit the cluster file, and can be read only by their owner. A PC without the keys that give
//! orders can still look at the swarm.

use super::Line;
use crate::inventory::{Inventory, SecurityKind};
use crate::keys::certificate::{Unfit, expires, unfit};
use crate::keys::folder::{AUTHORITY, Folder, ORDERS_KEY, ORDERS_PUBLIC, certificate_file, key_file};
use crate::keys::{Role, certificate_spec, day, roles, shared_observer};
use skein_host::clock;
use skein_lab::error::Error;

/// Returns the faults of the keys, or one line that all are valid; then a note if no orders can be given from this PC.
pub(super) fn lines(inventory: &Inventory, file: &str) -> Vec<Line> {
    if inventory.security == SecurityKind::None {
        let found =
            "links are plain TCP and orders are not signed: any computer on the network can join and send orders";
        return vec![
            Line::new("this PC", "keys", found).warning("delete `security = \"none\"`, then `skein cluster keys`"),
        ];
    }
    let faults = faults(inventory, file).unwrap_or_else(|error| {
        let error = error.to_string();
        let (found, remedy) =
            error.split_once(": `").map_or((&*error, None), |(found, rest)| (found, Some(format!("`{rest}"))));
        let remedy = remedy.unwrap_or_else(|| format!("`skein cluster keys -f {file}`"));
        vec![Line::new("this PC", "keys", found).fault(remedy)]
    });
    let folder = Folder(inventory.keys.clone());
    let note = without_orders(&folder).map(|found| Line::new("this PC", "orders", found));
    if !faults.is_empty() {
        return faults.into_iter().chain(note).collect();
    }
    let here: Vec<_> = roles(inventory).filter(|role| is_needed(&folder, *role)).collect();
    let ends = here.iter().filter_map(|role| expires(&folder.read(&certificate_file(*role)).ok()??)).min();
    let until = ends.map_or(String::new(), |end| format!("; the first expires on {}", day(end)));
    let good = Line::new("this PC", "keys", format!("all {} are valid{until}", here.len()));
    [good].into_iter().chain(note).collect()
}

/// Whether the key of this role has to be on this PC: the operator's need not, because another PC may give the orders.
fn is_needed(folder: &Folder, role: Role) -> bool {
    role != Role::Operator || folder.path(&key_file(role)).exists()
}

/// The note about a PC with keys that lacks one that gives orders. The book recommends it for all PCs but one.
fn without_orders(folder: &Folder) -> Option<String> {
    if !folder.path(AUTHORITY).exists() {
        return None;
    }
    let names = [key_file(Role::Operator), ORDERS_KEY.to_owned()];
    let missing: Vec<_> = names.into_iter().filter(|name| !folder.path(name).exists()).collect();
    let are = if missing.len() == 1 { "is" } else { "are" };
    let all = missing.join(" and ");
    (!missing.is_empty())
        .then(|| format!("orders cannot be given from this PC: {all} {are} not in {}", folder.0.display()))
}

fn faults(inventory: &Inventory, file: &str) -> Result<Vec<Line>, Error> {
    let folder = Folder(inventory.keys.clone());
    folder.check_private()?;
    let (authority, names) = (folder.need(AUTHORITY)?, folder.need_names()?);
    folder.need(ORDERS_PUBLIC)?;
    let line = |found: String| Line::new("this PC", "keys", found);
    let again = || format!("`skein cluster keys -f {file}`, then `skein cluster install -f {file}`");
    let mut lines: Vec<_> =
        shared_observer(inventory, &names).into_iter().map(|found| line(found).fault(again())).collect();
    // A node that is named there has no file either.
    let is_named = |role: &Role| matches!(role, Role::NodeObserver(id) if !names.observers.contains_key(id));
    for role in roles(inventory).filter(|role| !is_named(role) && is_needed(&folder, *role)) {
        let (certificate, again) = (certificate_file(role), again());
        match folder.pair(&certificate, &key_file(role))? {
            None => lines.push(line(format!("{certificate} or its key is missing")).fault(again)),
            Some(pair) => match unfit(&pair, &certificate_spec(inventory, &names, role), &authority, clock::utc()) {
                None => {}
                Some(why @ Unfit::Expiring) => lines.push(line(format!("{certificate} {why}")).warning(again)),
                Some(why) => lines.push(line(format!("{certificate} {why}")).fault(again)),
            },
        }
    }
    Ok(lines)
}
