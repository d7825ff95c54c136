//! Checks whether every node's port can be reached: from this PC and from every host that has the program.

use std::collections::BTreeMap;

use skein_common::id::VehicleName;

use super::Line;
use crate::host::probe;
use crate::inventory::{Inventory, Node};
use crate::protocol::{Cause, Reached};

/// Results of the calls from one computer to every node's port.
pub(super) struct Calls {
    /// Name of the caller: a host, or this PC.
    pub(super) from: String,
    pub(super) reached: BTreeMap<VehicleName, Reached>,
}

/// State of an agent, as its host reports it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum AgentState {
    Runs,
    DoesNot,
    /// Its host could not be asked.
    Unknown,
}

/// Calls every node's port from this PC.
pub(super) fn call_all(inventory: &Inventory) -> Calls {
    let endpoints: Vec<_> = inventory.nodes.values().map(Node::host_port).collect();
    let reached = inventory.nodes.keys().copied().zip(probe::reach(&endpoints)).collect();
    Calls { from: "this PC".to_owned(), reached }
}

/// Makes one line for each node's port, from all calls.
pub(super) fn lines(inventory: &Inventory, calls: &[Calls], agents: &BTreeMap<VehicleName, AgentState>) -> Vec<Line> {
    inventory.nodes.values().map(|node| line(node, calls, agents.get(&node.id).copied())).collect()
}

fn line(node: &Node, calls: &[Calls], agent: Option<AgentState>) -> Line {
    let at = node.host_port();
    let by = |filter: fn(&Reached) -> bool| -> Vec<&str> {
        let by = calls.iter().filter(|calls| calls.reached.get(&node.id).is_some_and(filter));
        by.map(|calls| calls.from.as_str()).collect()
    };
    let (taken, refused) = (by(|reached| *reached == Reached::Taken), by(|reached| *reached == Reached::Refused));
    let line = |found: String| Line::of(node, "port", found);
    let host = node.host.as_deref().unwrap_or(&node.address);
    let mut failed: Vec<(Cause, &str, Vec<&str>)> = Vec::new();
    for calls in calls {
        let Some(Reached::No(cause, why)) = calls.reached.get(&node.id) else { continue };
        match failed.iter_mut().find(|(other, reason, _)| (other, reason) == (cause, &why.as_str())) {
            Some((.., from)) => from.push(&calls.from),
            None => failed.push((*cause, why, vec![&calls.from])),
        }
    }
    if !failed.is_empty() {
        let only = if taken.len() + refused.len() > 0 { " (not for all)" } else { "" };
        let found = failed.iter().map(|(cause, why, from)| {
            let what = if *cause == Cause::Silence { "is closed for" } else { "cannot be reached from" };
            format!("{what} {}{only}: {why}", from.join(", "))
        });
        let mut remedies: Vec<_> =
            failed.iter().map(|(cause, _, from)| remedy(node, host, *cause, &from.join(", "))).collect();
        remedies.dedup();
        let found = found.collect::<Vec<_>>().join("; ");
        return line(format!("{at} {found}")).fault(remedies.join("; "));
    }
    match (agent, taken.is_empty(), refused.is_empty()) {
        (Some(AgentState::DoesNot), false, _) => {
            line(format!("{at} is used by another program than this node's agent"))
                .fault(format!("find and end that program: `ssh {host} ss -ltnp sport = :{}`", node.port))
        }
        (Some(AgentState::Runs), _, false) => {
            line(format!("{at} refuses {}, although its agent runs", refused.join(", "))).fault(format!(
                "check that {} is an address of {host} and that no firewall rejects port {}",
                node.address, node.port
            ))
        }
        (_, false, _) => line(format!("{at} accepts connections")),
        (_, true, false) => line(format!("{at} can be reached; no agent listens yet")),
        (_, true, true) => line(format!("{at}: could not be called")).unknown(),
    }
}

