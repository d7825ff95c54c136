//! Two sites that Zenoh routers join: the processes and the network.
//!
//! ```text
//!   site a: agents of teams 1 and 2 = router == relay -- joint -- router = agents of teams 3 and 4: site b
//!           10.81.1.1                          10.79.0.1  10.79.0.2                      10.81.2.1
//! ```
//!
//! Each site is a namespace, as one network of its own. Within a site every agent is linked with every other, and with the
//! site's router; the routers are linked through the joint alone. The relay delays what passes the joint, because this
//! kernel may not have netem.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::process::{Child, Stdio};
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};
use std::thread::{sleep, spawn};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use serde_json::Value;
use skein_common::message::{self, Health, State, Trace};
use skein_tests::namespaces::{Namespaces, ip};
use tempfile::TempDir;
use zenoh::{Config, Session, Wait};

const PROGRAM: &str = env!("CARGO_BIN_EXE_skein-under-test");
/// Environment variable with the arguments of a process of this file.
const ROLE: &str = "SKEIN_SITES";
/// The name of the swarm in its scenario, which is the namespace of its sessions.
const SWARM: &str = "two-sites";
/// Number of vehicles in each team.
pub(super) const MEMBERS: u8 = 4;
const ROUTER: &str = "7440";

/// Configuration of a site's router, as `zenohd --config` takes it: where it listens, and the router that it dials.
fn router_file(listen: &[String], dial: &[String]) -> String {
    format!(
        r#"{{
  mode: "router",
  listen: {{ endpoints: {listen:?} }},
  connect: {{ endpoints: {dial:?}, retry: {{ period_init_ms: 200, period_max_ms: 1000, period_increase_factor: 1.5 }} }},
  scouting: {{ multicast: {{ enabled: false }}, gossip: {{ enabled: false }} }},
  transport: {{ unicast: {{ open_timeout: 2000 }}, link: {{ tx: {{ lease: 2000, keep_alive: 4 }} }} }},
}}"#
    )
}

/// One of the two sites.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Site {
    A,
    B,
}

impl Site {
    pub(super) const BOTH: [Self; 2] = [Self::A, Self::B];

    fn name(self) -> &'static str {
        ["a", "b"][self as usize]
    }

    pub(super) fn teams(self) -> [u8; 2] {
        [[1, 2], [3, 4]][self as usize]
    }

    /// Its address for its own agents.
    fn address(self) -> &'static str {
        ["10.81.1.1", "10.81.2.1"][self as usize]
    }

    /// Its address at the joint.
    fn at_joint(self) -> &'static str {
        ["10.79.0.1", "10.79.0.2"][self as usize]
    }

    fn vehicles(self) -> impl Iterator<Item = (u8, u8)> {
        self.teams().into_iter().flat_map(|team| (1..=MEMBERS).map(move |vehicle| (team, vehicle)))
    }
}

/// What a process of this file printed, with the time at which it arrived.
pub(super) type Lines = Arc<Mutex<Vec<(Instant, String)>>>;

/// The two sites of a test, with their agents and routers.
pub(super) struct Sites {
    namespaces: Namespaces,
    folder: TempDir,
    processes: BTreeMap<String, Child>,
}

