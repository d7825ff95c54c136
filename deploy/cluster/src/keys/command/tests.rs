use std::fs;
use std::path::Path;

use super::*;
use crate::inventory::SecurityKind;
use crate::inventory::tests::{TEAMS, fleet, lab};
use crate::keys::certificate::Pair;
use crate::keys::check_for_flight;
use crate::keys::folder::Names;
use crate::mesh::reach::Reach;
use skein_agent::link::Security;
use skein_common::id::{VehicleId, VehicleName};
use time::Duration;

/// The owners and what was done, for the results in which something was done.
fn done(lines: &[KeyFileLine]) -> Vec<(&str, &str)> {
    lines.iter().filter_map(|line| Some((line.who.as_str(), line.done.as_deref()?))).collect()
}

/// All files and their contents.
fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let read = |entry: fs::DirEntry| (entry.file_name().into_string().unwrap(), fs::read(entry.path()).unwrap());
    let mut files: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| read(entry.unwrap())).collect();
    files.sort();
    files
}

fn pair(folder: &Folder, role: Role) -> Pair {
    folder.pair(&certificate_file(role), &key_file(role)).unwrap().unwrap()
}

fn id(number: u8) -> VehicleName {
    VehicleId::new(number).unwrap().into()
}

/// The connection to the only swarm of a cluster.
fn reach(inventory: &Inventory, role: Role) -> Result<Reach, Error> {
    inventory.reaches(role).map(|mut reaches| reaches.remove(0))
}

fn vehicle(number: u8) -> Role {
    Role::Vehicle(id(number))
}

#[test]
fn a_second_run_changes_nothing() {
    let temporary = tempfile::tempdir().unwrap();
    let inventory = lab(temporary.path(), 3, "");
    let now = clock::utc();
    let lines = make(&inventory, None, None, now).unwrap();
    assert_eq!(done(&lines).len(), 10, "authority, three vehicles, four observers, operator, key of orders");
    assert_eq!((lines[3].name.as_str(), lines[3].address.as_deref()), ("vehicle-3", Some("10.0.0.13")));
    let before = files(&inventory.keys);
    let names: Vec<_> = before.iter().map(|(name, _)| name.as_str()).collect();
    let of = |stem: &str| [format!("{stem}.key"), format!("{stem}.pem")];
    let mut expected: Vec<_> = ["authority", "observer", "operator"].into_iter().flat_map(of).collect();
    expected.extend(
        ["observer-1", "observer-2", "observer-3", "vehicle-1", "vehicle-2", "vehicle-3"].into_iter().flat_map(of),
    );
    expected.extend(["names.toml", "orders.key", "orders.pub"].map(str::to_owned));
    expected.sort();
    assert_eq!(names, expected);
    assert_eq!(done(&make(&inventory, None, None, now).unwrap()), []);
    assert_eq!(files(&inventory.keys), before);
}

#[cfg(unix)]
#[test]
fn only_the_owner_can_read_the_secrets() {
    use std::os::unix::fs::PermissionsExt;

    let temporary = tempfile::tempdir().unwrap();
    let inventory = lab(temporary.path(), 1, "");
    make(&inventory, None, None, clock::utc()).unwrap();
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
    assert_eq!(mode(&inventory.keys), 0o700);
    for (name, _) in files(&inventory.keys) {
        let expected = if name.ends_with(".key") { 0o600 } else { 0o644 };
        assert_eq!(mode(&inventory.keys.join(&name)), expected, "{name}");
    }
    for (name, given, remedy) in [("", 0o750, "chmod 700"), ("operator.key", 0o640, "chmod 600")] {
        let path = if name.is_empty() { inventory.keys.clone() } else { inventory.keys.join(name) };
        let before = mode(&path);
        fs::set_permissions(&path, fs::Permissions::from_mode(given)).unwrap();
        let refused = make(&inventory, None, None, clock::utc()).unwrap_err();
        assert!(refused.to_string().contains(remedy) && refused.exit_code() == 2, "{refused}");
        fs::set_permissions(&path, fs::Permissions::from_mode(before)).unwrap();
    }
    assert!(make(&inventory, None, None, clock::utc()).is_ok());
}

