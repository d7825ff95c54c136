//! Intruders in a flying swarm: some without a valid certificate, one with the key of a captured node. They send every
//! message that they can make, over and over, through Skein's own links.

use std::collections::BTreeMap;
use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::sleep;
use std::time::{Duration, Instant};

use rcgen::{CertificateParams, DnType, ExtendedKeyUsagePurpose, Issuer, KeyPair, date_time_ymd};
use rustls_pki_types::CertificateDer;
use rustls_pki_types::pem::PemObject;
use serde_json::json;
use skein_agent::link::security::{PeerIdentity, Tls};
use skein_agent::link::signature::messages::{ADDED_BYTES, KeyRing};
use skein_agent::link::signature::{SigningKey, VerificationKey};
use skein_agent::link::{Security, Sessions};
use skein_cluster::inventory::Inventory;
use skein_cluster::keys::Role;
use skein_common::frame::{Geodetic, VelocityNed};
use skein_common::id::{Incarnation, SwarmName, VehicleId, VehicleName, VehicleSet};
use skein_common::message::{self, Header, Heartbeat, Message, Order, Signature, State, Verb};
use skein_common::state::{Membership, VehicleState};
use skein_common::time::SenderStamp;
use skein_common::topic::{Cell, Topic};
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::{ClientConfig, ClientConnection, RootCertStore, Stream};
use zenoh::Wait;
use zenoh::sample::Locality;

use super::lab::{HOSTS, Lab};

/// Intruders without a valid certificate, by the folder of their files.
pub(super) const UNINVITED: [&str; 3] = ["none", "other", "expired"];
/// The intruder that has captured node 3, by the folder of its files.
pub(super) const TAKEN_OVER: &str = "valid";
/// The vehicle of the captured node.
pub(super) const OWN: u8 = 3;
/// The vehicle in whose name the intruders send.
pub(super) const VICTIM: u8 = 5;
/// Issuer of the forged orders.
const FORGER: u64 = 77;
/// Duration of an intrusion.
const DURATION: Duration = Duration::from_secs(6);
/// Environment variable of an intruder's process with the folder of its files.
const FILES_VARIABLE: &str = "SKEIN_INTRUDER";

/// Puts the files of each intruder onto the intruders' PC.
pub(super) fn equip(lab: &Lab) {
    let keys = lab.operator().path("/root/lab/keys");
    lab.intruder().put_program(&std::env::current_exe().unwrap(), "/opt/intruder");
    lab.operator().sh("mkdir other && cp lab/*.toml other").succeeded();
    lab.skein("cluster keys -f other/cluster.toml", 30).succeeded();
    let others = lab.operator().path("/root/other/keys");
    let inventory = Inventory::read(&lab.operator().path("/root/lab/cluster.toml")).unwrap();
    let reach = inventory.reaches(Role::Observer).unwrap().remove(0);
    let Security::Tls(tls) = reach.security else { panic!("the swarm is secured") };
    let known = serde_json::to_string(&tls.vehicles.values().collect::<Vec<_>>()).unwrap();
    let folder = |who: &str| {
        let folder = lab.intruder().path("/root").join(who);
        fs::create_dir_all(&folder).unwrap();
        fs::copy(keys.join("authority.pem"), folder.join("authority.pem")).unwrap();
        fs::write(folder.join("known.json"), &known).unwrap();
        folder
    };
    folder("none");
    let own = format!("vehicle-{OWN}");
    for (who, keys, name) in [("other", &others, &*own), (TAKEN_OVER, &keys, &own)] {
        let folder = folder(who);
        for end in ["pem", "key"] {
            fs::copy(keys.join(format!("{name}.{end}")), folder.join(format!("own.{end}"))).unwrap();
        }
    }
    expired(&keys, &folder("expired"));
}

/// Makes a certificate of the right name and authority that has expired.
fn expired(keys: &Path, folder: &Path) {
    let read = |name: &str| fs::read_to_string(keys.join(name)).unwrap();
    let authority = KeyPair::from_pem(&read("authority.key")).unwrap();
    let issuer = Issuer::from_ca_cert_pem(&read("authority.pem"), authority).unwrap();
    let key = KeyPair::generate().unwrap();
    let mut about = CertificateParams::default();
    about.distinguished_name.push(DnType::CommonName, format!("vehicle-{OWN}"));
    about.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth, ExtendedKeyUsagePurpose::ClientAuth];
    (about.not_before, about.not_after) = (date_time_ymd(2020, 1, 1), date_time_ymd(2021, 1, 1));
    fs::write(folder.join("own.pem"), about.signed_by(&key, &issuer).unwrap().pem()).unwrap();
    fs::write(folder.join("own.key"), key.serialize_pem()).unwrap();
}

