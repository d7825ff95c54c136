//! Names and addresses that are reserved for documentation (RFC 2606, 3849, 5737): examples use them, and no computer of a lab
//! has them.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

/// Whether this host, a name or an address, is reserved for documentation.
pub(super) fn is_for_documentation(host: &str) -> bool {
    match host.trim_matches(['[', ']']).parse::<IpAddr>() {
        Ok(IpAddr::V4(address)) => is_v4(address),
        Ok(IpAddr::V6(address)) => address.to_ipv4_mapped().is_some_and(is_v4) || is_v6(address),
        Err(_) => is_name(host),
    }
}

fn is_v4(address: Ipv4Addr) -> bool {
    address.is_documentation()
}

fn is_v6(address: Ipv6Addr) -> bool {
    address.segments()[..2] == [0x2001, 0xdb8]
}

fn is_name(name: &str) -> bool {
    let name = name.trim_end_matches('.').to_ascii_lowercase();
    let mut labels = name.rsplit('.');
    matches!(
        (labels.next(), labels.next()),
        (Some("example" | "invalid"), Some(_)) | (Some("com" | "net" | "org"), Some("example"))
    )
}
