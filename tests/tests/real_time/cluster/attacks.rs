//! What attackers with and without stolen keys do to a flying cluster: how late its control steps are, how old its states, and
//! how long a restarted vehicle takes to be in contact again. The attackers are on the bridge, beside the hosts.

use std::fs;
use std::io::Write;
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::thread::{self, sleep};
use std::time::{Duration, Instant};

use rustls_pki_types::pem::PemObject;
use rustls_pki_types::{CertificateDer, PrivateKeyDer};
use skein_agent::link::{Security, Sessions};
use skein_cluster::inventory::Inventory;
use skein_cluster::keys::Role;
use skein_common::id::{SwarmName, VehicleId};
use skein_common::topic::{Cell, Topic};
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::{ClientConfig, ClientConnection, RootCertStore, Stream};
use zenoh::Wait;

use super::flight::Flight;
use super::host::kill;
use super::lab::{HOSTS, Lab};
use super::print_line;
use super::sky::{Sky, now_s};

/// The attacks: name in the table, and what it does.
const ATTACKS: [(&str, &str); 7] = [
    ("none", "nothing"),
    ("idle", "120 links with the keys of eight observers, idle"),
    ("silent", "360 open sockets without a handshake"),
    ("handshakes", "as many first halves of a handshake as one core makes"),
    ("declares", "an observer's key: subscriptions without end"),
    ("floods", "an observer's key: messages in a vehicle's name without end"),
    ("stops", "12 observers that subscribe to everything and then stop reading"),
];
/// Time that each attack is measured for before a vehicle is restarted.
const MEASURED: Duration = Duration::from_secs(12);
/// Time for an attack to begin and to end.
const BEGINS: Duration = Duration::from_secs(3);
/// Longest time of an attack.
const ATTACK: Duration = Duration::from_secs(90);
/// Environment variable of an attacker's process with the name of its attack.
const ATTACK_VARIABLE: &str = "SKEIN_ATTACK";
/// Folder of the attacker's files on its PC.
const FILES: &str = "/root/stolen";
/// Host that is attacked most, because its agent accepts the links of all others.
const FIRST: u8 = 1;

/// Flies a ring of eight and prints a row for each attack.
pub(super) fn print() {
    let mut flight = Flight::prepare();
    let sky = flight.start();
    flight.form(&sky);
    steal(&flight.lab);
    print_line(&format!(
        "{:<11} {:>11} {:>8} {:>5} {:>10} {:>9} {:>9} {:>9} {:>6}",
        "attack", "step p99 us", "max us", "late", "jitter ms", "age p99", "age max", "memory MB", "back s"
    ));
    // Another vehicle each time, because a supervisor waits longer before each further start.
    for ((name, _), restarted) in ATTACKS.into_iter().zip(FIRST + 1..) {
        let mut attacker = start(&flight.lab, name);
        sleep(BEGINS);
        let from_s = now_s();
        sleep(MEASURED);
        let row = Row::of(&flight.lab, &sky, from_s);
        let back_s = flight.restart(&sky, restarted);
        flight.lab.intruder().processes(&["attacker"]).into_iter().for_each(kill);
        // `nsenter` stops with a program that stops.
        let _ = attacker.kill();
        let done = attacker.wait_with_output().map(|ended| String::from_utf8_lossy(&ended.stdout).into_owned());
        print_line(&format!("{name:<11} {row} {back_s:>6.2}"));
        let said = done.unwrap_or_default();
        said.lines().rfind(|line| line.starts_with("attack:")).into_iter().for_each(print_line);
        sleep(BEGINS);
        assert!(sky.now().all(HOSTS.into(), |vehicle| vehicle.is_active), "a vehicle is lost: {:?}", sky.now());
    }
    for (name, what) in ATTACKS {
        print_line(&format!("{name:<11} {what}"));
    }
    flight.cluster("down", 90).succeeded();
}

/// What the vehicles measured during an attack.
struct Row {
    step_p99_us: f64,
    step_max_us: f64,
    late: f64,
    jitter_ms: f64,
    age_p99_ms: f64,
    age_max_ms: f64,
    memory_mb: f64,
}

