//! Differences between a study, a flight in real time and a flight behind X-Plane's protocol, for the same scenario and
//! seeds.

use std::path::Path;
use std::process::{Command, Stdio};

use skein_lab::compare::divergence;
use skein_lab::compare::folder::Folder;
use skein_lab::compare::pairs::Paired;

/// Commands that the program `tables` passes on to `skein`: the flights start this program again.
pub const SKEIN_COMMANDS: [&str; 4] = ["study", "fly", "agent", "standin"];

/// Four vehicles, long enough for figures of the last 100 s.
const SCENARIO: [&str; 4] = ["--set", "swarm.name=divergence", "--set", "duration_s=130"];

/// Flies the hover formation with this many seeds in each of the three ways, and compares each way with the one before.
/// Each seed takes twice three minutes of real time.
///
/// # Panics
/// If a flight fails.
pub fn table(seeds: u64) -> String {
    let folder = std::env::temp_dir().join(format!("skein-divergence-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder for the flights");
    skein(&folder, &["study", "--seeds", &format!("0..{seeds}"), "--out", "study"]);
    for plant in ["builtin", "standin"] {
        for seed in 0..seeds {
            eprintln!("{plant}, seed {seed} of {seeds}");
            let out = format!("{plant}/{seed}");
            skein(&folder, &["fly", "--plant", plant, "--seed", &seed.to_string(), "--out", &out]);
        }
    }
    let read = |name: &str| Folder::read(&folder.join(name)).expect("a folder of flights");
    let [study, builtin, standin] = ["study", "builtin", "standin"].map(read);
    let table = |a: &Folder, b: &Folder| {
        let paired = Paired::new(a, b).expect("the same seeds");
        divergence::table(&divergence::divergence(&paired, &[]))
    };
    let text = format!("{}\n{}", table(&study, &builtin), table(&builtin, &standin));
    let _ = std::fs::remove_dir_all(folder);
    text
}

fn skein(folder: &Path, arguments: &[&str]) {
    let program = std::env::current_exe().expect("the program that runs");
    let mut command = Command::new(program);
    // A separate runtime folder keeps other swarms of this host away.
    command.current_dir(folder).env("XDG_RUNTIME_DIR", folder).stdout(Stdio::null()).stderr(Stdio::null());
    let status = command.args(arguments).args(SCENARIO).status().expect("the program starts");
    assert!(status.success(), "{arguments:?}: {status}");
}
