//! Properties of inventories and plans, for clusters of any shape; and sockets for the tests of several modules.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::time::Duration;

use proptest::prelude::*;
use proptest::sample::subsequence;
use skein_agent::link::signature::SigningKey;
use skein_agent::link::signature::runs::RunNote;
use skein_common::id::{SwarmName, VehicleId, VehicleName};
use skein_host::clock;

use crate::flown::Evidence;
use crate::install::roll::until_one_fails;
use crate::inventory::{Install, Inventory, Node};
use crate::keys::folder::new_key;
use crate::keys::run::Record;
use crate::nodes::{ChosenNodes, list};
use crate::pack::pack;

/// Address at which a test listens at a free port of this PC that stays closed when the test has closed it: no program listens at
/// this address and might take the port. macOS has only the usual address.
pub(crate) const LEFT_ALONE: &str = if cfg!(target_os = "macos") { "127.0.0.1:0" } else { "127.0.0.77:0" };

/// Closes a test's socket, and waits until it accepts no connection: a program that another test starts has the socket too until it
/// runs, on a busy PC for a second.
pub(crate) fn close(listener: TcpListener) {
    let address = listener.local_addr().unwrap();
    drop(listener);
    let until = clock::now() + Duration::from_secs(20);
    while TcpStream::connect_timeout(&address, Duration::from_secs(1)).is_ok() {
        assert!(clock::now() < until, "{address} is still open");
        clock::sleep(Duration::from_millis(20));
    }
}

/// One node of a cluster file: the number of its host, whether it has a user of its own, and whether it is installed by hand.
type Entry = (u8, bool, bool);

/// Entries for 1 to 8 nodes on at most four hosts.
fn entries() -> impl Strategy<Value = Vec<Entry>> {
    prop::collection::vec((1..5_u8, any::<bool>(), prop::bool::weighted(0.2)), 1..9)
}

/// Writes and reads the cluster of these entries, with links that need no keys.
fn cluster(folder: &Path, entries: &[Entry]) -> Inventory {
    let node = |(id, (host, has_user, by_hand)): (usize, &Entry)| {
        let place = match by_hand {
            true => "install = 'manual'\n".to_owned(),
            false => format!("host = 'heli{host}'\n{}", if *has_user { "user = 'lab'\n" } else { "" }),
        };
        format!("[node.{}]\n{place}address = '10.0.{host}.{}'\n", id + 1, id + 11)
    };
    let nodes: String = entries.iter().enumerate().map(node).collect();
    fs::write(folder.join("hover.toml"), format!("name = 'hover'\nswarm.vehicles = {}\n", entries.len())).unwrap();
    let text = format!("swarm = 'lab'\nscenario = 'hover.toml'\nsecurity = 'none'\n{nodes}");
    fs::write(folder.join("cluster.toml"), text).unwrap();
    Inventory::read(&folder.join("cluster.toml")).unwrap()
}

