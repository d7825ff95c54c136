//! `skein xplane release`: gives the controls of X-Planes back, after the PC of an agent has died.

use std::path::Path;
use std::time::Duration;

use skein_host::files;
use skein_lab::error::Error;
use skein_lab::terminal::{complain, say};

use skein_cluster::ports::HostPort;
use skein_cluster::simulators::survey::{SILENT, Surveyor};

/// `skein xplane release`
#[derive(Clone, Debug, clap::Args)]
#[command(
    long_about = "Gives the controls of X-Planes back to their pilots, and the other aircraft that showed peers to X-Plane. An \
                  agent does this when it ends; after its PC has died, X-Plane still ignores its own joystick. An agent that \
                  still flies takes the controls again at once: land it instead.",
    after_help = "Examples:\n  skein xplane release 10.0.0.7\n  skein xplane release 10.0.0.7:49000 10.0.0.8:49000"
)]
pub struct ReleaseArgs {
    /// The X-Planes
    #[arg(required = true, value_name = "HOST[:PORT]")]
    pub xplanes: Vec<HostPort>,
    /// Aircraft file whose overrides were taken; without it X-Plane's usual one
    #[arg(long, value_name = "AIRCRAFT", default_value = "xcell60", hide_default_value = true)]
    pub aircraft: String,
}

/// Time limit for X-Plane to answer, and time for which its controls have to stay free: an agent takes them five times a second.
const ANSWER: Duration = Duration::from_secs(3);
const STAYS: Duration = Duration::from_millis(600);

/// Gives the controls of each X-Plane back and reads them again.
///
/// # Errors
/// If an X-Plane does not answer, or its controls are taken again.
pub fn run(args: &ReleaseArgs) -> Result<(), Error> {
    let (profile, _) = files::profile(&args.aircraft, Path::new(""))
        .map_err(|fault| Error::Refused(format!("--aircraft: {fault}")))?;
    let overrides: Vec<String> = profile.overrides.iter().map(|path| path.as_str().to_owned()).collect();
    let mut failed = 0;
    for xplane in &args.xplanes {
        let address = xplane.to_string();
        match release(&address, &overrides) {
            Ok(done) => say(&format!("{address}: {done}\n")),
            Err(error) => {
                complain(&format!("{address}: {error}"));
                failed += 1;
            }
        }
    }
    match failed {
        0 => Ok(()),
        _ => Err(Error::Failed(format!("{failed} of {} not given back", args.xplanes.len()))),
    }
}

fn release(address: &str, overrides: &[String]) -> Result<String, Error> {
    let surveyor = Surveyor::open(address)?;
    // The other aircraft, which show peers.
    let others = (1..=19).map(|number| format!("sim/operation/override/override_planepath[{number}]"));
    let all: Vec<String> = overrides.iter().cloned().chain(others).collect();
    let before = surveyor.survey(&all, 0, ANSWER, false)?;
    if !before.has_answered() {
        return Err(Error::Failed(format!(
            "no answer within {} s; is X-Plane running, and does it accept incoming connections?",
            SILENT.as_secs()
        )));
    }
    let is_held = |path: &&String| before.value(path).is_some_and(|value| value != 0.0);
    let was_held = overrides.iter().any(|path| is_held(&path));
    let drawn: Vec<_> = all[overrides.len()..].iter().filter(is_held).collect();
    overrides.iter().chain(drawn.iter().copied()).for_each(|path| surveyor.write(path, 0.0));
    let is_free = surveyor.reads(overrides, 0.0)?;
    skein_host::clock::sleep(STAYS);
    if !(is_free && surveyor.reads(overrides, 0.0)?) {
        return Err(Error::Failed("an agent takes the controls again; land it: `skein order land`".to_owned()));
    }
    let controls = if was_held { "the controls are given back" } else { "the controls were free already" };
    Ok(match drawn.len() {
        0 => controls.to_owned(),
        count => format!("{controls}, and {count} of its other aircraft"),
    })
}
