//! A client of X-Plane 12's Web API, for the commands that check an X-Plane and place its aircraft. Agents do without it:
//! nothing in flight depends on it.
//!
//! What an X-Plane did is read from its state, never from its reply: it can time out while scenery loads, and answer
//! yes to what it does not do.

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::str::FromStr;
use std::time::Duration;

use serde_json::{Value, json};
use skein_common::printable::printable;

use crate::ports::HostPort;

/// X-Plane's port.
const PORT: u16 = 8086;
/// Time for a connection, for an answer of a PC that does much else, and for a flight that is being loaded.
const CONNECTS_WITHIN: Duration = Duration::from_secs(3);
const ANSWERS_WITHIN: Duration = Duration::from_secs(10);
const LOADS_WITHIN: Duration = Duration::from_secs(60);
/// Largest answer, bytes: X-Plane lists about ten thousand datarefs.
const LARGEST: u64 = 32 * 1024 * 1024;
/// Longest reason for a refusal that is shown, characters.
const MESSAGE_CHARACTERS: usize = 120;

/// The address at which the Web API of an X-Plane is looked for, if it is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum WebChoice {
    /// Nowhere.
    Off,
    /// There.
    At(HostPort),
}

impl FromStr for WebChoice {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let with_port = if text.contains(':') { text.to_owned() } else { format!("{text}:{PORT}") };
        match text {
            "off" => Ok(Self::Off),
            _ => with_port.parse().map(Self::At).map_err(|_| "has to be HOST or HOST:PORT, or off".to_owned()),
        }
    }
}

impl WebChoice {
    /// The given choice, else the one that is written in the scenario, else the simulator's own host where that is this PC: X-Plane
    /// answers on the loopback only.
    pub fn or_of(given: Option<&Self>, written: Option<&str>, simulator: &HostPort) -> Self {
        let written = written.and_then(|text| text.parse().ok()).map(Self::At);
        let is_here = simulator.host == "localhost"
            || simulator.host.parse::<IpAddr>().is_ok_and(|address| address.is_loopback());
        match given.cloned().or(written) {
            Some(choice) => choice,
            None if is_here => Self::At(HostPort { host: simulator.host.clone(), port: PORT }),
            None => Self::Off,
        }
    }

    /// Looks for it there; `None` if it is not to be looked for.
    pub fn open(&self) -> Option<Result<WebApi, WebError>> {
        match self {
            Self::Off => None,
            Self::At(at) => Some(WebApi::open(at)),
        }
    }
}

/// The reason why the Web API gives no answer of use.
#[derive(Debug, thiserror::Error)]
pub enum WebError {
    /// Nothing answers.
    #[error("no Web API at {0}: {1}")]
    Absent(String, String),
    /// X-Plane's settings refuse everything.
    #[error("the Web API at {0} refuses everything: \"Accept incoming connections\" is off in Settings, Network")]
    Forbidden(String),
    /// One request was refused.
    #[error("{0}: {1}")]
    Refused(u16, String),
    /// The answer is not X-Plane's.
    #[error("the program at {0} is not X-Plane: {1}")]
    Foreign(String, String),
}

/// A dataref as X-Plane lists it.
#[derive(Clone, Debug, PartialEq)]
pub struct ListedDataref {
    pub(crate) id: u64,
    pub(crate) value_type: String,
}

/// An X-Plane's Web API.
#[derive(Debug)]
pub struct WebApi {
    agent: ureq::Agent,
    place: String,
    /// Supported versions, `v1` and so on.
    pub versions: Vec<String>,
    /// X-Plane's version, `12.4.0`.
    pub simulator: String,
    datarefs: BTreeMap<String, ListedDataref>,
}

impl WebApi {
    /// Asks for the versions and the list of datarefs, whose numbers hold until X-Plane ends.
    ///
    /// # Errors
    /// If nothing answers, or X-Plane refuses.
    pub fn open(at: &HostPort) -> Result<Self, WebError> {
        let config = ureq::Agent::config_builder().http_status_as_error(false).proxy(None);
        let agent =
            config.timeout_connect(Some(CONNECTS_WITHIN)).timeout_global(Some(LOADS_WITHIN)).build().new_agent();
        let place = at.to_string();
        let mut api = Self { agent, place, versions: Vec::new(), simulator: String::new(), datarefs: BTreeMap::new() };
        match api.get("capabilities") {
            Ok(found) => {
                let versions = found["api"]["versions"].as_array().cloned().unwrap_or_default();
                api.versions = versions.iter().filter_map(Value::as_str).map(str::to_owned).collect();
                api.simulator = found["x-plane"]["version"].as_str().unwrap_or("unknown").to_owned();
            }
            // 12.1.1 to 12.1.3 have no list of versions.
            Err(WebError::Refused(404, _)) => {
                api.versions = vec!["v1".to_owned()];
                api.simulator = "12.1.1 or later".to_owned();
            }
            Err(error) => return Err(error),
        }
        let listed = datarefs(&api.get(&format!("{}/datarefs", api.version()))?);
        api.datarefs = listed.ok_or_else(|| WebError::Foreign(api.place.clone(), "it lists no datarefs".to_owned()))?;
        Ok(api)
    }

