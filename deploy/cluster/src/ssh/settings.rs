//! The settings of a session that the operator's configuration of ssh must not change. Where a host is and how to log in to it,
//! by jump hosts too, is taken from that configuration.

use std::ffi::OsString;
use std::process::{Command, Stdio};

/// Settings that every OpenSSH in use knows. `LogLevel` is among them because a quiet ssh gives no reason for a failure.
const ALWAYS: [&str; 7] = [
    "ClearAllForwardings=yes",
    "PermitLocalCommand=no",
    "Tunnel=no",
    "ForwardX11=no",
    "ForwardAgent=no",
    "ConnectionAttempts=1",
    "LogLevel=INFO",
];
/// Settings by the version in which they came, 7.6 and 8.7. An older ssh would refuse them, and its configuration has none.
const NEWER: [&[&str]; 2] =
    [&["RemoteCommand=none"], &["SessionType=default", "StdinNull=no", "ForkAfterAuthentication=no"]];

/// The arguments with which this ssh, a program and its first arguments, runs one command on a host and nothing else.
pub(super) fn of_session(program: &[OsString]) -> Vec<String> {
    let newer = NEWER.into_iter().filter(|settings| knows(program, settings)).flatten();
    options(ALWAYS.iter().chain(newer))
}

fn options<'a>(settings: impl Iterator<Item = &'a &'a str>) -> Vec<String> {
    settings.flat_map(|setting| ["-o".to_owned(), (*setting).to_owned()]).collect()
}

/// Whether this ssh accepts these settings. It is asked for the result of a configuration and connects to no host.
fn knows(program: &[OsString], settings: &[&str]) -> bool {
    let Some((ssh, first)) = program.split_first() else { return false };
    let mut command = Command::new(ssh);
    command.args(first).args(["-F", "none", "-G"]).args(options(settings.iter())).arg("localhost");
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    command.status().is_ok_and(|status| status.success())
}

#[cfg(test)]
#[cfg(unix)]
mod tests;