/// The remedy for a connection that was not made from these PCs, by its cause.
fn remedy(node: &Node, host: &str, cause: Cause, from: &str) -> String {
    let Node { id, address, port, .. } = node;
    match cause {
        Cause::Name => format!(
            "give node {id} an IP address with `address`, or enter {address} into the name service or /etc/hosts of {from}"
        ),
        Cause::Route => format!(
            "connect {from} and {host} to one network, or enter a route: `ip route get {address}` there shows the way; check \
             that {address} is an address of {host}, which is on"
        ),
        Cause::Address => format!(
            "give node {id} another `address`: the system of {from} cannot connect to {address}, as to a link-local address \
             without its interface"
        ),
        Cause::Forbidden => format!("let TCP to port {port} out through the firewall of {from}"),
        Cause::Silence => format!(
            "open TCP port {port} in the firewall on {host} or in front of it: `sudo ufw allow {port}/tcp` or `sudo \
             firewall-cmd --permanent --add-port={port}/tcp && sudo firewall-cmd --reload`; check that {address} is its \
             address and that {host} is on"
        ),
        Cause::Other => format!("check `address` of node {id} and the network between {from} and {host}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::findings::State;
    use crate::inventory::tests::lab;

    /// The line of node 1 after calls from this PC and heli2.
    fn line_of(pc: Reached, other: Reached, agent: AgentState) -> Line {
        let folder = tempfile::tempdir().unwrap();
        let inventory = lab(folder.path(), 1, "");
        let id = "1".parse().unwrap();
        let call = |from: &str, reached| Calls { from: from.to_owned(), reached: BTreeMap::from([(id, reached)]) };
        let calls = [call("this PC", pc), call("heli2", other)];
        lines(&inventory, &calls, &BTreeMap::from([(id, agent)])).remove(0)
    }

    #[test]
    fn a_closed_used_or_refused_port_has_its_remedy() {
        let late = || Reached::No(Cause::Silence, "no answer within 1 s".to_owned());
        let closed = line_of(late(), late(), AgentState::DoesNot);
        assert_eq!(closed.state, State::Fault);
        assert_eq!(closed.found, "10.0.0.11:7447 is closed for this PC, heli2: no answer within 1 s");
        assert!(closed.remedy.unwrap().contains("ufw allow 7447/tcp"));
        let partly = line_of(Reached::Taken, late(), AgentState::Runs);
        assert_eq!((partly.state, partly.found.contains("for heli2 (not for all)")), (State::Fault, true));
        let taken = line_of(Reached::Taken, Reached::Taken, AgentState::DoesNot);
        assert!(taken.state == State::Fault && taken.remedy.unwrap().contains("ss -ltnp sport = :7447"));
        let refused = line_of(Reached::Refused, Reached::Taken, AgentState::Runs);
        assert!(refused.state == State::Fault && refused.found.contains("refuses this PC"));
        for (cause, wanted) in [
            (Cause::Name, "/etc/hosts of this PC, heli2"),
            (Cause::Route, "`ip route get 10.0.0.11`"),
            (Cause::Address, "give node 1 another `address`"),
            (Cause::Forbidden, "out through the firewall of this PC, heli2"),
            (Cause::Other, "check `address` of node 1"),
        ] {
            let failed = || Reached::No(cause, "why".to_owned());
            let line = line_of(failed(), failed(), AgentState::DoesNot);
            assert_eq!(line.found, "10.0.0.11:7447 cannot be reached from this PC, heli2: why");
            let remedy = line.remedy.unwrap();
            assert!(remedy.contains(wanted) && !remedy.contains("ufw"), "{cause:?}: {remedy}");
        }
        let two = line_of(late(), Reached::No(Cause::Route, "no route".to_owned()), AgentState::DoesNot);
        assert!(two.found.contains("closed for this PC: no answer within 1 s; cannot be reached from heli2: no route"));
        for (reached, agent) in [(Reached::Taken, AgentState::Runs), (Reached::Refused, AgentState::DoesNot)] {
            assert_eq!(line_of(reached.clone(), reached, agent).state, State::Good);
        }
        assert_eq!(line_of(Reached::Taken, Reached::Taken, AgentState::Unknown).state, State::Good);
    }
}
