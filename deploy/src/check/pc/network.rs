//! Ports, the loopback, the firewall, and X-Plane's beacon.

use std::io;
use std::net::{Ipv4Addr, TcpListener};
use std::time::Duration;

use skein_agent::plant::xplane::discovery::FoundSimulator;

use super::{firewall, installed, line, remedy};
use crate::new::discover;
use skein_cluster::findings::Line;
use skein_cluster::host::probe;
use skein_cluster::ports;
use skein_cluster::protocol::Reached;
use skein_cluster::simulators::survey::version_text;

/// Number of agents for which ports are tried.
const AGENTS: u16 = 16;
/// Port of the first agent that is started by hand or on a cluster; that of vehicle 1.
const FIRST_PORT: u16 = 7447;

/// All lines but the beacon's.
pub(super) fn lines() -> Vec<Line> {
    vec![loopback(), cluster_ports(FIRST_PORT, AGENTS), firewall::look()]
}

/// Whether agents on this PC can listen and reach each other.
fn loopback() -> Line {
    if let Err(error) = ports::tcp(AGENTS.into()) {
        return line("loopback", format!("no free TCP ports: {error}")).fault(remedy(
            "end programs that hold many ports: `ss -tanp` lists them",
            "end programs that hold many ports: `netstat -ano -p tcp` lists them",
        ));
    }
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0));
    let reached = listener.and_then(|listener| {
        let address = listener.local_addr()?.to_string();
        Ok(probe::reach(&[address]).remove(0))
    });
    match reached {
        Ok(Reached::Taken) => line("loopback", format!("{AGENTS} free ports, and agents reach each other")),
        Ok(Reached::Refused) => unreachable("refused".to_owned()),
        Ok(Reached::No(_, why)) => unreachable(why),
        Err(error) => unreachable(error.to_string()),
    }
}

fn unreachable(why: String) -> Line {
    line("loopback", format!("a connection from this PC to itself fails: {why}")).fault(remedy(
        "let TCP on the interface lo through the firewall: `sudo ufw allow in on lo`",
        "let TCP on the loopback through: a program for security may filter it",
    ))
}

/// The ports on which agents of a cluster, and those started by hand, listen.
fn cluster_ports(first: u16, count: u16) -> Line {
    let last = first + count - 1;
    let is_used = |port: &u16| {
        let tried = TcpListener::bind((Ipv4Addr::UNSPECIFIED, *port));
        tried.is_err_and(|error| error.kind() == io::ErrorKind::AddrInUse)
    };
    let used: Vec<String> = (first..=last).filter(is_used).map(|port| port.to_string()).collect();
    match used.first() {
        None => line("ports", format!("{first} to {last}, for agents of a cluster, are free")),
        Some(one) => {
            let shows = if cfg!(windows) {
                format!("netstat -ano -p tcp | findstr :{one}")
            } else {
                format!("ss -ltnp sport = :{one}")
            };
            line("ports", format!("in use: {}", used.join(", "))).warning(format!(
                "`{shows}` shows by which program; an agent of a cluster needs port 7446 + its id, `skein fly` takes free ones"
            ))
        }
    }
}

/// The X-Planes that announce themselves within this time.
pub(super) fn beacon(wait: Duration) -> Line {
    match discover::heard(wait) {
        Err(error) => line("X-Plane", error.to_string()).unknown(),
        Ok(found) if found.is_empty() => {
            let folders: Vec<String> = installed::folders().iter().map(|folder| folder.display().to_string()).collect();
            let where_to = match folders.as_slice() {
                [] => "the built-in helicopter needs none".to_owned(),
                several => format!("it is installed in {}: start it", several.join(" and in ")),
            };
            let found = format!("none announces itself within {} s; {where_to}", wait.as_secs_f64());
            Line {
                remedy: Some("if one runs: `skein xplane check --xplane HOST` asks it; its beacon is UDP multicast to 239.255.1.1:49707".to_owned()),
                ..line("X-Plane", found).unknown()
            }
        }
        Ok(found) => {
            let one = |found: &FoundSimulator| {
                let (version, over) = (version_text(found.version), discover::over(found));
                format!("{version} on {} at {}:{}{over}", found.computer, found.address, found.port)
            };
            line("X-Plane", found.iter().map(one).collect::<Vec<_>>().join(", "))
        }
    }
}

#[cfg(test)]
mod tests {
    use skein_cluster::findings::State;
    use skein_host::clock;

    use super::*;

    #[test]
    fn a_port_in_use_is_named() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let used = cluster_ports(port, 1);
        assert_eq!((used.state, used.found), (State::Warning, format!("in use: {port}")));
        assert!(used.remedy.unwrap().contains(&format!("sport = :{port}")));
        drop(listener);
        // A program that another test starts has the socket too until it runs.
        let until = clock::now() + Duration::from_secs(20);
        while cluster_ports(port, 1).state != State::Good {
            assert!(clock::now() < until, "port {port} is still in use");
            clock::sleep(Duration::from_millis(20));
        }
    }

    #[test]
    fn agents_on_this_pc_reach_each_other() {
        assert_eq!(loopback().state, State::Good);
    }
}
