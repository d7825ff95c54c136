//! What other programs and files give to the control loop: replies of external laws, and fuzzy rules.

use skein_core::control::Sugeno;
use skein_core::formation::external::{LawReply, ReplyCommand};
use skein_fuzz::{NUMBERS, explore, explore_text};
use skein_host::external::protocol::{self, MessageFromLaw};
use skein_host::external::vector;

const RULES: [(&str, &str); 4] = [
    ("roll.fis", include_str!("../../../deploy/controllers/roll.fis")),
    ("pitch.fis", include_str!("../../../deploy/controllers/pitch.fis")),
    ("heading.fis", include_str!("../../../deploy/controllers/heading.fis")),
    ("collective.fis", include_str!("../../../deploy/controllers/collective.fis")),
];

fn assert_finite(reply: &LawReply) {
    let is_finite = match &reply.command {
        ReplyCommand::VelocityNed(velocity) => velocity.iter().all(|part| part.is_finite()),
        ReplyCommand::FieldNe(field) => field.iter().all(|part| part.is_finite()),
    };
    let heading_and_log = reply.heading_rad.iter().chain(reply.log.iter().map(|number| &number.value));
    assert!(is_finite && heading_and_log.clone().all(|number| number.is_finite()), "{reply:?}");
}

#[test]
fn a_line_of_a_law_is_refused_or_a_reply_with_finite_numbers() {
    let examples = [
        r#"{"say":"ready","protocol":1}"#,
        r#"{"say":"answer","vehicle":1,"tick":2,"velocity_ned_m_s":[1.0,-2.5,0]}"#,
        r#"{"say":"answer","vehicle":250,"tick":18446744073709551615,"field_ne":[1e3,2],"heading_rad":1.5,"reached":true}"#,
        r#"{"say":"answer","vehicle":1,"tick":2,"field_ne":[0,0],"log":{"error_m":1.5,"x":-1}}"#,
    ];
    explore_text(20_000, &examples, |line| {
        if let Ok(MessageFromLaw::LawReply(reply)) = protocol::read(line.as_bytes()) {
            assert_finite(&reply);
        }
    });
}

#[test]
fn a_vector_of_a_law_is_refused_or_a_reply_with_finite_numbers() {
    let reply = |kind: f64| [1.0, 3.0, 7.0, kind, 1.0, 2.0, 3.0, 0.5, 1.0].map(f64::to_le_bytes).concat();
    let examples = vec![reply(1.0), reply(2.0), vec![0xff; 72]];
    assert!(vector::read(&examples[0]).is_ok(), "the example is a reply");
    explore(20_000, &examples, |datagram| {
        if let Ok(reply) = vector::read(datagram) {
            assert_finite(&reply);
        }
    });
}

#[test]
fn rules_are_refused_or_give_finite_controls_for_every_finite_input() {
    for (file, text) in RULES {
        assert!(Sugeno::parse(file, text).is_ok(), "{file}");
    }
    // Usual and odd values at every place among the inputs.
    let values = [0.0, 0.4, -3.0, 80.0, 1e-7].into_iter().chain(NUMBERS);
    let values: Vec<f64> = values.collect();
    // Every form of Sugeno systems, besides the tables of the shipped rules.
    let examples = [
        include_str!("../../golden/sugeno/mixed-probor-wtaver.fis"),
        include_str!("../../golden/sugeno/mixed-max-wtaver.fis"),
        include_str!("../../golden/sugeno/linear-min-wtsum.fis"),
        include_str!("../../golden/sugeno/pimf.fis"),
        include_str!("../../golden/sugeno/dsigmf.fis"),
    ];
    let examples: Vec<&str> = RULES.iter().map(|(_, text)| *text).chain(examples).collect();
    explore_text(1_500, &examples, |text| {
        let Ok(rules) = Sugeno::parse("damaged.fis", text) else { return };
        for first in 0..values.len() {
            let inputs: Vec<f64> = values.iter().cycle().skip(first).step_by(3).copied().take(rules.inputs()).collect();
            let output = rules.evaluate(&inputs);
            let is_finite = inputs.iter().all(|input| input.is_finite());
            assert_eq!(output.is_some(), is_finite, "covered for {inputs:?}");
            assert!(output.is_none_or(f64::is_finite), "{output:?} for {inputs:?}");
        }
    });
}
