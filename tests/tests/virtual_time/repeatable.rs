//! Virtual time gives the same bits on every computer: golden flights, and a processor that hides its extensions.

use std::fs;
use std::process::Command;

use skein_lab::metrics::WALL_CLOCK_KEYS;
use skein_tests::golden::FILES;
use tempfile::TempDir;

const PROGRAM: &str = env!("CARGO_BIN_EXE_skein-under-test");

#[test]
fn the_golden_flights_repeat_to_the_bit() {
    let file = &FILES[0];
    let (golden, flown) = (fs::read_to_string(file.path()).unwrap(), (file.make)());
    for (nth, (expected, line)) in golden.lines().zip(flown.lines()).enumerate() {
        assert_eq!(line, expected, "{} line {}", file.name, nth + 1);
    }
    assert_eq!(flown.lines().count(), golden.lines().count());
}

/// The figures of a short study in gusts, flown by a process with this `GLIBC_TUNABLES`, without those of the wall
/// clock.
fn figures(tunables: &str) -> Vec<Vec<String>> {
    let folder = TempDir::new().unwrap();
    let sets =
        ["duration_s=60", "world.wind_m_s=3", "world.gust_w20_m_s=5", "network.loss=0.1", "network.jitter_s=0.1"];
    let mut command = Command::new(PROGRAM);
    command.current_dir(folder.path()).env("GLIBC_TUNABLES", tunables);
    command.args(["study", concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/scenarios/hover.toml")]);
    command.args(["--seeds", "0..2", "--no-record", "--out", "out"]);
    sets.iter().for_each(|set| {
        command.args(["--set", set]);
    });
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let csv = fs::read_to_string(folder.path().join("out/runs.csv")).unwrap();
    let names: Vec<&str> = csv.lines().next().unwrap().split(',').collect();
    let kept = |line: &str| {
        let cells = line.split(',').zip(&names).filter(|(_, name)| !WALL_CLOCK_KEYS.contains(name));
        cells.map(|(cell, _)| cell.to_owned()).collect()
    };
    csv.lines().map(kept).collect()
}

/// Without AVX2 and FMA glibc uses other routines for sine, exponential and the like, which differ in the last bits.
/// Only glibc on x86-64 has this setting; elsewhere the test flies twice in the same way.
#[test]
fn a_processor_without_avx2_and_fma_flies_the_same() {
    let figures = [figures(""), figures("glibc.cpu.hwcaps=-AVX2,-AVX2_Usable,-FMA,-FMA_Usable,-FMA4")];
    assert_eq!(figures[0].len(), 3, "a heading and two seeds");
    assert_eq!(figures[0], figures[1]);
}

/// The elementary functions that a program imports from the C library, whose bits depend on its version.
#[cfg(target_os = "linux")]
fn elementary_imports(program: &str) -> Vec<&'static str> {
    let names =
        ["sin", "cos", "sincos", "tan", "asin", "acos", "atan", "atan2", "hypot", "exp", "log", "log10", "cbrt"];
    let output = Command::new("nm").args(["--dynamic", "--undefined-only", "--format=posix", program]).output();
    let symbols = String::from_utf8(output.expect("nm, which comes with the C compiler").stdout).unwrap();
    let imports: Vec<&str> = symbols.lines().filter_map(|line| line.split([' ', '@']).next()).collect();
    assert!(imports.contains(&"memcpy"), "{symbols}");
    names.into_iter().filter(|name| imports.contains(name)).collect()
}

/// A flight and its figures use elementary functions of the program itself.
#[cfg(target_os = "linux")]
#[test]
fn a_flight_takes_no_elementary_function_from_the_c_library() {
    let program = env!("CARGO_BIN_EXE_flight-only");
    let flown = Command::new(program).output().unwrap();
    assert_eq!(String::from_utf8_lossy(&flown.stdout), "1\n", "{}", String::from_utf8_lossy(&flown.stderr));
    assert_eq!(elementary_imports(program), [""; 0]);
}

/// Besides `pow`, for tokio's statistics and the progress bar, `skein` imports only those with which resvg draws figures.
#[cfg(target_os = "linux")]
#[test]
fn the_program_takes_elementary_functions_from_the_c_library_for_pictures_only() {
    let for_pictures = ["cos", "sincos", "tan", "acos", "atan2"];
    let others: Vec<_> = elementary_imports(PROGRAM).into_iter().filter(|name| !for_pictures.contains(name)).collect();
    assert_eq!(others, [""; 0]);
}
