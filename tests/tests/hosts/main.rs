//! Agents and whole clusters on hosts of their own: network namespaces of this PC.
//!
//! Needs Linux and root. Without them these tests print a message and pass, unless `SKEIN_NAMESPACES=required`.
#![cfg(target_os = "linux")]
#![expect(clippy::disallowed_methods, reason = "real hosts take real time")]
#![expect(clippy::unwrap_used, reason = "what a test cannot do has failed")]

mod cluster;
mod namespaces;
