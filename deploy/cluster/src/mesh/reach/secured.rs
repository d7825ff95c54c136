//! Prepares connections to a swarm with the keys of a folder: the cluster's own folder, or the part of it that a node has.

use std::collections::BTreeMap;
use std::sync::Arc;

use skein_agent::link::Security;
use skein_agent::link::security::Tls;
use skein_common::scenario::Loaded;
use skein_common::topic::Branch;

use super::{Flown, Reach};
use crate::inventory::Inventory;
use crate::keys::folder::{AUTHORITY, Folder, certificate_file, key_file};
use crate::keys::run::RunFile;
use crate::keys::{Role, accepted_pair};
use skein_lab::error::Error;

impl Inventory {
    /// Returns how to connect in this role to the swarm, or to each team of the fleet, in the order of the teams.
    ///
    /// # Errors
    /// If its keys are missing or invalid, or others can read them.
    pub fn reaches(&self, role: Role) -> Result<Vec<Reach>, Error> {
        let plain = Reach::plain(self.swarm.clone(), BTreeMap::new(), Flown::Text(String::new()));
        let to_none = match RunFile::of(self) {
            Some(run_file) => self.secured(role, run_file, plain)?,
            None => plain,
        };
        let reach = |loaded: &Loaded| {
            let team = loaded.scenario.team.map(|team| team.id);
            let own = self.nodes.iter().filter(|(id, _)| id.team == team);
            let agents = own.map(|(id, node)| (id.vehicle, node.endpoint(self.security))).collect();
            let scenario = Flown::Text(loaded.to_toml());
            Reach { branch: Branch::of(team), agents, scenario, ..to_none.clone() }
        };
        Ok(self.scenario.all().iter().map(reach).collect())
    }

    /// The observer whose key is in this folder: the folder of a node has that of the node's own observer alone.
    fn observer_in(&self, folder: &Folder) -> Role {
        let is_there = |role: &Role| folder.path(&key_file(*role)).exists();
        let mut of_nodes = self.nodes.keys().map(|id| Role::NodeObserver(*id)).filter(is_there);
        match (is_there(&Role::Observer), of_nodes.next(), of_nodes.next()) {
            (false, Some(only), None) => only,
            _ => Role::Observer,
        }
    }

    /// Adds what secured links need to a connection.
    fn secured(&self, role: Role, run_file: RunFile, plain: Reach) -> Result<Reach, Error> {
        let folder = Folder(self.keys.clone());
        let role = if role == Role::Observer { self.observer_in(&folder) } else { role };
        let (certificate, key) = (certificate_file(role), key_file(role));
        folder.check_private_file(&key)?;
        let (_, mut names) = accepted_pair(self, &folder, role)?;
        // A vehicle that has left the cluster is not accepted.
        names.retain(|id| self.nodes.contains_key(&id));
        let orders_key = folder.orders_key()?;
        let tls = Tls {
            authority: folder.path(AUTHORITY),
            certificate: folder.path(&certificate),
            key: folder.path(&key),
            orders: orders_key,
            observers: names.all_observers(),
            vehicles: names.vehicles,
            operator: names.operator,
        };
        let signing_key = (role == Role::Operator).then(|| folder.signing_key(orders_key)).transpose()?;
        Ok(Reach {
            security: Security::Tls(tls),
            orders_key: Some(orders_key),
            signing_key: signing_key.map(Arc::new),
            own_run: run_file.read()?.map(|record| record.note.run),
            run_file: Some(run_file),
            ..plain
        })
    }
}