#[test]
fn only_missing_moved_or_expiring_certificates_are_issued_again() {
    let temporary = tempfile::tempdir().unwrap();
    let inventory = lab(temporary.path(), 3, "");
    let now = clock::utc();
    make(&inventory, None, None, now).unwrap();
    fs::remove_file(inventory.keys.join("vehicle-2.key")).unwrap();
    assert_eq!(
        done(&make(&inventory, None, None, now).unwrap()),
        [("node 2", "issued again: does not belong to its key")]
    );
    let mut moved = inventory.clone();
    moved.nodes.get_mut(&id(3)).unwrap().address = "heli3.lab".to_owned();
    assert_eq!(done(&make(&moved, None, None, now).unwrap()), [("node 3", "issued again: has another address")]);
    assert_eq!(done(&make(&moved, None, None, now).unwrap()), []);
    let certificate = inventory.keys.join("vehicle-1.pem");
    fs::copy(inventory.keys.join("vehicle-2.pem"), &certificate).unwrap();
    assert_eq!(done(&make(&moved, None, None, now).unwrap()), [("node 1", "issued again: does not belong to its key")]);
    fs::write(&certificate, "nothing").unwrap();
    assert_eq!(done(&make(&moved, None, None, now).unwrap()), [("node 1", "issued again: unreadable")]);
    // Certificates are valid for a year, the authority for ten.
    assert_eq!(done(&make(&moved, None, None, now + Duration::days(334)).unwrap()), []);
    let late = make(&moved, None, None, now + Duration::days(336)).unwrap();
    assert_eq!(done(&late).len(), 8);
    assert!(done(&late).iter().all(|(_, why)| *why == "issued again: expires soon"), "{late:?}");
    let authority = fs::read_to_string(inventory.keys.join(AUTHORITY_KEY)).unwrap();
    let late = make(&moved, None, None, now + Duration::days(3640)).unwrap();
    assert_eq!(done(&late).len(), 9);
    assert_eq!(fs::read_to_string(inventory.keys.join(AUTHORITY_KEY)).unwrap(), authority, "the key stays the same");
}

#[test]
fn a_certificate_has_a_name_an_address_and_a_validity() {
    let temporary = tempfile::tempdir().unwrap();
    let inventory = lab(temporary.path(), 2, "");
    let now = clock::utc();
    make(&inventory, None, None, now).unwrap();
    let folder = Folder(inventory.keys.clone());
    let names = folder.need_names().unwrap();
    let authority = folder.need(AUTHORITY).unwrap();
    let its = |role| certificate_spec(&inventory, &names, role);
    for role in roles(&inventory) {
        assert_eq!(unfit(&pair(&folder, role), &its(role), &authority, now), None, "{role:?}");
    }
    let pem = fs::read(inventory.keys.join("vehicle-2.pem")).unwrap();
    let (_, pem) = x509_parser::pem::parse_x509_pem(&pem).unwrap();
    let certificate = pem.parse_x509().unwrap();
    let usage = certificate.extended_key_usage().unwrap().unwrap().value;
    assert!(usage.client_auth && usage.server_auth && !certificate.is_ca());
    assert_eq!(certificate.validity().not_before.to_datetime(), now - Duration::days(7), "for clocks that are behind");
    assert_eq!(certificate.validity().not_after.to_datetime(), now + Duration::days(365));
    // Another swarm's authority has signed nothing in this folder.
    let elsewhere = tempfile::tempdir().unwrap();
    let other = lab(elsewhere.path(), 2, "");
    make(&other, None, None, now).unwrap();
    let other_authority = Folder(other.keys.clone()).need(AUTHORITY).unwrap();
    assert_eq!(unfit(&pair(&folder, vehicle(2)), &its(vehicle(2)), &other_authority, now), Some(Unfit::OtherAuthority));
    assert_eq!(unfit(&pair(&folder, vehicle(2)), &its(vehicle(1)), &authority, now), Some(Unfit::OtherName));
}

