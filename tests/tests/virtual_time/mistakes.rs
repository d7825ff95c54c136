//! What a newcomer's mistakes at the command line are answered with: `golden/mistakes.txt` has every answer with
//! its exit status. After an intended change of an answer, `SKEIN_GOLDEN=write` in this test's environment
//! writes the file again.
#![cfg(unix)]

use std::fmt::Write;
use std::fs;
use std::net::UdpSocket;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::thread;

use tempfile::TempDir;

const PROGRAM: &str = env!("CARGO_BIN_EXE_skein-under-test");
const GOLDEN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/golden/mistakes.txt");

/// The mistakes, each with its command; `USED` is a port that another program holds, and `SILENT` one that never answers.
const CASES: &[(&str, &str)] = &[
    ("a misspelt command", "skein stduy hover"),
    ("a misspelt name of a shipped scenario", "skein fly hovr"),
    ("a file that does not exist", "skein fly my-scenario.toml"),
    ("two scenarios", "skein fly hover tour"),
    ("a folder in place of a scenario", "skein fly empty"),
    ("a recording in place of a scenario", "skein fly old.mcap"),
    ("a cluster file in place of a scenario", "skein fly lab.toml"),
    ("a scenario in place of a cluster file", "skein check -f mine.toml"),
    ("a file that is not TOML", "skein fly broken.toml"),
    ("a misspelt option", "skein fly --durration 20"),
    ("an option of another command", "skein fly --seeds 0..5"),
    ("an option without its value", "skein fly --duration"),
    ("a value with a unit", "skein fly --duration 20s"),
    ("a value that is no choice", "skein fly --plant xplan"),
    ("a negative seed", "skein fly --seed -1"),
    ("a negative duration", "skein fly --duration -20"),
    ("a key without its unit", "skein fly --set formation.radius=50"),
    ("a key without its table", "skein fly --set radius_m=50"),
    ("a key that does not exist", "skein fly --set formation.wobble=3"),
    ("a key without a value", "skein fly --set formation.radius_m"),
    ("a value of a key with a unit", "skein fly --set formation.radius_m=50m"),
    ("a negative radius", "skein fly --set formation.radius_m=-50"),
    ("a misspelt law", "skein fly --set formation.law=rnig"),
    ("more vehicles than a swarm can have", "skein fly --set swarm.vehicles=251"),
    ("a vehicle with id 0", "skein agent --scenario mine.toml --id 0"),
    ("a vehicle that the swarm does not have", "skein agent --scenario mine.toml --id 9"),
    ("seeds in reverse", "skein study hover --seeds 5..0"),
    ("a number in place of a range of seeds", "skein study hover --seeds 5"),
    ("a sweep without values", "skein study hover --sweep formation.radius_m"),
    ("a sweep of a key that does not exist", "skein study hover --sweep formation.raduis_m=40,50"),
    ("no jobs", "skein study hover --jobs 0"),
    ("an order while nothing flies", "skein order hold"),
    ("a misspelt order", "skein order hodl"),
    ("a misspelt order that is similar to one that lands", "skein order lnad"),
    ("an order without its step", "skein order goto"),
    ("a key that cannot change in flight", "skein order set formation.law=flock"),
    ("a value out of a key's range", "skein order set formation.radius_m=-5"),
    ("an order to a swarm that does not fly", "skein order hold --swarm lab"),
    ("orders from every PC without a token", "skein view --orders --listen 0.0.0.0:7480"),
    ("a token without orders", "skein view --token mine.toml"),
    ("orders from the page of a recording", "skein view old.mcap --orders"),
    ("a ground station without a port", "skein view --mavlink 127.0.0.1"),
    ("orders from a ground station on another PC without a key", "skein view --orders --mavlink 192.0.2.1:14550"),
    ("a key for ground stations that is no key", "skein view --mavlink 127.0.0.1:14550 --mavlink-key mine.toml"),
    ("a recording without a file", "skein record"),
    ("a recording into a file that exists", "skein record --out old.mcap"),
    ("a report of an empty folder", "skein report empty"),
    ("a report of a folder that does not exist", "skein report nowhere"),
    ("a report of a file that is no recording", "skein report mine.toml"),
    ("a comparison of one study", "skein compare empty"),
    ("a comparison of folders that are no studies", "skein compare empty full"),
    ("a folder that has files already", "skein fly --out full"),
    ("a folder that cannot be written", "skein fly --out /proc/run"),
    ("a folder of runs that cannot be written", "SKEIN_RUNS=/proc/runs skein study hover --set duration_s=1"),
    ("a port in use", "skein xplane standin --port USED"),
    ("an X-Plane that is not there", "skein fly --set swarm.vehicles=1 --xplane 127.0.0.1:SILENT"),
    ("an X-Plane with a wrong port", "skein xplane check --xplane heli7:x"),
    ("a law whose file is missing", "skein study law.toml"),
    ("a law whose language is missing", "skein study python.toml"),
    ("a cluster without its file", "skein cluster up"),
    ("a variable that names no cluster file", "SKEIN_CLUSTER=no/such.toml skein order hold"),
    ("a name with a capital and a space", "skein files new scenario 'My Ring'"),
    ("something new that exists", "skein files new scenario mine"),
    ("a search for a misspelt key", "skein files explain raduis"),
    ("a scenario that is not shipped", "skein files scenarios huver"),
];