    /// The newest version that this client knows.
    fn version(&self) -> &'static str {
        ["v3", "v2"].into_iter().find(|known| self.versions.iter().any(|version| version == known)).unwrap_or("v1")
    }

    /// Whether it starts flights: X-Plane 12.4 and later.
    pub fn starts_flights(&self) -> bool {
        self.version() == "v3"
    }

    /// Number of datarefs.
    pub fn count(&self) -> usize {
        self.datarefs.len()
    }

    /// The dataref with this name; `name[2]` is one of an array, or in X-Plane 11's style a name of its own.
    pub fn find(&self, path: &str) -> Option<&ListedDataref> {
        let name = path.split_once('[').map_or(path, |(name, _)| name);
        self.datarefs.get(path).or_else(|| self.datarefs.get(name))
    }

    /// Value of a dataref, whole and exact.
    ///
    /// # Errors
    /// If X-Plane has no such dataref, or does not answer.
    pub(crate) fn read(&self, name: &str) -> Result<Value, WebError> {
        let missing = || WebError::Refused(404, format!("Dataref {name} doesn't exist"));
        let id = self.find(name).ok_or_else(missing)?.id;
        let mut reply = self.get(&format!("{}/datarefs/{id}/value", self.version()))?;
        Ok(reply.get_mut("data").map(Value::take).unwrap_or_default())
    }

    /// A number, exact; `None` if X-Plane has no such dataref, or it is no number.
    pub fn number(&self, name: &str) -> Option<f64> {
        self.find(name)?;
        self.read(name).ok()?.as_f64()
    }

    /// Whether X-Plane has a command of this name; `None` if it does not say: its first version lists no commands.
    pub fn has_command(&self, name: &str) -> Option<bool> {
        if self.version() == "v1" {
            return None;
        }
        match self.get(&format!("{}/commands?filter%5Bname%5D={name}", self.version())) {
            Ok(found) => Some(found["data"].as_array()?.iter().any(|command| command["name"] == name)),
            Err(WebError::Refused(404, _)) => Some(false),
            Err(_) => None,
        }
    }

    /// A text that X-Plane keeps as bytes, up to its end.
    pub fn text(&self, name: &str) -> Option<String> {
        use base64::Engine;
        let bytes = base64::engine::general_purpose::STANDARD.decode(self.read(name).ok()?.as_str()?).ok()?;
        let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
        Some(String::from_utf8_lossy(&bytes[..end]).into_owned())
    }

    /// Asks for a new flight. Whether it began has to be read from the simulator's state.
    ///
    /// # Errors
    /// If X-Plane refuses it, or does not answer.
    pub(crate) fn start_flight(&self, flight: &Value) -> Result<(), WebError> {
        let address = self.address(&format!("{}/flight", self.version()));
        self.answer(self.agent.post(&address).send_json(json!({ "data": flight }))).map(drop)
    }

    /// Asks for a change of the flight under way: of everything but its aircraft and its start. Whether it was changed has to be
    /// read from the simulator's state.
    ///
    /// # Errors
    /// If X-Plane refuses it, or does not answer.
    pub(crate) fn change_flight(&self, flight: &Value) -> Result<(), WebError> {
        let address = self.address(&format!("{}/flight", self.version()));
        self.answer(self.agent.patch(&address).send_json(json!({ "data": flight }))).map(drop)
    }

    fn address(&self, path: &str) -> String {
        format!("http://{}/api/{path}", self.place)
    }

    fn get(&self, path: &str) -> Result<Value, WebError> {
        let request = self.agent.get(self.address(path)).config().timeout_global(Some(ANSWERS_WITHIN)).build();
        self.answer(request.header("Accept", "application/json").call())
    }

    fn answer(&self, answer: Result<ureq::http::Response<ureq::Body>, ureq::Error>) -> Result<Value, WebError> {
        let mut answer = answer.map_err(|error| WebError::Absent(self.place.clone(), error.to_string()))?;
        let status = answer.status().as_u16();
        let text = answer.body_mut().with_config().limit(LARGEST).read_to_string();
        let text = text.map_err(|error| WebError::Foreign(self.place.clone(), error.to_string()))?;
        read_answer(&self.place, status, &text)
    }
}

/// Reads the answer of an X-Plane at this place, with this status and text.
///
/// # Errors
/// If it refuses, or the text is not JSON.
pub fn read_answer(place: &str, status: u16, text: &str) -> Result<Value, WebError> {
    let body = serde_json::from_str::<Value>(text);
    match (status, body) {
        (403, Ok(body)) if body["error_code"] == "dataref_is_readonly" => {
            Err(WebError::Refused(status, "the dataref cannot be written".to_owned()))
        }
        (403, _) => Err(WebError::Forbidden(place.to_owned())),
        (200, Ok(body)) => Ok(body),
        (200, Err(_)) if text.trim().is_empty() => Ok(Value::Null),
        (200, Err(error)) => Err(WebError::Foreign(place.to_owned(), error.to_string())),
        (_, body) => {
            let message =
                body.ok().and_then(|body| Some(printable(body["error_message"].as_str()?, MESSAGE_CHARACTERS)));
            Err(WebError::Refused(status, message.unwrap_or_else(|| "without a reason".to_owned())))
        }
    }
}

/// The datarefs in an answer, by their names; `None` if it lists none.
fn datarefs(answer: &Value) -> Option<BTreeMap<String, ListedDataref>> {
    let entry = |entry: &Value| {
        let value_type = entry["value_type"].as_str()?.to_owned();
        Some((entry["name"].as_str()?.to_owned(), ListedDataref { id: entry["id"].as_u64()?, value_type }))
    };
    Some(answer["data"].as_array()?.iter().filter_map(entry).collect())
}
