//! Passes the source revision, the target and Zenoh's version to the program at build time.

use std::path::Path;
use std::process::Command;
use std::{env, fs};

/// The revision of a source archive, in its root; a checkout has none and asks git.
const OF_ARCHIVE: &str = "../../.revision";
/// The versions of all dependencies.
const LOCK: &str = "../../Cargo.lock";

/// The output of git, if it succeeds.
fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// The version of a package in a lock file.
fn locked(lock: &str, name: &str) -> Option<String> {
    let (_, package) = lock.split_once(&format!("name = \"{name}\"\nversion = \""))?;
    package.split_once('"').map(|(version, _)| version.to_owned())
}

fn main() {
    let unknown = || "unknown".to_owned();
    let of_archive = fs::read_to_string(OF_ARCHIVE).ok().map(|text| text.trim().to_owned());
    let revision = of_archive.or_else(|| git(&["describe", "--always", "--dirty", "--abbrev=12"]));
    let zenoh = fs::read_to_string(LOCK).ok().and_then(|lock| locked(&lock.replace('\r', ""), "zenoh"));
    println!("cargo::rustc-env=SKEIN_REVISION={}", revision.unwrap_or_else(unknown));
    println!("cargo::rustc-env=SKEIN_TARGET={}", env::var("TARGET").unwrap_or_else(|_| unknown()));
    println!("cargo::rustc-env=SKEIN_ZENOH={}", zenoh.unwrap_or_else(unknown));
    // The log of HEAD grows with every commit and checkout. Other operations of git, such as `git status`, rewrite only the
    // index: watching it would compile this crate, and all that need it, again and again. So `-dirty` is decided when HEAD
    // moves or one of these sources changes, not when a change elsewhere appears. A path that does not exist would make every
    // build start anew: an archive has no `.git`, and in a second work tree `.git` is a file.
    let of_git = ["HEAD", "logs/HEAD"].map(|name| git(&["rev-parse", "--git-path", name]));
    let of_sources =
        ["src", "../cluster/src", "../view/src", "../src", "../../agent", "../../common/src", OF_ARCHIVE, LOCK]
            .map(|path| Some(path.to_owned()));
    for path in of_git.into_iter().chain(of_sources).flatten().filter(|path| Path::new(path).exists()) {
        println!("cargo::rerun-if-changed={path}");
    }
}
