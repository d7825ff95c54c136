//! Whether a firewall of this PC may drop what agents and X-Planes send: as far as this user may read its rules.

use std::env;
use std::ffi::OsString;
use std::io;
use std::process::{Command, Stdio};

use super::{line, windows};
use skein_cluster::findings::Line;

/// The answer of a firewall's program.
#[derive(Clone, Debug, PartialEq, Eq)]
enum FirewallAnswer {
    /// It is not installed.
    Missing,
    /// This user may not ask it, or it failed.
    Unreadable,
    Text(String),
}

/// Asks the programs of the common firewalls, or Windows'.
pub(super) fn look() -> Line {
    if cfg!(windows) {
        return windows::firewall(&env::current_exe().unwrap_or_default());
    }
    let answers = [
        ("ufw", ask("ufw", &["status"])),
        ("firewalld", ask("firewall-cmd", &["--state"])),
        ("nftables", ask("nft", &["list", "ruleset"])),
        ("iptables", ask("iptables", &["-S", "INPUT"])),
    ];
    verdict(&answers)
}

fn ask(program: &str, arguments: &[&str]) -> FirewallAnswer {
    // An ordinary user's PATH often lacks the folders of the administrator's programs.
    let path = env::var_os("PATH").unwrap_or_default();
    let folders = env::split_paths(&path).chain(["/usr/sbin", "/sbin"].map(Into::into));
    let path = env::join_paths(folders).unwrap_or_else(|_| OsString::from("/usr/sbin:/usr/bin:/sbin:/bin"));
    let output = Command::new(program).args(arguments).env("PATH", path).stdin(Stdio::null()).output();
    match output {
        Err(error) if error.kind() == io::ErrorKind::NotFound => FirewallAnswer::Missing,
        Ok(output) if output.status.success() => {
            FirewallAnswer::Text(String::from_utf8_lossy(&output.stdout).into_owned())
        }
        // firewalld that is not running answers so, and fails.
        Ok(output) if String::from_utf8_lossy(&output.stderr).contains("not running") => {
            FirewallAnswer::Text(String::new())
        }
        Ok(_) | Err(_) => FirewallAnswer::Unreadable,
    }
}

/// Whether incoming packets are dropped by this firewall, according to what it prints.
fn drops(firewall: &str, text: &str) -> bool {
    let of_input = |line: &str| line.contains("hook input") && line.contains("policy drop");
    match firewall {
        "ufw" => text.lines().any(|line| line.trim() == "Status: active"),
        "firewalld" => text.trim() == "running",
        "nftables" => text.lines().any(of_input),
        _ => text
            .lines()
            .any(|line| line.starts_with("-P INPUT DROP") || line.ends_with("-j DROP") || line.contains("-j REJECT")),
    }
}

fn verdict(answers: &[(&str, FirewallAnswer)]) -> Line {
    let dropping =
        answers.iter().find(|(name, answer)| matches!(answer, FirewallAnswer::Text(text) if drops(name, text)));
    if let Some((name, _)) = dropping {
        return line("firewall", format!("{name} drops incoming packets; a flight on this PC alone is not affected")).warning(
            "for a cluster or an X-Plane on another PC let TCP 7447 and up and UDP 49000 to 49200 in: `sudo ufw allow 7447:7500/tcp`, \
             or `sudo firewall-cmd --add-port=7447-7500/tcp`",
        );
    }
    let unreadable: Vec<&str> =
        answers.iter().filter(|(_, answer)| *answer == FirewallAnswer::Unreadable).map(|(name, _)| *name).collect();
    let is_missing = |(_, answer): &(&str, FirewallAnswer)| *answer == FirewallAnswer::Missing;
    match unreadable.as_slice() {
        [] if answers.iter().all(is_missing) => line("firewall", "none is installed"),
        [] => line("firewall", "no rule drops incoming packets"),
        several => Line {
            remedy: Some("`sudo skein check --pc` may read them".to_owned()),
            ..line("firewall", format!("this user may not read the rules of {}", several.join(", "))).unknown()
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use skein_cluster::findings::State;

    fn of(answers: [FirewallAnswer; 4]) -> Line {
        let names = ["ufw", "firewalld", "nftables", "iptables"];
        verdict(&names.into_iter().zip(answers).collect::<Vec<_>>())
    }

    #[test]
    fn a_firewall_that_drops_is_named_whatever_the_others_answer() {
        let text = |text: &str| FirewallAnswer::Text(text.to_owned());
        let nft =
            "table inet filter {\n\tchain input {\n\t\ttype filter hook input priority filter; policy drop;\n\t}\n}\n";
        for (nth, name, active) in [
            (0, "ufw", "Status: active\n"),
            (1, "firewalld", "running\n"),
            (2, "nftables", nft),
            (3, "iptables", "-P INPUT DROP\n"),
            (3, "iptables", "-P INPUT ACCEPT\n-A INPUT -p tcp -j REJECT --reject-with tcp-reset\n"),
        ] {
            let mut answers =
                [FirewallAnswer::Missing, FirewallAnswer::Unreadable, text(""), text("-P INPUT ACCEPT\n")];
            answers[nth] = text(active);
            let line = of(answers);
            assert!(line.state == State::Warning && line.found.starts_with(name), "{line:?}");
        }
    }

    #[test]
    fn rules_that_cannot_be_read_are_not_called_good() {
        let open = FirewallAnswer::Text("Status: inactive\n".to_owned());
        let accepts = nft_that_accepts();
        assert_eq!(of([open.clone(), FirewallAnswer::Missing, accepts, FirewallAnswer::Missing]).state, State::Good);
        assert_eq!(of([const { FirewallAnswer::Missing }; 4]).found, "none is installed");
        let line = of([FirewallAnswer::Unreadable, FirewallAnswer::Missing, FirewallAnswer::Unreadable, open]);
        assert!(line.state == State::Unknown && line.found.ends_with("ufw, nftables"), "{line:?}");
    }

    fn nft_that_accepts() -> FirewallAnswer {
        let chain = "\tchain input {\n\t\ttype filter hook input priority filter; policy accept;\n\t}\n";
        FirewallAnswer::Text(format!(
            "table inet filter {{\n{chain}\tchain forward {{ type filter hook forward priority 0; policy drop; }}\n}}\n"
        ))
    }
}