impl Sites {
    /// Makes the network, without a process.
    pub(super) fn new(scenario: &str) -> Self {
        let mut namespaces = Namespaces::new("sites");
        let [a, b] = Site::BOTH.map(|site| namespaces.add(site.name()));
        ip(&["link", "add", "joint", "netns", &a, "type", "veth", "peer", "name", "joint", "netns", &b]);
        for (site, namespace) in Site::BOTH.into_iter().zip([&a, &b]) {
            ip(&["-n", namespace, "addr", "add", &format!("{}/24", site.at_joint()), "dev", "joint"]);
            ip(&["-n", namespace, "addr", "add", &format!("{}/32", site.address()), "dev", "lo"]);
            ip(&["-n", namespace, "link", "set", "joint", "up"]);
        }
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("scenario.toml"), scenario).unwrap();
        Self { namespaces, folder, processes: BTreeMap::new() }
    }

    /// Starts the agents of both sites.
    pub(super) fn start_agents(&mut self) {
        for site in Site::BOTH {
            let mut below: Vec<String> = Vec::new();
            for (team, vehicle) in site.vehicles() {
                let port = 7500 + u16::from(team) * 10 + u16::from(vehicle);
                let own = format!("tcp/{}:{port}", site.address());
                let mut dial = below.clone();
                dial.push(format!("tcp/{}:{ROUTER}", site.address()));
                let file = format!(
                    "scenario = \"scenario.toml\"\nid = \"{team}/{vehicle}\"\nlisten = [{own:?}]\ndial = {dial:?}\n"
                );
                below.push(own);
                let path = self.folder.path().join(format!("{team}-{vehicle}.toml"));
                fs::write(&path, file).unwrap();
                let mut command = self.namespaces.command(site.name(), PROGRAM);
                command.args(["agent", "--config"]).arg(path).env_remove("RUST_LOG").stdin(Stdio::null());
                let log = File::create(self.log(team, vehicle)).unwrap();
                let agent = command.stdout(Stdio::null()).stderr(log).spawn().unwrap();
                self.processes.insert(format!("agent {team}/{vehicle}"), agent);
            }
        }
    }

    /// Starts the router of a site. That of site a dials that of site b through the relay.
    pub(super) fn start_router(&mut self, site: Site) {
        let inside = format!("tcp/{}:{ROUTER}", site.address());
        let (listen, dial) = match site {
            Site::A => (vec![inside], vec![format!("tcp/127.0.0.1:{ROUTER}")]),
            Site::B => (vec![inside, format!("tcp/{}:{ROUTER}", site.at_joint())], vec![]),
        };
        self.start(site, &format!("router {}", site.name()), "router", &router_file(&listen, &dial));
    }

    /// Starts the relay of the joint, which delays everything by this time in each direction.
    pub(super) fn start_relay(&mut self, delay: Duration) {
        let to = format!("{}:{ROUTER} {}", Site::B.at_joint(), delay.as_millis());
        self.start(Site::A, "relay", "relay", &to);
    }

    /// Starts a process at a site that listens to the messages of the swarm, linked with the site's router alone or, if
    /// `directly`, with all agents of the site, and returns what it prints.
    pub(super) fn start_listener(&mut self, site: Site, directly: bool) -> Lines {
        let router = format!("tcp/{}:{ROUTER}", site.address());
        let agent =
            |(team, vehicle)| format!("tcp/{}:{}", site.address(), 7500 + u16::from(team) * 10 + u16::from(vehicle));
        let dial: Vec<String> = if directly { site.vehicles().map(agent).collect() } else { vec![router] };
        let role = if directly { "observe" } else { "listen" };
        self.start(site, &format!("{role} {}", site.name()), role, &format!("{dial:?}"))
    }

    /// Starts a process at a site that publishes the time fifty times a second through the site's router.
    pub(super) fn start_clock(&mut self, site: Site) {
        let dial = [format!("tcp/{}:{ROUTER}", site.address())];
        self.start(site, "clock", "clock", &format!("{dial:?}"));
    }

    /// Ends a process at once.
    pub(super) fn kill(&mut self, process: &str) {
        end(&mut self.processes.remove(process).unwrap());
    }

    /// Disconnects the joint, or connects it again: no packet passes, and neither end notices.
    pub(super) fn cut(&self, cut: bool) {
        ip(&["-n", &self.namespaces.name("a"), "link", "set", "joint", if cut { "down" } else { "up" }]);
    }

    /// Lets each packet at the joint be lost with this probability, in percent; both directions alike.
    pub(super) fn lose(&self, percent: u32) {
        let rule = format!("iifname \"joint\" numgen random mod 100 < {percent} drop");
        let rules = format!("table inet joint {{\nchain in {{\ntype filter hook input priority 0;\n{rule}\n}}\n}}\n");
        for site in Site::BOTH {
            let status = self.namespaces.command(site.name(), "nft").arg(&rules).status().unwrap();
            assert!(status.success(), "nft {rules}");
        }
    }

    /// Number of bytes that have come in and gone out at site a's end of the joint, and of packets.
    pub(super) fn at_joint(&self) -> [u64; 4] {
        let count = |name: &str| {
            let path = format!("/sys/class/net/joint/statistics/{name}");
            let output = self.namespaces.command("a", "cat").arg(path).output().unwrap();
            String::from_utf8(output.stdout).unwrap().trim().parse().unwrap()
        };
        ["rx_bytes", "tx_bytes", "rx_packets", "tx_packets"].map(count)
    }

    /// The logs of all agents of a site, each line with its vehicle in front.
    pub(super) fn logs(&self, site: Site) -> Vec<String> {
        let lines = |(team, vehicle): (u8, u8)| {
            let text = fs::read_to_string(self.log(team, vehicle)).unwrap_or_default();
            text.lines().map(|line| format!("{team}/{vehicle} {line}")).collect::<Vec<_>>()
        };
        site.vehicles().flat_map(lines).collect()
    }

    /// Processor time that a process has used, s.
    pub(super) fn processor_s(&self, process: &str) -> f64 {
        let stat = fs::read_to_string(format!("/proc/{}/stat", self.processes[process].id())).unwrap();
        let fields: Vec<&str> = stat.rsplit_once(") ").unwrap().1.split(' ').collect();
        // Fields 14 and 15 of proc(5), in hundredths of a second.
        fields[11..13].iter().map(|ticks| ticks.parse::<f64>().unwrap() / 100.0).sum()
    }

    fn log(&self, team: u8, vehicle: u8) -> std::path::PathBuf {
        self.folder.path().join(format!("{team}-{vehicle}.log"))
    }

    fn start(&mut self, site: Site, name: &str, role: &str, argument: &str) -> Lines {
        let this = std::env::current_exe().unwrap();
        let mut command = self.namespaces.command(site.name(), this.to_str().unwrap());
        command.args(["--exact", "namespaces::site_process", "--ignored", "--nocapture"]);
        command.env(ROLE, format!("{role}\n{argument}")).stdin(Stdio::null()).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let (lines, printed) = (Lines::default(), BufReader::new(child.stdout.take().unwrap()));
        let kept = lines.clone();
        spawn(move || {
            printed.lines().map_while(Result::ok).for_each(|line| kept.lock().unwrap().push((Instant::now(), line)));
        });
        self.processes.insert(name.to_owned(), child);
        lines
    }
}