/// Result of one intrusion.
#[derive(Debug)]
pub(super) struct Outcome {
    /// Largest number of nodes that the intruder was linked with.
    pub(super) links: u64,
    /// Number of messages that the intruder sent.
    pub(super) sent: u64,
}

/// Starts all these intruders at once and waits for their results.
pub(super) fn start(lab: &Lab, who: &[&str]) -> Vec<Outcome> {
    let start = |who: &&str| -> Child {
        let mut command = lab.intruder().command("env");
        command.arg(format!("{FILES_VARIABLE}={who}")).arg("/opt/intruder").args([
            "--exact",
            "cluster::intruder",
            "--ignored",
        ]);
        command.arg("--nocapture").stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap()
    };
    let children: Vec<Child> = who.iter().map(start).collect();
    let outcomes = children.into_iter().map(|child| {
        let out = child.wait_with_output().unwrap().stdout;
        let out = String::from_utf8_lossy(&out).into_owned();
        let value = out.lines().find_map(|line| serde_json::from_str::<serde_json::Value>(line).ok());
        let value = value.filter(serde_json::Value::is_object).unwrap_or_else(|| panic!("an intruder printed {out:?}"));
        Outcome { links: value["links"].as_u64().unwrap(), sent: value["sent"].as_u64().unwrap() }
    });
    outcomes.collect()
}

/// The process of an intruder.
pub(super) fn intrude() {
    let Ok(who) = std::env::var(FILES_VARIABLE) else { return };
    let intruder = Intruder::open(&who);
    let session = intruder.sessions.first();
    let received = Arc::<Mutex<Vec<(String, Vec<u8>)>>>::default();
    let into = received.clone();
    let listen = move |sample: zenoh::sample::Sample| {
        into.lock().unwrap().push((sample.key_expr().to_string(), sample.payload().to_bytes().into_owned()));
    };
    session
        .declare_subscriber("vehicle/*/**")
        .allowed_origin(Locality::Remote)
        .callback(listen)
        .background()
        .wait()
        .unwrap();
    let (mut links, mut sent) = (0, 0);
    let until = Instant::now() + DURATION;
    if who == UNINVITED[0] {
        knock(&Path::new("/root").join(&who));
    }
    while Instant::now() < until {
        sleep(Duration::from_millis(100));
        links = links.max(session.info().peers_zid().wait().count());
        let received = received.lock().unwrap().clone();
        sent += intruder.forge(run(&received));
        sent += intruder.replay(run(&received), &received);
    }
    let mut out = std::io::stdout().lock();
    writeln!(out, "\n{}", json!({ "links": links, "sent": sent })).unwrap();
}

/// The run of the swarm, read from a received message.
fn run(received: &[(String, Vec<u8>)]) -> u64 {
    let run =
        |bytes: &[u8]| Some(u64::from_le_bytes(*bytes[..bytes.len().checked_sub(Signature::BYTES)?].last_chunk()?));
    received.first().and_then(|(_, bytes)| run(bytes)).unwrap_or(0)
}

/// Connects to each node without a certificate.
fn knock(folder: &Path) {
    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_file(folder.join("authority.pem")).unwrap()).unwrap();
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()));
    let config = config.with_safe_default_protocol_versions().unwrap().with_root_certificates(roots);
    let config = Arc::new(config.with_no_client_auth());
    for (address, port) in nodes() {
        let mut tls = ClientConnection::new(config.clone(), address.clone().try_into().unwrap()).unwrap();
        let mut socket = TcpStream::connect((address, port)).unwrap();
        let answer = Stream::new(&mut tls, &mut socket).read(&mut [0; 1]);
        assert!(answer.is_err(), "the node accepts a link without a certificate");
    }
}

/// Address and port of each node.
fn nodes() -> impl Iterator<Item = (String, u16)> {
    (1..=HOSTS).map(|id| (format!("10.79.0.{id}"), 7446 + u16::from(id)))
}

/// Opens a session with the intruder's files; without a certificate over plain TCP.
fn open(who: &str) -> Sessions {
    let folder = Path::new("/root").join(who);
    let [authority, certificate, key] = ["authority.pem", "own.pem", "own.key"].map(|file| folder.join(file));
    let (protocol, security) = match certificate.exists() {
        false => ("tcp", Security::Plain),
        true => {
            // The intruder itself accepts every certificate.
            let known: Vec<PeerIdentity> =
                serde_json::from_slice(&fs::read(folder.join("known.json")).unwrap()).unwrap();
            let vehicles = VehicleId::first(HOSTS.into()).map(VehicleName::from).zip(known).collect();
            let (observers, operator) = (vec!["observer".to_owned()], "operator".to_owned());
            (
                "tls",
                Security::Tls(Tls {
                    authority,
                    certificate,
                    key,
                    orders: VerificationKey([0; 32]),
                    vehicles,
                    observers,
                    operator,
                }),
            )
        }
    };
    let dial: Vec<String> = nodes().map(|(address, port)| format!("{protocol}/{address}:{port}")).collect();
    Sessions::open(&SwarmName::new("lab").unwrap(), &[], &dial, &security).unwrap()
}

