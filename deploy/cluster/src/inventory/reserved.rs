//! Names and addresses that are reserved for documentation (RFC 2606, 3849, 5737): examples use them, and no computer of a lab
//! has them.

use std::net::IpAddr;

/// Whether this host, a name or an address, is reserved for documentation.
pub(super) fn is_for_documentation(host: &str) -> bool {
    match host.trim_matches(['[', ']']).parse::<IpAddr>().map(|address| address.to_canonical()) {
        Ok(IpAddr::V4(address)) => address.is_documentation(),
        Ok(IpAddr::V6(address)) => address.segments()[..2] == [0x2001, 0xdb8],
        Err(_) => is_name(host),
    }
}

fn is_name(name: &str) -> bool {
    let name = name.trim_end_matches('.').to_ascii_lowercase();
    let mut labels = name.rsplit('.');
    matches!(
        (labels.next(), labels.next()),
        (Some("example" | "invalid"), Some(_)) | (Some("com" | "net" | "org"), Some("example"))
    )
}
