//! The page of `skein view` in headless Chromium, driven by the programs in `tests/page`: synthetic swarms of every size, a real
//! flight with its recording, recordings of swarms and fleets in virtual time, and the page behind proxies. Needs Node.js, Chromium,
//! OpenSSL and the packages of `tests/page/package-lock.json`; without them the tests skip this, unless `SKEIN_PAGE=required`.

use skein_tests::share::Share;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, PoisonError};

const PROGRAM: &str = env!("CARGO_BIN_EXE_skein-under-test");

/// What is missing for tests in a browser.
fn missing(folder: &Path) -> Option<String> {
    let runs = |program: &Path| Command::new(program).arg("--version").output().is_ok_and(|out| out.status.success());
    let chromium = std::env::var_os("SKEIN_CHROMIUM").map_or_else(|| PathBuf::from("/usr/bin/chromium"), PathBuf::from);
    if !runs(Path::new("node")) {
        return Some("Node.js is missing: install it".to_owned());
    }
    if !runs(&chromium) {
        return Some(format!(
            "{} is missing: install Chromium, or name another with SKEIN_CHROMIUM",
            chromium.display()
        ));
    }
    let has_packages = folder.join("node_modules/playwright-core").is_dir();
    (!has_packages).then(|| "packages are missing: npm ci --prefix tests/page".to_owned())
}

/// One browser at a time: a flight in real time shares the PC with it.
static ALONE: Mutex<()> = Mutex::new(());

/// Runs a file of tests, and prints what it prints.
fn run(file: &str) {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("page");
    if let Some(missing) = missing(&folder) {
        assert_ne!(std::env::var("SKEIN_PAGE").as_deref(), Ok("required"), "{missing}");
        eprintln!("skipped: {missing}");
        return;
    }
    let mut node = Command::new("node");
    // A page that shows nothing fails all tests of a file, each after a minute.
    node.args(["--test", "--test-reporter=spec", "--test-timeout=300000", file])
        .current_dir(&folder)
        .env("SKEIN_PROGRAM", PROGRAM);
    let output = node.output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    println!("{text}");
    assert!(output.status.success(), "{file}\n{text}{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn the_parts_of_the_page_that_need_no_browser_compute_correctly() {
    let _share = Share::of(100);
    run("unit.test.mjs");
}

#[test]
fn the_page_shows_synthetic_swarms_of_every_size() {
    let _share = Share::of(100);
    run("mock.test.mjs");
}

#[test]
fn the_page_works_behind_a_proxy_or_names_the_option_that_lets_it() {
    let _share = Share::of(100);
    run("proxy.test.mjs");
}

#[test]
fn the_page_shows_a_real_flight_and_its_recording() {
    let _share = Share::of(100);
    run("live.test.mjs");
}

#[test]
fn a_frame_of_recorded_vehicles_costs_the_browser_little() {
    let _share = Share::of(100);
    run("recorded.test.mjs");
}

#[test]
fn a_foxglove_client_decodes_every_channel_of_a_flight_and_of_its_recording() {
    let _share = Share::of(100);
    run("foxglove.test.mjs");
}
