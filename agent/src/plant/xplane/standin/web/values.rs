//! Indices of datarefs, and values as JSON that a client wants to write.

use serde_json::Value as Json;

use super::Fault;
use crate::plant::xplane::server::Dataref;

/// Number of engines of X-Plane 12, the only version with a Web API.
const ENGINES: usize = 16;

/// Checks an index against a dataref; `what` names the dataref in the message.
pub(super) fn check_index(dataref: &Dataref, index: Option<u64>, what: &str) -> Result<Option<usize>, Fault> {
    let Some(index) = index else { return Ok(None) };
    if !dataref.is_array() {
        let message = format!("An index was provided for {what} but the dataref is not an array");
        return Err(Fault::bad("not_an_array", message));
    }
    let at = usize::try_from(index).ok().filter(|&at| at < dataref.elements(ENGINES));
    at.map(Some).ok_or_else(|| Fault::bad("index_out_of_range", format!("{what} array index out of range")))
}

/// The elements that a client wants to write, with their values.
pub(super) fn elements(dataref: &Dataref, index: Option<usize>, data: &Json) -> Result<Vec<(usize, f64)>, Fault> {
    let unfit = || {
        Fault::bad("incompatible_data", "Provided data is too much or not enough to set all elements of the dataref")
    };
    if !dataref.is_writable() {
        let message = "Attempted to write to a read-only dataref";
        return Err(Fault::new(axum::http::StatusCode::FORBIDDEN, "dataref_is_readonly", message));
    }
    match (data, index) {
        (Json::Array(values), None) if values.len() == dataref.elements(ENGINES) && dataref.is_array() => {
            values.iter().enumerate().map(|(at, value)| Ok((at, value.as_f64().ok_or_else(unfit)?))).collect()
        }
        (Json::Number(value), None) if !dataref.is_array() => Ok(vec![(0, value.as_f64().ok_or_else(unfit)?)]),
        (Json::Number(value), Some(at)) => Ok(vec![(at, value.as_f64().ok_or_else(unfit)?)]),
        _ => Err(unfit()),
    }
}
