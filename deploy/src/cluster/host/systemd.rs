//! systemd, where it serves: a unit for each node, the user's own or the system's. Its log goes to the journal.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use super::files::{self, at};
use super::node::NodeFolder;
use crate::cluster::protocol::Service;
use crate::os;
use skein_common::id::SwarmName;

const TEMPLATE: &str = include_str!("../../../service/skein-agent.service");
/// There while systemd is the host's first process.
const BOOTED: &str = "/run/systemd/system";
/// Left among the user's units if we were the ones to let the user's services outlive the last login.
const LINGERS: &str = "skein-lingers";

/// One systemd of this host.
#[derive(Clone, Debug)]
pub(super) struct Systemd {
    /// The user's, not the system's.
    pub(super) is_users: bool,
    /// Where its units are.
    pub(super) units: PathBuf,
    /// Where its programs are found, if not where all are.
    pub(super) path: Option<OsString>,
}

impl Systemd {
    /// The one that serves the user of this process.
    pub(super) fn here() -> Self {
        let is_users = !os::is_root();
        Self { is_users, units: if is_users { users_units() } else { "/etc/systemd/system".into() }, path: None }
    }

    pub(super) fn service(&self) -> Service {
        if self.is_users { Service::SystemdUser } else { Service::SystemdSystem }
    }

    /// Whether it is the host's first process.
    pub(super) fn is_booted() -> bool {
        Path::new(BOOTED).is_dir()
    }

    /// Whether it can serve: it answers, and keeps a user's services after the last login has ended.
    pub(super) fn ready(&self) -> Result<(), String> {
        self.call("systemctl", &["show", "--property=Version"])?;
        if self.is_users && self.loginctl(&["show-user", "--property=Linger"])?.trim() != "Linger=yes" {
            self.loginctl(&["enable-linger"])?;
            fs::create_dir_all(&self.units).map_err(at(&self.units))?;
            let marker = self.units.join(LINGERS);
            files::write(&marker, b"", true)?;
        }
        Ok(())
    }

    /// Has a unit for this node. Whether anything was written.
    pub(super) fn install_service(&self, swarm: &SwarmName, node: &NodeFolder) -> Result<bool, String> {
        let (path, text) = (self.units.join(unit(swarm, node)), text(swarm, node)?);
        if fs::read_to_string(&path).is_ok_and(|there| there == text) {
            return Ok(false);
        }
        fs::create_dir_all(&self.units).map_err(at(&self.units))?;
        files::write(&path, text.as_bytes(), false)?;
        self.call("systemctl", &["daemon-reload"])?;
        Ok(true)
    }

    /// Takes the node's unit away.
    pub(super) fn remove_service(&self, swarm: &SwarmName, node: &NodeFolder) -> Result<(), String> {
        let path = self.units.join(unit(swarm, node));
        if path.exists() {
            files::remove(&path).map_err(at(&path))?;
            self.call("systemctl", &["daemon-reload"])?;
        }
        let marker = self.units.join(LINGERS);
        let is_ours = |path: &PathBuf| files::name(path).is_some_and(|name| name.starts_with("skein-"));
        if marker.exists() && files::entries(&self.units).iter().filter(|path| is_ours(path)).count() == 1 {
            self.loginctl(&["disable-linger"])?;
            files::remove(&marker).map_err(at(&marker))?;
        }
        Ok(())
    }

    /// Starts the node's unit, and does not wait for it.
    pub(super) fn start(&self, swarm: &SwarmName, node: &NodeFolder) -> Result<(), String> {
        let unit = unit(swarm, node);
        // One that has failed begins anew. One that never ran has nothing to forget.
        let _ = self.call("systemctl", &["reset-failed", &unit]);
        self.call("systemctl", &["start", "--no-block", &unit]).map(drop)
    }

    /// Stops the node's unit, and does not wait for it. One that was taken away already is not there to be stopped.
    pub(super) fn stop(&self, swarm: &SwarmName, node: &NodeFolder) -> Result<(), String> {
        let unit = unit(swarm, node);
        let stopped = self.call("systemctl", &["stop", "--no-block", &unit]);
        if self.units.join(&unit).exists() { stopped.map(drop) } else { Ok(()) }
    }

    /// Becomes the program that shows what the journal has of the node. Comes back only if it cannot.
    pub(super) fn become_log(&self, swarm: &SwarmName, node: &NodeFolder, lines: usize, follow: bool) -> String {
        let mut command = self.command("journalctl");
        // The agent's lines have times of their own.
        command.args(["--quiet", "--no-pager", "--output=cat", "--unit", &unit(swarm, node)]);
        command.args(["--lines", &lines.to_string()]);
        if follow {
            command.arg("--follow");
        }
        format!("journalctl: {}", os::become_program(&mut command))
    }

    /// One of systemd's programs, for the user or the system. What it said, or why it did not do it.
    fn call(&self, program: &str, arguments: &[&str]) -> Result<String, String> {
        output_of(program, self.command(program).args(arguments))
    }

    fn loginctl(&self, arguments: &[&str]) -> Result<String, String> {
        output_of("loginctl", self.plain("loginctl").args(arguments))
    }

    fn command(&self, program: &str) -> Command {
        let mut command = self.plain(program);
        if self.is_users {
            command.arg("--user");
        }
        command
    }

    fn plain(&self, program: &str) -> Command {
        let mut command = Command::new(program);
        command.stdin(Stdio::null());
        if let Some(path) = &self.path {
            command.env("PATH", path);
        }
        // A login without a terminal may not have been told where its own systemd is.
        let runtime = PathBuf::from(format!("/run/user/{}", os::user_name()));
        if std::env::var_os("XDG_RUNTIME_DIR").is_none() && runtime.is_dir() {
            command.env("XDG_RUNTIME_DIR", runtime);
        }
        command
    }
}

fn output_of(program: &str, command: &mut Command) -> Result<String, String> {
    let output = command.output().map_err(|error| format!("{program}: {error}"))?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    let arguments: Vec<_> = command.get_args().map(|argument| argument.to_string_lossy()).collect();
    let why = String::from_utf8_lossy(&output.stderr);
    Err(format!("{program} {}: {}", arguments.join(" "), why.trim().replace('\n', "; ")))
}

/// Where this user's units are.
fn users_units() -> PathBuf {
    let variable = |name| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let config = variable("XDG_CONFIG_HOME").or_else(|| Some(variable("HOME")?.join(".config")));
    config.unwrap_or_default().join("systemd/user")
}

/// The name of a node's unit.
fn unit(swarm: &SwarmName, node: &NodeFolder) -> String {
    format!("skein-{}-{}.service", swarm, node.id)
}

/// A node's unit.
fn text(swarm: &SwarmName, node: &NodeFolder) -> Result<String, String> {
    let folder = node.path.to_str().filter(|path| !path.contains(['"', '\\', '$', '\n']));
    let folder = folder.ok_or_else(|| format!("{}: a systemd unit cannot name this path", node.path.display()))?;
    let text = TEMPLATE.replace("@NODE@", &folder.replace('%', "%%"));
    Ok(text.replace("@SWARM@", swarm.as_str()).replace("@ID@", &node.id.to_string()))
}

#[cfg(test)]
#[cfg(unix)]
mod tests;
