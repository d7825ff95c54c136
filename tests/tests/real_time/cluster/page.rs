//! Output of the commands of the book's pages on clusters, run on the lab's hosts in the order of the pages, with the
//! files that the page on installing shows.

use std::fs;
use std::time::Duration;

use super::finished::Finished;
use super::fleet::Fleet;
use super::lab::Lab;
use super::print_line;

/// The page on installing.
const PAGE: &str = include_str!("../../../../deploy/book/src/cluster.md");

/// Vehicles that the page's scenario has.
const VEHICLES: u8 = 2;

/// Runs all commands and prints their output.
pub(super) fn print() {
    let lab = Lab::new("page", |_| &[]);
    let folder = lab.operator().path("/root/lab");
    fs::create_dir_all(&folder).unwrap();
    for (name, text) in files(PAGE) {
        fs::write(folder.join(name), text).unwrap();
    }
    let _fleet = Fleet::start(&lab, 1..=VEHICLES);
    // A terminal of the book's width.
    let show = |line: &str| {
        let mut command = lab.operator().command("sh");
        command.args(["-c", &format!("cd lab && {line}")]).env("COLUMNS", "120");
        let Finished { out, err, took, status, .. } = Finished::of(&mut command, Duration::from_secs(240));
        print_line(&format!("$ {line}\n{err}{out}[{:.1} s, status {status:?}]\n", took.as_secs_f64()));
    };
    for line in [
        "skein cluster keys",
        "skein cluster keys",
        "skein check -f cluster.toml",
        "skein cluster install --dry-run",
        "skein cluster install",
        "skein cluster install",
        "skein check",
        "skein cluster up",
        "sleep 10; skein cluster status",
        "timeout 4 skein cluster status -w",
        "ssh heli1 .skein/lab/releases/*/skein cluster status -f .skein/lab/node-1/current/cluster.toml",
        "skein order hold -f cluster.toml",
        "skein order hold -f cluster.toml",
        "skein order goto 0 -f cluster.toml",
        "skein order land -f cluster.toml",
        "skein order goto 0 -f cluster.toml",
        "skein cluster logs -n 2",
        "skein cluster logs 2",
        "timeout 4 skein cluster logs -F -n 1",
        "timeout -s INT 8 skein record -f cluster.toml --out flight.mcap; ls",
        "skein cluster down --node 2",
        "skein cluster up",
        "sed -i 's/radius_m = 60/radius_m = 50/' ring.toml",
        "skein cluster install",
        "skein cluster install --rollback",
        "skein cluster uninstall",
        "skein cluster down",
        "skein cluster keys --renew 2",
        "skein cluster keys --renew",
        "skein cluster install",
        "skein cluster keys --revoke 2",
        "skein cluster down; skein cluster install && skein cluster up",
        "skein cluster keys --revoke observer",
        "skein cluster install",
        "skein cluster keys --revoke operator",
        "skein cluster install",
        "skein cluster status",
        "skein order abort",
        "skein order abort -f cluster.toml",
        "skein cluster down",
        "skein cluster uninstall",
        "skein cluster uninstall",
    ] {
        show(line);
    }
}

/// The files of a page: the fences whose info string has `file=NAME`.
pub(super) fn files(page: &'static str) -> impl Iterator<Item = (&'static str, &'static str)> {
    page.split("\n```toml file=").skip(1).map(|fence| {
        let (name, rest) = fence.split_once('\n').unwrap();
        (name, rest.split_once("\n```").unwrap().0)
    })
}
