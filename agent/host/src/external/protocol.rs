//! The JSON lines exchanged with a law.
//!
//! Skein sends hello, ask and bye; the law sends ready and answer. Each line is one object in UTF-8 with finite
//! numbers. Objects of one kind always have the same keys and no nulls. Unknown keys are ignored; any other deviation
//! is a [`Fault`], which costs one reply and nothing more.

use nalgebra::{Vector2, Vector3};
use serde::Serialize;
use serde_json::{Map, Value};
use skein_common::id::VehicleId;
use skein_common::message::LawNumber;
use skein_common::scenario::Scenario;

use skein_core::formation::external::{LawQuery, LawReply, ReplyCommand};
use skein_core::random::{self, Purpose};

/// Version of the protocol.
pub const PROTOCOL: u64 = 1;
/// Longest line from a law, bytes.
pub const MAX_LINE: usize = 64 * 1024;
/// Largest absolute value of a number from a law.
const MAX_NUMBER: f64 = 1e9;
/// Length of the excerpt of a faulty line in a log, characters.
const EXCERPT: usize = 80;

/// First message to a law, which then starts from its initial state.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Hello {
    /// [`PROTOCOL`].
    pub protocol: u64,
    /// Scenario and seed, as `name/seed`.
    pub run: String,
    /// Vehicle of this law.
    pub vehicle: VehicleId,
    /// Ids of the whole swarm, ascending.
    pub ids: Vec<VehicleId>,
    /// Seed for the law's own random numbers, different for each vehicle and run. Exact as a floating-point number too.
    pub seed: u64,
    /// Whether the flight waits for replies.
    pub time: Time,
    /// Time between two queries, s.
    pub period_s: f64,
    /// Speed to which a faster reply is cut, m/s.
    pub max_speed_m_s: f64,
    /// Parameters from the scenario.
    pub parameters: toml::Table,
}

/// The kind of time in which a flight runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Time {
    /// The flight waits for every reply.
    Virtual,
    /// The flight never waits.
    Real,
}

impl Hello {
    /// Hello for the law of vehicle `own`.
    pub fn new(scenario: &Scenario, own: VehicleId, time: Time) -> Self {
        let external = &scenario.formation.external;
        let mut generator = random::generator(scenario.seed, Some(own), Purpose::Law);
        let draw = random::uniform(&mut generator) * f64::from(u32::MAX);
        Self {
            protocol: PROTOCOL,
            run: format!("{}/{}", scenario.name, scenario.seed),
            vehicle: own,
            ids: scenario.ids().collect(),
            seed: draw as u64,
            time,
            period_s: external.period_s,
            max_speed_m_s: external.max_speed_m_s,
            parameters: external.parameters.clone(),
        }
    }
}

/// A message to a law.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "say", rename_all = "snake_case")]
pub enum MessageToLaw<'a> {
    /// First message, sent again to start the law anew.
    Hello(&'a Hello),
    /// Query that needs one reply.
    #[serde(rename = "ask")]
    LawQuery(&'a LawQuery),
    /// Last message.
    Bye,
}

impl MessageToLaw<'_> {
    /// The message as a line, with its newline.
    pub fn line(&self) -> Vec<u8> {
        // The messages hold only numbers, texts and a TOML table, whose keys are texts.
        #[expect(clippy::expect_used, reason = "a message to a law always has a JSON form")]
        let mut line = serde_json::to_vec(self).expect("a line of JSON");
        line.push(b'\n');
        line
    }
}

/// A valid message from a law.
#[derive(Clone, Debug, PartialEq)]
pub enum MessageFromLaw {
    /// The law has processed the hello.
    Ready,
    /// Reply to a query.
    LawReply(LawReply),
}

/// The reason why a message from a law is not valid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Fault {
    /// Not a JSON object. `NaN` and `Infinity` also make a line invalid JSON.
    #[error("a line that is not a JSON object ({0}): {1}")]
    NotJson(String, String),
    /// The line is too long.
    #[error("a line longer than {MAX_LINE} bytes")]
    TooLong,
    /// Neither ready nor answer, or one of them at the wrong time.
    #[error("an unexpected line: {0}")]
    OutOfPlace(String),
    /// Another version of the protocol.
    #[error("another protocol version than {PROTOCOL}")]
    Protocol,
    /// A datagram of the wrong length.
    #[error("a datagram of {0} bytes, not {expected}", expected = .1)]
    Length(usize, usize),
    /// A key of a reply is missing or has a wrong value.
    #[error("a reply whose {0}")]
    Content(&'static str),
    /// A reply for another vehicle.
    #[error("a reply for vehicle {0}")]
    Vehicle(u64),
    /// A reply to a tick that is not the open query's.
    #[error("a reply to tick {got}, not {open}")]
    Tick {
        /// Tick of the reply.
        got: u64,
        /// Tick of the open query.
        open: u64,
    },
    /// A reply to an earlier query, or after its deadline.
    #[error("a late reply, to tick {0}")]
    Late(u64),
}

