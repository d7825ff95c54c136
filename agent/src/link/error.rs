//! The reasons why an agent's network cannot be used.

use std::io;
use std::path::PathBuf;

use skein_common::id::VehicleName;

/// The reason why the network cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// Zenoh rejects our configuration.
    #[error("the network cannot be configured: {}", plain(.0))]
    Configuration(#[source] zenoh::Error),
    /// A text that is not an endpoint.
    #[error("{0:?} is not an endpoint; write it like tcp/127.0.0.1:7447")]
    Endpoint(String),
    /// A plain endpoint where links are secured, or a secured endpoint without keys.
    #[error(
        "{endpoint:?}: {}",
        if *expected == "tls" { "links are secured here; write the endpoint like tls/10.0.0.11:7447" }
        else { "there are no keys for secured links; write a plain endpoint like tcp/127.0.0.1:7447" }
    )]
    Protocol {
        /// The endpoint.
        endpoint: String,
        /// Protocol that the endpoint must start with.
        expected: &'static str,
    },
    /// A key or certificate file that cannot be used, and the fault found in it.
    #[error("{}: {}", .0.display(), .1)]
    File(PathBuf, #[source] io::Error),
    /// A certificate name that is empty or used twice.
    #[error("the certificate name {0:?} must name exactly one of the vehicles, the observer and the operator")]
    Name(String),
    /// The node's own key differs from the key that the swarm has for this vehicle.
    #[error("this node's key is not the key that the swarm has for vehicle {0}")]
    Key(VehicleName),
    /// A session that listens on these endpoints cannot be opened, most often because the address is in use or belongs to another
    /// host.
    #[error("cannot listen on {}: {}", .0.join(", "), plain(.1))]
    Open(Vec<String>, #[source] zenoh::Error),
    /// The session rejects a publisher, subscriber, queryable or token with this key expression.
    #[error("cannot declare {}: {}", .0, plain(.1))]
    Declare(String, #[source] zenoh::Error),
    /// A sending thread cannot be started.
    #[error("a thread cannot be started: {0}")]
    Thread(io::Error),
}

impl LinkError {
    /// Whether the cause is an argument or a file, not the network.
    pub fn is_user_error(&self) -> bool {
        !matches!(self, Self::Configuration(_) | Self::Open(..) | Self::Declare(..) | Self::Thread(_))
    }
}

/// Zenoh's error text without the places in its source code, such as `at .../tcp.rs:61.`.
pub(super) fn plain(error: &zenoh::Error) -> String {
    let mut text = error.to_string();
    while let Some(place) = text.find(".rs:") {
        let begin = text[..place].rfind(" at ").unwrap_or(place);
        let number = place + ".rs:".len();
        let after = text[number..].find(|c: char| !c.is_ascii_digit() && c != '.');
        text.replace_range(begin..after.map_or(text.len(), |after| number + after), "");
    }
    text
}

/// Makes the error of a declaration with this key expression.
pub(super) fn declaring(key: &str) -> impl FnOnce(zenoh::Error) -> LinkError {
    let key = key.to_owned();
    move |source| LinkError::Declare(key, source)
}
