//! Asks laws that are Python objects in this process.

use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::{Vector2, Vector3};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use skein_common::id::VehicleId;
use skein_common::message::LawNumber;
use skein_core::formation::external::{LawQuery, LawReply, ReplyCommand};
use skein_core::formation::law::Neighbour;
use skein_host::external::protocol::Hello;
use skein_lab::external::{LawMaker, LocalLaws};

/// Largest absolute value of a number from a law, as in the protocol of laws in other programs.
const MAX_NUMBER: f64 = 1e9;

/// The laws of a study, which are objects of one Python class.
#[derive(Clone)]
pub(crate) struct LawsInPython {
    /// Makes a law from the contents of a hello.
    make: Arc<Py<PyAny>>,
    /// Asks a law: takes it with the parts of a query and returns the parts of the answer.
    ask: Arc<Py<PyAny>>,
    /// The first exception that a law has raised.
    raised: Arc<Mutex<Option<PyErr>>>,
}

impl LawsInPython {
    pub(crate) fn new(py: Python<'_>, law: Py<PyAny>) -> PyResult<Self> {
        let module = py.import("skein._laws")?;
        let make = module.getattr("_Maker")?.call1((law,))?;
        Ok(Self {
            make: Arc::new(make.unbind()),
            ask: Arc::new(module.getattr("_ask")?.unbind()),
            raised: Arc::default(),
        })
    }

    /// Makes the laws of each run.
    pub(crate) fn maker(&self) -> LawMaker {
        let of = self.clone();
        LawMaker::new(move || Box::new(LawsOfRun { of: of.clone(), laws: Vec::new() }))
    }

    /// Takes the first exception that a law has raised.
    pub(crate) fn take_raised(&self) -> Option<PyErr> {
        self.raised.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

/// One object for each vehicle of a run.
struct LawsOfRun {
    of: LawsInPython,
    laws: Vec<(VehicleId, Py<PyAny>)>,
}

impl fmt::Debug for LawsOfRun {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LawsOfRun").field("vehicles", &self.laws.len()).finish_non_exhaustive()
    }
}

impl LawsOfRun {
    /// Calls Python and keeps the exception that it raises.
    fn call<T>(&self, call: impl FnOnce(Python<'_>) -> PyResult<T>) -> Result<T, String> {
        Python::attach(|py| {
            call(py).map_err(|error| {
                let text = error.to_string();
                self.of.raised.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
                text
            })
        })
    }
}

impl LocalLaws for LawsOfRun {
    fn begin(&mut self, hello: &Hello) -> Result<(), String> {
        let text = serde_json::to_string(hello).map_err(|error| error.to_string())?;
        let law = self.call(|py| self.of.make.call1(py, (text,)))?;
        self.laws.retain(|(id, _)| *id != hello.vehicle);
        self.laws.push((hello.vehicle, law));
        Ok(())
    }

    fn answer(&mut self, query: &LawQuery) -> Result<LawReply, String> {
        let law = self.laws.iter().find(|(id, _)| *id == query.vehicle).map(|(_, law)| law);
        let law = law.ok_or_else(|| "it has not begun".to_owned())?;
        self.call(|py| {
            let answer = self.of.ask.call1(py, (law, parts_of(py, query)?))?;
            reply(query, &answer.extract(py)?)
        })
    }
}

/// A query as nested lists, in the order of its fields.
fn parts_of<'py>(py: Python<'py>, query: &LawQuery) -> PyResult<Bound<'py, PyList>> {
    let (own, goal) = (&query.own, &query.goal);
    let peer = |peer: &Neighbour| {
        let (position, velocity): ([f64; 3], [f64; 3]) = (peer.position.into(), peer.velocity.into());
        (peer.id.get(), position, velocity, peer.heading_rad, peer.age_s, peer.is_fresh).into_pyobject(py)
    };
    let parts = PyList::empty(py);
    parts.append(query.vehicle.get())?;
    parts.append(query.tick)?;
    parts.append(query.time_s)?;
    parts.append(query.dt_s)?;
    let (position, velocity): ([f64; 3], [f64; 3]) = (own.position.into(), own.velocity.into());
    parts.append((position, velocity, own.heading_rad, own.age_s))?;
    parts.append(query.peers.iter().map(peer).collect::<PyResult<Vec<_>>>()?)?;
    let (centre, velocity): ([f64; 3], [f64; 3]) = (goal.centre.into(), goal.centre_velocity.into());
    parts.append((goal.step, centre, velocity, goal.heading_rad, goal.radius_m, goal.gamma))?;
    Ok(parts)
}

/// An answer's velocity or field, heading, whether the vehicle is in place, and numbers for the recording.
type Parts<'py> = (Vec<f64>, Option<f64>, Option<bool>, Option<Bound<'py, PyDict>>);

/// The reply to a query; an answer that the protocol refuses is an exception here.
fn reply(query: &LawQuery, parts: &Parts<'_>) -> PyResult<LawReply> {
    let (numbers, heading_rad, reached, log) = parts;
    let wrong = |what: &str| Err(pyo3::exceptions::PyValueError::new_err(what.to_owned()));
    if !numbers.iter().chain(heading_rad).all(|number| number.abs() <= MAX_NUMBER) {
        return wrong("the law's answer has a number that is not finite or beyond 1e9");
    }
    let command = match *numbers.as_slice() {
        [north, east, down] => ReplyCommand::VelocityNed(Vector3::new(north, east, down)),
        [north, east] => ReplyCommand::FieldNe(Vector2::new(north, east)),
        _ => return wrong("a velocity has three numbers and a field has two"),
    };
    let log = log.iter().flat_map(|log| log.iter()).filter_map(|(name, value)| {
        let mut name: String = name.extract().ok()?;
        name.truncate(name.floor_char_boundary(LawNumber::MAX_NAME));
        let value = value.extract().ok().filter(|value: &f64| value.abs() <= MAX_NUMBER)?;
        Some(LawNumber { name, value })
    });
    // The protocol's JSON reader takes the names in their order.
    let mut log: Vec<LawNumber> = log.collect();
    log.sort_by(|one, other| one.name.cmp(&other.name));
    log.truncate(LawNumber::MAX_COUNT);
    let (vehicle, tick) = (query.vehicle, query.tick);
    Ok(LawReply { vehicle, tick, command, heading_rad: *heading_rad, reached: *reached, log })
}