impl Drop for Sites {
    /// Ends all processes before the network is removed, also of a failed test.
    fn drop(&mut self) {
        self.processes.values_mut().for_each(end);
    }
}

fn end(process: &mut Child) {
    let _ = process.kill();
    let _ = process.wait();
}

/// A process of a site: never returns, unless this program was not started as one.
pub(super) fn process() {
    let Ok(role) = std::env::var(ROLE) else { return };
    let (role, argument) = role.split_once('\n').unwrap();
    match role {
        "router" => {
            let _router = zenoh::open(Config::from_json5(argument).unwrap()).wait().unwrap();
            wait_for_ever();
        }
        "relay" => relay(argument),
        "clock" => clock(&peer(argument)),
        "listen" => listen(&peer(argument)),
        "observe" => observe(&peer(argument)),
        other => panic!("no role {other}"),
    }
}

fn wait_for_ever() -> ! {
    loop {
        sleep(Duration::from_secs(60));
    }
}

/// A session as an agent's, that listens nowhere.
fn peer(dial: &str) -> Session {
    let mut configuration = Config::default();
    let settings = [
        ("mode", "\"peer\""),
        ("namespace", &format!("{SWARM:?}")),
        ("listen/endpoints", "[]"),
        ("connect/endpoints", dial),
        ("connect/retry", "{ period_init_ms: 200, period_max_ms: 1000, period_increase_factor: 1.5 }"),
        ("scouting/multicast/enabled", "false"),
        ("scouting/gossip/enabled", "false"),
    ];
    settings.iter().for_each(|(key, value)| configuration.insert_json5(key, value).unwrap());
    zenoh::open(configuration).wait().unwrap()
}

fn unix_us() -> u128 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_micros()
}

/// Publishes the time. All processes of the test have one clock.
fn clock(session: &Session) {
    let publisher = session.declare_publisher("clock").express(true).wait().unwrap();
    loop {
        publisher.put(unix_us().to_string()).wait().unwrap();
        sleep(Duration::from_millis(20));
    }
}

