//! Checks whether the keys exist, fit the cluster file, and can be read only by their owner.

use super::Line;
use crate::inventory::{Inventory, SecurityKind};
use crate::keys::certificate::{expires, unfit};
use crate::keys::folder::{AUTHORITY, Folder, ORDERS_PUBLIC, certificate_file, key_file};
use crate::keys::{Role, certificate_spec, day, roles, shared_observer};
use skein_host::clock;
use skein_lab::error::Error;

/// Returns the faults of the keys, or one line that all are valid.
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
    if !faults.is_empty() {
        return faults;
    }
    let folder = Folder(inventory.keys.clone());
    let ends = roles(inventory).filter_map(|role| expires(&folder.read(&certificate_file(role)).ok()??)).min();
    let until = ends.map_or(String::new(), |end| format!("; the first expires on {}", day(end)));
    vec![Line::new("this PC", "keys", format!("all {} are valid{until}", roles(inventory).count()))]
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
    for role in roles(inventory).filter(|role| !is_named(role)) {
        let (certificate, again) = (certificate_file(role), again());
        match folder.pair(&certificate, &key_file(role))? {
            None => lines.push(line(format!("{certificate} or its key is missing")).fault(again)),
            Some(pair) => match unfit(&pair, &certificate_spec(inventory, &names, role), &authority, clock::utc()) {
                None => {}
                Some(why) if why.forbids_flight() => lines.push(line(format!("{certificate} {why}")).fault(again)),
                Some(why) => lines.push(line(format!("{certificate} {why}")).warning(again)),
            },
        }
    }
    Ok(lines)
}
