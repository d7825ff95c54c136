//! A PC with two network cards: X-Planes announce themselves over the card that is not the default one.
//!
//! ```text
//!   pc: eth0 10.81.0.1, the default route ---- first
//!       eth1 10.82.0.1 ----------------------- second, where the other X-Plane is, 10.82.0.254
//! ```

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;
use std::time::Duration;

use skein_agent::plant::xplane::wire::becn::{self, Beacon};
use skein_tests::namespaces::{BRIDGE, Namespaces, ip, join};

use super::{can_run, print_line};

/// Sends its first argument, a beacon in hexadecimal digits, over the interface of its second, twice a second.
const SENDER: &str = "import socket, sys, time\n\
    s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)\n\
    s.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(sys.argv[2]))\n\
    s.bind((sys.argv[2], 0))\n\
    while True:\n    s.sendto(bytes.fromhex(sys.argv[1]), ('239.255.1.1', 49707))\n    time.sleep(0.5)\n";
/// Time within which an agent finds its X-Plane.
const FOUND_WITHIN: Duration = Duration::from_secs(10);

/// A process that ends with the test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The PC and the network of its second card.
fn network() -> Namespaces {
    let mut namespaces = Namespaces::new("cards");
    let pc = namespaces.add("pc");
    for (card, net) in [("first", 81), ("second", 82)] {
        let bridge = namespaces.add_bridge(card);
        ip(&["-n", &bridge, "addr", "add", &format!("10.{net}.0.254/24"), "dev", BRIDGE]);
        join(&pc, &format!("eth{}", net - 81), &format!("10.{net}.0.1/24"), &bridge, "pc");
    }
    ip(&["-n", &pc, "route", "add", "default", "via", "10.81.0.254"]);
    namespaces
}

/// Announces an X-Plane with this port from the interface with this address.
fn announce(namespaces: &Namespaces, namespace: &str, address: &str, port: u16) -> Running {
    let beacon = Beacon {
        minor: 2,
        host_id: 1,
        version: 121_400,
        role: 1,
        port,
        name: "heli".to_owned(),
        raknet_port: Some(becn::RAKNET_PORT),
    };
    let mut bytes = Vec::new();
    beacon.encode(&mut bytes).unwrap();
    let digits: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    let mut sender = namespaces.command(namespace, "python3");
    Running(sender.args(["-c", SENDER, &digits, address]).spawn().unwrap())
}

#[test]
fn x_planes_of_every_network_card_are_found_and_the_card_is_named() {
    if !can_run() {
        return;
    }
    let namespaces = network();
    let _other = announce(&namespaces, "second", "10.82.0.254", 49_000);
    let mut check = namespaces.command("pc", env!("CARGO_BIN_EXE_skein-under-test"));
    let found = check.args(["check", "--pc", "--wait", "3"]).output().unwrap();
    let found = String::from_utf8_lossy(&found.stdout).into_owned();
    assert!(found.contains("12.1.4 on heli at 10.82.0.254:49000 over eth1"), "{found}");

    // The agent's own X-Plane sends its beacon over the second card only.
    let folder = tempfile::tempdir().unwrap();
    let scenario = folder.path().join("one.toml");
    std::fs::write(&scenario, "swarm.vehicles = 1\nswarm.plant = \"xplane\"\n").unwrap();
    let _own = announce(&namespaces, "pc", "10.82.0.1", 49_030);
    let mut agent: Command = namespaces.command("pc", env!("CARGO_BIN_EXE_skein-under-test"));
    agent.arg("agent").arg("--scenario").arg(&scenario).args(["--id", "1"]);
    let mut agent = Running(agent.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap());
    let (sender, lines) = mpsc::channel();
    let stderr = BufReader::new(agent.0.stderr.take().unwrap());
    std::thread::spawn(move || stderr.lines().map_while(Result::ok).try_for_each(|line| sender.send(line)));
    let begin = std::time::Instant::now();
    let mut printed = Vec::new();
    while begin.elapsed() < FOUND_WITHIN && !printed.iter().any(|line: &String| line.contains("found X-Plane")) {
        printed.extend(lines.recv_timeout(Duration::from_millis(200)));
    }
    print_line(&format!(
        "an agent finds its X-Plane behind the second card after {:.1} s",
        begin.elapsed().as_secs_f64()
    ));
    assert!(printed.iter().any(|line| line.contains("found X-Plane")), "{printed:#?}");
}
