//! `skein xplane fit`: flies an aircraft that was never flown with these rules before, and writes its aircraft file.

use std::path::{Path, PathBuf};
use std::time::Duration;

use skein_core::aircraft::Profile;
use skein_core::control::Rules;
use skein_core::fit::{Fit, Fitted, Rung};
use skein_core::plant::{Command, Plant};
use skein_host::{clock, files};
use skein_lab::error::Error;
use skein_lab::out;
use skein_lab::terminal::{complain, json, say, what_next};

use crate::new::Name;
use skein_cluster::os::Interrupts;
use skein_cluster::ports::HostPort;
use skein_cluster::simulators;

/// `skein xplane fit`
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  skein xplane fit my-heli --xplane 127.0.0.1\n  skein xplane fit my-r22 --xplane 10.0.0.7:49000 --base my-datarefs"
)]
pub struct FitArgs {
    /// Name of the new aircraft; the file is NAME.toml
    pub name: Name,
    /// The X-Plane, with the aircraft on level ground, engine running, in calm air
    #[arg(long, value_name = "HOST[:PORT]")]
    pub xplane: HostPort,
    /// Aircraft file whose table "xplane" says which datarefs are the controls: one of yours, r22 or rc-helicopter; without
    /// it X-Plane's usual ones
    #[arg(long, value_name = "AIRCRAFT", default_value = "xcell60", hide_default_value = true)]
    pub base: String,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// Longest duration of one wait for a position, and longest silence of the simulator, s.
const ATTEMPT: Duration = Duration::from_millis(100);
const SILENT_S: f64 = 5.0;

/// Flies the aircraft up the ladder of [`skein_core::fit`], lands it, gives the controls back and writes the file. Ctrl-C
/// lands it at once.
///
/// # Errors
/// If the file exists already, the simulator does not answer, or a rung of the ladder fails: then the vehicle has landed, or
/// the error says that the simulator is gone.
pub fn run(args: &FitArgs) -> Result<(), Error> {
    let file = PathBuf::from(format!("{}.toml", args.name));
    if file.exists() {
        return Err(Error::Refused(format!("{} exists; choose another name, or move it away", file.display())));
    }
    let (profile, text) =
        files::profile(&args.base, Path::new("")).map_err(|fault| Error::Refused(format!("--base: {fault}")))?;
    let address = args.xplane.to_string();
    let interrupts = Interrupts::listen()?;
    let (fitted, version) = fly(&address, &profile, &interrupts)?;
    let version = version.map_or_else(|| "X-Plane".to_owned(), |version| format!("X-Plane (version number {version})"));
    let found_on = format!("{version} at {address}");
    out::write(&file, aircraft_file(&fitted, &args.name.to_string(), &found_on, &text))?;
    if args.json {
        say(&json(&figures(&fitted, &file)));
        return Ok(());
    }
    let fly = format!("skein fly hover --plant xplane --set swarm.aircraft={}", args.name);
    say(&format!(
        "{}: hover at collective {:.2}, responses {}; overshoot {:.0} %, settled in {:.1} s\n{}",
        file.display(),
        fitted.trim.collective,
        responses(&fitted),
        100.0 * fitted.overshoot,
        fitted.settled_s,
        what_next(&[(fly, "flies it with others of its kind")])
    ));
    Ok(())
}

/// Flies one fit; gives what it found and X-Plane's version.
fn fly(address: &str, profile: &Profile, interrupts: &Interrupts) -> Result<(Fitted, Option<u32>), Error> {
    // The ladder has a frame of its own; the origin of this one affects only the truth, which it does not use.
    let mut link = simulators::link(address, profile).map_err(Error::Refused)?;
    let mut fit = Fit::new(Rules::shipped());
    let (mut heard, mut last) = (clock::now(), None::<Rung>);
    loop {
        if interrupts.count() > 0 {
            fit.stop();
        }
        let Some(frame) = link.wait(ATTEMPT).frame else {
            if link.client.is_paused() {
                heard = clock::now();
            }
            if clock::now().saturating_duration_since(heard).as_secs_f64() > SILENT_S {
                let advice = "is X-Plane running, its network setting \"Accept incoming connections\" on?";
                return Err(Error::Failed(format!("{address}: no position for {SILENT_S:.0} s; {advice}")));
            }
            continue;
        };
        heard = clock::now();
        let step = fit.step(frame.time, &frame.measurement);
        link.command(Command::Controls(step.controls));
        if last != Some(step.rung) {
            last = Some(step.rung);
            complain(step.rung.text());
        }
        if let Some(end) = step.end {
            let version = link.client.version();
            link.release();
            let fitted = end.map_err(|error| Error::Failed(format!("{error}; the controls are given back")))?;
            return Ok((fitted, version));
        }
    }
}

fn responses(fitted: &Fitted) -> String {
    let found = &fitted.responses;
    format!(
        "roll {:.2}, pitch {:.2}, yaw {:.2} rad/s and climb {:.1} m/s per full control",
        found.roll_rad_s, found.pitch_rad_s, found.yaw_rad_s, found.climb_m_s
    )
}

fn figures(fitted: &Fitted, file: &Path) -> serde_json::Value {
    let Fitted { trim, gains, rotor_speed_rad_s, responses, overshoot, settled_s, .. } = fitted;
    serde_json::json!({
        "file": file,
        "trim": {
            "roll_stick": trim.roll_stick, "pitch_stick": trim.pitch_stick, "yaw_stick": trim.yaw_stick,
            "collective": trim.collective, "roll_deg": trim.roll_rad.to_degrees(), "pitch_deg": trim.pitch_rad.to_degrees(),
        },
        "gains": { "roll": gains.roll, "pitch": gains.pitch, "yaw": gains.yaw, "collective": gains.collective },
        "rotor_speed_rad_s": rotor_speed_rad_s,
        "responses": {
            "roll_rad_s": responses.roll_rad_s, "pitch_rad_s": responses.pitch_rad_s, "yaw_rad_s": responses.yaw_rad_s,
            "climb_m_s": responses.climb_m_s,
        },
        "overshoot": overshoot,
        "settled_s": settled_s,
    })
}

/// The aircraft file of a fit: its trim and gains, and the table `[xplane]` of the file that it began with.
pub fn aircraft_file(fitted: &Fitted, name: &str, found_on: &str, base: &str) -> String {
    let Fitted { trim, gains, rotor_speed_rad_s, overshoot, settled_s, .. } = fitted;
    let rotor = rotor_speed_rad_s.map_or_else(String::new, |speed| {
        format!("rotor_speed_rad_s = {speed:.2}                        # main rotor in flight\n\n")
    });
    let xplane = xplane_table(base);
    format!(
        "# {name}: an aircraft that X-Plane flies. Found by `skein xplane fit` in calm air, on {found_on}.\n\
         # Measured: {}; 8 m aside with {:.0} % overshoot, within 0.5 m after {settled_s:.1} s.\n\n\
         {rotor}# Controls and attitude in the hover.\n[trim]\n\
         roll_stick = {:.5}\npitch_stick = {:.5}\nyaw_stick = {:.5}\ncollective = {:.5}\nroll_deg = {:.3}\npitch_deg = {:.3}\n\n\
         # How far each control moves about its trim for what the rules ask; negative: in the opposite direction.\n[gains]\n\
         roll = {:.4}\npitch = {:.4}\nyaw = {:.4}\ncollective = {:.4}\n{xplane}",
        responses(fitted),
        100.0 * overshoot,
        trim.roll_stick,
        trim.pitch_stick,
        trim.yaw_stick,
        trim.collective,
        trim.roll_rad.to_degrees(),
        trim.pitch_rad.to_degrees(),
        gains.roll,
        gains.pitch,
        gains.yaw,
        gains.collective,
    )
}

/// The lines of the table `[xplane]` and of those below it; none if the file has no such table.
fn xplane_table(text: &str) -> String {
    let mut lines = String::new();
    let mut is_inside = false;
    for line in text.lines() {
        if line.starts_with('[') {
            is_inside = line.starts_with("[xplane]") || line.starts_with("[xplane.");
        }
        if is_inside {
            lines += line;
            lines.push('\n');
        }
    }
    if lines.is_empty() { lines } else { format!("\n{}\n", lines.trim_end()) }
}

#[cfg(test)]
mod tests {
    use skein_core::aircraft::Aircraft;
    use skein_core::control::{Gains, Trim};
    use skein_core::fit::Responses;