#[test]
fn no_flight_begins_with_a_certificate_that_expires_within_a_day() {
    let temporary = tempfile::tempdir().unwrap();
    let inventory = lab(temporary.path(), 2, "");
    let now = clock::utc();
    make(&inventory, None, None, now).unwrap();
    assert!(check_for_flight(&inventory, now + Duration::days(363)).is_ok());
    let why = check_for_flight(&inventory, now + Duration::days(364) + Duration::minutes(1)).unwrap_err().to_string();
    let all = "vehicle-1.pem, vehicle-2.pem, observer.pem, observer-1.pem, observer-2.pem, operator.pem";
    assert!(why.starts_with(&format!("{all} expires within 24 h")), "{why}");
    assert!(why.contains("`skein cluster keys -f ") && why.contains("`skein cluster install -f "), "{why}");
    // Only the certificates of node 2 are issued again.
    make(&inventory, Some(Whose::One(vehicle(2))), None, now + Duration::days(300)).unwrap();
    let why = check_for_flight(&inventory, now + Duration::days(365)).unwrap_err().to_string();
    assert!(why.starts_with("vehicle-1.pem, observer.pem, observer-1.pem, operator.pem expires"), "{why}");
    let plain = Inventory { security: SecurityKind::None, ..inventory };
    assert!(check_for_flight(&plain, now + Duration::days(400)).is_ok(), "plain links need no certificate");
}

#[test]
fn renewing_keeps_the_name_and_revoking_changes_it() {
    let temporary = tempfile::tempdir().unwrap();
    let inventory = lab(temporary.path(), 3, "");
    let now = clock::utc();
    make(&inventory, None, None, now).unwrap();
    let public_key = fs::read_to_string(inventory.keys.join(ORDERS_PUBLIC)).unwrap();
    let lines = make(&inventory, Some(Whose::One(vehicle(1))), None, now).unwrap();
    assert_eq!(done(&lines), [("node 1", "issued again"), ("observer at node 1", "issued again")]);
    assert_eq!((lines[1].name.as_str(), lines[5].name.as_str()), ("vehicle-1", "observer-1"));
    assert_eq!(done(&make(&inventory, Some(Whose::All), None, now).unwrap()).len(), 8);
    for number in [2, 3] {
        let before = fs::read(inventory.keys.join("observer-3.key")).unwrap();
        let lines = make(&inventory, None, Some(Whose::One(vehicle(3))), now).unwrap();
        let both = ["node 3", "observer at node 3"].map(|who| (who, "issued again: revoked"));
        assert_eq!(done(&lines), both);
        let names = (lines[3].name.as_str(), lines[7].name.as_str());
        assert_eq!(names, (&*format!("vehicle-3.{number}"), &*format!("observer-3.{number}")));
        assert_ne!(fs::read(inventory.keys.join("observer-3.key")).unwrap(), before);
    }
    assert_eq!(fs::read_to_string(inventory.keys.join(ORDERS_PUBLIC)).unwrap(), public_key);
    let lines = make(&inventory, None, Some(Whose::One(Role::Operator)), now).unwrap();
    assert_eq!(done(&lines), [("operator", "issued again: revoked"), ("orders' key", "made again: revoked")]);
    let anew = fs::read_to_string(inventory.keys.join(ORDERS_PUBLIC)).unwrap();
    assert!(
        anew != public_key && anew.trim().len() == 64 && anew.trim().bytes().all(|digit| digit.is_ascii_hexdigit())
    );
    assert_eq!(done(&make(&inventory, None, None, now).unwrap()), [], "all of it is kept");
    let names = Folder(inventory.keys.clone()).need_names().unwrap();
    assert_eq!((names.operator.as_str(), names.vehicles.len()), ("operator.2", 3));
    // A vehicle that leaves and comes back does not have its revoked name again.
    let fewer = lab(temporary.path(), 2, "");
    make(&fewer, None, None, now).unwrap();
    let back = make(&lab(temporary.path(), 3, ""), None, None, now).unwrap();
    assert_eq!(back[3].name, "vehicle-3.3");
}

