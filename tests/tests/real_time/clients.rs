//! Clients of X-Plane that others wrote, in three languages, against the stand-in: by UDP and by the Web API. They are
//! installed from their registries at the versions of the lock files in `clients/`; what cannot be installed fails.
//!
//! Client and stand-in have a network namespace of their own, with X-Plane's own ports and with multicast over its
//! loopback, so that the clients find the beacon.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, Stdio};
use std::sync::OnceLock;

use skein_tests::namespaces::{Namespaces, ip, missing};

const LATITUDE_DEG: &str = "47.123456789";
const UDP_PORT: &str = "49000";
const WEB_PORT: &str = "8086";

/// Runs a command and fails with what it printed.
fn run(command: &mut Command) {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    let text = [output.stdout, output.stderr].concat();
    assert!(output.status.success(), "{command:?}\n{}", String::from_utf8_lossy(&text));
    print!("{}", String::from_utf8_lossy(&text));
}

/// The programs that use the clients.
fn programs() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/clients")
}

/// Where the clients are installed. A later run finds them there.
fn installed() -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join("clients")
}

/// The clients need Python 3.12: that of the path, or one that pyenv has.
fn python() -> PathBuf {
    let of_pyenv = std::env::var_os("HOME").map(|home| Path::new(&home).join(".pyenv/versions"));
    let versions = of_pyenv.and_then(|folder| std::fs::read_dir(folder).ok()).into_iter().flatten().flatten();
    let found = versions.map(|version| version.path().join("bin/python3.12"));
    let runs = |python: &PathBuf| Command::new(python).arg("--version").output().is_ok_and(|out| out.status.success());
    let mut candidates = std::iter::once(PathBuf::from("python3.12")).chain(found);
    candidates.find(runs).expect("Python 3.12 is needed: install it, with its module venv")
}

/// The Python of an environment with the Python clients.
fn python_with_clients() -> &'static Path {
    static PYTHON: OnceLock<PathBuf> = OnceLock::new();
    PYTHON.get_or_init(|| {
        let environment = installed().join("python");
        run(Command::new(python()).args(["-m", "venv"]).arg(&environment));
        let python = environment.join("bin/python");
        let install = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--require-hashes", "-r"];
        run(Command::new(&python).args(install).arg(programs().join("requirements.txt")));
        python
    })
}

/// The folder of the installed JavaScript client.
fn node_modules() -> PathBuf {
    let folder = installed().join("node");
    std::fs::create_dir_all(&folder).unwrap();
    for file in ["package.json", "package-lock.json"] {
        std::fs::copy(programs().join(file), folder.join(file)).unwrap();
    }
    run(Command::new("npm").args(["ci", "--ignore-scripts", "--no-audit", "--no-fund"]).current_dir(&folder));
    folder.join("node_modules")
}

/// The folder of the compiled programs that use the Rust clients.
fn rust_programs() -> &'static Path {
    static PROGRAMS: OnceLock<PathBuf> = OnceLock::new();
    PROGRAMS.get_or_init(|| {
        let target = installed().join("rust");
        let build = ["build", "--quiet", "--locked", "--manifest-path"];
        let manifest = programs().join("rust/Cargo.toml");
        run(Command::new(env!("CARGO")).args(build).arg(manifest).arg("--target-dir").arg(&target));
        target.join("debug")
    })
}

/// A running stand-in in a network namespace of its own.
struct Simulator {
    process: Child,
    /// Kept open, because the stand-in writes its log here.
    _log: BufReader<ChildStderr>,
    namespaces: Namespaces,
}

impl Simulator {
    fn start(test: &str) -> Self {
        assert_eq!(missing(), None);
        let mut namespaces = Namespaces::new(test);
        let own = namespaces.add("x-plane");
        ip(&["-n", &own, "link", "set", "lo", "multicast", "on"]);
        ip(&["-n", &own, "route", "add", "224.0.0.0/4", "dev", "lo"]);
        let mut command = namespaces.command("x-plane", env!("CARGO_BIN_EXE_skein-under-test"));
        command
            .args(["xplane", "standin", "--port", UDP_PORT, "--web", WEB_PORT, "--lat", LATITUDE_DEG])
            .stdin(Stdio::null());
        let mut process = command.env_remove("RUST_LOG").stderr(Stdio::piped()).spawn().unwrap();
        let mut log = BufReader::new(process.stderr.take().unwrap());
        let mut first = String::new();
        log.read_line(&mut first).unwrap();
        assert!(first.contains("the stand-in for X-Plane is running"), "{first}");
        Self { process, _log: log, namespaces }
    }

    /// A command in the namespace of the simulator.
    fn command(&self, program: impl AsRef<Path>) -> Command {
        self.namespaces.command("x-plane", program.as_ref().to_str().unwrap())
    }
}

impl Drop for Simulator {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn python_client(test: &str, program: &str, port: &str) {
    let python = python_with_clients();
    let simulator = Simulator::start(test);
    run(simulator.command(python).arg(programs().join(program)).args([port, LATITUDE_DEG]));
}

fn rust_client(test: &str, program: &str, port: &str) {
    let program = rust_programs().join(program);
    let simulator = Simulator::start(test);
    run(simulator.command(program).args([port, LATITUDE_DEG]));
}

#[test]
#[ignore = "installs programs: `.ci/long`"]
fn xpwebapi_reads_writes_subscribes_and_commands_by_web_api() {
    python_client("xpwebapi-web", "xpwebapi_web.py", WEB_PORT);
}

#[test]
#[ignore = "installs programs: `.ci/long`"]
fn xpwebapi_sees_the_beacon_reads_writes_subscribes_and_commands_by_udp() {
    python_client("xpwebapi-udp", "xpwebapi_udp.py", UDP_PORT);
}

#[test]
#[ignore = "installs programs: `.ci/long`"]
fn pyxpudp_reads_writes_subscribes_and_commands() {
    python_client("pyxpudp", "pyxpudp_client.py", UDP_PORT);
}

#[test]
#[ignore = "installs programs: `.ci/long`"]
fn pyxpudpserver_sees_the_beacon_reads_writes_subscribes_and_commands() {
    python_client("pyxpudpserver", "pyxpudpserver_client.py", UDP_PORT);
}

#[test]
#[ignore = "installs programs: `.ci/long`"]
fn xplane_node_udp_client_reads_writes_subscribes_and_commands() {
    let modules = node_modules();
    let simulator = Simulator::start("node");
    let mut command = simulator.command("node");
    command.env("NODE_PATH", modules).arg(programs().join("xplane_node_client.js"));
    run(command.args([UDP_PORT, LATITUDE_DEG]));
}

#[test]
#[ignore = "installs programs: `.ci/long`"]
fn xpudpc_sees_the_beacon_reads_positions_writes_subscribes_and_commands() {
    rust_client("xpudpc", "xpudpc_client", UDP_PORT);
}

#[test]
#[ignore = "installs programs: `.ci/long`"]
fn xplane_web_api_reads_writes_subscribes_and_commands() {
    rust_client("xplane-web-api", "web_api_client", WEB_PORT);
}
