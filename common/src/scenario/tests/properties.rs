//! Properties of the loader for any text and any value.

use proptest::prelude::*;
use proptest::sample::{Index, select};
use proptest::strategy::ValueTree;

use super::*;
use crate::math;

/// A value of this kind as `--set` takes it, inside its range.
fn value(kind: Kind) -> BoxedStrategy<String> {
    let number = |range: Range| {
        let inside = move |share: f64| {
            (range.min + (range.max - range.min) * math::square(math::square(share))).clamp(range.min, range.max)
        };
        (1e-3..=1.0).prop_map(move |share| format!("{:?}", inside(share)))
    };
    match kind {
        Kind::Number(range) => number(range).boxed(),
        Kind::NumberOr(choice, range) => prop_oneof![number(range), Just(choice.to_owned())].boxed(),
        Kind::Integer(min, max) => (min..=max).prop_map(|number| number.to_string()).boxed(),
        Kind::Bool => any::<bool>().prop_map(|truth| truth.to_string()).boxed(),
        Kind::True => Just("true".to_owned()).boxed(),
        Kind::Law => select(law::NAMES).prop_map(str::to_owned).boxed(),
        Kind::OneOf(choices) => select(choices).prop_map(str::to_owned).boxed(),
        Kind::Name => "[A-Za-z][A-Za-z0-9_-]{0,20}".boxed(),
        Kind::TomlName => "[A-Za-z][A-Za-z0-9_-]{0,20}(\\.toml)?".boxed(),
        Kind::Text => "[a-zé'\"\\\\/ ]{1,10}x".prop_map(|text| format!("{}", toml::Value::String(text))).boxed(),
        Kind::Address(prefix) => (1..=65285u16).prop_map(move |port| format!("{prefix}10.0.0.1:{port}")).boxed(),
        Kind::Texts => Just("['python3', 'my \"law\".py']".to_owned()).boxed(),
        Kind::Id => Just("1".to_owned()).boxed(),
        Kind::Ids => Just("[1, 2]".to_owned()).boxed(),
        Kind::Edges => Just("[[1, 2], [2, 1]]".to_owned()).boxed(),
        Kind::Point => (-500..500i32, -5e2..5e2).prop_map(|(north, east)| format!("[{north}, {east:?}]")).boxed(),
        Kind::Points | Kind::Path => Just("[[0, 0], [3, 4]]".to_owned()).boxed(),
        Kind::Tables => steps().boxed(),
        Kind::Free => Just("{ gain = 0.3, 'a b' = [1, { c = \"\"\"x\ny\"\"\" }], t = true }".to_owned()).boxed(),
    }
}

/// Steps; events come from the shipped tour, links from [`links`].
fn steps() -> impl Strategy<Value = String> {
    let step = select(vec![
        "{ hold_s = 3 }",
        "{ centre_ne_m = [1, 2], dwell_s = 7, name = \"x # y\" }",
        "{ path_ne_m = [[0, 0], [3, 4]], speed_m_s = 1, formation = { law = 'flock' } }",
        "{ centre_ne_m = [1, 2], formation = { law = 'ring', heading_deg = 9 } }",
    ]);
    prop::collection::vec(step, 1..4).prop_map(|steps| format!("[{}]", steps.join(", ")))
}

/// Entries of `network.links`.
fn links() -> impl Strategy<Value = String> {
    let link = select(vec![
        "{ from = [1], loss = 0.5 }",
        "{ to = [2, 1], both_ways = true, delay_s = 1, jitter_s = 2.5 }",
        "{ from = [2], to = [1], bandwidth_bit_s = 9600, queue_s = 1, burst_s = 3 }",
    ]);
    prop::collection::vec(link, 0..4).prop_map(|links| format!("[{}]", links.join(", ")))
}

/// `--set` options of any keys, each valid on its own.
fn sets() -> impl Strategy<Value = Vec<String>> {
    let keys = KEYS.iter().filter(|key| {
        let lists = ["vehicle.N", "mission.events", "mission.steps[", "network.links[", "airspace.obstacles["];
        let later = lists.iter().any(|prefix| key.path.starts_with(prefix));
        // Most values of these keys contradict other values.
        !later && key.path != "swarm.vehicles" && !key.path.contains("udp")
    });
    let of = |key: &Key| match key.path {
        "network.links" => links().boxed(),
        "airspace.obstacles" => Just("[{ centre_ne_m = [1, 900], radius_m = 3 }]".to_owned()).boxed(),
        "airspace.fence_ne_m" => Just("[[0, 0], [900, 0], [0, 900]]".to_owned()).boxed(),
        _ => value(key.kind),
    };
    let vehicle = KEYS
        .iter()
        .filter(|key| key.path.starts_with("vehicle.N"))
        .map(|key| (Just(key.path.replace('N', "2")), value(key.kind)).boxed());
    let all: Vec<_> = keys.map(|key| (Just(key.path.to_owned()), of(key)).boxed()).chain(vehicle).collect();
    prop::collection::vec(select(all).prop_flat_map(|set| set), 0..6)
        .prop_map(|sets| sets.into_iter().map(|(path, value)| format!("{path}={value}")).collect())
}

/// Checks that every value is in the range of the table.
fn assert_in_range(loaded: &Loaded) -> Result<(), TestCaseError> {
    for line in loaded.explain() {
        let Some(key) = KEYS.iter().find(|key| key.path == line.key) else { continue };
        let number = line.value.as_ref().and_then(|value| value.parse::<f64>().ok());
        match (key.kind, number) {
            (Kind::Number(range), number) => {
                prop_assert!(number.is_some_and(|number| range.contains(number)), "{line:?}")
            }
            (Kind::NumberOr(_, range), Some(number)) => prop_assert!(range.contains(number), "{line:?}"),
            (Kind::Integer(min, max), Some(number)) => prop_assert!((min as f64..=max as f64).contains(&number)),
            _ => {}
        }
    }
    Ok(())
}