/// Prints a line for each state of a vehicle, `state TEAM/ID SEQUENCE`, and one for each time of the clock, with the time that it took,
/// `clock MICROSECONDS`.
fn listen(session: &Session) {
    subscribe(session, "clock", |_, bytes| {
        let sent: u128 = String::from_utf8_lossy(bytes).parse().ok()?;
        Some(format!("clock {}", unix_us().saturating_sub(sent)))
    });
    subscribe(session, "team/*/vehicle/*/cell/*/*/state", |vehicle, bytes| {
        let state: State = message::decode(bytes).ok()?;
        Some(format!("state {vehicle} {}", state.header.sequence))
    });
    wait_for_ever();
}

/// Prints a line for each health report, `health TEAM/ID LINKS RECEIVED BYTES REFUSED`, and for every fifth step one with the place
/// in the team's frame, `place TEAM/ID NORTH EAST DOWN STEP`.
fn observe(session: &Session) {
    subscribe(session, "team/*/vehicle/*/health", |vehicle, bytes| {
        let Health { links, received, drops, .. } = message::decode(bytes).ok()?;
        let refused: u64 = serde_json::to_value(drops).ok()?.as_object()?.values().filter_map(Value::as_u64).sum();
        Some(format!("health {vehicle} {links} {} {} {refused}", received.messages, received.bytes))
    });
    subscribe(session, "team/*/vehicle/*/trace", |vehicle, bytes| {
        let trace: Trace = message::decode(bytes).ok()?;
        let place = trace.position;
        let line = || {
            let (north_m, east_m, down_m) = (place.north_m(), place.east_m(), place.down_m());
            format!("place {vehicle} {north_m} {east_m} {down_m} {}", trace.step)
        };
        trace.header.sequence.is_multiple_of(5).then(line)
    });
    wait_for_ever();
}

/// Prints what `line` makes of each message and its sender's name.
fn subscribe(session: &Session, key: &str, line: impl Fn(&str, &[u8]) -> Option<String> + Send + Sync + 'static) {
    let print = move |sample: zenoh::sample::Sample| {
        let parts: Vec<&str> = sample.key_expr().as_str().split('/').collect();
        let vehicle = format!("{}/{}", parts.get(1).unwrap_or(&""), parts.get(3).unwrap_or(&""));
        if let Some(line) = line(&vehicle, &sample.payload().to_bytes()) {
            let _ = writeln!(io::stdout(), "{line}");
        }
    };
    session.declare_subscriber(key).callback(print).background().wait().unwrap();
}

/// Carries each connection to the address in `argument`, and what it sends after this delay.
fn relay(argument: &str) {
    let (to, delay_ms) = argument.split_once(' ').unwrap();
    let (to, delay): (SocketAddr, _) = (to.parse().unwrap(), Duration::from_millis(delay_ms.parse().unwrap()));
    let listener = TcpListener::bind(format!("127.0.0.1:{ROUTER}")).unwrap();
    for near in listener.incoming().map_while(Result::ok) {
        spawn(move || -> io::Result<()> {
            let far = TcpStream::connect_timeout(&to, Duration::from_secs(1)).inspect_err(|_| {
                let _ = near.shutdown(Shutdown::Both);
            })?;
            near.set_nodelay(true)?;
            far.set_nodelay(true)?;
            carry(near.try_clone()?, far.try_clone()?, delay);
            carry(far, near, delay);
            Ok(())
        });
    }
}

/// Copies bytes in one direction, each block after the delay, in threads of its own.
fn carry(mut from: TcpStream, mut to: TcpStream, delay: Duration) {
    let (sender, blocks) = channel::<(Instant, Vec<u8>)>();
    let closing = to.try_clone();
    spawn(move || {
        let mut buffer = [0; 65_536];
        while let Ok(size @ 1..) = from.read(&mut buffer) {
            let _ = sender.send((Instant::now() + delay, buffer[..size].to_vec()));
        }
        let _ = closing.map(|to| to.shutdown(Shutdown::Both));
    });
    spawn(move || {
        for (at, block) in blocks {
            sleep(at.saturating_duration_since(Instant::now()));
            if to.write_all(&block).is_err() {
                let _ = to.shutdown(Shutdown::Both);
                break;
            }
        }
    });
}
