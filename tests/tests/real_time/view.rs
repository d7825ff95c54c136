//! `skein view` as a user runs it: a process that serves a recording or a live swarm, and clients at its port.

mod live;
mod mavlink;
mod recorded;

use std::fs;
use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

use tempfile::TempDir;

const PROGRAM: &str = env!("CARGO_BIN_EXE_skein-under-test");

/// A folder with its own runtime folder, so that a test sees no swarm of another.
struct Place {
    folder: TempDir,
}

impl Place {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn command(&self) -> Command {
        let mut command = Command::new(PROGRAM);
        command.env("XDG_RUNTIME_DIR", self.path("runtime")).env_remove("RUST_LOG").current_dir(self.folder.path());
        command
    }

    /// Starts `skein view` with these arguments on a free port.
    fn view(&self, args: &[&str]) -> Server {
        let mut command = self.command();
        command.arg("view").args(args).args(["--listen", "127.0.0.1:0"]);
        command.stdout(Stdio::piped()).stderr(fs::File::create(self.path("view.log")).unwrap());
        let mut child = command.spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let address = line.trim().strip_prefix("http://").unwrap_or_else(|| panic!("{line:?}")).parse().unwrap();
        Server { child, address }
    }
}

fn number(value: &serde_json::Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// A running `skein view`, killed at the end.
struct Server {
    child: Child,
    address: SocketAddr,
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
