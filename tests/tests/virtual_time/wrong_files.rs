//! Errors of thirty wrong files of all kinds: `golden/wrong_files.txt` has every message as an operator sees it. After
//! an intended change of a message, `SKEIN_GOLDEN=write` in this test's environment writes the file again.

use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::process::Command;

use skein_core::aircraft::Aircraft;

const PROGRAM: &str = env!("CARGO_BIN_EXE_skein-under-test");
const GOLDEN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/golden/wrong_files.txt");

/// The command that reads the file.
enum Read {
    /// `skein check NAME`, beside a valid `hover.toml`.
    Scenario(&'static str),
    /// `skein check -f NAME`.
    Cluster(&'static str),
    /// The shipped aircraft with the first text replaced by the second, in a scenario.
    Aircraft(&'static str, &'static str),
}

use Read::{Aircraft as Plane, Cluster, Scenario};

const CASES: [(&str, Read); 31] = [
    ("a misspelt key", Scenario("swarm.vehicles = 4\n[formation]\nraduis_m = 80\n")),
    ("a key without its unit", Scenario("swarm.vehicles = 4\n[formation]\nheading = 30\n")),
    ("a key of another table", Scenario("swarm.vehicles = 4\n[formation]\nspeed_m_s = 3\n")),
    (
        "an unknown key of a step, similar to one that lands",
        Scenario("swarm.vehicles = 4\n[mission]\nsteps = [{ lnad = true }]\n"),
    ),
    ("a key similar to no other", Scenario("swarm.vehicles = 4\n[formation]\nwobble = 3\n")),
    ("a text where a number is needed", Scenario("swarm.vehicles = 4\n[formation]\nradius_m = 'wide'\n")),
    ("a number out of its range", Scenario("swarm.vehicles = 4\n[formation]\naltitude_m = 2\n")),
    ("a text that is not a choice", Scenario("swarm.vehicles = 4\n[formation]\nlaw = 'vasarheli'\n")),
    ("an order that is not one", Scenario("swarm.vehicles = 4\n[mission]\nevents = [{ at_s = 5, order = 'abrot' }]\n")),
    (
        "a fault without its vehicle",
        Scenario("swarm.vehicles = 4\n[mission]\nevents = [{ at_s = 5, fault = 'kill' }]\n"),
    ),
    ("no number of vehicles", Scenario("name = 'empty'\n")),
    ("a vehicle that is not in the swarm", Scenario("swarm.vehicles = 4\n[vehicle.9]\nheading_deg = 90\n")),
    ("a key that was removed", Scenario("swarm.vehicles = 4\n[network]\nstate_json_hz = 2\n")),
    ("a table that is not closed", Scenario("swarm.vehicles = 4\n[formation\n")),
    ("a key that is written twice", Scenario("swarm.vehicles = 4\n[formation]\ngamma = 1\ngamma = 2\n")),
    ("a ring too small for its vehicles", Scenario("swarm.vehicles = 40\n[formation]\nradius_m = 40\n")),
    ("a cluster file", Scenario("swarm = 'lab'\nscenario = 'hover.toml'\n[node.1]\nhost = '10.0.0.1'\n")),
    ("a cluster file without nodes", Scenario("swarm = 'lab'\nscenario = 'hover.toml'\n")),
    ("an aircraft file", Scenario("rotor_speed_rad_s = 170\n[trim]\nroll_stick = 0\n")),
    (
        "a misspelt key of a node",
        Cluster("swarm = 'lab'\nscenario = 'hover.toml'\n[node.1]\nhost = '10.0.0.1'\nadress = '10.0.0.1'\n"),
    ),
    ("a text that is not a choice", Cluster("swarm = 'lab'\nscenario = 'hover.toml'\nsecurity = 'tsl'\n")),
    ("no scenario", Cluster("swarm = 'lab'\n[node.1]\nhost = '10.0.0.1'\n")),
    ("a vehicle without a node", Cluster("swarm = 'lab'\nscenario = 'hover.toml'\n[node.1]\nhost = '10.0.0.1'\n")),
    (
        "an address with a port",
        Cluster(
            "swarm = 'lab'\nscenario = 'hover.toml'\n[node.1]\nhost = 'heli1'\naddress = '10.0.0.1:7447'\n[node.2]\n\
             host = '10.0.0.2'\n",
        ),
    ),
    ("a scenario", Cluster("[swarm]\nvehicles = 4\n[formation]\nradius_m = 80\n")),
    ("a misspelt key", Plane("gain_s = 0.1 ", "gian_s = 0.1 ")),
    ("a text where a number is needed", Plane("mass_kg = 8.2 ", "mass_kg = 'heavy' ")),
    ("a mass below zero", Plane("mass_kg = 8.2 ", "mass_kg = -8.2 ")),
    ("a key that is left out", Plane("lag_s = 0.03 ", "# lag_s = 0.03 ")),
    ("a trim that no hover has", Plane("roll_deg = 4.61 ", "roll_deg = 461 ")),
    ("a dataref with a space", Plane("[trim]", "[xplane]\nroll = 'sim/joystick roll'\n[trim]")),
];

/// A case in the format of the golden file: title, the wrong line, the message.
fn case(title: &str, read: &Read) -> String {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    write("hover.toml", "swarm.vehicles = 2\n");
    let (kind, text, arguments) = match read {
        Scenario(text) => ("scenario", (*text).to_owned(), &["check", "my.toml"][..]),
        Cluster(text) => ("cluster", (*text).to_owned(), &["check", "-f", "my.toml"][..]),
        Plane(from, to) => {
            let shipped = Aircraft::SHIPPED[0].1;
            assert!(shipped.contains(from), "{from}");
            ("aircraft", shipped.replacen(from, to, 1), &["check", "hover.toml", "--set", "swarm.aircraft=my"][..])
        }
    };
    write("my.toml", &text);
    let output = Command::new(PROGRAM).current_dir(folder.path()).args(arguments).output().unwrap();
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{title}: {message}");
    assert_eq!(message.lines().count(), 1, "{title}: {message}");
    let place = message.strip_prefix("my.toml:").and_then(|rest| rest.split(':').next()?.parse::<usize>().ok());
    let line = text.lines().nth(place.unwrap_or_else(|| panic!("{title} has no position: {message}")) - 1);
    let line = line.unwrap_or_default();
    // The text after the value is a comment.
    let line = line.split_once("  #").map_or(line, |(line, _)| line).trim_end();
    format!("{kind}: {title}\n    {line}\n    {message}\n")
}

#[test]
fn every_wrong_file_is_refused_with_its_position_and_a_remedy() {
    let mut text = "What `skein check` prints about wrong files: the kind of file, the mistake, the wrong line, the \
                    message.\n\n"
        .to_owned();
    for (title, read) in &CASES {
        let _ = write!(text, "{}", case(title, read));
    }
    if std::env::var("SKEIN_GOLDEN").is_ok_and(|what| what == "write") {
        fs::write(GOLDEN, &text).unwrap();
    }
    let golden = fs::read_to_string(GOLDEN).unwrap_or_default();
    for (nth, (expected, line)) in golden.lines().zip(text.lines()).enumerate() {
        assert_eq!(line, expected, "{} line {}", Path::new(GOLDEN).display(), nth + 1);
    }
    assert_eq!(text.lines().count(), golden.lines().count());
}
