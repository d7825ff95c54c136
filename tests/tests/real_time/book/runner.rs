//! Runs the commands of one chapter in their own folder.

use std::fs;
use std::io::Read;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::os::unix::process::CommandExt;
use std::path::{Component, Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process_group};
use tempfile::TempDir;

use crate::book::{PROGRAM, is_long, root};

/// Timeout of a command, s; CI's PCs may be busy.
const LIMIT_S: u64 = 180;
/// Timeout where long studies are run, s.
const LONG_LIMIT_S: u64 = 1800;

/// A new folder with a link to `deploy`; the output shows it as `/home/you/lab`.
pub(crate) struct Folder {
    /// Removed with the folder.
    _tree: TempDir,
    tree_path: String,
    background: Vec<Pid>,
}

/// Output of a command on stdout and stderr together, and its exit status.
pub(crate) struct Printed {
    pub(crate) text: String,
    pub(crate) status: Option<i32>,
}

impl Folder {
    pub(crate) fn new() -> Self {
        let tree = tempfile::tempdir().unwrap();
        let tree_path = tree.path().canonicalize().unwrap().display().to_string();
        let folder = Self { _tree: tree, tree_path, background: Vec::new() };
        for name in ["home/you/lab", "run", "bin"] {
            fs::create_dir_all(folder.at(name)).unwrap();
        }
        fs::set_permissions(folder.at("run"), fs::Permissions::from_mode(0o700)).unwrap();
        symlink(root().join("deploy"), folder.at("home/you/lab/deploy")).unwrap();
        symlink(PROGRAM, folder.at("bin/skein")).unwrap();
        if let Some(python) = std::env::var_os("SKEIN_PYTHON") {
            // A script, not a link: Python finds a virtual environment by the path of its program.
            let script = format!("#!/bin/sh\nexec '{}' \"$@\"\n", Path::new(&python).display());
            fs::write(folder.at("bin/python3"), script).unwrap();
            fs::set_permissions(folder.at("bin/python3"), fs::Permissions::from_mode(0o755)).unwrap();
        }
        folder
    }

    fn at(&self, name: &str) -> PathBuf {
        Path::new(&self.tree_path).join(name)
    }

    /// Writes a file that a chapter shows.
    pub(crate) fn write(&self, name: &str, text: &str) {
        let is_inside = Path::new(name).components().all(|part| matches!(part, Component::Normal(_)));
        assert!(is_inside && !name.starts_with("deploy"), "{name} is not a file of the folder itself");
        let path = self.at("home/you/lab").join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    fn shell(&self, line: &str) -> Command {
        let mut shell = Command::new("/bin/sh");
        let path = format!("{}:{}", self.at("bin").display(), std::env::var("PATH").unwrap_or_default());
        shell.arg("-c").arg(line).current_dir(self.at("home/you/lab")).stdin(Stdio::null()).env_clear();
        shell.env("PATH", path).env("HOME", self.at("home/you")).env("XDG_RUNTIME_DIR", self.at("run"));
        shell.envs([("COLUMNS", "100"), ("NO_COLOR", "1"), ("TERM", "dumb"), ("LANG", "C.UTF-8")]);
        shell
    }

    /// Whether Python has this module, or all modules are required.
    pub(crate) fn has_python(&self, module: &str) -> bool {
        let found = self.shell(&format!("python3 -c 'import {module}'")).stderr(Stdio::null()).status();
        found.is_ok_and(|status| status.success())
            || std::env::var("SKEIN_MCAP").is_ok_and(|whether| whether == "required")
    }

    /// Runs a command to its end. A command that ends in `&` continues in the background until the chapter ends.
    pub(crate) fn run(&mut self, line: &str) -> Printed {
        let (mut from, to) = std::io::pipe().unwrap();
        let mut shell = self.shell(line);
        shell.stdout(to.try_clone().unwrap()).stderr(to).process_group(0);
        let child = shell.spawn().unwrap();
        // `shell` keeps the pipe's other end open, and the reader ends only when all copies are closed.
        drop(shell);
        let (send, receive) = mpsc::channel();
        thread::spawn(move || {
            let mut bytes = Vec::new();
            let _ = from.read_to_end(&mut bytes);
            let _ = send.send(bytes);
        });
        let limit_s = if is_long() { LONG_LIMIT_S } else { LIMIT_S };
        let bytes = receive.recv_timeout(Duration::from_secs(limit_s));
        let group = Pid::from_child(&child);
        if bytes.is_err() {
            let _ = kill_process_group(group, Signal::KILL);
            end(child);
            panic!("`{line}` has not ended after {limit_s} s");
        }
        if line.trim_end().ends_with('&') {
            self.background.push(group);
        }
        let text = String::from_utf8(bytes.unwrap()).unwrap().replace(&self.tree_path, "");
        Printed { text: without_progress(&text), status: end(child) }
    }
}

/// The output without the lines that a study prints every ten seconds: on a busy PC they are more.
fn without_progress(text: &str) -> String {
    let is_progress = |line: &str| line.contains(" s gone, about ") && line.trim_end().ends_with(" s left");
    text.split_inclusive('\n').filter(|line| !is_progress(line)).collect()
}

fn end(mut child: Child) -> Option<i32> {
    child.wait().unwrap().code()
}

impl Drop for Folder {
    fn drop(&mut self) {
        for group in self.background.drain(..) {
            let _ = kill_process_group(group, Signal::KILL);
        }
    }
}
