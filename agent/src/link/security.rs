//! Who may join a swarm, and who may say what in it: mutual TLS on every link, and rules by the common name in the other
//! end's certificate. Zenoh enforces both before anything reaches our code, and each session for itself: whoever runs a
//! program without rules is stopped by the others.
//!
//! Nothing passes but what a rule allows. Everybody who has a name may listen and ask; a vehicle says only what stands in its own
//! branch; an observer says nothing; the operator says orders. A certificate of the swarm's authority whose name is none
//! of these (one that was issued anew since) makes a link and is neither heard nor told anything.
//!
//! What Zenoh lets by unchecked says nothing: abbreviations of keys, the end of an answer, interest in subscribers (what is
//! answered to it is checked), and hints about the network's shape, which nobody heeds without gossip.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde_json::{Value, json};
use skein_common::id::{SwarmName, VehicleId};
use zenoh::config::EndPoint;

use super::LinkError;

/// What Zenoh's endpoints separate their parts with; a path among them cannot have one.
const SEPARATORS: [char; 4] = ['?', '#', ';', '|'];

/// How links are secured.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Security {
    /// Plain TCP: whoever reaches it takes part. For the loopback, and for who asks for it by name.
    Plain,
    /// Mutual TLS, and rules.
    Tls(Box<Tls>),
}

/// One end of secured links.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tls {
    /// File of the certificates of the swarm's authority, PEM.
    pub authority: PathBuf,
    /// File of the own certificate, PEM.
    pub certificate: PathBuf,
    /// File of its private key, PEM.
    pub key: PathBuf,
    /// Who this is.
    pub role: Role,
    /// Who everybody is.
    pub names: Names,
}

/// Who takes part in a swarm's traffic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// A vehicle's agent: says what this vehicle may say.
    Vehicle(VehicleId),
    /// Says nothing.
    Observer,
    /// Gives orders.
    Operator,
}

/// The common names of the certificates that count; one that was replaced has another.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Names {
    /// Every vehicle's.
    pub vehicles: BTreeMap<VehicleId, String>,
    /// All observers'.
    pub observer: String,
    /// The operator's.
    pub operator: String,
}

impl Names {
    /// With the names that first certificates have: `vehicle-1`, ..., `observer`, `operator`.
    pub fn first(vehicles: impl IntoIterator<Item = VehicleId>) -> Self {
        Self {
            vehicles: vehicles.into_iter().map(|id| (id, format!("vehicle-{id}"))).collect(),
            observer: "observer".to_owned(),
            operator: "operator".to_owned(),
        }
    }

    /// The first name that stands for two, or for nobody.
    fn ambiguous(&self) -> Option<&str> {
        let mut known = BTreeSet::new();
        let mut all = self.vehicles.values().chain([&self.observer, &self.operator]);
        all.find(|name| name.trim().is_empty() || !known.insert(*name)).map(String::as_str)
    }
}

impl Security {
    /// Whether everything is in order before Zenoh is asked: it would try again and again in silence.
    pub(super) fn check(&self, listen: &[String], dial: &[String]) -> Result<(), LinkError> {
        let wanted = self.protocol();
        for text in listen.iter().chain(dial) {
            let endpoint = EndPoint::from_str(text).map_err(|_| LinkError::Endpoint(text.clone()))?;
            if endpoint.protocol().as_str() != wanted {
                return Err(LinkError::Protocol { endpoint: text.clone(), wanted });
            }
        }
        let Self::Tls(tls) = self else { return Ok(()) };
        if let Some(name) = tls.names.ambiguous() {
            return Err(LinkError::Name(name.to_owned()));
        }
        if let Role::Vehicle(id) = tls.role
            && !tls.names.vehicles.contains_key(&id)
        {
            return Err(LinkError::Nameless(id));
        }
        pem(&tls.authority, "CERTIFICATE-----")?;
        pem(&tls.certificate, "CERTIFICATE-----")?;
        pem(&tls.key, "PRIVATE KEY-----")
    }

    /// What to tell Zenoh of an endpoint to be dialled: over TLS it does not know an IPv6 address in its brackets.
    pub(super) fn dialled(&self, endpoint: &str) -> String {
        match self {
            Self::Plain => endpoint.to_owned(),
            Self::Tls(_) => endpoint.replace(['[', ']'], ""),
        }
    }

