//! The Python package: its wheel is built, installed into a fresh environment, and tested there by pytest.

use std::env;
use std::ffi::OsString;
use std::fs;
use std::io::{Write, stdout};
use std::path::{Path, PathBuf};
use std::process::Command;

/// What builds the wheel, and what the tests of the package import.
const PACKAGES: &str = "import gymnasium, matplotlib, maturin, nbclient, pandas, pettingzoo, polars, pyarrow, pytest";

/// The Python with the packages of `tests/requirements.txt`; `None`, with a message, if they are missing.
fn python() -> Option<PathBuf> {
    let python = env::var_os("SKEIN_PYTHON").map_or_else(|| PathBuf::from("python3"), PathBuf::from);
    let has_packages = Command::new(&python).args(["-c", PACKAGES]).output();
    if has_packages.is_ok_and(|output| output.status.success()) {
        return Some(python);
    }
    let why = format!("{} lacks packages: pip install -r tests/requirements.txt", python.display());
    assert_ne!(env::var("SKEIN_MCAP").as_deref(), Ok("required"), "{why}");
    // The real stdout, which the test harness does not capture.
    let _ = writeln!(stdout(), "the Python package is not tested: {why}");
    None
}

/// Runs a command to its end and gives what it wrote to stdout.
fn run(command: &mut Command) -> String {
    let done = command.output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    assert!(done.status.success(), "{command:?}\n{}\n{}", text(&done.stdout), text(&done.stderr));
    text(&done.stdout)
}

/// Builds the wheel beside the program under test: the crates that both need are compiled already.
fn wheel(python: &Path, here: &Path, folder: &Path) -> PathBuf {
    let built = Path::new(env!("CARGO_BIN_EXE_skein-under-test")).parent().unwrap();
    let mut maturin = Command::new(python);
    // The variables that cargo sets for this test would make build scripts run again.
    let ours = env::vars_os().map(|(name, _)| name).filter(|name| {
        let name = name.to_string_lossy();
        ["CARGO_PKG_", "CARGO_MANIFEST_", "CARGO_BIN_", "CARGO_CRATE_"].iter().any(|ours| name.starts_with(ours))
    });
    for name in ours {
        maturin.env_remove(name);
    }
    maturin.args(["-m", "maturin", "build", "--locked", "--auditwheel", "skip", "--out"]).arg(folder);
    maturin.arg("--target-dir").arg(built.parent().unwrap()).arg("--interpreter").arg(python);
    maturin.arg("--manifest-path").arg(here.join("../deploy/python/Cargo.toml"));
    if built.ends_with("release") {
        maturin.arg("--release");
    }
    run(&mut maturin);
    let wheel = fs::read_dir(folder).unwrap().next().unwrap().unwrap().path();
    let name = wheel.file_name().unwrap().to_str().unwrap();
    assert!(name.starts_with("skein_swarm-") && name.contains("-cp39-abi3-"), "{name}");
    wheel
}

#[test]
fn the_wheel_installs_into_a_fresh_environment_and_passes_its_tests() {
    let Some(python) = python() else { return };
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    let wheel = wheel(&python, here, &folder.path().join("wheels"));

    let fresh = folder.path().join("fresh");
    run(Command::new(&python).args(["-m", "venv"]).arg(&fresh));
    let fresh_python = fresh.join(if cfg!(windows) { "Scripts/python.exe" } else { "bin/python" });
    let install = ["-m", "pip", "install", "--quiet", "--no-index", "--no-deps", "--disable-pip-version-check"];
    run(Command::new(&fresh_python).args(install).arg(&wheel));
    // The packages that it needs come from the Python that has them, so that nothing is downloaded.
    let packages = "import sysconfig; print(sysconfig.get_path('purelib'))";
    let [theirs, ours] = [&python, &fresh_python].map(|python| run(Command::new(python).args(["-c", packages])));
    fs::write(Path::new(ours.trim()).join("packages.pth"), theirs).unwrap();

    let tests: [OsString; 10] = [
        "-m".into(),
        "pytest".into(),
        "--quiet".into(),
        "--doctest-glob=python.md".into(),
        "--doctest-glob=learning.md".into(),
        "--doctest-glob=for-researchers.md".into(),
        here.join("../deploy/python/tests").into(),
        here.join("../deploy/book/src/python.md").into(),
        here.join("../deploy/book/src/learning.md").into(),
        here.join("../deploy/book/src/for-researchers.md").into(),
    ];
    let mut pytest = Command::new(&fresh_python);
    pytest.args(tests).args(["-p", "no:cacheprovider", "--doctest-modules", "--pyargs", "skein"]);
    pytest.current_dir(folder.path()).env("SKEIN_PROGRAM", env!("CARGO_BIN_EXE_skein-under-test"));
    // Jupyter finds its kernel beside the Python that runs the tests.
    pytest.env("HOME", folder.path()).env_remove("PYTHONPATH").env("PYTHONDONTWRITEBYTECODE", "1");
    let printed = run(&mut pytest);
    assert!(printed.contains(" passed") && !printed.contains("skipped"), "{printed}");
}