#[test]
fn after_a_vehicles_revocation_the_swarm_has_to_land_first() {
    let next = |revoke| next(revoke, Path::new("cluster.toml"));
    assert_eq!(next(None), "next: skein cluster install -f cluster.toml");
    assert_eq!(next(Some(Whose::One(Role::Operator))), next(None));
    let of_vehicle = next(Some(Whose::One(vehicle(3))));
    assert!(of_vehicle.starts_with("next: skein cluster down, install, up, each with -f cluster.toml"), "{of_vehicle}");
}

#[test]
fn a_revoked_name_stays_revoked_when_the_names_file_is_lost() {
    let temporary = tempfile::tempdir().unwrap();
    let inventory = lab(temporary.path(), 3, "");
    let now = clock::utc();
    make(&inventory, None, None, now).unwrap();
    for role in [vehicle(2), vehicle(3), Role::Observer, Role::NodeObserver(id(1))] {
        make(&inventory, None, Some(Whose::One(role)), now).unwrap();
    }
    let folder = Folder(inventory.keys.clone());
    let names = folder.need_names().unwrap();
    assert_eq!(names.all_observers(), ["observer.2", "observer-1.2", "observer-2.2", "observer-3.2"]);
    let lose = || fs::remove_file(folder.path(NAMES)).unwrap();
    lose();
    assert_eq!(done(&make(&inventory, None, None, now).unwrap()), []);
    assert_eq!(folder.need_names().unwrap(), names);
    // The same for vehicles that have left the cluster or lost their key.
    lose();
    fs::remove_file(folder.path("vehicle-2.key")).unwrap();
    make(&lab(temporary.path(), 2, ""), None, None, now).unwrap();
    let anew = folder.need_names().unwrap();
    let name = |number| anew.vehicles[&id(number)].name.as_str();
    assert_eq!((name(2), name(3)), ("vehicle-2.2", "vehicle-3.2"));
}

/// Makes the folder one of an earlier version, in which every node had the operator's observer's key.
fn share_the_observer(folder: &Folder) {
    let names = Names { observers: Default::default(), ..folder.need_names().unwrap() };
    let text = names.to_toml().replace("\n[observers]\n", "");
    assert!(!text.contains("observers"), "{text}");
    folder.write(NAMES, &text).unwrap();
    for (name, _) in files(&folder.0).iter().filter(|(name, _)| name.starts_with("observer-")) {
        fs::remove_file(folder.path(name)).unwrap();
    }
}

#[test]
fn nodes_that_share_an_observers_key_get_one_each() {
    let temporary = tempfile::tempdir().unwrap();
    let inventory = lab(temporary.path(), 2, "");
    let now = clock::utc();
    let folder = Folder(inventory.keys.clone());
    make(&inventory, None, None, now).unwrap();
    for loses_names in [false, true] {
        share_the_observer(&folder);
        let before = pair(&folder, Role::Observer).key;
        let why = check_for_flight(&inventory, now).unwrap_err().to_string();
        let expected = "names.toml: the observer at node 1, 2 has no key of its own, which a revocation of the node would \
                        revoke: `skein cluster keys -f ";
        assert!(why.contains(expected) && why.contains("`skein cluster install -f "), "{why}");
        if loses_names {
            fs::remove_file(folder.path(NAMES)).unwrap();
        }
        assert_eq!(
            done(&make(&inventory, None, None, now).unwrap()),
            [
                ("observer", "issued again: every node had its key"),
                ("observer at node 1", "made"),
                ("observer at node 2", "made")
            ]
        );
        assert_ne!(pair(&folder, Role::Observer).key, before, "the key that lies on the nodes is worthless");
        assert!(check_for_flight(&inventory, now).is_ok());
        assert_eq!(done(&make(&inventory, None, None, now).unwrap()), []);
    }
    assert_eq!(folder.need_names().unwrap().all_observers(), ["observer.3", "observer-1", "observer-2"]);
}

