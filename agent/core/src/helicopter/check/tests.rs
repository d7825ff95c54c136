use super::*;
use crate::helicopter::tests::xcell60;

/// The aircraft file with one number replaced, for each number, with its key within `[helicopter]`.
fn with_each_number_replaced(value: f64) -> Vec<(String, Parameters)> {
    let text = include_str!("../../../../../deploy/aircraft/xcell60.toml");
    let file: toml::Table = text.parse().unwrap();
    let helicopter = file["helicopter"].as_table().unwrap();
    let mut replaced = Vec::new();
    for (key, entry) in helicopter {
        match entry.as_table() {
            None => {
                let mut copy = helicopter.clone();
                copy[key] = value.into();
                replaced.push((key.clone(), copy.try_into().unwrap()));
            }
            Some(part) => {
                for inner in part.keys() {
                    let mut copy = helicopter.clone();
                    copy[key][inner] = value.into();
                    replaced.push((format!("{key}.{inner}"), copy.try_into().unwrap()));
                }
            }
        }
    }
    replaced
}

#[test]
fn the_shipped_parameters_are_valid() {
    assert_eq!(xcell60().check(), Ok(()));
}

fn refused_key(parameters: &Parameters) -> String {
    match parameters.check() {
        Err(ParameterError::Value { key, .. }) => key,
        other => panic!("{other:?}"),
    }
}

#[test]
fn every_number_is_checked_and_named() {
    let replaced = with_each_number_replaced(f64::NAN);
    assert_eq!(replaced.len(), xcell60().rules().len());
    for bad in [f64::NAN, f64::INFINITY] {
        for (key, parameters) in with_each_number_replaced(bad) {
            assert_eq!(refused_key(&parameters), key, "{bad}");
        }
    }
}

#[test]
fn signs_lags_and_order_are_checked() {
    let refused = |change: fn(&mut Parameters)| {
        let mut parameters = xcell60();
        change(&mut parameters);
        refused_key(&parameters)
    };
    assert_eq!(refused(|p| p.mass_kg = 0.0), "mass_kg");
    assert_eq!(refused(|p| p.fin.area_m2 = -0.01), "fin.area_m2");
    assert_eq!(refused(|p| p.tail_rotor.inflow_lag_s = 0.001), "tail_rotor.inflow_lag_s");
    assert_eq!(refused(|p| p.tail.max_pitch_rad = -0.3), "tail.max_pitch_rad");
    assert_eq!(refused(|p| p.servos.max_collective_rad = -0.1), "servos.max_collective_rad");
}

#[test]
fn parameters_that_cannot_hover_are_refused() {
    for change in [
        (|p: &mut Parameters| p.mass_kg = 20.0) as fn(&mut Parameters),
        |p| p.engine.max_power_w = 1_100.0,
        |p| p.tail.max_pitch_rad = 0.2,
        |p| p.fin.area_m2 = 1.0,
        |p| p.fuselage.vertical_area_m2 = 10.0,
        |p| p.tail.arm_m = 1e-3,
    ] {
        let mut parameters = xcell60();
        change(&mut parameters);
        assert_eq!(parameters.check(), Err(ParameterError::CannotHover), "{parameters:?}");
    }
}

#[test]
fn an_unknown_key_is_refused_by_name() {
    let text = include_str!("../../../../../deploy/aircraft/xcell60.toml");
    let mut file: toml::Table = text.parse().unwrap();
    file["helicopter"]["fin"].as_table_mut().unwrap().insert("area_cm2".into(), 120.0.into());
    let error = file["helicopter"].clone().try_into::<Parameters>().unwrap_err();
    assert!(error.to_string().contains("area_cm2"), "{error}");
}

#[test]
fn an_error_names_key_value_and_rule() {
    let error = ParameterError::Value { key: "mass_kg".to_owned(), value: -1.0, rule: "finite and greater than 0" };
    assert_eq!(error.to_string(), "`helicopter.mass_kg` is -1, but has to be finite and greater than 0");
}
