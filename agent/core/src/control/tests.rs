mod axes;
mod closed_loop;
mod shipped;

use core::f64::consts::{FRAC_PI_2, PI, TAU};

use proptest::prelude::*;
use skein_common::frame::{Attitude, BodyRates, Geodetic, PositionNed, VelocityNed};
use skein_common::math;

use super::*;
use crate::setpoint::VELOCITY_PER_ERROR_PER_S;

/// Trim of the built-in helicopter.
pub(super) const TRIM: Trim = Trim {
    roll_stick: 0.0185,
    pitch_stick: 0.0,
    yaw_stick: 0.0,
    collective: 0.6,
    roll_rad: 4.61 * PI / 180.0,
    pitch_rad: 0.0,
};

fn controller(auto_trim: bool) -> VehicleController {
    VehicleController::new(Rules::shipped(), TRIM, Gains::default(), auto_trim)
}

/// The estimate of a trimmed hover at 30 m.
fn hover(heading_rad: f64) -> Estimate {
    Estimate {
        position: PositionNed::new(0.0, 0.0, -30.0),
        geodetic: Geodetic::from_degrees(28.0, -82.0, 30.0),
        height_m: 30.0,
        velocity: VelocityNed::default(),
        attitude: Attitude { roll_rad: TRIM.roll_rad, pitch_rad: TRIM.pitch_rad, heading_rad },
        rates: BodyRates::default(),
        rotor_speed_rad_s: None,
    }
}

/// The setpoint of that hover.
fn stay(heading_rad: f64) -> Setpoint {
    Setpoint {
        relative_velocity_ne_m_s: Vector2::zeros(),
        feedforward_ne_m_s: Vector2::zeros(),
        altitude_m: 30.0,
        heading_rad,
    }
}

fn controls(estimate: &Estimate, setpoint: &Setpoint) -> Controls {
    let controls = controller(false).step(0.02, estimate, setpoint);
    assert_eq!(controls.fault, None);
    controls.controls
}

#[track_caller]
fn assert_near(got: f64, expected: f64) {
    assert!((got - expected).abs() < 1e-9, "{got}, not {expected}");
}

#[test]
fn pseudo_errors_have_the_papers_signs() {
    let c = 7.0;
    for (field, heading_rad, expected) in [
        ([1.0, 0.0], 0.0, [-7.0, 0.0]),
        ([1.0, 0.0], FRAC_PI_2, [0.0, -7.0]),
        ([0.0, 1.0], 0.0, [0.0, 7.0]),
        ([0.0, 1.0], FRAC_PI_2, [-7.0, 0.0]),
    ] {
        let errors = pseudo_errors(Vector2::from(field) * c, &HeadingFrame::new(heading_rad));
        assert!(errors.iter().zip(expected).all(|(error, expected)| (error - expected).abs() < 1e-12), "{errors:?}");
    }
}

#[test]
fn a_trimmed_hover_needs_the_trim_controls() {
    for heading_rad in [0.0, 1.0, -2.5] {
        let Controls { roll, pitch, yaw, collective } = controls(&hover(heading_rad), &stay(heading_rad));
        assert_near(roll, TRIM.roll_stick);
        assert_near(pitch, TRIM.pitch_stick);
        assert_near(yaw, 0.0);
        assert_near(collective, TRIM.collective);
    }
}

#[test]
fn an_error_moves_the_control_that_reduces_it() {
    let towards = |north, east| Setpoint {
        relative_velocity_ne_m_s: Vector2::new(north, east) * VELOCITY_PER_ERROR_PER_S,
        ..stay(0.0)
    };
    assert_near(controls(&hover(0.0), &towards(5.0, 0.0)).pitch, -0.25);
    assert_near(controls(&hover(0.0), &towards(-5.0, 0.0)).pitch, 0.25);
    assert_near(controls(&hover(0.0), &towards(0.0, 5.0)).roll, TRIM.roll_stick + 0.25);
    assert_near(controls(&hover(0.0), &towards(0.0, -5.0)).roll, TRIM.roll_stick - 0.25);

    // Heading east, a target in the east is ahead.
    let east = Setpoint { heading_rad: FRAC_PI_2, ..towards(0.0, 5.0) };
    assert_near(controls(&hover(FRAC_PI_2), &east).pitch, -0.25);
    assert_near(controls(&hover(FRAC_PI_2), &east).roll, TRIM.roll_stick);

    assert_near(controls(&hover(0.0), &Setpoint { heading_rad: 0.3, ..stay(0.0) }).yaw, 0.225);
    assert_near(controls(&hover(0.0), &Setpoint { altitude_m: 33.0, ..stay(0.0) }).collective, 0.6675);
    assert_near(controls(&hover(0.0), &Setpoint { altitude_m: 20.0, ..stay(0.0) }).collective, 0.4875);
}