/// Reads a line from a law.
///
/// # Errors
/// The fault of the line. The caller has to check that a reply answers the open query.
pub fn read(line: &[u8]) -> Result<MessageFromLaw, Fault> {
    let not_json = |why: String| Fault::NotJson(why, excerpt(line));
    let object = match serde_json::from_slice(line) {
        Ok(Value::Object(object)) => object,
        Ok(_) => return Err(not_json("not an object".to_owned())),
        Err(error) => return Err(not_json(error.to_string())),
    };
    match object.get("say").and_then(Value::as_str) {
        Some("ready") if whole(object.get("protocol")) == Some(PROTOCOL) => Ok(MessageFromLaw::Ready),
        Some("ready") => Err(Fault::Protocol),
        Some("answer") => answer(&object).map(MessageFromLaw::LawReply),
        _ => Err(Fault::OutOfPlace(excerpt(line))),
    }
}

fn answer(object: &Map<String, Value>) -> Result<LawReply, Fault> {
    let vehicle = whole(object.get("vehicle")).ok_or(Fault::Content("vehicle is not a number"))?;
    let tick = whole(object.get("tick")).ok_or(Fault::Content("tick is not a number"))?;
    let command = match (object.get("velocity_ned_m_s"), object.get("field_ne")) {
        (Some(velocity), None) => {
            let velocity = numbers(velocity).ok_or(Fault::Content("velocity_ned_m_s is not three finite numbers"))?;
            ReplyCommand::VelocityNed(Vector3::from(velocity))
        }
        (None, Some(field)) => {
            let field = numbers(field).ok_or(Fault::Content("field_ne is not two finite numbers"))?;
            ReplyCommand::FieldNe(Vector2::from(field))
        }
        _ => return Err(Fault::Content("velocity_ned_m_s and field_ne are both present, or both missing")),
    };
    let heading = object.get("heading_rad").map(|heading| number(heading).ok_or("heading_rad is not a finite number"));
    let heading_rad = heading.transpose().map_err(Fault::Content)?;
    let reached = object.get("reached").map(|reached| reached.as_bool().ok_or("reached is neither true nor false"));
    let reached = reached.transpose().map_err(Fault::Content)?;
    let vehicle = vehicle_id(vehicle)?;
    Ok(LawReply { vehicle, tick, command, heading_rad, reached, log: object.get("log").map(log).unwrap_or_default() })
}

/// Vehicle id of this number.
///
/// # Errors
/// If the number is not a vehicle id.
pub(super) fn vehicle_id(number: u64) -> Result<VehicleId, Fault> {
    let id = u8::try_from(number).ok().and_then(|number| VehicleId::new(number).ok());
    id.ok_or(Fault::Vehicle(number))
}

/// The first numbers of a law's log, by name. Values that are not numbers are left out, because no flight depends on
/// the log.
fn log(value: &Value) -> Vec<LawNumber> {
    let Some(object) = value.as_object() else { return Vec::new() };
    let numbers = object.iter().filter_map(|(name, value)| {
        let end = name.floor_char_boundary(LawNumber::MAX_NAME);
        Some(LawNumber { name: name[..end].to_owned(), value: number(value)? })
    });
    numbers.take(LawNumber::MAX_COUNT).collect()
}

fn numbers<const N: usize>(value: &Value) -> Option<[f64; N]> {
    let numbers: Vec<f64> = value.as_array()?.iter().map(number).collect::<Option<_>>()?;
    numbers.try_into().ok()
}

fn number(value: &Value) -> Option<f64> {
    value.as_f64().filter(|number| number.abs() <= MAX_NUMBER)
}

/// A whole number, written with or without a fraction or exponent.
fn whole(value: Option<&Value>) -> Option<u64> {
    let value = value?;
    value.as_u64().or_else(|| value.as_f64().and_then(whole_f64))
}

/// Converts a number that is whole, not negative and exact.
pub(super) fn whole_f64(number: f64) -> Option<u64> {
    (number.fract() == 0.0 && (0.0..9e15).contains(&number)).then_some(number as u64)
}

/// Whether a number from a law is finite and not too large.
pub(super) fn is_sane(number: f64) -> bool {
    number.abs() <= MAX_NUMBER
}

fn excerpt(line: &[u8]) -> String {
    let text = String::from_utf8_lossy(&line[..line.len().min(4 * EXCERPT)]);
    let shown: String = text.trim_end().chars().take(EXCERPT).collect();
    format!("{shown:?}")
}

#[cfg(test)]
mod tests;
