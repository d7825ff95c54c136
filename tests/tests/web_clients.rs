//! A client of X-Plane's Web API that others wrote, against the stand-in. It is installed from its registry at the versions of
//! `web_clients/requirements.txt`; what cannot be installed fails.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use clap::Parser;
use skein_agent::plant::xplane::standin::{Standin, StandinOptions};

#[derive(Parser)]
struct Cli {
    #[command(flatten)]
    options: StandinOptions,
}

const LATITUDE_DEG: &str = "47.123456789";

/// Runs a command and fails with what it printed.
fn run(command: &mut Command) {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    let text = [output.stdout, output.stderr].concat();
    assert!(output.status.success(), "{command:?}\n{}", String::from_utf8_lossy(&text));
    print!("{}", String::from_utf8_lossy(&text));
}

/// The client needs Python 3.12: that of the path, or one that pyenv has.
fn python() -> PathBuf {
    let of_pyenv = std::env::var_os("HOME").map(|home| Path::new(&home).join(".pyenv/versions"));
    let versions = of_pyenv.and_then(|folder| std::fs::read_dir(folder).ok()).into_iter().flatten().flatten();
    let found = versions.map(|version| version.path().join("bin/python3.12"));
    let runs = |python: &PathBuf| Command::new(python).arg("--version").output().is_ok_and(|out| out.status.success());
    let mut candidates = std::iter::once(PathBuf::from("python3.12")).chain(found);
    candidates.find(runs).expect("Python 3.12 is needed: install it, with its module venv")
}

#[test]
#[ignore = "installs programs: a step of .ci/long"]
fn xpwebapi_reads_writes_subscribes_and_commands() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/web_clients");
    let environment = tempfile::tempdir().unwrap();
    run(Command::new(python()).args(["-m", "venv"]).arg(environment.path()));
    let python = environment.path().join("bin/python");
    let install = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--require-hashes", "-r"];
    run(Command::new(&python).args(install).arg(folder.join("requirements.txt")));

    let given = ["standin", "--port", "0", "--beacon", "false", "--web", "0", "--lat", LATITUDE_DEG];
    let mut standin = Standin::open(&Cli::parse_from(given).options).unwrap();
    let port = standin.web_address().unwrap().port().to_string();
    let stop = Arc::new(AtomicBool::new(false));
    let of_thread = Arc::clone(&stop);
    let thread = std::thread::spawn(move || standin.run(&of_thread));
    run(Command::new(&python).arg(folder.join("xpwebapi_client.py")).args([&port, LATITUDE_DEG]));
    stop.store(true, Relaxed);
    thread.join().unwrap();
}
