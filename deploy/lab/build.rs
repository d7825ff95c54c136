//! Passes the source revision to the program at build time.

use std::path::Path;
use std::process::Command;

/// The output of git, if it succeeds.
fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

fn main() {
    // Built from an archive, the revision is unknown.
    let revision = git(&["describe", "--always", "--dirty", "--abbrev=12"]).unwrap_or_else(|| "unknown".to_owned());
    println!("cargo::rustc-env=SKEIN_REVISION={revision}");
    // The revision also marks uncommitted changes in the program's sources. A path that does not exist would make every
    // build start anew: an archive has no `.git`, and in a second work tree `.git` is a file.
    let of_git = ["HEAD", "index"].map(|name| git(&["rev-parse", "--git-path", name]));
    let of_sources = ["src", "../src", "../../agent", "../../common/src"].map(|path| Some(path.to_owned()));
    for path in of_git.into_iter().chain(of_sources).flatten().filter(|path| Path::new(path).exists()) {
        println!("cargo::rerun-if-changed={path}");
    }
}