/// Copies the files of a specimen, which are private only to their owner after that.
fn copy_specimen(from: &Path, to: &Path) -> Inventory {
    os::private_folder(&to.join("keys")).unwrap();
    for name in ["cluster.toml", "scenario.toml"] {
        fs::copy(from.join(name), to.join(name)).unwrap();
    }
    let folder = Folder(to.join("keys"));
    for (name, content) in files(&from.join("keys")) {
        folder.write(&name, &String::from_utf8(content).unwrap()).unwrap();
    }
    Inventory::read(&to.join("cluster.toml")).unwrap()
}

#[test]
fn keys_that_earlier_releases_made_stay_valid() {
    let specimens = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/specimens");
    let with_keys =
        |entry: std::io::Result<fs::DirEntry>| Some(entry.unwrap().path()).filter(|path| path.join("keys").exists());
    let folders: Vec<_> = fs::read_dir(specimens).unwrap().filter_map(with_keys).collect();
    assert!(folders.len() >= 2, "{folders:?}");
    for specimen in folders {
        let temporary = tempfile::tempdir().unwrap();
        let inventory = copy_specimen(&specimen, temporary.path());
        let before = files(&inventory.keys);
        let authority = fs::read_to_string(inventory.keys.join(AUTHORITY)).unwrap();
        let issued = expires(&authority).unwrap() - Duration::days(3650);
        let lines = make(&inventory, None, None, issued + Duration::days(1)).unwrap();
        let replaced = done(&lines);
        let is_of_before = specimen.ends_with("messages-6");
        assert_eq!(replaced.len(), if is_of_before { 3 } else { 0 }, "{}: {replaced:?}", specimen.display());
        for (name, content) in before {
            let is_kept = fs::read(inventory.keys.join(&name)).unwrap() == content;
            let is_observers = is_of_before && (name.starts_with("observer.") || name == NAMES);
            assert_eq!(is_kept, !is_observers, "{}: {name}", specimen.display());
        }
    }
}

#[test]
fn the_valid_key_is_the_key_of_the_certificate() {
    let temporary = tempfile::tempdir().unwrap();
    let inventory = lab(temporary.path(), 2, "");
    let now = clock::utc();
    let folder = Folder(inventory.keys.clone());
    let known = || folder.need_names().unwrap().vehicles[&id(1)].key;
    make(&inventory, None, None, now).unwrap();
    let first = known();
    assert_eq!(SigningKey::from_pem(&pair(&folder, vehicle(1)).key).unwrap().key(), first);
    make(&inventory, Some(Whose::All), None, now).unwrap();
    assert_eq!(known(), first, "renewing changes nothing for the other nodes");
    make(&inventory, None, Some(Whose::One(vehicle(1))), now).unwrap();
    let second = known();
    assert_ne!(second, first);
    // A key of another algorithm cannot sign.
    fs::write(folder.path("vehicle-1.key"), rcgen::KeyPair::generate().unwrap().serialize_pem()).unwrap();
    assert_eq!(
        done(&make(&inventory, None, None, now).unwrap()),
        [("node 1", "issued again: does not belong to its key")]
    );
    assert_eq!(SigningKey::from_pem(&pair(&folder, vehicle(1)).key).unwrap().key(), known());
    fs::write(folder.path(ORDERS_KEY), "no key").unwrap();
    assert!(
        make(&inventory, None, None, now)
            .unwrap_err()
            .to_string()
            .ends_with("orders.key: not an Ed25519 key in PKCS#8")
    );
}

#[test]
fn impossible_requests_are_refused() {
    let temporary = tempfile::tempdir().unwrap();
    let inventory = lab(temporary.path(), 2, "");
    let now = clock::utc();
    let refused = |renew, revoke| make(&inventory, renew, revoke, now).unwrap_err().to_string();
    assert!(refused(Some(Whose::One(vehicle(7))), None).starts_with("vehicle 7 is not in "));
    assert!(refused(None, Some(Whose::All)).starts_with("--revoke all "));
    make(&inventory, None, None, now).unwrap();
    fs::remove_file(inventory.keys.join(AUTHORITY_KEY)).unwrap();
    assert!(refused(None, None).contains("authority.key is missing, and nothing can be issued without it"));
    let plain = lab(temporary.path(), 2, "security = 'none'");
    assert!(make(&plain, None, None, now).unwrap_err().to_string().contains("this cluster has no keys"));
    assert_eq!("3".parse(), Ok(Whose::One(vehicle(3))));
    assert!("three".parse::<Whose>().is_err());
}

