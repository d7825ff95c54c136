//! Turns ssh's error messages into one sentence with the remedy.

use std::path::{Path, PathBuf};

use skein_common::printable::printable;

use super::{CONNECT_S, Host, MAX_SENTENCE};

/// Returns the sentence for ssh's standard error. `keys` returns the key files that ssh tries for this host.
pub(super) fn sentence(host: &Host, stderr: &str, keys: impl FnOnce() -> Vec<String>) -> String {
    let has = |texts: &[&str]| texts.iter().any(|text| stderr.contains(text));
    let last = || last_line(stderr).unwrap_or_else(|| "ssh failed without a message".to_owned());
    let name = &host.name;
    let why = if has(&["IDENTIFICATION HAS CHANGED"]) {
        format!(
            "its host key has changed; if the host was reinstalled, run `ssh-keygen -R {name}`, then `ssh {host}` once by hand"
        )
    } else if has(&["Host key verification failed", "host key is known"]) {
        format!("its host key is not known on this PC; run `ssh {host}` once by hand to check and accept it")
    } else if has(&["Permission denied", "Too many authentication failures"]) {
        let tried = match keys().as_slice() {
            [] => "you have no key file on this PC".to_owned(),
            keys => format!("tried {}", keys.join(", ")),
        };
        format!("accepts none of your keys ({tried}, and the keys of ssh-agent); run `ssh-copy-id {host}` once by hand")
    } else if has(&["Could not resolve hostname"]) {
        "this name is unknown; give the address in the cluster file (`host`) or in ~/.ssh/config (HostName)".to_owned()
    } else if has(&["Connection refused"]) {
        "no ssh server answers; start its sshd, or give its port in ~/.ssh/config".to_owned()
    } else if has(&["Invalid argument"]) {
        "its address needs the name of the interface on this PC; write it behind a %, as in `host = \"fe80::1%eth0\"`, or give \
         another address"
            .to_owned()
    } else if has(&["timed out", "Connection timeout"]) {
        format!("no answer within {CONNECT_S} s; check that it is on, and that no firewall blocks ssh")
    } else if has(&["No route to host", "Network is unreachable"]) {
        "no route from this network; check its address and that both are connected".to_owned()
    } else if has(&["closed by", "reset by peer", "Broken pipe", "master", "not responding"]) {
        format!("the connection was lost ({}); try again", last())
    } else {
        last()
    };
    format!("{host}: {why}")
}

/// The last line that is not empty, made safe for a terminal.
pub(super) fn last_line(stderr: &str) -> Option<String> {
    let last = stderr.lines().rev().map(str::trim).find(|line| !line.is_empty());
    last.map(|line| printable(line, MAX_SENTENCE))
}

/// Returns the key files named by `ssh -G` that exist.
pub(super) fn keys(options: &str) -> Vec<String> {
    let named = options.lines().filter_map(|line| line.strip_prefix("identityfile "));
    named.filter(|file| in_home(file).exists()).map(str::to_owned).collect()
}

fn in_home(file: &str) -> PathBuf {
    match (file.strip_prefix("~/"), std::env::var_os("HOME")) {
        (Some(file), Some(home)) => Path::new(&home).join(file),
        _ => PathBuf::from(file),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inventory::System;

    #[test]
    fn every_failure_of_ssh_has_its_remedy() {
        let host = Host { name: "heli1".to_owned(), user: Some("lab".to_owned()), system: System::Unix };
        for (stderr, expected) in [
            (
                "@@@@\n@ WARNING: REMOTE HOST IDENTIFICATION HAS CHANGED! @\nHost key verification failed.\r\n",
                "lab@heli1: its host key has changed; if the host was reinstalled, run `ssh-keygen -R heli1`, then \
                 `ssh lab@heli1` once by hand",
            ),
            (
                "No ED25519 host key is known for heli1 and you have requested strict checking.\r\nHost key verification \
                 failed.\r\n",
                "lab@heli1: its host key is not known on this PC; run `ssh lab@heli1` once by hand to check and accept it",
            ),
            (
                "lab@heli1: Permission denied (publickey).\r\n",
                "lab@heli1: accepts none of your keys (tried ~/.ssh/lab, and the keys of ssh-agent); run `ssh-copy-id lab@heli1` \
                 once by hand",
            ),
            (
                "ssh: Could not resolve hostname heli1: Name or service not known\r\n",
                "lab@heli1: this name is unknown; give the address in the cluster file (`host`) or in ~/.ssh/config \
                 (HostName)",
            ),
            (
                "ssh: connect to host heli1 port 22: Connection refused\r\n",
                "lab@heli1: no ssh server answers; start its sshd, or give its port in ~/.ssh/config",
            ),
            (
                "ssh: connect to host heli1 port 22: Connection timed out\r\n",
                "lab@heli1: no answer within 10 s; check that it is on, and that no firewall blocks ssh",
            ),
            (
                "Connection timed out during banner exchange\r\n",
                "lab@heli1: no answer within 10 s; check that it is on, and that no firewall blocks ssh",
            ),
            (
                "ssh: connect to host fe80::1 port 22: Invalid argument\r\n",
                "lab@heli1: its address needs the name of the interface on this PC; write it behind a %, as in `host = \
                 \"fe80::1%eth0\"`, or give another address",
            ),
            (
                "ssh: connect to host heli1 port 22: No route to host\r\n",
                "lab@heli1: no route from this network; check its address and that both are connected",
            ),
            (
                "Warning: something\nclient_loop: send disconnect: Broken pipe\r\n",
                "lab@heli1: the connection was lost (client_loop: send disconnect: Broken pipe); try again",
            ),
            ("one\nBad owner or permissions on config\n\n", "lab@heli1: Bad owner or permissions on config"),
            ("", "lab@heli1: ssh failed without a message"),
            ("\u{1b}[2J\u{1b}]0;all ready\u{7}", "lab@heli1: \\u001b[2J\\u001b]0;all ready\\u0007"),
        ] {
            assert_eq!(sentence(&host, stderr, || vec!["~/.ssh/lab".to_owned()]), expected);
        }
        let none = sentence(&host, "Permission denied (publickey).", Vec::new);
        assert!(none.contains("(you have no key file on this PC, and"), "{none}");
    }

    #[test]
    fn only_key_files_that_exist_are_listed() {
        let folder = tempfile::tempdir().unwrap();
        let key = folder.path().join("id");
        std::fs::write(&key, "").unwrap();
        let options = format!("user lab\nidentityfile {}\nidentityfile {}-not\n", key.display(), key.display());
        assert_eq!(keys(&options), [key.display().to_string()]);
    }
}
