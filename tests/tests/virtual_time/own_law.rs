//! A control law of the user, in a crate outside of Skein's workspace: it is compiled and flown, and checked by name.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

use serde_json::Value;
use skein_lab::metrics::WALL_CLOCK_KEYS;

/// The program of that crate, built beside the one under test: with the same lock file and profile, Skein's
/// dependencies are compiled already.
fn program() -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| {
        let here = Path::new(env!("CARGO_MANIFEST_DIR"));
        let built = Path::new(env!("CARGO_BIN_EXE_skein-under-test")).parent().unwrap();
        let copy = Path::new(env!("CARGO_TARGET_TMPDIR")).join("own-law");
        let deploy = here.join("../deploy").canonicalize().unwrap();
        let manifest = fs::read_to_string(here.join("own-law/Cargo.toml")).unwrap();
        let manifest = manifest.replace("../../deploy", deploy.to_str().unwrap());
        fs::create_dir_all(copy.join("src")).unwrap();
        fs::write(copy.join("Cargo.toml"), manifest).unwrap();
        fs::copy(here.join("own-law/src/main.rs"), copy.join("src/main.rs")).unwrap();
        fs::copy(here.join("../Cargo.lock"), copy.join("Cargo.lock")).unwrap();
        let mut cargo = Command::new(env!("CARGO"));
        // The variables that cargo sets for this test would make every build script run again.
        let ours = env::vars_os().map(|(name, _)| name).filter(|name| {
            let name = name.to_string_lossy();
            ["CARGO_PKG_", "CARGO_MANIFEST_", "CARGO_BIN_", "CARGO_CRATE_"].iter().any(|ours| name.starts_with(ours))
        });
        for name in ours {
            cargo.env_remove(name);
        }
        cargo.args(["build", "--offline", "--quiet", "--target-dir"]).arg(built.parent().unwrap());
        if built.ends_with("release") {
            // The same as in the workspace's manifest.
            cargo.args(["--release", "--config", "profile.release.strip='debuginfo'"]);
            // Another workspace compiles Skein's own crates again. Short flights do not need the optimiser.
            for name in ["skein-lab", "skein-host", "skein-core", "skein-common"] {
                cargo.arg("--config").arg(format!("profile.release.package.{name}.opt-level=0"));
            }
        }
        let done = cargo.current_dir(&copy).output().unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        built.join(format!("own-law{}", env::consts::EXE_SUFFIX))
    })
}

fn study(out: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(program());
    command.args(["study", "--json", "--no-record", "--set", "duration_s=150"]).args(arguments);
    command.arg("--out").arg(out).current_dir(out.parent().unwrap()).output().unwrap()
}

fn figures(folder: &Path) -> Value {
    let mut figures: Value = serde_json::from_str(&fs::read_to_string(folder.join("metrics.json")).unwrap()).unwrap();
    WALL_CLOCK_KEYS.iter().for_each(|key| drop(figures.as_object_mut().unwrap().remove(*key)));
    figures
}

/// A scenario with a law that Skein itself does not have.
fn hover(folder: &Path) -> PathBuf {
    let file = folder.join("mine.toml");
    fs::write(&file, "[swarm]\nvehicles = 5\n[formation]\nlaw = \"pursuit\"\nradius_m = 60\n").unwrap();
    file
}

#[test]
fn a_law_of_a_foreign_crate_flies_the_same_with_one_job_and_with_two() {
    let folder = tempfile::tempdir().unwrap();
    let file = hover(folder.path());
    let [one, two] = ["one", "two"].map(|name| folder.path().join(name));
    for (out, jobs) in [(&one, "1"), (&two, "2")] {
        let flown = study(out, &[file.to_str().unwrap(), "--seeds", "0..2", "--jobs", jobs]);
        assert!(flown.status.success(), "{}", String::from_utf8_lossy(&flown.stderr));
    }
    for seed in ["seed-0", "seed-1"] {
        let flown = figures(&one.join(seed));
        assert_eq!(flown, figures(&two.join(seed)));
        assert_eq!(flown["law"], "pursuit");
        let figure = |name: &str| flown[name].as_f64().unwrap();
        assert!((figure("radial_mean_m") - 60.0).abs() < 10.0, "{flown:#}");
        assert!(figure("polarization") < 0.3, "five vehicles on a circle fly in five directions: {flown:#}");
        assert!(figure("collisions") == 0.0 && figure("min_separation_m") > 5.0, "{flown:#}");
    }
    let slow =
        study(&folder.path().join("slow"), &[file.to_str().unwrap(), "--set", "formation.parameters.speed_m_s=1"]);
    assert!(slow.status.success(), "{}", String::from_utf8_lossy(&slow.stderr));
    assert_ne!(figures(&folder.path().join("slow"))["radial_rms_m"], figures(&one.join("seed-1"))["radial_rms_m"]);
}

#[test]
fn the_name_and_the_parameters_of_a_users_law_are_checked() {
    let folder = tempfile::tempdir().unwrap();
    let file = hover(folder.path());
    let refused = |sets: &[&str]| {
        let refused = study(&folder.path().join("out"), &[&[file.to_str().unwrap()], sets].concat());
        assert_eq!(refused.status.code(), Some(2));
        assert!(!folder.path().join("out").exists());
        String::from_utf8(refused.stderr).unwrap()
    };
    let misspelt = refused(&["--set", "formation.law=pursit"]);
    assert!(misspelt.contains("\"external\", \"pursuit\"; did you mean \"pursuit\"?"), "{misspelt}");
    let wrong = refused(&["--set", "formation.parameters.speed_m_s=[1]"]);
    assert!(wrong.contains("`formation.parameters.speed_m_s` has to be a number, not [1]"), "{wrong}");
    let unknown = Command::new(env!("CARGO_BIN_EXE_skein-under-test")).arg("check").arg(&file).output().unwrap();
    assert_eq!(unknown.status.code(), Some(2), "Skein itself does not have this law");
}
