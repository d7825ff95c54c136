//! Helicopters that no one has flown before: the ladder of `skein xplane fit` makes each fly the default ring.

use std::process::Command;

use skein_core::aircraft::Aircraft;
use skein_core::fit::{FitError, Fitted};
use skein_tests::fit::{Climbed, climb, fit_over_wire, random_helicopter, ring};
use skein_tests::wire::{Frames, Swarm};
use skein_tests::{in_parallel, scenario};

/// Random helicopters that are tried, and the least number of those that have to be fitted.
const TRIED: u64 = 40;
const FITTED: usize = 20;

#[test]
fn random_helicopters_are_fitted_and_fly_the_default_ring() {
    let fitted = in_parallel(0..TRIED, |seed| {
        let parameters = random_helicopter(seed);
        if let Err(error) = parameters.check() {
            println!("{seed}: no helicopter: {error}");
            return false;
        }
        let Climbed { end, largest_tilt_deg, last, .. } = climb(&parameters);
        assert!(largest_tilt_deg < 30.0, "seed {seed}: {largest_tilt_deg} deg");
        assert!(last.truth.height_m < 0.35 && last.truth.velocity.0.norm() < 0.1, "seed {seed} has not landed");
        let found: Fitted = match end {
            Ok(found) => found,
            // With the margin that the ladder asks for, every one is fitted.
            Err(error @ (FitError::Margin { .. } | FitError::NoLift)) => {
                println!("{seed}: rejected: {error}");
                return false;
            }
            Err(error) => panic!("seed {seed}: {error}"),
        };
        let reversed = &parameters.servos.reversed;
        let signs = [found.gains.roll, found.gains.pitch, found.gains.yaw].map(|gain| gain < 0.0);
        assert_eq!(signs, [reversed.roll, reversed.pitch, reversed.yaw], "seed {seed}");
        let report = ring(&parameters, &found, 1).remove(0);
        // The limits of the default hover formation.
        assert_eq!((report.collisions, report.crashes), (0, 0), "seed {seed}");
        assert!(report.at_altitude_s.unwrap() <= 20.0, "seed {seed}: {:?}", report.at_altitude_s);
        assert!(report.in_band_s.unwrap() <= 30.0, "seed {seed}: {:?}", report.in_band_s);
        assert!(report.even_10deg_s.unwrap() <= 120.0, "seed {seed}: {:?}", report.even_10deg_s);
        assert!(report.radial_rms_m.unwrap() <= 2.0, "seed {seed}: {:?}", report.radial_rms_m);
        assert!(report.spacing_error_deg.unwrap() <= 3.0, "seed {seed}: {:?}", report.spacing_error_deg);
        assert!(report.min_separation_m.unwrap() >= 10.0, "seed {seed}: {:?}", report.min_separation_m);
        true
    });
    let fitted = fitted.into_iter().filter(|is| *is).count();
    assert!(fitted >= FITTED, "only {fitted} of {TRIED} have enough margin");
}

/// The files of aircraft to be fitted, with the path of an aircraft that has the datarefs of each.
const TO_FIT: [(&str, &str); 2] = [
    ("r22", "Aircraft/Laminar Research/Robinson R22 Beta II/R22.acf"),
    ("rc-helicopter", "Aircraft/Skein/xcell60/xcell60.acf"),
];

#[test]
fn each_aircraft_of_x_plane_is_fitted_over_the_protocol_and_flies_the_ring() {
    assert_eq!(TO_FIT.map(|(name, _)| name), Aircraft::TO_FIT.map(|(name, _)| name));
    let cell = Frames { rate: 50, jitter: 0.2, drop: 0.02 };
    for (name, acf) in TO_FIT {
        let base = Aircraft::shipped_text(name).unwrap();
        let text = fit_over_wire(base, acf).unwrap();
        let fitted = Aircraft::from_text("fitted.toml", &text).unwrap();
        assert!(fitted.rotor_speed_rad_s.is_some() && fitted.helicopter.is_none(), "{text}");
        let expected = skein_core::aircraft::Profile::from_text(name, base).unwrap();
        assert_eq!(fitted.xplane, expected, "{name}");
        let mut swarm = Swarm::of(&scenario("hover.toml", &[]), cell, &fitted, acf);
        swarm.run_until(60.0);
        for nth in 0..4 {
            let (place, height_m) = swarm.place(nth);
            let radius_m = (place.0.xy() - swarm.agent(nth).centre_ne_m()).norm();
            assert!((90.0..110.0).contains(&radius_m) && height_m > 25.0, "{name}: {radius_m} m, {height_m} m");
        }
    }
}

#[test]
fn an_aircraft_that_was_never_fitted_is_refused_with_the_command_that_fits_it() {
    for (name, _) in TO_FIT {
        let set = format!("swarm.aircraft={name}");
        for command in [
            &["fly", "hover", "--set", &set][..],
            &["check", "hover", "--set", &set],
            &["study", "hover", "--set", &set],
            &["agent", "--scenario", "hover.toml", "--id", "1", "--set", &set],
        ] {
            let folder = tempfile::tempdir().unwrap();
            std::fs::write(folder.path().join("hover.toml"), "swarm.vehicles = 1").unwrap();
            let mut skein = Command::new(env!("CARGO_BIN_EXE_skein-under-test"));
            let ended = skein.current_dir(&folder).args(command).output().unwrap();
            let printed = String::from_utf8_lossy(&ended.stderr).replace(['\n', '\r'], " ");
            assert_eq!(ended.status.code(), Some(2), "{command:?}: {printed}");
            let remedy = format!("skein xplane fit my-{name} --base {name} --xplane HOST");
            assert!(printed.contains(&remedy), "{command:?}: {printed}");
        }
    }
}
