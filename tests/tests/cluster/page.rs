//! Console output for the README's page on clusters: every command, run on the lab's hosts one after the other.

use std::time::Duration;

use super::finished::Finished;
use super::flight::Flight;
use super::print_line;

/// Runs all commands and prints their output.
pub(super) fn print() {
    let flight = Flight::prepare();
    // A terminal of the README's width.
    let show = |line: &str| {
        let mut command = flight.lab.operator().command("sh");
        command.args(["-c", &format!("cd lab && {line}")]).env("COLUMNS", "120");
        let Finished { out, err, took, .. } = Finished::of(&mut command, Duration::from_secs(240));
        print_line(&format!("$ {line}\n{err}{out}[{:.1} s]\n", took.as_secs_f64()));
    };
    // The cluster file of the test sets a more detailed log for one node.
    assert_eq!(flight.lab.operator().sh("sed -i /^log/d lab/cluster.toml").status, Some(0));
    for line in [
        "skein cluster keys",
        "skein check -f cluster.toml",
        "skein cluster install",
        "skein cluster install",
        "skein cluster up",
        "sleep 10; skein cluster status",
        "ssh heli3 .skein/lab/releases/*/skein cluster status -f .skein/lab/node-3/current/cluster.toml",
        "skein order hold -f cluster.toml",
        "skein cluster logs -n 2",
        "skein check -f cluster.toml",
        "skein cluster keys --revoke 3",
        "skein cluster install --node 3",
        "skein cluster down",
        "skein cluster uninstall",
    ] {
        show(line);
    }
}
