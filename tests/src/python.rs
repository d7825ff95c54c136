//! What the public Python reader of MCAP finds in recordings.

use std::io::{Write, stdout};
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

const LOOK: &str = include_str!("look.py");
const WANTED: &str = "pip install -r tests/requirements.txt";

/// What `look.py` finds in each of these files; `None` if there is no Python with the packages. Then it says so, unless
/// `SKEIN_MCAP=required`. The Python is `$SKEIN_PYTHON`, else `python3`.
///
/// # Panics
/// If the packages are required and not there, or a file cannot be read.
pub fn look(files: &[&Path]) -> Option<Vec<Value>> {
    let python = std::env::var_os("SKEIN_PYTHON").map_or_else(|| PathBuf::from("python3"), PathBuf::from);
    let has_packages = Command::new(&python).args(["-c", "import mcap, mcap_protobuf"]).output();
    if !has_packages.is_ok_and(|output| output.status.success()) {
        let why = format!("{} cannot read MCAP: {WANTED}, or name another with SKEIN_PYTHON", python.display());
        assert_ne!(std::env::var("SKEIN_MCAP").as_deref(), Ok("required"), "{why}");
        // To the real stdout, whatever the harness captures.
        let _ = writeln!(stdout(), "no look at recordings from Python: {why}");
        return None;
    }
    let looked = Command::new(python).arg("-c").arg(LOOK).args(files).output().expect("it has run before");
    assert!(looked.status.success(), "{}", String::from_utf8_lossy(&looked.stderr));
    Some(serde_json::from_slice(&looked.stdout).expect("look.py prints JSON"))
}
