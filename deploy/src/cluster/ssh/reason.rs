//! Why a host could not be called: ssh's own words, turned into one sentence with what to do about it.

use std::path::{Path, PathBuf};

use skein_common::printable::printable;

use super::{CONNECT_S, Host, MAX_SENTENCE};

/// The sentence. `keys`: the key files that ssh tries for this host.
pub(super) fn sentence(host: &Host, stderr: &str, keys: impl FnOnce() -> Vec<String>) -> String {
    let says = |words: &str| stderr.contains(words);
    let name = &host.name;
    if says("IDENTIFICATION HAS CHANGED") {
        return format!(
            "{host}: its host key is not the one known here; if it was set up anew, `ssh-keygen -R {name}`, then `ssh {host}` \
             once by hand"
        );
    }
    if says("Host key verification failed") || says("host key is known") {
        return format!("{host}: its host key is not known here; `ssh {host}` once by hand to see it and accept it");
    }
    if says("Permission denied") || says("Too many authentication failures") {
        let tried = match keys().as_slice() {
            [] => "there is no key file of yours here".to_owned(),
            keys => format!("tried {}", keys.join(", ")),
        };
        return format!(
            "{host}: lets none of your keys in ({tried}, and what ssh-agent holds); `ssh-copy-id {host}` once by hand"
        );
    }
    if says("Could not resolve hostname") {
        return format!(
            "{host}: nobody knows this name; give its address in the cluster's file (`host`) or in ~/.ssh/config (HostName)"
        );
    }
    if says("Connection refused") {
        return format!("{host}: no ssh server answers there; start its sshd, or give its port in ~/.ssh/config");
    }
    if says("timed out") || says("Connection timeout") {
        return format!(
            "{host}: no answer within {CONNECT_S} s; see that it is on, and that nothing between blocks ssh"
        );
    }
    if says("No route to host") || says("Network is unreachable") {
        return format!("{host}: no way there from this network; see that both are connected, and its address");
    }
    if says("closed by") || says("reset by peer") || says("Broken pipe") || says("master") || says("not responding") {
        return format!("{host}: the connection was lost ({}); try again", last(stderr));
    }
    format!("{host}: {}", last(stderr))
}

fn last(stderr: &str) -> String {
    let last = stderr.lines().rev().map(str::trim).find(|line| !line.is_empty());
    printable(last.unwrap_or("ssh failed and says nothing"), MAX_SENTENCE)
}

/// The key files that exist, of those that `ssh -G` names.
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

    #[test]
    fn every_failure_of_ssh_has_its_remedy() {
        let host = Host { name: "heli1".to_owned(), user: Some("lab".to_owned()) };
        for (stderr, expected) in [
            (
                "@@@@\n@ WARNING: REMOTE HOST IDENTIFICATION HAS CHANGED! @\nHost key verification failed.\r\n",
                "lab@heli1: its host key is not the one known here; if it was set up anew, `ssh-keygen -R heli1`, then \
                 `ssh lab@heli1` once by hand",
            ),
            (
                "No ED25519 host key is known for heli1 and you have requested strict checking.\r\nHost key verification \
                 failed.\r\n",
                "lab@heli1: its host key is not known here; `ssh lab@heli1` once by hand to see it and accept it",
            ),
            (
                "lab@heli1: Permission denied (publickey).\r\n",
                "lab@heli1: lets none of your keys in (tried ~/.ssh/lab, and what ssh-agent holds); `ssh-copy-id lab@heli1` \
                 once by hand",
            ),
            (
                "ssh: Could not resolve hostname heli1: Name or service not known\r\n",
                "lab@heli1: nobody knows this name; give its address in the cluster's file (`host`) or in ~/.ssh/config \
                 (HostName)",
            ),
            (
                "ssh: connect to host heli1 port 22: Connection refused\r\n",
                "lab@heli1: no ssh server answers there; start its sshd, or give its port in ~/.ssh/config",
            ),
            (
                "ssh: connect to host heli1 port 22: Connection timed out\r\n",
                "lab@heli1: no answer within 5 s; see that it is on, and that nothing between blocks ssh",
            ),
            (
                "Connection timed out during banner exchange\r\n",
                "lab@heli1: no answer within 5 s; see that it is on, and that nothing between blocks ssh",
            ),
            (
                "ssh: connect to host heli1 port 22: No route to host\r\n",
                "lab@heli1: no way there from this network; see that both are connected, and its address",
            ),
            (
                "Warning: something\nclient_loop: send disconnect: Broken pipe\r\n",
                "lab@heli1: the connection was lost (client_loop: send disconnect: Broken pipe); try again",
            ),
            ("one\nBad owner or permissions on config\n\n", "lab@heli1: Bad owner or permissions on config"),
            ("", "lab@heli1: ssh failed and says nothing"),
            ("\u{1b}[2J\u{1b}]0;all ready\u{7}", "lab@heli1: \\u001b[2J\\u001b]0;all ready\\u0007"),
        ] {
            assert_eq!(sentence(&host, stderr, || vec!["~/.ssh/lab".to_owned()]), expected);
        }
        let none = sentence(&host, "Permission denied (publickey).", Vec::new);
        assert!(none.contains("(there is no key file of yours here, and"), "{none}");
    }

    #[test]
    fn only_keys_that_are_there_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let key = folder.path().join("id");
        std::fs::write(&key, "").unwrap();
        let options = format!("user lab\nidentityfile {}\nidentityfile {}-not\n", key.display(), key.display());
        assert_eq!(keys(&options), [key.display().to_string()]);
    }
}