#[test]
fn motion_is_damped() {
    let moving = |north, east, down| Estimate { velocity: VelocityNed::new(north, east, down), ..hover(0.0) };
    assert_near(controls(&moving(3.0, 0.0, 0.0), &stay(0.0)).pitch, 0.3);
    assert_near(controls(&moving(0.0, 3.0, 0.0), &stay(0.0)).roll, TRIM.roll_stick - 0.3);
    assert_near(controls(&moving(0.0, 0.0, -1.5), &stay(0.0)).collective, 0.5325);

    let attitude = Attitude { roll_rad: TRIM.roll_rad + 0.3, pitch_rad: -0.3, heading_rad: 0.0 };
    let tilted = Estimate { attitude, ..hover(0.0) };
    assert_near(controls(&tilted, &stay(0.0)).roll, TRIM.roll_stick - 0.3);
    assert_near(controls(&tilted, &stay(0.0)).pitch, 0.3);

    let turning = Estimate { rates: BodyRates { yaw_rad_s: 1.5, ..BodyRates::default() }, ..hover(0.0) };
    assert_near(controls(&turning, &stay(0.0)).yaw, -0.3);
}

#[test]
fn the_moving_centres_velocity_is_not_damped() {
    let with_it = Estimate { velocity: VelocityNed::new(3.0, -2.0, 0.0), ..hover(0.7) };
    let follow = Setpoint { feedforward_ne_m_s: Vector2::new(3.0, -2.0), ..stay(0.7) };
    assert_eq!(controls(&with_it, &follow), controls(&hover(0.7), &stay(0.7)));
}

#[test]
fn heading_error_takes_the_short_way_round() {
    let setpoint = stay(-PI + 0.1);
    assert_near(controls(&hover(PI - 0.1), &setpoint).yaw, 0.75 * 0.2);
    assert_near(controls(&hover(PI - 0.1 + 3.0 * TAU), &setpoint).yaw, 0.75 * 0.2);
}

#[test]
fn near_the_ground_there_is_no_lateral_command() {
    let setpoint =
        Setpoint { relative_velocity_ne_m_s: Vector2::new(-5.0, 5.0) * VELOCITY_PER_ERROR_PER_S, ..stay(0.0) };
    for (height_m, share) in [(0.24, 0.0), (1.5, 0.0), (2.5, 0.5), (3.5, 1.0), (30.0, 1.0)] {
        let low = Estimate { height_m, ..hover(0.0) };
        assert_near(controls(&low, &setpoint).roll, TRIM.roll_stick + 0.25 * share);
        assert_near(controls(&low, &setpoint).pitch, 0.25 * share);
    }
    let moving = Setpoint { feedforward_ne_m_s: Vector2::new(4.0, -2.0), ..stay(0.0) };
    let on_skids = Estimate { height_m: 0.24, ..hover(0.0) };
    assert_eq!(controls(&on_skids, &moving), controls(&on_skids, &stay(0.0)), "nor forwards with a moving centre");
}

/// The integrals of auto-trim after one second with this estimate and setpoint.
fn after_a_second(estimate: &Estimate, setpoint: &Setpoint) -> AutoTrim {
    let mut controller = controller(true);
    for _ in 0..50 {
        controller.step(0.02, estimate, setpoint);
    }
    controller.auto_trim.unwrap()
}

