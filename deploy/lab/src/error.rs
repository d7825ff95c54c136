//! The errors that end a command: each is reported once, with the exit status that scripts rely on.

use std::io;
use std::process::ExitCode;

use miette::{GraphicalReportHandler, LabeledSpan, MietteDiagnostic, NamedSource, Report};
use skein_common::scenario::ScenarioError;

/// The reason why a command failed.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A scenario file or a `--set` option is invalid: exit status 2, nothing was written.
    #[error("{fault}")]
    Scenario {
        /// The error and its place in the file.
        fault: Box<ScenarioError>,
        /// Text of the scenario file.
        text: String,
    },
    /// The command cannot be carried out: exit status 2, nothing was started or written.
    #[error("{0}")]
    Refused(String),
    /// The command started and failed: exit status 1.
    #[error("{0}")]
    Failed(String),
}

impl Error {
    /// The exit status of the process.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Scenario { .. } | Self::Refused(_) => 2,
            Self::Failed(_) => 1,
        }
    }

    /// Writes the error to stderr and returns the exit status.
    ///
    /// A terminal that obeys escape sequences gets the line of the file with the error marked; a pipe gets one line:
    /// `file:line:column: message; help`.
    pub fn report(&self) -> ExitCode {
        match self.drawn().filter(|_| crate::terminal::obeys_escapes(&io::stderr())) {
            Some(drawn) => eprint!("{drawn}"),
            None => crate::terminal::complain(&self.to_string()),
        }
        self.exit_code().into()
    }

    /// The line of the file with the error marked, if a file is invalid.
    fn drawn(&self) -> Option<String> {
        let Self::Scenario { fault, text } = self else { return None };
        let label = LabeledSpan::at(fault.span.clone()?, "here");
        let mut marked = MietteDiagnostic::new(&*fault.message).with_label(label);
        marked.help = fault.help.as_ref().map(ToString::to_string);
        let marked = Report::new(marked).with_source_code(NamedSource::new(&*fault.file, text.clone()));
        let mut drawn = String::new();
        GraphicalReportHandler::new().render_report(&mut drawn, &*marked).ok()?;
        Some(drawn)
    }
}

#[cfg(test)]
mod tests {
    use skein_common::scenario::{Source, load};

    use super::*;

    fn error(text: &str, sets: &[String]) -> Error {
        let fault = load(&Source { name: "my.toml", text }, sets).unwrap_err().into();
        Error::Scenario { fault, text: text.to_owned() }
    }

    #[test]
    fn an_error_in_a_file_is_drawn_with_its_line() {
        let error = error("[swarm]\nvehicles = 4\n[formation]\nraduis_m = 80\n", &[]);
        let line = "my.toml:4:1: unknown key `formation.raduis_m`; did you mean `formation.radius_m`?";
        assert_eq!(error.to_string(), line);
        assert_eq!(error.exit_code(), 2);
        let drawn = error.drawn().unwrap();
        for part in ["my.toml:4:1", "raduis_m = 80", "unknown key", "did you mean `formation.radius_m`?"] {
            assert!(drawn.contains(part), "{part} is missing in\n{drawn}");
        }
    }

    #[test]
    fn an_error_in_an_option_has_no_line() {
        let error = error("swarm.vehicles = 4", &["seed=x".to_owned()]);
        assert_eq!(error.drawn(), None);
        assert!(error.to_string().starts_with("--set seed=x: "), "{error}");
    }
}