    use super::*;

    #[test]
    fn the_file_of_a_fit_is_an_aircraft_with_the_datarefs_of_its_base() {
        let trim = Trim {
            roll_stick: 0.02,
            pitch_stick: -0.03,
            yaw_stick: 0.0,
            collective: 0.7,
            roll_rad: 0.08,
            pitch_rad: 0.01,
        };
        let gains = Gains { roll: -1.2, pitch: 0.8, yaw: -0.5, collective: 1.1 };
        let responses = Responses { roll_rad_s: -2.9, pitch_rad_s: 4.2, yaw_rad_s: -4.0, climb_m_s: 16.0 };
        let found = Fitted { trim, gains, rotor_speed_rad_s: Some(45.5), ..Fitted::default() };
        let fitted = Fitted { responses, overshoot: 0.04, settled_s: 4.6, ..found };
        let base =
            "[trim]\ncollective = 0.1\n[xplane]\nroll = 'a/b'\n[xplane.hold]\n'c/d' = 1.0\n[helicopter]\nmass_kg = 1\n";
        let text = aircraft_file(&fitted, "my-heli", "X-Plane", base);
        let aircraft = Aircraft::from_text("my-heli.toml", &text).unwrap();
        assert_eq!((aircraft.gains, aircraft.rotor_speed_rad_s), (gains, Some(45.5)));
        assert!((aircraft.trim.roll_rad - 0.08).abs() < 1e-4 && (aircraft.trim.collective - 0.7).abs() < 1e-4);
        assert_eq!(aircraft.xplane.roll.as_str(), "a/b");
        assert!(aircraft.xplane.hold.len() == 1 && aircraft.helicopter.is_none());
        let bare = aircraft_file(&fitted, "my-heli", "X-Plane", "[trim]\ncollective = 0.1\n");
        assert_eq!(Aircraft::from_text("x", &bare).unwrap().xplane, Profile::default());
    }
}
