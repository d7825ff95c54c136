//! Checks whether a node's address in the cluster file is still one of its host's addresses.

use std::net::{IpAddr, ToSocketAddrs};

use super::Line;
use crate::host::probe::is_from_elsewhere;
use crate::inventory::Node;

/// Makes the line about a node's address, if its host has these and not that one. A name is resolved on this PC. It prevents
/// no flight, because a router may forward the address to the host.
pub(super) fn line(node: &Node, of_host: &[IpAddr], file: &str) -> Option<Line> {
    let known: Vec<IpAddr> = match node.address.parse() {
        Ok(address) => vec![address],
        // The check of the port reports a name that cannot be resolved.
        Err(_) => (&*node.address, node.port).to_socket_addrs().ok()?.map(|at| at.ip()).collect(),
    };
    if of_host.is_empty() || known.iter().any(|address| of_host.contains(address)) {
        return None;
    }
    let from_elsewhere: Vec<_> =
        of_host.iter().filter(|address| is_from_elsewhere(address)).map(IpAddr::to_string).collect();
    let has = match from_elsewhere.as_slice() {
        [] => "it has none but its loopback".to_owned(),
        all => format!("it has {}", all.join(", ")),
    };
    let found = format!("{} is no longer an address of its host: {has}", node.address);
    Some(Line::of(node, "address", found).warning(format!(
        "set `address` of node {} in {file}, then `skein cluster keys -f {file}` and `skein cluster install -f {file}`, because \
         its peers dial it there; nothing if a router forwards {} to it",
        node.id, node.address
    )))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::findings::State;
    use crate::inventory::tests::lab;

    #[test]
    fn an_address_that_its_host_no_longer_has_is_reported_with_the_remedy() {
        let folder = tempfile::tempdir().unwrap();
        let inventory = lab(folder.path(), 1, "");
        let mut node = inventory.nodes.values().next().unwrap().clone();
        let mut line_of = |address: &str, of_host: &[&str]| {
            node.address = address.to_owned();
            line(&node, &of_host.iter().map(|text| text.parse().unwrap()).collect::<Vec<_>>(), "lab.toml")
        };
        let moved = line_of("10.0.0.11", &["127.0.0.1", "10.0.0.42", "::1", "fe80::1", "fd00::42"]).unwrap();
        assert_eq!((moved.what, moved.state), ("address", State::Warning));
        assert_eq!(moved.found, "10.0.0.11 is no longer an address of its host: it has 10.0.0.42, fd00::42");
        let remedy = moved.remedy.unwrap();
        assert!(
            remedy.starts_with("set `address` of node 1 in lab.toml, then `skein cluster keys -f lab.toml`"),
            "{remedy}"
        );
        let unplugged = line_of("10.0.0.11", &["127.0.0.1"]).unwrap();
        assert!(unplugged.found.ends_with("it has none but its loopback"), "{unplugged:?}");
        for (address, of_host) in [
            ("10.0.0.11", &["127.0.0.1", "10.0.0.11"][..]),
            ("fd00::42", &["fd00:0::42"]),
            ("localhost", &["127.0.0.1", "::1", "10.0.0.42"]),
            ("no.such.host.invalid", &["10.0.0.42"]),
            ("10.0.0.11", &[]),
        ] {
            assert_eq!(line_of(address, of_host), None, "{address}");
        }
    }
}
