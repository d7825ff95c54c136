use super::*;

fn xcell60() -> Aircraft {
    Aircraft::from_text("xcell60", Aircraft::SHIPPED[0].1).unwrap()
}

const FILES: [(&str, &str); 4] = [
    ("roll.fis", include_str!("../../../../deploy/controllers/roll.fis")),
    ("pitch.fis", include_str!("../../../../deploy/controllers/pitch.fis")),
    ("heading.fis", include_str!("../../../../deploy/controllers/heading.fis")),
    ("collective.fis", include_str!("../../../../deploy/controllers/collective.fis")),
];

/// The shipped rules with this text for one axis.
fn with(axis: usize, text: &str) -> Rules {
    let mut files = FILES;
    files[axis].1 = text;
    Rules::from_texts(files).unwrap()
}

/// Every number of the constants of a rule base times a factor.
fn scaled(text: &str, factor: f64) -> String {
    let line = |line: &str| match line.split_once("'constant',[") {
        Some((before, constant)) => {
            let constant: f64 = constant.trim_end_matches(']').parse().unwrap();
            format!("{before}'constant',[{}]\n", constant * factor)
        }
        None => line.to_string() + "\n",
    };
    text.lines().map(line).collect()
}

#[test]
fn the_shipped_rules_hover() {
    for auto_trim in [false, true] {
        let hover = hover(&xcell60(), &Rules::shipped(), auto_trim).unwrap();
        println!("{hover}");
        assert_eq!(hover.fault(), None);
        assert!(hover.place_rms_m < 0.5 && hover.altitude_rms_m < 0.3 && hover.heading_rms_deg < 1.0, "{hover:?}");
        assert!(hover.saturation == 0.0 && hover.turn_rate_deg_s < 5.0 && hover.is_airborne, "{hover:?}");
    }
}

#[test]
fn of_rules_that_cannot_fly_the_axis_is_found() {
    // A yaw command of a few thousandths, as from rules for degrees, and hardly any collective.
    for (axis, text, fault) in
        [(2, scaled(FILES[2].1, 0.005), "heading error"), (3, scaled(FILES[3].1, 0.0001), "altitude error")]
    {
        let rules = with(axis, &text);
        let each = of_each_axis(&xcell60(), &rules, false).unwrap();
        for (nth, hover) in each.iter().enumerate() {
            println!("{}: {hover}", AXES[nth]);
            assert_eq!(hover.fault().is_some(), nth == axis, "{}: {hover:?}", AXES[nth]);
        }
        assert!(each[axis].fault().unwrap().contains(fault), "{:?}", each[axis].fault());
    }
}

#[test]
fn an_aircraft_without_a_flight_model_has_no_hover() {
    let aircraft = Aircraft { helicopter: None, ..xcell60() };
    assert_eq!(hover(&aircraft, &Rules::shipped(), false), None);
}

#[test]
fn a_figure_beyond_its_limit_is_named() {
    let good = hover(&xcell60(), &Rules::shipped(), false).unwrap();
    let bad = Hover { heading_rms_deg: 103.94, turn_rate_deg_s: f64::NAN, saturation: 1.0, ..good };
    let expected = "heading error 103.9 ° (at most 10), turn rate NaN °/s (at most 30), controls at their stops 1.0 of the time (at most 0.2)";
    assert_eq!(bad.fault().as_deref(), Some(expected));
}
