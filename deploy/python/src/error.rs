//! Makes Python exceptions of Skein's errors. Their text is the sentence that the command prints.

use pyo3::prelude::*;
use pyo3::types::PyDict;
use skein_lab::error::Error;

/// The exception for an error of a command: `skein.ScenarioError` for an invalid scenario, with its place in the file, and
/// `skein.SkeinError` for every other.
pub(crate) fn exception(py: Python<'_>, error: &Error) -> PyErr {
    let made = || -> PyResult<PyErr> {
        let classes = py.import("skein._errors")?;
        let raised = match error {
            Error::Scenario { fault, .. } => {
                let place = PyDict::new(py);
                place.set_item("file", &*fault.file)?;
                place.set_item("line", fault.line)?;
                place.set_item("column", fault.column)?;
                place.set_item("key", fault.key.as_deref())?;
                place.set_item("message", &*fault.message)?;
                place.set_item("help", fault.help.as_deref())?;
                classes.getattr("ScenarioError")?.call((error.to_string(),), Some(&place))?
            }
            Error::Refused(_) | Error::Failed(_) => classes.getattr("SkeinError")?.call1((error.to_string(),))?,
        };
        Ok(PyErr::from_value(raised))
    };
    made().unwrap_or_else(|error| error)
}

/// The exception `skein.SkeinError` with this sentence.
pub(crate) fn refused(py: Python<'_>, why: impl ToString) -> PyErr {
    exception(py, &Error::Refused(why.to_string()))
}

/// The exception `skein.ArgumentError` with this sentence.
pub(crate) fn wrong_argument(py: Python<'_>, why: String) -> PyErr {
    let made = || py.import("skein._errors")?.getattr("ArgumentError")?.call1((why,));
    made().map_or_else(|error| error, PyErr::from_value)
}