const LAW: &str =
    "swarm.vehicles = 2\n[formation]\nlaw = 'external'\n[formation.external]\nperiod_s = 0.1\nfallback = 'ring'\n";

/// A folder with what a newcomer may have there.
fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    for name in ["bin", "empty", "full", "run"] {
        fs::create_dir(folder.path().join(name)).unwrap();
    }
    fs::set_permissions(folder.path().join("run"), fs::Permissions::from_mode(0o700)).unwrap();
    symlink(PROGRAM, folder.path().join("bin/skein")).unwrap();
    write("full/notes.txt", "mine\n");
    write("mine.toml", "name = 'mine'\nswarm.vehicles = 4\n");
    write("lab.toml", "swarm = 'lab'\nscenario = 'mine.toml'\n[node.1]\nhost = '10.0.0.1'\n");
    write("broken.toml", "[swarm]\nvehicles 4\n");
    write("old.mcap", "\u{89}MCAP0\r\n");
    write("law.toml", &format!("{LAW}command = ['python3', 'my-law.py']\n"));
    // The message of the real one differs from release to release.
    write("bin/python3", "#!/bin/sh\necho \"python3: can't open file '$1'\" >&2\nexit 2\n");
    fs::set_permissions(folder.path().join("bin/python3"), fs::Permissions::from_mode(0o755)).unwrap();
    write("python.toml", &format!("{LAW}command = ['python-that-is-missing', 'my-law.py']\n"));
    folder
}

fn run(folder: &Path, line: &str) -> Output {
    let path = format!("{}:{}", folder.join("bin").display(), std::env::var("PATH").unwrap_or_default());
    let mut shell = Command::new("timeout");
    shell.args(["60", "/bin/sh", "-c", line]).current_dir(folder).stdin(Stdio::null()).env_clear();
    shell.env("PATH", path).env("HOME", folder).env("XDG_RUNTIME_DIR", folder.join("run"));
    shell.envs([("COLUMNS", "100"), ("NO_COLOR", "1"), ("TERM", "dumb"), ("LANG", "C.UTF-8")]);
    shell.output().unwrap()
}

/// The answer with `DATE` in place of the date and time in the name of a new folder, `20261123T221738Z`.
fn without_date(answer: &str) -> String {
    let is_date = |text: &str| text.len() == 16 && text.ends_with('Z') && text.as_bytes()[8] == b'T';
    let date = answer.split(|letter: char| !letter.is_ascii_alphanumeric()).find(|part| is_date(part));
    date.map_or_else(|| answer.to_owned(), |date| answer.replace(date, "DATE"))
}

