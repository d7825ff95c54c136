//! What of a rule base is compared with its axis.

use super::*;

const FILES: [(&str, &str); 4] = [
    ("roll.fis", include_str!("../../../../../deploy/controllers/roll.fis")),
    ("pitch.fis", include_str!("../../../../../deploy/controllers/pitch.fis")),
    ("heading.fis", include_str!("../../../../../deploy/controllers/heading.fis")),
    ("collective.fis", include_str!("../../../../../deploy/controllers/collective.fis")),
];
const HEADING: usize = 2;
const COLLECTIVE: usize = 3;

/// The warnings of the shipped rules with another text for one axis, or why it is refused.
fn with(axis: usize, text: &str) -> Result<Vec<String>, String> {
    let mut files = FILES;
    files[axis].1 = text;
    let rules = Rules::from_texts(files).map_err(|error| error.to_string())?;
    Ok(rules.warnings.iter().map(ToString::to_string).collect())
}

fn changed(axis: usize, changes: &[(&str, &str)]) -> Result<Vec<String>, String> {
    let changed = |text: String, (from, to): &(&str, &str)| {
        assert!(text.contains(from), "{from}");
        text.replace(from, to)
    };
    with(axis, &changes.iter().fold(FILES[axis].1.to_owned(), changed))
}

#[track_caller]
fn refused(result: Result<Vec<String>, String>, expected: &str) {
    let why = result.expect_err("it is refused");
    assert!(why.contains(expected), "{why}");
}

#[track_caller]
fn warned(result: Result<Vec<String>, String>, expected: &str) {
    let warnings = result.expect("a warning at most");
    assert!(warnings.len() == 1 && warnings[0].contains(expected), "{warnings:?}");
}

#[test]
fn the_shipped_rules_have_no_warnings() {
    assert_eq!(with(HEADING, FILES[HEADING].1), Ok(Vec::new()));
    assert!(Rules::shipped().warnings.is_empty());
}

#[test]
fn a_rule_base_of_another_axis_is_refused_or_can_serve_both() {
    refused(with(COLLECTIVE, FILES[HEADING].1), "collective.fis:15:6: by its inputs this is the rule base of heading");
    refused(with(HEADING, FILES[COLLECTIVE].1), "heading.fis:15:6: by its inputs this is the rule base of collective");
    refused(with(HEADING, FILES[0].1), "heading.fis:15:6: this controller has 2 inputs, not 3");
    refused(with(0, FILES[HEADING].1), "roll.fis:15:6: this controller has 3 inputs, not 2");
    warned(with(1, FILES[0].1), "pitch.fis:15:6: by its inputs this is the rule base of roll");
}

#[test]
fn a_rule_base_of_the_right_job_with_other_names_gets_a_warning() {
    let other = [("heading_error_rad", "e"), ("yaw_rate_rad_s", "r"), ("'stick'", "'u'")];
    warned(
        changed(HEADING, &other),
        "heading.fis:15:6: the inputs are called e, r; the controller gives the heading error (rad)",
    );
    let short = [("heading_error_rad", "Heading-Error"), ("yaw_rate_rad_s", "yaw rate")];
    assert_eq!(changed(HEADING, &short), Ok(Vec::new()), "the same name without its unit");
}

#[test]
fn exchanged_inputs_and_signs_are_refused() {
    let named = [("heading_error_rad", "x"), ("yaw_rate_rad_s", "heading_error_rad"), ("'x'", "'yaw_rate_rad_s'")];
    refused(changed(HEADING, &named), "heading.fis:15:6: the inputs are in another order");
    // Without names the response gives it away: every rule with its two sets exchanged.
    let three = "[System]\nType='sugeno'\nAndMethod='prod'\nDefuzzMethod='wtaver'\n\
                 [Input1]\nName='a'\nRange=[-2 2]\nMF1='n':'linzmf',[-1 1]\nMF2='p':'linsmf',[-1 1]\n\
                 [Input2]\nName='b'\nRange=[-2 2]\nMF1='n':'linzmf',[-1 1]\nMF2='p':'linsmf',[-1 1]\n\
                 [Output1]\nMF1='u':'linear',[SLOPES 0]\n[Rules]\n1 0, 1 (1) : 1\n2 0, 1 (1) : 1\n";
    refused(
        with(HEADING, &three.replace("SLOPES", "-0.2 0.7")),
        "heading.fis:6:6: the command falls as input 1, the heading error, rises",
    );
    refused(
        with(HEADING, &three.replace("SLOPES", "0.7 0.2")),
        "heading.fis:11:6: the command rises as input 2, the yaw rate, rises",
    );
    refused(with(HEADING, &three.replace("SLOPES", "0 -0.2")), "the command does not depend on input 1");
    let warnings = with(HEADING, &three.replace("SLOPES", "0.4 0")).unwrap();
    assert!(warnings.iter().any(|warning| warning.contains("nothing damps it")), "{warnings:?}");
    warned(with(HEADING, &three.replace("SLOPES", "0.4 -0.1")), "the inputs are called a, b");
}

#[test]
fn other_units_and_sizes_are_refused_or_get_a_warning() {
    let degrees =
        [("heading_error_rad", "heading_error_deg"), ("Range=[-2 2]\nNumMFs=5", "Range=[-180 180]\nNumMFs=5")];
    refused(changed(HEADING, &degrees), "heading.fis:15:6: 'heading_error_deg' is named in another unit (deg)");
    let only_named = [("heading_error_rad", "heading_error_deg")];
    let warnings = changed(HEADING, &only_named).unwrap();
    assert!(warnings.iter().any(|warning| warning.contains("in another unit")), "{warnings:?}");
    let large = [("Range=[-2 2]\nNumMFs=5", "Range=[-180 180]\nNumMFs=5")];
    warned(changed(HEADING, &large), "heading.fis:16:7: Range=[-180 180] is of an unusual size");
    let one_sided = [("Range=[-15 15]", "Range=[0 15]")];
    refused(changed(COLLECTIVE, &one_sided), "collective.fis:16:7: Range=[0 15] has one sign only");
    let hundreds = [("'constant',[0.6]", "'constant',[600]"), ("'constant',[-0.6]", "'constant',[-600]")];
    refused(changed(HEADING, &hundreds), "heading.fis:33:6: the output reaches 600");
    let beyond = [("'constant',[0.9]", "'constant',[1.5]"), ("'constant',[-0.9]", "'constant',[-1.5]")];
    warned(changed(HEADING, &beyond), "heading.fis:33:6: the output reaches 1.5000; the heading control ends at 1");
}