#[test]
fn auto_trim_integrates_the_velocity_command_error() {
    // e_v = 0.5·error + feed-forward − v = (1 + 0.25 − 0.75, −0.5 + 0 − 0.5) m/s, k = 0.01.
    let drifting = Estimate { velocity: VelocityNed::new(0.75, 0.5, 0.2), ..hover(2.0) };
    let setpoint = Setpoint {
        relative_velocity_ne_m_s: Vector2::new(2.0, -1.0) * VELOCITY_PER_ERROR_PER_S,
        feedforward_ne_m_s: Vector2::new(0.25, 0.0),
        altitude_m: 31.0,
        heading_rad: 2.0,
    };
    let found = after_a_second(&drifting, &setpoint);
    assert_near(found.tilt_ne_rad.x, 0.005);
    assert_near(found.tilt_ne_rad.y, -0.01);
    // 0.9 k (0.38·1 + 0.2).
    assert_near(found.collective, 0.009 * 0.58);
    assert_eq!(controller(false).auto_trim, None);
}

#[test]
fn auto_trim_pauses_near_the_ground_and_in_manoeuvres() {
    let nothing = AutoTrim::default();
    let setpoint = Setpoint {
        relative_velocity_ne_m_s: Vector2::new(1.0, 0.0) * VELOCITY_PER_ERROR_PER_S,
        altitude_m: 31.0,
        ..stay(0.0)
    };
    assert_eq!(after_a_second(&Estimate { height_m: 3.49, ..hover(0.0) }, &setpoint), nothing);
    assert_ne!(after_a_second(&Estimate { height_m: 3.5, ..hover(0.0) }, &setpoint), nothing);

    // At 1 m/s the velocity error is just below or above 1.5 m/s.
    let flies = Estimate { velocity: VelocityNed::new(1.0, 0.0, 0.0), ..hover(0.0) };
    let found = |error_m: f64| {
        after_a_second(
            &flies,
            &Setpoint { relative_velocity_ne_m_s: Vector2::new(error_m, 0.0) * VELOCITY_PER_ERROR_PER_S, ..stay(0.0) },
        )
        .tilt_ne_rad
    };
    assert_eq!(found(5.01), Vector2::zeros());
    assert_ne!(found(4.99), Vector2::zeros());
}

#[test]
fn auto_trim_integrates_for_a_steady_held_up_vehicle_but_not_for_a_flying_one() {
    let commanded =
        Setpoint { relative_velocity_ne_m_s: Vector2::new(4.0, 0.0) * VELOCITY_PER_ERROR_PER_S, ..stay(0.0) };
    let found = |velocity: VelocityNed, seconds: u32| {
        let mut controller = controller(true);
        for _ in 0..50 * seconds {
            controller.step(0.02, &Estimate { velocity, ..hover(0.0) }, &commanded);
        }
        controller.auto_trim.unwrap().tilt_ne_rad
    };
    let blown_back = VelocityNed::new(-1.5, 0.0, 0.0);
    assert_eq!(found(blown_back, 2), Vector2::zeros(), "the velocity is not steady yet");
    assert!(found(blown_back, 8).x > 0.1, "{:?}", found(blown_back, 8));
    assert_eq!(found(VelocityNed::new(-2.5, 0.0, 0.0), 8), Vector2::zeros(), "too large an error for trim");
    assert!(found(VelocityNed::new(0.4, 0.0, 0.0), 8).x > 0.1, "the vehicle is held up");
    assert_eq!(found(VelocityNed::new(0.49, 0.0, 0.0), 0), Vector2::zeros());
    let flies = Setpoint { relative_velocity_ne_m_s: Vector2::new(6.0, 0.0) * VELOCITY_PER_ERROR_PER_S, ..stay(0.0) };
    let mut controller = controller(true);
    (0..400).for_each(|_| {
        controller.step(0.02, &Estimate { velocity: VelocityNed::new(1.0, 0.0, 0.0), ..hover(0.0) }, &flies);
    });
    assert_eq!(controller.auto_trim.unwrap().tilt_ne_rad, Vector2::zeros(), "the vehicle flies");
}