/// An intruder with its sessions and its signing key.
struct Intruder {
    sessions: Sessions,
    key_ring: KeyRing,
    signing_key: Option<SigningKey>,
}

impl Intruder {
    fn open(who: &str) -> Self {
        let key = fs::read_to_string(Path::new("/root").join(who).join("own.key"));
        let signing_key = key.ok().and_then(|key| SigningKey::from_pem(&key).ok());
        let key_ring = KeyRing::signed(SwarmName::new("lab").unwrap(), BTreeMap::new());
        Self { sessions: open(who), key_ring, signing_key }
    }

    /// Publishes bytes; without links they reach no node.
    fn publish(&self, key: &str, bytes: Vec<u8>) -> u64 {
        self.sessions.first().put(key, bytes).wait().unwrap();
        1
    }

    /// Sends a message with the intruder's own signature, and without one.
    fn send(&self, run: u64, topic: Topic, message: &impl Message) -> u64 {
        let key = topic.key();
        self.publish(&key, self.key_ring.write(self.signing_key.as_ref(), run, &key, message))
            + self.publish(&key, message::encode(message))
    }

    /// Sends messages in the name of another vehicle and of an operator.
    fn forge(&self, run: u64) -> u64 {
        let id = VehicleId::new(VICTIM).unwrap();
        let header =
            Header { sender: id, incarnation: Incarnation(u64::MAX), sequence: u64::MAX, stamp: SenderStamp::ZERO };
        let position = Geodetic::from_degrees(28.0, -82.0, 5.0);
        let state = VehicleState { position, velocity: VelocityNed::new(0.0, 0.0, 0.0), heading_rad: 0.0 };
        let mission = Heartbeat {
            header,
            plan: 0,
            membership: Membership::Active,
            step: 399,
            vouched: 399,
            reached: Some(399),
            progress_m: 0.0,
            order: Some(order(None)),
            orders: 0,
            echo: None,
            lost: VehicleSet::default(),
        };
        let sent = self.send(run, Topic::State(id, Cell::default()), &State { header, state })
            + self.send(run, Topic::Mission(id), &mission)
            + self.publish(&Topic::Order(FORGER).key(), message::encode(&order(None)));
        // Its liveliness token appears and disappears.
        drop(self.sessions.first().liveliness().declare_token(Topic::Alive(id).key()).wait().unwrap());
        sent + 1
    }

    /// Replays received messages: own and foreign ones again, foreign ones under the own key, and an order in the own
    /// heartbeat.
    fn replay(&self, run: u64, received: &[(String, Vec<u8>)]) -> u64 {
        let of = |id: u8, kind: &str| {
            let branch = format!("vehicle/{id}/");
            received
                .iter()
                .filter(move |(key, _)| key.starts_with(&branch))
                .filter(move |(key, _)| key.ends_with(kind))
                .cloned()
                .collect::<Vec<_>>()
        };
        let mut sent = 0;
        for kind in ["state", "mission"] {
            for (key, bytes) in [OWN, VICTIM].iter().filter_map(|id| of(*id, kind).first().cloned()) {
                sent += self.publish(&key, bytes);
            }
            if let (Some((key, _)), Some((_, bytes))) = (of(OWN, kind).last(), of(VICTIM, kind).last()) {
                sent += self.publish(key, bytes.clone());
            }
        }
        let last = of(OWN, "mission").pop().filter(|(_, bytes)| bytes.len() > ADDED_BYTES);
        if let Some((_, bytes)) = last
            && let Ok(own) = message::decode::<Heartbeat>(&bytes[..bytes.len() - ADDED_BYTES])
        {
            for signature in [None, Some(Signature::from_bytes([7; Signature::BYTES]))] {
                let header = Header { sequence: own.header.sequence + 1, ..own.header };
                let order = Some(order(signature));
                sent += self.send(run, Topic::Mission(header.sender), &Heartbeat { header, order, ..own });
            }
        }
        sent
    }
}

fn order(signature: Option<Signature>) -> Order {
    Order { epoch: 1 << 40, issuer: FORGER, verb: Verb::Abort, vehicles: None, signature }
}
