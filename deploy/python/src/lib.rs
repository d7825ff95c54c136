//! The extension module `skein._skein` of the Python package `skein-swarm`.
//!
//! It is a thin layer over `skein-lab`: the package's Python files give its results the forms that users see, such as
//! pandas frames. Every long call releases the interpreter's lock while it flies.
//!
//! | module | what it does |
//! | --- | --- |
//! | `error` | makes Python exceptions of Skein's errors |
//! | `study` | flies studies, reads and compares folders |
//! | `law` | asks laws that are Python objects in this process |
//! | `recording` | reads recordings |
//! | `env` | steps many worlds at once for learning |

mod env;
mod error;
mod law;
mod recording;
mod study;

use pyo3::prelude::*;

/// The extension module.
#[pymodule]
mod _skein {
    use pyo3::prelude::*;

    #[pymodule_export]
    use super::env::Worlds;
    #[pymodule_export]
    use super::env::observation::observation_names;
    #[pymodule_export]
    use super::recording::recording_tables;
    #[pymodule_export]
    use super::study::{compare, figures, fly_study};

    /// Adds the versions.
    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", skein_lab::VERSION)?;
        module.add("REVISION", skein_lab::REVISION)
    }
}
