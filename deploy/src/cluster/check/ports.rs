//! Checks whether every node's port can be reached: from this PC and from every host that has the program.

use std::collections::BTreeMap;

use skein_common::id::VehicleName;

use super::Line;
use crate::cluster::host::probe;
use crate::cluster::protocol::Reached;
use crate::inventory::{Inventory, Node};

/// Results of the calls from one computer to every node's port.
pub(super) struct Calls {
    /// Name of the caller: a host, or this PC.
    pub(super) from: String,
    pub(super) reached: BTreeMap<VehicleName, Reached>,
}

/// State of an agent, as its host reports it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Agent {
    Runs,
    DoesNot,
    /// Its host could not be asked.
    Unknown,
}

/// Returns `HOST:PORT` of a node.
pub(super) fn address(node: &Node) -> String {
    match node.address.contains(':') {
        true => format!("[{}]:{}", node.address, node.port),
        false => format!("{}:{}", node.address, node.port),
    }
}

/// Calls every node's port from this PC.
pub(super) fn call_all(inventory: &Inventory) -> Calls {
    let endpoints: Vec<_> = inventory.nodes.values().map(address).collect();
    let reached = inventory.nodes.keys().copied().zip(probe::reach(&endpoints)).collect();
    Calls { from: "this PC".to_owned(), reached }
}

/// Makes one line for each node's port, from all calls.
pub(super) fn lines(inventory: &Inventory, calls: &[Calls], agents: &BTreeMap<VehicleName, Agent>) -> Vec<Line> {
    inventory.nodes.values().map(|node| line(node, calls, agents.get(&node.id).copied())).collect()
}

fn line(node: &Node, calls: &[Calls], agent: Option<Agent>) -> Line {
    let at = address(node);
    let by = |filter: fn(&Reached) -> bool| -> Vec<&str> {
        let by = calls.iter().filter(|calls| calls.reached.get(&node.id).is_some_and(filter));
        by.map(|calls| calls.from.as_str()).collect()
    };
    let closed = by(|reached| matches!(reached, Reached::No(_)));
    let (taken, refused) = (by(|reached| *reached == Reached::Taken), by(|reached| *reached == Reached::Refused));
    let line = |found: String| Line::of(node, "port", found);
    let host = node.host.as_deref().unwrap_or(&node.address);
    if !closed.is_empty() {
        let why = calls.iter().find_map(|calls| match calls.reached.get(&node.id) {
            Some(Reached::No(why)) => Some(why.as_str()),
            _ => None,
        });
        let only = if taken.len() + refused.len() > 0 { " (not for all)" } else { "" };
        return line(format!("{at} is closed for {}{only}: {}", closed.join(", "), why.unwrap_or_default())).fault(format!(
            "open TCP port {} in the firewall on {host} or in front of it: `sudo ufw allow {0}/tcp` or `sudo firewall-cmd \
             --permanent --add-port={0}/tcp && sudo firewall-cmd --reload`; check that {} is its address",
            node.port, node.address
        ));
    }
    match (agent, taken.is_empty(), refused.is_empty()) {
        (Some(Agent::DoesNot), false, _) => line(format!("{at} is used by another program than this node's agent"))
            .fault(format!("find and end that program: `ssh {host} ss -ltnp sport = :{}`", node.port)),
        (Some(Agent::Runs), _, false) => line(format!("{at} refuses {}, although its agent runs", refused.join(", ")))
            .fault(format!(
                "check that {} is an address of {host} and that no firewall rejects port {}",
                node.address, node.port
            )),
        (_, false, _) => line(format!("{at} accepts connections")),
        (_, true, false) => line(format!("{at} can be reached; no agent listens yet")),
        (_, true, true) => line(format!("{at}: could not be called")).unknown(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::findings::State;
    use crate::inventory::tests::lab;

    /// The line of node 1 after calls from this PC and heli2.
    fn line_of(pc: Reached, other: Reached, agent: Agent) -> Line {
        let folder = tempfile::tempdir().unwrap();
        let inventory = lab(folder.path(), 1, "");
        let id = "1".parse().unwrap();
        let call = |from: &str, reached| Calls { from: from.to_owned(), reached: BTreeMap::from([(id, reached)]) };
        let calls = [call("this PC", pc), call("heli2", other)];
        lines(&inventory, &calls, &BTreeMap::from([(id, agent)])).remove(0)
    }

    #[test]
    fn a_closed_used_or_refused_port_has_its_remedy() {
        let late = || Reached::No("no answer within 1 s".to_owned());
        let closed = line_of(late(), late(), Agent::DoesNot);
        assert_eq!(closed.state, State::Fault);
        assert_eq!(closed.found, "10.0.0.11:7447 is closed for this PC, heli2: no answer within 1 s");
        assert!(closed.remedy.unwrap().contains("ufw allow 7447/tcp"));
        let partly = line_of(Reached::Taken, late(), Agent::Runs);
        assert_eq!((partly.state, partly.found.contains("for heli2 (not for all)")), (State::Fault, true));
        let taken = line_of(Reached::Taken, Reached::Taken, Agent::DoesNot);
        assert!(taken.state == State::Fault && taken.remedy.unwrap().contains("ss -ltnp sport = :7447"));
        let refused = line_of(Reached::Refused, Reached::Taken, Agent::Runs);
        assert!(refused.state == State::Fault && refused.found.contains("refuses this PC"));
        for (reached, agent) in [(Reached::Taken, Agent::Runs), (Reached::Refused, Agent::DoesNot)] {
            assert_eq!(line_of(reached.clone(), reached, agent).state, State::Good);
        }
        assert_eq!(line_of(Reached::Taken, Reached::Taken, Agent::Unknown).state, State::Good);
    }
}
