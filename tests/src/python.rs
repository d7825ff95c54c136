//! Recordings as the public Python reader of MCAP reads them.

use std::io::{Write, stdout};
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

const LOOK: &str = include_str!("look.py");
const INSTALL_HINT: &str = "pip install -r tests/requirements.txt";

/// The result of `look.py` for each of these files; `None`, with a message, if no Python with the packages is
/// installed. The Python is `$SKEIN_PYTHON`, or else `python3`.
///
/// # Panics
/// If the packages are missing and `SKEIN_MCAP=required`, or if a file cannot be read.
pub fn look(files: &[&Path]) -> Option<Vec<Value>> {
    let python = std::env::var_os("SKEIN_PYTHON").map_or_else(|| PathBuf::from("python3"), PathBuf::from);
    let has_packages = Command::new(&python).args(["-c", "import mcap, mcap_protobuf"]).output();
    if !has_packages.is_ok_and(|output| output.status.success()) {
        let why = format!("{} cannot read MCAP: {INSTALL_HINT}, or name another with SKEIN_PYTHON", python.display());
        assert_ne!(std::env::var("SKEIN_MCAP").as_deref(), Ok("required"), "{why}");
        // The real stdout, which the test harness does not capture.
        let _ = writeln!(stdout(), "recordings are not read from Python: {why}");
        return None;
    }
    let looked = Command::new(python).arg("-c").arg(LOOK).args(files).output().expect("Python ran before");
    assert!(looked.status.success(), "{}", String::from_utf8_lossy(&looked.stderr));
    Some(serde_json::from_slice(&looked.stdout).expect("look.py prints JSON"))
}
