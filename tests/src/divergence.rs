//! Differences between a study, a flight in real time and a flight behind X-Plane's protocol, for the same scenario and
//! seeds.

use std::path::Path;
use std::process::{Command, Stdio};

use skein_lab::compare::divergence::{self, Divergence, FigureDifference};
use skein_lab::compare::folder::Folder;
use skein_lab::compare::pairs::Paired;
use skein_lab::metrics::limits::{self, Bound};

/// Commands that the program `tables` passes on to `skein`: the flights start this program again.
pub const SKEIN_COMMANDS: [&str; 4] = ["study", "fly", "agent", "xplane"];

/// Largest difference between two plants, as a share of the figure, or of its limit if that is more.
const OF_FIGURE: f64 = 0.05;
const OF_LIMIT: f64 = 0.1;

/// Four vehicles, long enough for figures of the last 100 s.
const SCENARIO: [&str; 4] = ["--set", "swarm.name=divergence", "--set", "duration_s=130"];

/// Flies the hover formation with this many seeds in each of the three ways, and compares each way with the one before.
/// Each seed takes twice three minutes of real time.
///
/// # Panics
/// If a flight fails, or the medians of the two plants differ by more than a twentieth of the figure and a tenth of its limit.
pub fn table(seeds: u64) -> String {
    let folder = std::env::temp_dir().join(format!("skein-divergence-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder for the flights");
    skein(&folder, &["study", "--seeds", &format!("0..{seeds}"), "--out", "study"]);
    for plant in ["builtin", "standin"] {
        eprintln!("{plant}, {seeds} seeds");
        skein(&folder, &["fly", "--plant", plant, "--seed", "0", "--runs", &seeds.to_string(), "--out", plant]);
    }
    let read = |name: &str| Folder::read(&folder.join(name)).expect("a folder of flights");
    let [study, builtin, standin] = ["study", "builtin", "standin"].map(read);
    let apart = |a: &Folder, b: &Folder| divergence::divergence(&Paired::new(a, b).expect("the same seeds"), &[]);
    let [clocks, plants] = [apart(&study, &builtin), apart(&builtin, &standin)];
    let text = format!("{}\n{}", divergence::table(&clocks), divergence::table(&plants));
    let too_far = too_far(&plants);
    assert!(too_far.is_empty(), "{text}\nthe plants differ too much in {}", too_far.join(", "));
    let _ = std::fs::remove_dir_all(folder);
    text
}

/// Keys of the figures of two plants that differ by more than a twentieth of the figure and a tenth of its limit.
pub fn too_far(plants: &Divergence) -> Vec<&str> {
    let differs = |figure: &&FigureDifference| {
        let Some(limit) = limits::HOVER.iter().find(|limit| limit.key == figure.key) else { return false };
        let (Bound::AtMost(bound) | Bound::AtLeast(bound)) = limit.bound;
        match (figure.a, figure.difference) {
            (Some(a), Some(difference)) => difference.abs() > (OF_FIGURE * a.abs()).max(OF_LIMIT * bound),
            (a, _) => a != figure.b,
        }
    };
    plants.figures.iter().filter(differs).map(|figure| figure.key.as_str()).collect()
}

fn skein(folder: &Path, arguments: &[&str]) {
    let program = std::env::current_exe().expect("the program that runs");
    let mut command = Command::new(program);
    // A separate runtime folder keeps other swarms of this host away.
    command.current_dir(folder).env("XDG_RUNTIME_DIR", folder).stdout(Stdio::null()).stderr(Stdio::null());
    let status = command.args(arguments).args(SCENARIO).status().expect("the program starts");
    assert!(status.success(), "{arguments:?}: {status}");
}
