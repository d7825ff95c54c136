//! Reads recordings.

use std::path::PathBuf;

use pyo3::prelude::*;
use skein_lab::error::Error;
use skein_lab::record;

use crate::error::{exception, refused};

/// Writes the tables of a recording into a folder, as `skein report --csv` does, and returns its scenario as JSON text.
#[pyfunction]
pub(crate) fn recording_tables(py: Python<'_>, file: PathBuf, folder: PathBuf) -> PyResult<String> {
    let read = py.detach(|| record::csv(&file, &folder).and_then(|_| record::read(&file)));
    let recording = read.map_err(|error| exception(py, &Error::Refused(error.to_string())))?;
    serde_json::to_string(&recording.scenario).map_err(|error| refused(py, error))
}