#[test]
fn a_steady_climb_fills_no_integral_and_the_climb_error_is_limited_to_2_5_m_s() {
    let found = |altitude_m: f64, climb_m_s: f64| {
        let climbing = Estimate { velocity: VelocityNed::new(0.0, 0.0, -climb_m_s), ..hover(0.0) };
        after_a_second(&climbing, &Setpoint { altitude_m, ..stay(0.0) }).collective
    };
    assert_near(found(34.0, 0.38 * 4.0), 0.0);
    assert_near(found(300.0, 1.9), 0.0);
    // A vehicle that climbs while the command is the fastest descent, as after a stop in a strong wind.
    assert_near(found(20.0, 1.0), -0.009 * 2.5);
}

#[test]
fn auto_trim_is_clamped_and_steps_are_capped() {
    let mut controller = controller(true);
    let setpoint = Setpoint {
        relative_velocity_ne_m_s: Vector2::new(2.0, -2.0) * VELOCITY_PER_ERROR_PER_S,
        altitude_m: 26.0,
        ..stay(0.0)
    };
    // However long the plant paused, a step counts as 0.1 s at most; a step back in time counts as zero.
    controller.step(1e9, &hover(0.0), &setpoint);
    assert_near(controller.auto_trim.unwrap().tilt_ne_rad.x, 0.001);
    controller.step(-5.0, &hover(0.0), &setpoint);
    assert_near(controller.auto_trim.unwrap().tilt_ne_rad.x, 0.001);
    for _ in 0..1000 {
        controller.step(0.1, &hover(0.0), &setpoint);
    }
    let found = controller.auto_trim.unwrap();
    assert_near(found.tilt_ne_rad.norm(), 0.3);
    assert_near(found.tilt_ne_rad.x, -found.tilt_ne_rad.y);
    assert_eq!(found.collective, -0.12);
}

/// The collective limit after this time at this height, this far below the altitude setpoint.
fn limit_after(seconds: u32, auto_trim: bool, height_m: f64, error_m: f64) -> Option<CollectiveLimit> {
    let mut controller = controller(auto_trim);
    let (estimate, setpoint) =
        (Estimate { height_m, ..hover(0.0) }, Setpoint { altitude_m: 30.0 + error_m, ..stay(0.0) });
    for _ in 0..50 * seconds {
        controller.step(0.02, &estimate, &setpoint);
    }
    controller.collective_limit
}

#[test]
fn the_collective_limit_is_reached_with_rules_and_integral_at_their_maximum() {
    use CollectiveLimit::{Highest, Lowest};
    assert_eq!(limit_after(10, true, 30.0, -2.5), None, "2.5 m too high, with trim left");
    assert_eq!(limit_after(20, true, 30.0, -2.5), Some(Lowest), "the integral is at its limit");
    assert_eq!(limit_after(1, true, 30.0, -4.9), None, "the integral still changes");
    assert_eq!(limit_after(1, true, 30.0, -5.0), Some(Lowest), "the rules give their maximum");
    assert_eq!(limit_after(60, true, 30.0, 0.0), None);
    for auto_trim in [false, true] {
        assert_eq!(limit_after(1, auto_trim, 0.24, 2.0), Some(Highest), "on the ground");
        assert_eq!(limit_after(1, auto_trim, 0.24, -2.0), None);
    }
    assert_eq!(limit_after(60, false, 30.0, -7.6), None, "the rules leave this error in 8 m/s of wind");
    assert_eq!(limit_after(60, false, 30.0, -10.0), Some(Lowest));
    assert!(Highest.is_towards(1.0) && !Highest.is_towards(-1.0) && Lowest.is_towards(-1.0) && !Lowest.is_towards(1.0));
}

#[test]
fn auto_trim_leans_in_the_direction_of_its_integral() {
    let found = AutoTrim { tilt_ne_rad: Vector2::new(0.1, 0.05), collective: 0.02, ..AutoTrim::default() };
    let mut controller = controller(false);
    controller.auto_trim = Some(found);
    // Heading north: nose down to lean north, right to lean east.
    let controls = controller.step(0.0, &hover(0.0), &stay(0.0)).controls;
    assert_near(controls.pitch, -0.1);
    assert_near(controls.roll, TRIM.roll_stick + 0.05);
    assert_near(controls.collective, 0.62);
    // Heading west: bank left to lean north.
    let controls = controller.step(0.0, &hover(-FRAC_PI_2), &stay(-FRAC_PI_2)).controls;
    assert_near(controls.roll, TRIM.roll_stick + 0.1);
    assert_near(controls.pitch, 0.05);
}