impl Row {
    fn of(lab: &Lab, sky: &Sky, from_s: f64) -> Self {
        let snapshots = sky.since(from_s);
        let all = |value: fn(&super::sky::Measured) -> f64| {
            let vehicles = snapshots.iter().flat_map(|snapshot| &snapshot.vehicles);
            let mut values: Vec<f64> =
                vehicles.map(|vehicle| value(&vehicle.measured)).filter(|value| value.is_finite()).collect();
            values.sort_by(f64::total_cmp);
            values
        };
        let p99 = |values: &[f64]| values.get(values.len() * 99 / 100).copied().unwrap_or(f64::NAN);
        let max = |values: &[f64]| values.last().copied().unwrap_or(f64::NAN);
        let late = |at: Option<&super::sky::Snapshot>| {
            at.map_or(f64::NAN, |at| at.vehicles.iter().map(|vehicle| vehicle.measured.late).sum())
        };
        let (steps, ages) = (all(|measured| measured.step_us), all(|measured| measured.oldest_ms));
        Self {
            step_p99_us: p99(&steps),
            step_max_us: max(&steps),
            late: late(snapshots.last()) - late(snapshots.first()),
            jitter_ms: max(&all(|measured| measured.jitter_ms)),
            age_p99_ms: p99(&ages),
            age_max_ms: max(&ages),
            memory_mb: memory_mb(lab),
        }
    }
}

impl std::fmt::Display for Row {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { step_p99_us, step_max_us, late, jitter_ms, age_p99_ms, age_max_ms, memory_mb } = self;
        write!(
            f,
            "{step_p99_us:>11.0} {step_max_us:>8.0} {late:>5.0} {jitter_ms:>10.1} {age_p99_ms:>9.0} {age_max_ms:>9.0} {memory_mb:>9.1}"
        )
    }
}

/// Memory of the first agent, MB.
fn memory_mb(lab: &Lab) -> f64 {
    let agents = lab.host(FIRST).processes(&["skein", "agent"]);
    let of = |agent: &u32| skein_tests::processes::resources(*agent).map(|of| of.memory_mb);
    agents.iter().filter_map(of).fold(0.0, f64::max)
}

/// Puts the files of all nodes' observers onto the attacker's PC.
fn steal(lab: &Lab) {
    let (from, to) = (lab.operator().path("/root/lab"), lab.intruder().path(FILES));
    fs::create_dir_all(to.join("keys")).unwrap();
    let mut files = vec!["cluster.toml".to_owned(), "ring.toml".to_owned()];
    let observers = (1..=HOSTS).map(|id| format!("observer-{id}")).chain(["observer".to_owned()]);
    files.extend(observers.flat_map(|who| ["pem", "key"].map(|end| format!("keys/{who}.{end}"))));
    files.extend(["authority.pem", "names.toml", "orders.pub"].map(|name| format!("keys/{name}")));
    for file in files {
        fs::copy(from.join(&file), to.join(&file)).unwrap();
    }
    lab.intruder().put_program(&std::env::current_exe().unwrap(), "/opt/attacker");
}

/// Starts this attack on the attacker's PC. With `SKEIN_ATTACKER_CPU` the attacker has this processor: on a PC of its own it would
/// take nothing from the hosts, which the test then runs on another (`taskset -c 0`).
fn start(lab: &Lab, name: &str) -> Child {
    let own = std::env::var("SKEIN_ATTACKER_CPU").ok();
    let mut command = lab.intruder().command(if own.is_some() { "taskset" } else { "env" });
    command.args(own.iter().flat_map(|cpu| ["-c", cpu, "env"]));
    command.arg(format!("{ATTACK_VARIABLE}={name}")).arg("/opt/attacker").args([
        "--exact",
        "cluster::attacker",
        "--ignored",
    ]);
    command.arg("--nocapture").stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap()
}

/// The process of an attacker.
pub(super) fn attack() {
    let Ok(name) = std::env::var(ATTACK_VARIABLE) else { return };
    let count = &AtomicU64::new(0);
    thread::scope(|scope| {
        scope.spawn(|| match name.as_str() {
            "idle" => idle(count),
            "silent" => silent(count),
            "handshakes" => handshakes(count),
            "declares" => declare(count),
            "floods" => flood(count),
            "stops" => stop(count),
            _ => {}
        });
        let (begin, mut before) = (Instant::now(), 0);
        while begin.elapsed() < ATTACK {
            sleep(Duration::from_secs(1));
            let now = count.load(Relaxed);
            println!("attack: {now} in all, {} in the last second", now - before);
            before = now;
        }
        std::process::exit(0);
    });
}

/// Address of each node.
fn nodes() -> impl Iterator<Item = (String, u16)> {
    (1..=HOSTS).map(|id| (format!("10.79.0.{id}"), 7446 + u16::from(id)))
}

/// What TLS needs to dial as this observer.
fn tls(who: &str) -> Arc<ClientConfig> {
    let keys = Path::new(FILES).join("keys");
    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_file(keys.join("authority.pem")).unwrap()).unwrap();
    let certificate = CertificateDer::from_pem_file(keys.join(format!("{who}.pem"))).unwrap();
    let key = PrivateKeyDer::from_pem_file(keys.join(format!("{who}.key"))).unwrap();
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()));
    let config = config.with_safe_default_protocol_versions().unwrap().with_root_certificates(roots);
    Arc::new(config.with_client_auth_cert(vec![certificate], key).unwrap())
}

