//! The JSON lines that are exchanged with a law.
//!
//! Skein says hello, ask and bye, the law ready and answer: one object a line, UTF-8, numbers finite. Objects of one kind
//! always have the same keys and no nulls. Keys that are not known are ignored; whatever else is not as agreed is a
//! [`Fault`], which costs one answer and nothing more.

use nalgebra::{Vector2, Vector3};
use serde::Serialize;
use serde_json::{Map, Value};
use skein_common::id::VehicleId;
use skein_common::message::LawNumber;
use skein_common::scenario::Scenario;

use skein_core::formation::external::{Answer, Ask, Wanted};
use skein_core::random::{self, Purpose};

/// The version that is spoken.
pub const PROTOCOL: u64 = 1;
/// No line of a law is longer, bytes.
pub const MAX_LINE: usize = 64 * 1024;
/// No number of a law's is larger.
const MAX_NUMBER: f64 = 1e9;
/// So much of a faulty line is shown, characters.
const EXCERPT: usize = 80;

/// The first thing that a law is told. It then starts from nothing.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Hello {
    /// [`PROTOCOL`].
    pub protocol: u64,
    /// Scenario and seed.
    pub run: String,
    /// Whose law it is.
    pub vehicle: VehicleId,
    /// Of the whole swarm, in order.
    pub ids: Vec<VehicleId>,
    /// For the law's own randomness: another for each vehicle and run. Exact as a floating-point number too.
    pub seed: u64,
    /// Whether anybody waits for an answer.
    pub time: Time,
    /// Between two asks.
    pub period_s: f64,
    /// A faster answer is cut to this.
    pub max_speed_m_s: f64,
    /// As the scenario has them.
    pub parameters: toml::Table,
}

/// Which time a flight has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Time {
    /// It waits for every answer.
    Virtual,
    /// It waits for nobody.
    Real,
}

impl Hello {
    /// For the law of vehicle `own`.
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

/// What is said to a law.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "say", rename_all = "snake_case")]
pub enum Said<'a> {
    /// First, and again before it is to start from nothing.
    Hello(&'a Hello),
    /// Each wants one answer.
    Ask(&'a Ask),
    /// Last.
    Bye,
}

impl Said<'_> {
    /// The line, with its end.
    pub fn line(&self) -> Vec<u8> {
        // Structs of numbers and texts, and a TOML table, whose keys are texts.
        #[expect(clippy::expect_used, reason = "what is said to a law always has a JSON form")]
        let mut line = serde_json::to_vec(self).expect("a line of JSON");
        line.push(b'\n');
        line
    }
}

/// What a law can say.
#[derive(Clone, Debug, PartialEq)]
pub enum Heard {
    /// It has taken up the hello.
    Ready,
    /// To an ask.
    Answer(Answer),
}

/// What can be wrong with what a law says.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Fault {
    /// Not an object in JSON, as `NaN` and `Infinity` make it too.
    #[error("a line that is no JSON object ({0}): {1}")]
    NotJson(String, String),
    /// A line that does not end in time.
    #[error("a line longer than {MAX_LINE} bytes")]
    TooLong,
    /// Neither ready nor answer, or the one in the other's place.
    #[error("a line out of place: {0}")]
    OutOfPlace(String),
    /// Another protocol.
    #[error("another protocol than {PROTOCOL}")]
    Protocol,
    /// A datagram of the wrong length.
    #[error("a datagram of {0} bytes, not {expected}", expected = .1)]
    Length(usize, usize),
    /// A key that is missing or is not what it has to be.
    #[error("an answer whose {0}")]
    Content(&'static str),
    /// An answer for another vehicle.
    #[error("an answer for vehicle {0}")]
    Vehicle(u64),
    /// An answer to an ask that is not open.
    #[error("an answer to tick {got}, not {open}")]
    Tick {
        /// What was answered.
        got: u64,
        /// What was asked.
        open: u64,
    },
    /// An answer to an earlier ask, or after its deadline.
    #[error("a late answer, to tick {0}")]
    Late(u64),
}

impl Fault {
    /// How many kinds there are.
    pub const KINDS: usize = 9;

