//! The checks that X-Plane 12's Web API adds. UDP is silent about a dataref that does not exist; the Web API says so.

use skein_core::aircraft::Profile;

use skein_cluster::findings::Line;
use skein_cluster::simulators::reset::RESET;
use skein_cluster::simulators::survey::{ACF, Survey, VERSION};
use skein_cluster::simulators::web::{WebApi, WebError};

/// First version number with a Web API, and the first that starts flights.
const FIRST: f32 = 121_100.0;

/// The Web API as it was found, if it was looked for.
pub(super) struct WebChecks(pub(super) Option<Result<WebApi, WebError>>);

impl WebChecks {
    fn api(&self) -> Option<&WebApi> {
        self.0.as_ref()?.as_ref().ok()
    }

    /// Path of the loaded aircraft's file.
    pub(super) fn aircraft(&self) -> Option<String> {
        self.api()?.text(ACF)
    }

    /// The exact value of a number; `None` where UDP has to answer.
    pub(super) fn number(&self, name: &str) -> Option<f64> {
        self.api()?.number(name)
    }

    /// Whether it is there, and whether it lists every dataref of the aircraft's file and every command that Skein sends.
    pub(super) fn lines(&self, place: &str, survey: &Survey, profile: &Profile) -> Vec<Line> {
        let line = |found: String| Line::new(place, "web API", found);
        match &self.0 {
            None => {
                vec![line("not looked for: it answers on the X-Plane's own PC only, see --web".to_owned()).unknown()]
            }
            Some(Err(WebError::Forbidden(at))) => vec![
                line(format!("{at} refuses everything"))
                    .warning("set Settings, Network, \"Accept incoming connections\""),
            ],
            Some(Err(_)) if survey.value(VERSION).is_some_and(|version| version < FIRST) => {
                vec![line("X-Plane before 12.1.1 has none, and needs none to fly".to_owned())]
            }
            Some(Err(error)) => vec![line(format!("{error}; not needed to fly")).unknown()],
            Some(Ok(api)) => {
                let flights = if api.starts_flights() { "starts flights" } else { "starts no flights" };
                let found = format!(
                    "{} of X-Plane {}, {} datarefs, {flights}",
                    api.versions.join(", "),
                    api.simulator,
                    api.count()
                );
                std::iter::once(line(skein_common::printable::printable(&found, 120)))
                    .chain(missing(place, api, profile))
                    .chain(commands(place, api))
                    .collect()
            }
        }
    }
}

/// Whether X-Plane has the commands that Skein sends; aircraft files name none.
fn commands(place: &str, api: &WebApi) -> Option<Line> {
    let line = |found: &str| Line::new(place, "web commands", format!("{RESET}: {found}"));
    Some(match api.has_command(RESET)? {
        true => line("exists"),
        false => line("X-Plane has no such command")
            .warning("`skein fly --runs` cannot reset a crashed aircraft: reset it by hand"),
    })
}

/// Each dataref of the aircraft's file that X-Plane does not list.
fn missing(place: &str, api: &WebApi, profile: &Profile) -> Vec<Line> {
    let line = |found: String| Line::new(place, "web datarefs", found);
    let missing = |path: &str| {
        let remedy = "correct the table [xplane] of the aircraft's file, or load the aircraft that it is for";
        api.find(path).is_none().then(|| line(format!("{path}: X-Plane has no such dataref")).fault(remedy))
    };
    super::each_dataref(profile, missing, |all| line(format!("all {all} of the aircraft's file exist")))
}
