//! Checks whether the keys exist, fit the cluster file, and can be read only by their owner.

use super::Line;
use crate::inventory::{Inventory, SecurityKind};
use crate::keys::certificate::{Unfit, expires, unfit};
use crate::keys::folder::{AUTHORITY, Folder, ORDERS_PUBLIC, certificate_file, key_file};
use crate::keys::{certificate_spec, day, roles};
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
    vec![Line::new("this PC", "keys", format!("all {} are valid{until}", inventory.nodes.len() + 2))]
}

fn faults(inventory: &Inventory, file: &str) -> Result<Vec<Line>, Error> {
    let folder = Folder(inventory.keys.clone());
    folder.check_private()?;
    let (authority, names) = (folder.need(AUTHORITY)?, folder.need_names()?);
    folder.need(ORDERS_PUBLIC)?;
    let mut lines = Vec::new();
    for role in roles(inventory) {
        let certificate = certificate_file(role);
        let again = format!("`skein cluster keys -f {file}`, then `skein cluster install -f {file}`");
        let line = |found: String| Line::new("this PC", "keys", found);
        match folder.pair(&certificate, &key_file(role))? {
            None => lines.push(line(format!("{certificate} or its key is missing")).fault(again)),
            Some(pair) => match unfit(&pair, &certificate_spec(inventory, &names, role), &authority, clock::utc()) {
                None => {}
                Some(Unfit::Expiring) => lines.push(line(format!("{certificate} {}", Unfit::Expiring)).warning(again)),
                Some(why) => lines.push(line(format!("{certificate} {why}")).fault(again)),
            },
        }
    }
    Ok(lines)
}