    /// Whose vehicle's a certificate of this common name is.
    pub fn certificates(&self) -> BTreeMap<String, VehicleId> {
        match self {
            Self::Plain => BTreeMap::new(),
            Self::Tls(tls) => tls.names.vehicles.iter().map(|(id, name)| (name.clone(), *id)).collect(),
        }
    }

    /// What endpoints begin with.
    fn protocol(&self) -> &'static str {
        match self {
            Self::Plain => "tcp",
            Self::Tls(_) => "tls",
        }
    }

    /// What Zenoh is to be told.
    pub(super) fn configuration(&self, swarm: &SwarmName) -> Vec<(&'static str, Value)> {
        let Self::Tls(tls) = self else { return Vec::new() };
        vec![("transport/link/tls", tls.files()), ("access_control", tls.rules(swarm))]
    }
}

impl Tls {
    /// Each end shows its certificate, whoever has dialled.
    fn files(&self) -> Value {
        json!({
            "root_ca_certificate": self.authority,
            "listen_certificate": self.certificate,
            "listen_private_key": self.key,
            "connect_certificate": self.certificate,
            "connect_private_key": self.key,
            "enable_mtls": true,
            "verify_name_on_connect": true,
            "close_link_on_expiration": true,
        })
    }

    /// Rules for what comes in from each other end, and for what goes out to it. Keys carry the swarm's name, as on the wire.
    fn rules(&self, swarm: &SwarmName) -> Value {
        let own = match self.role {
            Role::Vehicle(id) => Some(id),
            Role::Observer | Role::Operator => None,
        };
        let rule = |id: &str, flow: &str, key: String, messages: &[&str]| json!({ "id": id, "permission": "allow", "flows": [flow], "key_exprs": [key], "messages": messages });
        let branch = |id: &VehicleId| format!("{swarm}/vehicle/{id}/**");
        let (orders, all) = (format!("{swarm}/order/*"), format!("{swarm}/**"));
        // Nobody deletes; a token that goes is a token's message too.
        let says = ["put", "reply", "liveliness_token", "declare_queryable"];
        let listens = ["declare_subscriber", "query", "declare_liveliness_subscriber", "liveliness_query"];

        let mut rules =
            vec![rule("is-listened-to", "ingress", all.clone(), &listens), rule("listens", "egress", all, &listens)];
        let mut everybody = vec!["is-listened-to", "listens"];
        match self.role {
            Role::Vehicle(id) => {
                rules.push(rule("says", "egress", branch(&id), &says));
                rules.push(rule("is-ordered", "ingress", orders, &["put"]));
                everybody.push("says");
            }
            Role::Operator => {
                rules.push(rule("orders", "egress", orders, &["put"]));
                everybody.push("orders");
            }
            Role::Observer => {}
        }
        let (mut subjects, mut policies) = (Vec::new(), Vec::new());
        let mut subject = |name: &str, rules: &[&str]| {
            subjects.push(json!({ "id": name, "cert_common_names": [name] }));
            policies.push(json!({ "subjects": [name], "rules": rules }));
        };
        // Nobody else has the own name.
        for (id, name) in self.names.vehicles.iter().filter(|(id, _)| Some(**id) != own) {
            let is_heard = format!("{name} is heard");
            subject(name, &[&everybody[..], &[&is_heard]].concat());
            rules.push(rule(&is_heard, "ingress", branch(id), &says));
        }
        subject(&self.names.observer, &everybody);
        let orders: &[&str] = if own.is_some() { &["is-ordered"] } else { &[] };
        subject(&self.names.operator, &[&everybody[..], orders].concat());
        json!({
            "enabled": true,
            "default_permission": "deny",
            "rules": rules,
            "subjects": subjects,
            "policies": policies,
        })
    }
}

/// Whether there is such a thing in this file, under a path that Zenoh takes.
fn pem(path: &Path, what: &str) -> Result<(), LinkError> {
    let fault = |source| LinkError::File { path: path.to_owned(), source };
    let text = fs::read_to_string(path).map_err(fault)?;
    if !text.contains(what) {
        return Err(fault(io::Error::new(
            io::ErrorKind::InvalidData,
            format!("no {} in it", what.trim_end_matches('-')),
        )));
    }
    match path.to_str() {
        Some(path) if !path.contains(SEPARATORS) => Ok(()),
        _ => Err(fault(io::Error::new(io::ErrorKind::InvalidInput, "its path has one of ? # ; | or is not UTF-8"))),
    }
}