#[test]
fn a_non_finite_argument_repeats_the_last_controls() {
    let mut controller = controller(true);
    let bad = Estimate { height_m: f64::NAN, ..hover(0.0) };
    let neutral = Controls { roll: TRIM.roll_stick, pitch: 0.0, yaw: 0.0, collective: 0.6 };
    let before = controller.step(0.02, &bad, &stay(0.0));
    assert_eq!(before, ControlOutput { controls: neutral, fault: Some(ControlFault::Estimate) });

    let setpoint =
        Setpoint { relative_velocity_ne_m_s: Vector2::new(1.0, 2.0) * VELOCITY_PER_ERROR_PER_S, ..stay(0.3) };
    let good = controller.step(0.02, &hover(0.0), &setpoint);
    let found = controller.auto_trim;
    assert_ne!(good.controls, neutral);
    let nan = f64::NAN;
    let estimates = [
        Estimate { position: PositionNed::new(0.0, nan, 0.0), ..hover(0.0) },
        Estimate { velocity: VelocityNed::new(0.0, 0.0, f64::INFINITY), ..hover(0.0) },
        Estimate { attitude: Attitude { pitch_rad: nan, ..Attitude::default() }, ..hover(0.0) },
        Estimate { rates: BodyRates { yaw_rad_s: nan, ..BodyRates::default() }, ..hover(0.0) },
    ];
    let setpoints = [
        Setpoint { relative_velocity_ne_m_s: Vector2::new(nan, 0.0) * VELOCITY_PER_ERROR_PER_S, ..setpoint },
        Setpoint { feedforward_ne_m_s: Vector2::new(0.0, f64::NEG_INFINITY), ..setpoint },
        Setpoint { altitude_m: nan, ..setpoint },
        Setpoint { heading_rad: nan, ..setpoint },
    ];
    let faults = estimates.iter().map(|estimate| (controller.step(0.02, estimate, &setpoint), ControlFault::Estimate));
    let mut faults: Vec<_> = faults.collect();
    faults.extend(setpoints.iter().map(|s| (controller.step(0.02, &hover(0.0), s), ControlFault::Setpoint)));
    faults.push((controller.step(nan, &hover(0.0), &setpoint), ControlFault::TimeStep));
    // Each setpoint is finite, but its components along the heading are not.
    let overflowing =
        Setpoint { relative_velocity_ne_m_s: Vector2::new(f64::MAX, f64::MAX) * VELOCITY_PER_ERROR_PER_S, ..setpoint };
    faults.push((controller.step(0.02, &hover(0.8), &overflowing), ControlFault::Rules));
    for (controls, fault) in faults {
        assert_eq!(controls, ControlOutput { controls: good.controls, fault: Some(fault) });
    }
    assert_eq!(controller.auto_trim, found);
    assert_eq!(controller.step(0.02, &hover(0.0), &setpoint).fault, None);
}

#[test]
fn a_trim_table_is_read_in_degrees() {
    let table =
        "roll_stick = 0.0185\npitch_stick = 0.0\nyaw_stick = 0.0\ncollective = 0.6\nroll_deg = 4.61\npitch_deg = 0.0";
    let trim: Trim = toml::from_str(table).unwrap();
    assert_near(trim.roll_rad, 4.61f64.to_radians());
    assert_eq!((trim.roll_stick, trim.collective), (0.0185, 0.6));
    let error = |from: &str, to: &str| toml::from_str::<Trim>(&table.replace(from, to)).unwrap_err().to_string();
    assert!(error("0.6", "1.1").contains("collective is 1.1, but has to be within 0 to 1"));
    assert!(error("4.61", "nan").contains("roll_deg is NaN, but has to be within -45 to 45"));
    assert!(error("yaw_stick", "jaw_stick").contains("unknown field `jaw_stick`"));
}

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![3 => -100.0..100.0, 1 => any::<f64>(), 1 => Just(f64::NAN), 1 => Just(f64::MAX), 1 => Just(f64::INFINITY)]
}