#[test]
fn the_keys_in_the_folder_connect_to_the_swarm() {
    let temporary = tempfile::tempdir().unwrap();
    let inventory = lab(temporary.path(), 2, "");
    assert!(reach(&inventory, Role::Observer).unwrap_err().to_string().contains("`skein cluster keys` creates it"));
    make(&inventory, None, None, clock::utc()).unwrap();
    let operator = reach(&inventory, Role::Operator).unwrap();
    assert_eq!((operator.swarm.as_str(), operator.agents.len()), ("lab", 2));
    let Security::Tls(tls) = operator.security else { panic!("secured") };
    assert_eq!((tls.key, tls.vehicles.len()), (inventory.keys.join("operator.key"), 2));
    assert_eq!(tls.vehicles[&id(1)].name, "vehicle-1");
    let signing_key = SigningKey::from_pem(&fs::read_to_string(inventory.keys.join("orders.key")).unwrap()).unwrap();
    assert_eq!(
        (operator.orders_key, operator.signing_key.unwrap().key()),
        (Some(signing_key.key()), signing_key.key())
    );
    assert!(reach(&inventory, Role::Observer).unwrap().signing_key.is_none(), "an observer cannot sign orders");
    fs::write(inventory.keys.join("orders.pub"), "0".repeat(64)).unwrap();
    let error = reach(&inventory, Role::Operator).unwrap_err().to_string();
    assert!(error.contains("orders.key") && error.contains("not the private key of orders.pub"), "{error}");
    fs::write(inventory.keys.join("orders.pub"), "7").unwrap();
    assert!(reach(&inventory, Role::Observer).unwrap_err().to_string().contains("64 hexadecimal digits"));
    let plain = lab(temporary.path(), 2, "security = 'none'");
    let plain = reach(&plain, Role::Observer).unwrap();
    assert_eq!((plain.security, plain.orders_key, plain.signing_key.is_none()), (Security::Plain, None, true));
}

#[test]
fn the_certificates_of_a_fleet_are_for_one_vehicle_of_one_team() {
    let temporary = tempfile::tempdir().unwrap();
    let inventory = fleet(temporary.path(), TEAMS).unwrap();
    let now = clock::utc();
    let folder = Folder(inventory.keys.clone());
    let lines = make(&inventory, None, None, now).unwrap();
    let of_nodes: Vec<_> = lines.iter().filter(|line| line.who.starts_with("node ")).collect();
    assert_eq!((of_nodes.len(), of_nodes[2].who.as_str(), of_nodes[2].name.as_str()), (7, "node 2/1", "vehicle-2-1"));
    let whose: Whose = "2/1".parse().unwrap();
    make(&inventory, None, Some(whose), now).unwrap();
    let names = folder.need_names().unwrap();
    let name = |vehicle: &str| names.vehicles[&vehicle.parse().unwrap()].name.as_str();
    assert_eq!(
        [name("1/1"), name("2/1"), name("2/2"), name("3/1")],
        ["vehicle-1-1", "vehicle-2-1.2", "vehicle-2-2", "vehicle-3-1"]
    );
    let observers = names.all_observers().join(" ");
    assert!(observers.starts_with("observer observer-1-1 observer-1-2 observer-2-1.2 observer-2-2 "), "{observers}");
    // A lost list of names is made again from the certificates.
    fs::remove_file(folder.path("names.toml")).unwrap();
    assert_eq!(done(&make(&inventory, None, None, now).unwrap()), []);
    assert_eq!(folder.need_names().unwrap(), names);
    let unknown = make(&inventory, None, Some("2/4".parse().unwrap()), now).unwrap_err().to_string();
    assert!(unknown.contains("vehicle 2/4 is not in"), "{unknown}");
}
