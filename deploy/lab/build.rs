//! Passes the source revision to the program at build time.

use std::process::Command;

fn main() {
    let described = Command::new("git").args(["describe", "--always", "--dirty", "--abbrev=12"]).output();
    let revision = match described {
        Ok(output) if output.status.success() => String::from_utf8_lossy(&output.stdout).trim().to_owned(),
        // Built from an archive: the revision is unknown.
        _ => "unknown".to_owned(),
    };
    println!("cargo::rustc-env=SKEIN_REVISION={revision}");
    // The revision also marks uncommitted changes in the program's sources.
    for path in ["../../.git/HEAD", "../../.git/index", "src", "../src", "../../agent", "../../common/src"] {
        println!("cargo::rerun-if-changed={path}");
    }
}
