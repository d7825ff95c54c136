//! Takes root's capabilities away from an agent that Skein's own supervisor starts as root. Under systemd the unit does it.

use std::io;

/// Takes all capabilities from this process and from every program that it becomes, for good. The limits that root can
/// exceed, on real-time priority and on locked memory, are raised to what systemd's unit grants.
///
/// # Errors
/// If the system does not permit it, as in a container whose root may not change its own capabilities.
#[cfg(target_os = "linux")]
pub(super) fn give_up() -> io::Result<()> {
    use rustix::process::{Resource, Rlimit, setrlimit};
    use rustix::thread::{
        CapabilitySet, CapabilitySets, capability_is_in_bounding_set, clear_ambient_capability_set,
        remove_capability_from_bounding_set, set_capabilities, set_no_new_privs,
    };

    /// That of `LimitRTPRIO` in the unit.
    const PRIORITY: u64 = 50;

    for (resource, limit) in [(Resource::Rtprio, Some(PRIORITY)), (Resource::Memlock, None)] {
        // An agent with a lower limit flies with ordinary priority or pageable memory, and its log says so.
        let _ = setrlimit(resource, Rlimit { current: limit, maximum: limit });
    }
    // The kernel refuses a capability that it does not know.
    let known = (0..u64::BITS).map(|bit| CapabilitySet::from_bits_retain(1 << bit));
    for capability in known.filter(|capability| capability_is_in_bounding_set(*capability).unwrap_or(false)) {
        remove_capability_from_bounding_set(capability)?;
    }
    clear_ambient_capability_set()?;
    set_no_new_privs(true)?;
    let none = CapabilitySet::empty();
    Ok(set_capabilities(None, CapabilitySets { effective: none, permitted: none, inheritable: none })?)
}

/// Takes all capabilities from this process: only Linux has them.
///
/// # Errors
/// Always, because this system has no capabilities.
#[cfg(not(target_os = "linux"))]
pub(super) fn give_up() -> io::Result<()> {
    Err(io::ErrorKind::Unsupported.into())
}