fn any_estimate() -> impl Strategy<Value = Estimate> {
    prop::array::uniform11(any_number()).prop_map(
        |[n, e, d, height_m, vn, ve, vd, roll_rad, pitch_rad, heading_rad, r]| Estimate {
            position: PositionNed::new(n, e, d),
            height_m,
            velocity: VelocityNed::new(vn, ve, vd),
            attitude: Attitude { roll_rad, pitch_rad, heading_rad },
            rates: BodyRates { roll_rad_s: n, pitch_rad_s: e, yaw_rad_s: r },
            ..hover(0.0)
        },
    )
}

fn any_setpoint() -> impl Strategy<Value = Setpoint> {
    prop::array::uniform6(any_number()).prop_map(|[n, e, vn, ve, altitude_m, heading_rad]| Setpoint {
        relative_velocity_ne_m_s: Vector2::new(n, e) * VELOCITY_PER_ERROR_PER_S,
        feedforward_ne_m_s: Vector2::new(vn, ve),
        altitude_m,
        heading_rad,
    })
}

#[test]
fn in_autorotation_the_collective_stays_low_until_the_fall_is_braked() {
    let collective = |height_m: f64, sink_m_s: f64| {
        let falling = Estimate { height_m, velocity: VelocityNed::new(0.0, 0.0, sink_m_s), ..hover(0.0) };
        controller(false).autorotate(0.02, &falling, 0.0).controls.collective
    };
    assert_eq!(collective(30.0, 10.0), 0.0);
    assert_eq!(collective(3.0, 10.0), 1.0);
    // √(2 · 7 m/s² · 3 m) = 6.48 m/s.
    assert_near(collective(3.0, 42.0_f64.sqrt()), TRIM.collective);
    assert_near(collective(3.0, 42.0_f64.sqrt() - 0.1), TRIM.collective - 0.2);
    assert_eq!(collective(0.0, 0.0), TRIM.collective);
    let mut broken = controller(false);
    let unknown = Estimate { height_m: f64::NAN, ..hover(0.0) };
    assert_eq!(broken.autorotate(0.02, &unknown, 0.0).fault, Some(ControlFault::Estimate));
}

proptest! {
    #[test]
    fn pseudo_errors_keep_the_length(north in -9.0..9.0f64, east in -9.0..9.0f64, heading_rad in -9.0..9.0f64) {
        let [p, r] = pseudo_errors(Vector2::new(north, east), &HeadingFrame::new(heading_rad));
        prop_assert!((math::hypot(p, r) - math::hypot(north, east)).abs() < 1e-12);
    }

    #[test]
    fn commands_are_always_within_limits(
        steps in prop::collection::vec((any_number(), any_estimate(), any_setpoint()), 1..20),
        trim in prop::array::uniform6(any_number()),
        auto_trim: bool,
    ) {
        let [roll_stick, pitch_stick, yaw_stick, collective, roll_rad, pitch_rad] = trim;
        let trim = Trim { roll_stick, pitch_stick, yaw_stick, collective, roll_rad, pitch_rad };
        for trim in [trim, TRIM] {
            let mut controller = VehicleController::new(Rules::shipped(), trim, Gains::default(), auto_trim);
            for (dt_s, estimate, setpoint) in &steps {
                let controls = controller.step(*dt_s, estimate, setpoint).controls;
                prop_assert!(controls.is_within_limits(), "{controls:?}");
                let turning = controller.turn(*dt_s, estimate, setpoint).controls;
                prop_assert!(turning.is_within_limits() && turning.yaw == 1.0, "{turning:?}");
                let falling = controller.autorotate(*dt_s, estimate, setpoint.heading_rad).controls;
                prop_assert!(falling.is_within_limits(), "{falling:?}");
                let AutoTrim { tilt_ne_rad, collective, .. } = controller.auto_trim.unwrap_or_default();
                prop_assert!(tilt_ne_rad.amax() <= 0.15 && collective.abs() <= 0.1);
            }
        }
    }
}
