//! Controls systemd on hosts that have it: a unit for each node, of the user's or of the system's instance. The agent's
//! log is in the journal.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use super::files::{self, at};
use super::node::NodeFolder;
use crate::os;
use crate::protocol::Service;
use skein_common::id::SwarmName;

/// Template of a unit.
const TEMPLATE: &str = include_str!("../../../service/skein-agent.service");
/// The sandbox that only the system's instance can add to it.
const SANDBOX: &str = include_str!("../../../service/sandbox.conf");
/// This folder exists while systemd is the host's first process.
const BOOTED: &str = "/run/systemd/system";
/// Marker file among the user's units: Skein has enabled the user's services to outlive the last login.
const LINGERS: &str = "skein-lingers";

/// A systemd instance of this host.
#[derive(Clone, Debug)]
pub(super) struct Systemd {
    /// Whether it is the user's instance, not the system's.
    pub(super) is_users: bool,
    /// Folder of its units.
    pub(super) units: PathBuf,
    /// `PATH` for its programs; `None` for the normal one.
    pub(super) path: Option<OsString>,
}

impl Systemd {
    /// The instance for the user of this process.
    pub(super) fn here() -> Self {
        let is_users = !os::is_root();
        Self { is_users, units: if is_users { users_units() } else { "/etc/systemd/system".into() }, path: None }
    }

    pub(super) fn service(&self) -> Service {
        if self.is_users { Service::SystemdUser } else { Service::SystemdSystem }
    }

    /// Whether systemd is the host's first process.
    pub(super) fn is_booted() -> bool {
        Path::new(BOOTED).is_dir()
    }

    /// Checks that systemd can be used: that it answers, and keeps the user's services after the last logout, which is
    /// enabled if necessary.
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

    /// Writes the unit of this node. Returns whether anything was written.
    pub(super) fn install_service(&self, swarm: &SwarmName, node: &NodeFolder) -> Result<bool, String> {
        let (path, text) = (self.units.join(unit(swarm, node)), self.text(swarm, node)?);
        if fs::read_to_string(&path).is_ok_and(|there| there == text) {
            return Ok(false);
        }
        fs::create_dir_all(&self.units).map_err(at(&self.units))?;
        files::write(&path, text.as_bytes(), false)?;
        self.call("systemctl", &["daemon-reload"])?;
        Ok(true)
    }

    /// Removes the node's unit.
    pub(super) fn remove_service(&self, swarm: &SwarmName, node: &NodeFolder) -> Result<(), String> {
        let path = self.units.join(unit(swarm, node));
        if path.exists() {
            self.call("systemctl", &["disable", &unit(swarm, node)])?;
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

    /// Starts the node's unit, now and with each start of the host, without waiting for it.
    pub(super) fn start(&self, swarm: &SwarmName, node: &NodeFolder) -> Result<(), String> {
        let unit = unit(swarm, node);
        // Forget earlier failures. This fails for a unit that has never run.
        let _ = self.call("systemctl", &["reset-failed", &unit]);
        self.call("systemctl", &["enable", &unit])?;
        self.call("systemctl", &["start", "--no-block", &unit]).map(drop)
    }

    /// Stops the node's unit, also for the next start of the host, without waiting for it. A unit that was removed is
    /// ignored.
    pub(super) fn stop(&self, swarm: &SwarmName, node: &NodeFolder) -> Result<(), String> {
        let unit = unit(swarm, node);
        let disabled = self.call("systemctl", &["disable", &unit]);
        let stopped = self.call("systemctl", &["stop", "--no-block", &unit]).and(disabled);
        if self.units.join(&unit).exists() { stopped.map(drop) } else { Ok(()) }
    }

    /// Replaces this process with the program that shows the node's journal. Returns only if that fails.
    pub(super) fn become_log(&self, swarm: &SwarmName, node: &NodeFolder, lines: usize, follow: bool) -> String {
        let mut command = self.command("journalctl");
        // The agent's lines contain their times.
        command.args(["--quiet", "--no-pager", "--output=cat", "--unit", &unit(swarm, node)]);
        command.args(["--lines", &lines.to_string()]);
        if follow {
            command.arg("--follow");
        }
        format!("journalctl: {}", os::become_program(&mut command))
    }

    /// Text of a node's unit.
    fn text(&self, swarm: &SwarmName, node: &NodeFolder) -> Result<String, String> {
        let folder = node.path.to_str().filter(|path| !path.contains(['"', '\\', '$', '\n']));
        let folder = folder.ok_or_else(|| format!("{}: a systemd unit cannot name this path", node.path.display()))?;
        let sandbox = if self.is_users { "" } else { SANDBOX };
        let text = TEMPLATE.replace("@SANDBOX@\n", sandbox).replace("@NODE@", &folder.replace('%', "%%"));
        let text = text.replace("@UNIT@", &unit_stem(swarm, node));
        Ok(text.replace("@SWARM@", swarm.as_str()).replace("@ID@", &node.id.to_string()))
    }

    /// Runs one of systemd's programs for this instance; returns its output.
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
        // A login without a terminal may lack the variable that locates the user's systemd.
        let runtime = PathBuf::from(format!("/run/user/{}", os::user_name()));
        if std::env::var_os("XDG_RUNTIME_DIR").is_none() && runtime.is_dir() {
            command.env("XDG_RUNTIME_DIR", runtime);
        }
        command
    }
}

/// Runs a command; returns its standard output, or an error with its standard error.
fn output_of(program: &str, command: &mut Command) -> Result<String, String> {
    let output = command.output().map_err(|error| format!("{program}: {error}"))?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    let arguments: Vec<_> = command.get_args().map(|argument| argument.to_string_lossy()).collect();
    let why = String::from_utf8_lossy(&output.stderr);
    Err(format!("{program} {}: {}", arguments.join(" "), why.trim().replace('\n', "; ")))
}

/// Folder of this user's units.
fn users_units() -> PathBuf {
    let variable = |name| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let config = variable("XDG_CONFIG_HOME").or_else(|| Some(variable("HOME")?.join(".config")));
    config.unwrap_or_default().join("systemd/user")
}

/// Name of a node's unit.
fn unit(swarm: &SwarmName, node: &NodeFolder) -> String {
    format!("{}.service", unit_stem(swarm, node))
}

/// Name of a node's unit, without its ending. The name of a swarm may have dashes, but no dots: vehicle 3/7 of `lab` is
/// not vehicle 7 of a swarm `lab-3`.
fn unit_stem(swarm: &SwarmName, node: &NodeFolder) -> String {
    format!("skein-{swarm}-{}", node.id.to_string().replace('/', "."))
}

#[cfg(test)]
#[cfg(unix)]
mod tests;