fn id(number: usize) -> VehicleName {
    VehicleId::new(u8::try_from(number).unwrap()).unwrap().into()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn the_cluster_file_of_each_node_describes_the_same_swarm(entries in entries(), nth in any::<prop::sample::Index>()) {
        let (folder, there) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let inventory = cluster(folder.path(), &entries);
        let own = id(nth.index(entries.len()) + 1);
        let bundle = pack(&inventory, own).unwrap();
        for (path, file) in &bundle.files {
            fs::write(there.path().join(path), &file.content).unwrap();
        }
        let read = Inventory::read(&there.path().join("cluster.toml")).unwrap();
        let essence = |inventory: &Inventory| {
            let of_node = |node: &Node| (node.id, node.host.clone(), node.install, node.endpoint(inventory.security));
            inventory.nodes.values().map(of_node).collect::<Vec<_>>()
        };
        prop_assert_eq!(essence(&read), essence(&inventory));
        prop_assert_eq!(&read.swarm, &inventory.swarm);
        let scenario = |inventory: &Inventory| inventory.scenario.first().scenario.clone();
        prop_assert_eq!(scenario(&read), scenario(&inventory));
        // What a node would give to another one is what it was given.
        let again = pack(&read, own).unwrap();
        prop_assert_eq!(&again.files["cluster.toml"], &bundle.files["cluster.toml"]);
    }

    #[test]
    fn one_of_each_pair_of_agents_dials_the_other(entries in entries()) {
        let folder = tempfile::tempdir().unwrap();
        let inventory = cluster(folder.path(), &entries);
        let owner: BTreeMap<String, VehicleName> =
            inventory.nodes.values().map(|node| (node.endpoint(inventory.security), node.id)).collect();
        prop_assert_eq!(owner.len(), entries.len());
        let mut pairs = BTreeSet::new();
        for id in inventory.nodes.keys() {
            for endpoint in inventory.dialled_by(*id) {
                let other = owner[&endpoint];
                prop_assert!(*id != other && pairs.insert((*id.min(&other), *id.max(&other))));
            }
        }
        prop_assert_eq!(pairs.len(), entries.len() * (entries.len() - 1) / 2);
    }

    #[test]
    fn every_chosen_node_is_called_once_at_its_own_host_or_left_to_its_operator(
        entries in entries(),
        chosen in any::<prop::sample::Selector>(),
        count in 1..9_usize,
    ) {
        let folder = tempfile::tempdir().unwrap();
        let inventory = cluster(folder.path(), &entries);
        let ids: BTreeSet<VehicleName> = (0..count).map(|_| *chosen.select(inventory.nodes.keys())).collect();
        let named: Vec<VehicleName> = ids.iter().copied().collect();
        let chosen = ChosenNodes::read(&inventory.path, &named).unwrap();
        let hosts = chosen.hosts();
        for (host, nodes) in &hosts {
            for node in nodes {
                prop_assert_eq!((node.host.as_ref(), &node.user), (Some(&host.name), &host.user));
            }
            prop_assert!(nodes.is_sorted_by_key(|node| node.id), "the nodes of {} in the order of ids", host);
        }
        prop_assert!(hosts.is_sorted_by_key(|(_, nodes)| nodes[0].id));
        let names: BTreeSet<_> = hosts.iter().map(|(host, _)| host).collect();
        prop_assert_eq!(names.len(), hosts.len(), "no host is called twice");
        let called = hosts.iter().flat_map(|(_, nodes)| nodes.iter().map(|node| node.id));
        let mut all: Vec<VehicleName> = called.chain(chosen.manual().map(|node| node.id)).collect();
        all.sort();
        prop_assert_eq!(all, named);
        prop_assert!(chosen.manual().all(|node| node.install == Install::Manual));
        let unknown = ChosenNodes::read(&inventory.path, &[id(entries.len() + 1)]).unwrap_err().to_string();
        prop_assert!(unknown.ends_with(&format!("has no node {}", entries.len() + 1)), "{}", unknown);
    }

    #[test]
    fn a_list_of_nodes_names_each_of_them_once(
        names in prop::collection::btree_set((prop::option::of(1..4_u16), 1..12_u8), 0..20)
    ) {
        let name = |(team, vehicle): &(Option<u16>, u8)| -> VehicleName {
            team.map_or_else(|| vehicle.to_string(), |team| format!("{team}/{vehicle}")).parse().unwrap()
        };
        let names: BTreeSet<VehicleName> = names.iter().map(name).collect();
        let mut read = Vec::new();
        for part in list(&names).split(", ").filter(|part| !part.is_empty()) {
            let (first, last) = part.split_once('-').unwrap_or((part, part));
            let first: VehicleName = first.parse().unwrap();
            let last = last.rsplit('/').next().unwrap().parse::<u8>().unwrap();
            let run = first.vehicle.get()..=last;
            read.extend(run.map(|vehicle| VehicleName { vehicle: VehicleId::new(vehicle).unwrap(), ..first }));
        }
        prop_assert_eq!(read, names.into_iter().collect::<Vec<_>>());
    }

    #[test]
    fn a_swarm_is_joined_only_in_a_run_that_is_proven(
        reported in prop::collection::vec(prop::option::of(1..4_u64), 1..7),
        own in prop::option::of((1..4_u64, any::<bool>())),
        kept in subsequence(vec![1_u64, 2, 3], 0..=3),
    ) {
        let operator = SigningKey::from_pem(&new_key().unwrap()).unwrap();
        let swarm = SwarmName::new("lab").unwrap();
        // A run with a larger number was begun later.
        let note = |run: u64| RunNote::new(&operator, &swarm, run, 1000 * run);
        let notes: Vec<RunNote> = kept.iter().copied().map(note).collect();
        let record = own.map(|(run, over)| Record { note: note(run), over });
        let vehicles = reported.len();
        let flown: BTreeMap<VehicleName, u64> =
            (1..).zip(&reported).filter_map(|(nth, run)| Some((id(nth), (*run)?))).collect();
        let counted = |run: u64| flown.values().filter(|flown| **flown == run).count();
        let majority = (1..4).find(|run| 2 * counted(*run) > vehicles);
        let joined = Evidence { vehicles, reported: flown.clone(), own: record, notes: &notes }.run(&operator.key(), &swarm);
        let by_record = own.filter(|(run, over)| !over && counted(*run) > 0 && kept.iter().all(|kept| kept <= run));
        match (majority, by_record) {
            (Some(run), _) => prop_assert_eq!(joined, Ok(Some(run))),
            (None, _) if flown.is_empty() => prop_assert_eq!(joined, Ok(None), "nothing flies: a new run"),
            (None, Some((run, _))) => prop_assert_eq!(joined, Ok(Some(run))),
            (None, None) => {
                let refusal = joined.unwrap_err();
                prop_assert!(refusal.contains("`skein cluster down`"), "{}", refusal);
            }
        }
    }

    #[test]
    fn a_roll_restarts_each_vehicle_once_and_in_order_until_one_does_not_come_back(
        comes_back in prop::collection::vec(prop::bool::weighted(0.8), 0..12)
    ) {
        let all: Vec<usize> = (0..comes_back.len()).collect();
        let mut restarted = Vec::new();
        let stopped = until_one_fails(&all, |nth| {
            restarted.push(*nth);
            comes_back[*nth]
        });
        let first = comes_back.iter().position(|is_back| !is_back);
        prop_assert_eq!(stopped.map(|(at, _)| *at), first);
        let left = stopped.map_or(&[][..], |(_, rest)| rest);
        prop_assert_eq!([&restarted, left].concat(), all, "each is restarted or left alone");
        prop_assert_eq!(restarted.len(), first.map_or(comes_back.len(), |first| first + 1));
    }
}