/// A case in the format of the golden file: title, command, answer, exit status.
fn case(title: &str, command: &str) -> String {
    let folder = folder();
    let silent = UdpSocket::bind("127.0.0.1:0").unwrap();
    let used = UdpSocket::bind("0.0.0.0:0").unwrap();
    let ports = [("USED", used.local_addr().unwrap()), ("SILENT", silent.local_addr().unwrap())];
    let ports = ports.map(|(name, address)| (name, address.port().to_string()));
    let line = ports.iter().fold(command.to_owned(), |line, (name, port)| line.replace(name, port));
    let output = run(folder.path(), &line);
    let answer = String::from_utf8(output.stderr).unwrap();
    let status = output.status.code();
    assert!(matches!(status, Some(1 | 2)) && !answer.is_empty(), "{title}: {status:?} {answer}");
    assert_eq!(String::from_utf8_lossy(&output.stdout), "", "{title}: an error belongs on stderr");
    assert!(!answer.contains("panicked"), "{title}: {answer}");
    let place = folder.path().canonicalize().unwrap().display().to_string();
    let answer = answer.replace(&place, "FOLDER").replace(&folder.path().display().to_string(), "FOLDER");
    let answer = ports.iter().fold(answer, |answer, (name, port)| answer.replace(port.as_str(), name));
    let answer = without_date(&answer);
    let mut text = format!("{title}\n    $ {command}\n");
    answer.lines().for_each(|line| _ = writeln!(text, "{}", format!("    {line}").trim_end()));
    text + &format!("    [status {}]\n\n", status.unwrap_or_default())
}

#[test]
fn every_mistake_is_answered_with_what_is_wrong_and_what_to_do() {
    let mut text =
        "What is printed about a newcomer's mistakes: the mistake, the command, the answer on stderr, the exit \
                    status. FOLDER is the current folder.\n\n"
            .to_owned();
    // Some wait for an answer that never comes.
    let answers: Vec<String> = thread::scope(|scope| {
        let asked: Vec<_> = CASES
            .chunks(CASES.len().div_ceil(4))
            .map(|cases| {
                scope.spawn(move || cases.iter().map(|(title, command)| case(title, command)).collect::<String>())
            })
            .collect();
        asked.into_iter().map(|asked| asked.join().unwrap()).collect()
    });
    text += &answers.concat();
    if std::env::var("SKEIN_GOLDEN").is_ok_and(|what| what == "write") {
        fs::write(GOLDEN, &text).unwrap();
    }
    let golden = fs::read_to_string(GOLDEN).unwrap_or_default();
    for (nth, (expected, line)) in golden.lines().zip(text.lines()).enumerate() {
        assert_eq!(line, expected, "{} line {}", Path::new(GOLDEN).display(), nth + 1);
    }
    assert_eq!(text.lines().count(), golden.lines().count());
}

/// The exit status and stderr of a command whose stdout is this file.
#[cfg(target_os = "linux")]
fn printed_to(stdout: Stdio, arguments: &str) -> (Option<i32>, String) {
    let folder = TempDir::new().unwrap();
    let mut command = Command::new(PROGRAM);
    command.current_dir(folder.path()).args(arguments.split(' ')).stdin(Stdio::null()).stdout(stdout);
    let output = command.stderr(Stdio::piped()).output().unwrap();
    (output.status.code(), String::from_utf8(output.stderr).unwrap())
}

#[cfg(target_os = "linux")]
#[test]
fn a_limit_on_file_sizes_is_an_error_with_its_remedy() {
    let folder = TempDir::new().unwrap();
    for command in [
        "files scenarios hover >big",
        "files explain --json >big",
        "study hover --set duration_s=5 --seeds 0..1 --out study",
    ] {
        let script = format!("ulimit -f 0; \"$0\" {command}");
        let mut limited = Command::new("sh");
        limited.current_dir(folder.path()).args(["-c", &script, PROGRAM]).stdin(Stdio::null());
        let output = limited.output().unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{command}: {stderr}");
        assert!(stderr.contains("File too large") && stderr.contains("`ulimit -f unlimited`"), "{command}: {stderr}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn what_cannot_be_printed_is_a_failure_unless_its_reader_has_gone() {
    for arguments in [
        "--version",
        "--help",
        "study --help",
        "check hover",
        "check hover --json",
        "files explain radius",
        "files scenarios",
        "completions bash",
        "study hover --set duration_s=5 --no-record --json",
        "study hover --set duration_s=5 --no-record",
    ] {
        let full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let (status, stderr) = printed_to(full.into(), arguments);
        assert_eq!(status, Some(1), "{arguments}: {stderr}");
        assert!(stderr.contains("standard output: No space left on device"), "{arguments}: {stderr}");
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let (status, stderr) = printed_to(writer.into(), arguments);
        assert_eq!(status, Some(0), "{arguments}: {stderr}");
    }
}