/// Fifteen links under each of eight keys, all with the first node, which say nothing.
fn idle(count: &AtomicU64) {
    let (address, port) = nodes().next().unwrap();
    let mut links = Vec::new();
    let configs: Vec<_> = (1..=HOSTS).map(|id| tls(&format!("observer-{id}"))).collect();
    loop {
        for config in &configs {
            let of_key = links.iter().filter(|(of, _)| Arc::ptr_eq(of, config)).count();
            let Ok(mut socket) = TcpStream::connect((address.clone(), port)) else { continue };
            let mut tls = ClientConnection::new(config.clone(), address.clone().try_into().unwrap()).unwrap();
            if of_key < 15 && Stream::new(&mut tls, &mut socket).flush().is_ok() {
                links.push((config.clone(), (tls, socket)));
                count.fetch_add(1, Relaxed);
            }
        }
        // The nodes end a link that opens no session.
        links.retain(|(_, (_, socket))| {
            let mut byte = [0];
            socket.set_nonblocking(true).unwrap();
            !matches!(socket.peek(&mut byte), Ok(0))
        });
        sleep(Duration::from_millis(10));
    }
}

/// Sockets that are open and say nothing, 45 with each node; one that the node closes is opened again.
fn silent(count: &AtomicU64) {
    let mut sockets: Vec<TcpStream> = Vec::new();
    let nodes: Vec<_> = nodes().collect();
    loop {
        sockets.retain(|socket| !matches!(socket.peek(&mut [0]), Ok(0)));
        for node in nodes.iter().cycle().take(360 - sockets.len().min(360)) {
            if let Ok(socket) = TcpStream::connect((node.0.as_str(), node.1)) {
                socket.set_nonblocking(true).unwrap();
                sockets.push(socket);
                count.fetch_add(1, Relaxed);
            }
        }
        sleep(Duration::from_millis(20));
    }
}

/// First halves of handshakes, one after the other, with all nodes in turn.
fn handshakes(count: &AtomicU64) {
    let config = tls("observer-3");
    let (address, _) = nodes().next().unwrap();
    let mut hello = Vec::new();
    let mut tls = ClientConnection::new(config, address.try_into().unwrap()).unwrap();
    tls.write_tls(&mut hello).unwrap();
    loop {
        for (address, port) in nodes() {
            if let Ok(mut socket) = TcpStream::connect((address, port)) {
                let _ = socket.write_all(&hello);
                count.fetch_add(1, Relaxed);
            }
        }
    }
}

/// Sessions with all nodes under the stolen key of the observer at node 3.
fn sessions() -> Sessions {
    let inventory = Inventory::read(&Path::new(FILES).join("cluster.toml")).unwrap();
    let mut reach = inventory.reaches(Role::NodeObserver(VehicleId::new(3).unwrap().into())).unwrap().remove(0);
    if let Security::Tls(tls) = &mut reach.security {
        let own = Path::new(FILES).join("keys/observer-3");
        (tls.certificate, tls.key) = (own.with_extension("pem"), own.with_extension("key"));
    }
    Sessions::open(&SwarmName::new("lab").unwrap(), &[], &reach.all(), &reach.security).unwrap()
}

fn declare(count: &AtomicU64) {
    let (sessions, mut kept) = (sessions(), Vec::new());
    loop {
        let key = format!("nothing/{}", kept.len());
        kept.push(sessions.first().declare_subscriber(key).callback(|_| {}).wait().unwrap());
        count.fetch_add(1, Relaxed);
        if kept.len().is_multiple_of(20) {
            sleep(Duration::from_millis(2));
        }
    }
}

fn flood(count: &AtomicU64) {
    let sessions = sessions();
    let key = Topic::State(VehicleId::new(5).unwrap(), Cell::default()).key();
    loop {
        let put = sessions.first().put(key.as_str(), vec![7; 200]).express(true);
        put.wait().unwrap();
        count.fetch_add(1, Relaxed);
        if count.load(Relaxed).is_multiple_of(10) {
            sleep(Duration::from_millis(1));
        }
    }
}

fn stop(count: &AtomicU64) {
    let all: Vec<_> = (0..12).map(|_| sessions()).collect();
    for sessions in &all {
        sessions.first().declare_subscriber("**").callback(|_| {}).background().wait().unwrap();
        count.fetch_add(1, Relaxed);
    }
    println!("attack: {} observers have stopped", count.load(Relaxed));
    sleep(Duration::from_secs(1));
    let own = rustix::process::getpid();
    rustix::process::kill_process(own, rustix::process::Signal::STOP).unwrap();
}
