//! Helicopters that no one has flown before: the ladder of `skein fit` makes each fly the default ring.

use skein_core::fit::{FitError, Fitted};
use skein_tests::fit::{Climbed, climb, random_helicopter, ring};
use skein_tests::in_parallel;

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