/// Checks that reading the complete file gives the same scenario.
fn assert_reads_back(loaded: &Loaded) -> Result<(), TestCaseError> {
    let complete = loaded.to_toml();
    let again = try_load("complete.toml", &complete, &[]);
    let again = again.map_err(|error| TestCaseError::fail(format!("{error}\n{complete}")))?;
    prop_assert_eq!(&again.scenario, &loaded.scenario, "{}", complete);
    prop_assert_eq!(again.scenario.plan_hash(), loaded.scenario.plan_hash());
    let values = |loaded: &Loaded| loaded.explain().iter().map(|line| line.value.clone()).collect::<Vec<_>>();
    prop_assert_eq!(values(&again), values(loaded));
    Ok(())
}

/// Checks that a refusal has a position, and that an accepted file is in range and reads back.
fn assert_sane(text: &str, sets: &[String]) -> Result<bool, TestCaseError> {
    match load(&Source { name: "a.toml", text }, sets) {
        Ok(loaded) => {
            assert_in_range(&loaded)?;
            assert_reads_back(&loaded)?;
            Ok(true)
        }
        Err(error) => {
            prop_assert!(!error.message.is_empty());
            prop_assert!(!error.to_string().contains('\n'), "{error}");
            if error.file.starts_with("--set ") {
                prop_assert!(error.line.is_none());
            } else {
                prop_assert!(error.line.is_some_and(|line| line <= text.matches('\n').count() + 1), "{error}");
                prop_assert!(error.column.is_some() && error.span.is_some());
            }
            Ok(false)
        }
    }
}

#[test]
fn shipped_scenarios_read_back() {
    for (name, text) in SHIPPED {
        for sets in [&[][..], &["preset=paper".to_owned()]] {
            let loaded = load(&Source { name, text }, sets).unwrap();
            assert_reads_back(&loaded).unwrap();
            assert_in_range(&loaded).unwrap();
        }
    }
}

/// Checks that most valid options are accepted: otherwise the property below would show nothing.
#[test]
fn valid_sets_are_mostly_accepted() {
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let accepted = (0..300).filter(|_| {
        let sets = sets().new_tree(&mut runner).unwrap().current();
        load(&Source { name: "a.toml", text: HOVER }, &sets).is_ok()
    });
    let accepted = accepted.count();
    assert!(accepted > 150, "{accepted} of 300");
}

proptest! {
    #[test]
    fn valid_sets_read_back(sets in sets(), shipped in select(&SHIPPED[..])) {
        assert_sane(shipped.1, &sets)?;
    }

    #[test]
    fn any_text_is_read_or_refused(text in any::<String>(), set in any::<String>()) {
        assert_sane(&text, &[])?;
        assert_sane(HOVER, &[set])?;
    }

    #[test]
    fn any_bytes_that_are_text_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        assert_sane(&String::from_utf8_lossy(&bytes), &[])?;
    }

    #[test]
    fn toml_tokens_in_any_order_are_read_or_refused(tokens in prop::collection::vec(select(TOKENS), 0..30)) {
        assert_sane(&tokens.concat(), &[])?;
        assert_sane(&format!("swarm.vehicles = 4\n{}", tokens.concat()), &[])?;
    }

    #[test]
    fn a_set_option_of_any_tokens_is_read_or_refused(tokens in prop::collection::vec(select(TOKENS), 1..8), key in select(KEYS)) {
        let path = key.path.replace("[N]", "[0]").replace('N', "3");
        assert_sane(SHIPPED[2].1, &[format!("{path}={}", tokens.concat()), tokens.concat()])?;
    }

    #[test]
    fn a_shipped_scenario_with_random_edits_is_read_or_refused(
        shipped in select(&SHIPPED[..]),
        edits in prop::collection::vec((any::<Index>(), any::<Index>(), select(TOKENS)), 1..4),
    ) {
        let mut text: Vec<char> = shipped.1.chars().collect();
        for (start, length, token) in edits {
            let start = start.index(text.len());
            let end = (start + length.index(6)).min(text.len());
            text.splice(start..end, token.chars());
        }
        assert_sane(&text.into_iter().collect::<String>(), &[])?;
    }
}

/// Tokens of scenario files, and characters that may break the parser.
const TOKENS: &[&str] = &[
    "",
    " ",
    "\n",
    "\r\n",
    "=",
    " = ",
    ".",
    ",",
    "[",
    "]",
    "[[",
    "]]",
    "{",
    "}",
    "\"",
    "'",
    "'''",
    "#",
    "-",
    "_",
    "0",
    "1",
    "7",
    "-1",
    "1e9",
    "1e-9",
    "1e400",
    "0x10",
    "nan",
    "inf",
    "-inf",
    "-0.0",
    "true",
    "false",
    "1979-05-27",
    "\u{feff}",
    "\0",
    "ä",
    "\\",
    "swarm",
    "vehicles",
    "formation",
    "radius_m",
    "mission",
    "steps",
    "events",
    "external",
    "parameters",
    "vehicle",
    "vehicle.3",
    "land = true",
    "hold_s = 1",
    "path_ne_m",
    "[[0, 0], [1, 1]]",
    "fault = 'kill'",
    "order = 'goto'",
    "at_s",
    "law = 'flock'",
    "[swarm]\nvehicles = 4\n",
    "[formation]\n",
    "[mission]\n",
    "preset = 'paper'\n",
    "\nradius_m = 50\n",
    "99999999999999999999",
];