    /// Which kind it is, below [`Self::KINDS`].
    pub fn kind(&self) -> usize {
        match self {
            Self::NotJson(..) => 0,
            Self::TooLong => 1,
            Self::OutOfPlace(_) => 2,
            Self::Protocol => 3,
            Self::Length(..) => 4,
            Self::Content(_) => 5,
            Self::Vehicle(_) => 6,
            Self::Tick { .. } => 7,
            Self::Late(_) => 8,
        }
    }
}

/// Reads a line.
///
/// # Errors
/// What is wrong with it. Whether it is the answer to an open ask is the caller's to see.
pub fn read(line: &[u8]) -> Result<Heard, Fault> {
    let not_json = |why: String| Fault::NotJson(why, excerpt(line));
    let object = match serde_json::from_slice(line) {
        Ok(Value::Object(object)) => object,
        Ok(_) => return Err(not_json("not in braces".to_owned())),
        Err(error) => return Err(not_json(error.to_string())),
    };
    match object.get("say").and_then(Value::as_str) {
        Some("ready") if whole(object.get("protocol")) == Some(PROTOCOL) => Ok(Heard::Ready),
        Some("ready") => Err(Fault::Protocol),
        Some("answer") => answer(&object).map(Heard::Answer),
        _ => Err(Fault::OutOfPlace(excerpt(line))),
    }
}

fn answer(object: &Map<String, Value>) -> Result<Answer, Fault> {
    let vehicle = whole(object.get("vehicle")).ok_or(Fault::Content("vehicle is no number"))?;
    let tick = whole(object.get("tick")).ok_or(Fault::Content("tick is no number"))?;
    let wanted = match (object.get("velocity_ned_m_s"), object.get("field_ne")) {
        (Some(velocity), None) => {
            let velocity = numbers(velocity).ok_or(Fault::Content("velocity_ned_m_s is not three finite numbers"))?;
            Wanted::VelocityNed(Vector3::from(velocity))
        }
        (None, Some(field)) => {
            let field = numbers(field).ok_or(Fault::Content("field_ne is not two finite numbers"))?;
            Wanted::FieldNe(Vector2::from(field))
        }
        _ => return Err(Fault::Content("velocity_ned_m_s and field_ne are both there, or neither")),
    };
    let heading_rad = match object.get("heading_rad") {
        Some(heading) => Some(number(heading).ok_or(Fault::Content("heading_rad is no finite number"))?),
        None => None,
    };
    let reached = match object.get("reached") {
        Some(reached) => Some(reached.as_bool().ok_or(Fault::Content("reached is neither true nor false"))?),
        None => None,
    };
    let vehicle = vehicle_id(vehicle)?;
    Ok(Answer { vehicle, tick, wanted, heading_rad, reached, log: object.get("log").map(log).unwrap_or_default() })
}

/// The vehicle of this number.
///
/// # Errors
/// If there is none.
pub(super) fn vehicle_id(number: u64) -> Result<VehicleId, Fault> {
    let id = u8::try_from(number).ok().and_then(|number| VehicleId::new(number).ok());
    id.ok_or(Fault::Vehicle(number))
}

/// The first numbers, by name; what is no number is left out: no flight depends on it.
fn log(value: &Value) -> Vec<LawNumber> {
    let Some(object) = value.as_object() else { return Vec::new() };
    let numbers = object.iter().filter_map(|(name, value)| {
        let end = name.floor_char_boundary(LawNumber::MAX_NAME);
        Some(LawNumber { name: name[..end].to_owned(), value: number(value)? })
    });
    numbers.take(LawNumber::MAX_COUNT).collect()
}

fn numbers<const N: usize>(value: &Value) -> Option<[f64; N]> {
    let items: &[Value; N] = value.as_array()?.as_slice().try_into().ok()?;
    let mut numbers = [0.0; N];
    for (number_here, item) in numbers.iter_mut().zip(items) {
        *number_here = number(item)?;
    }
    Some(numbers)
}

fn number(value: &Value) -> Option<f64> {
    value.as_f64().filter(|number| number.abs() <= MAX_NUMBER)
}

/// A whole number, however it is written.
fn whole(value: Option<&Value>) -> Option<u64> {
    let value = value?;
    value.as_u64().or_else(|| value.as_f64().and_then(whole_f64))
}

/// A whole number, not negative and exact.
pub(super) fn whole_f64(number: f64) -> Option<u64> {
    (number.fract() == 0.0 && (0.0..9e15).contains(&number)).then_some(number as u64)
}

/// Whether a number of a law's can be believed.
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
