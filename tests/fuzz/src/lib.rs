//! Runs a check of something that reads bytes of others on very many inputs.
//!
//! `cargo test` damages valid examples at random. Built with the feature `guided` by `cargo bolero`, the same test starts from the
//! same examples and looks for inputs that reach code which no input has reached before.

#[cfg(not(feature = "guided"))]
mod damage;

#[cfg(feature = "guided")]
use std::ops::Deref;
#[cfg(feature = "guided")]
use std::panic::AssertUnwindSafe;

#[cfg(not(feature = "guided"))]
use proptest::test_runner::{Config, TestError, TestRunner};

/// Numbers that are often treated wrongly.
pub const NUMBERS: [f64; 8] =
    [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -0.0, f64::MAX, f64::MIN_POSITIVE, 1e9, -1.0];

/// Checks each example, and as many damaged ones as CI has time for. Without examples every input is noise. The environment
/// variable `SKEIN_FUZZ` multiplies the number of inputs.
///
/// # Panics
/// If the check panics; the message shows the smallest input that is found to do so.
#[cfg(not(feature = "guided"))]
pub fn explore(inputs_in_ci: u32, examples: &[Vec<u8>], check: impl Fn(&[u8])) {
    let times = std::env::var("SKEIN_FUZZ").map_or(1, |times| times.parse().expect("SKEIN_FUZZ is a whole number"));
    let config = Config { cases: inputs_in_ci * times, failure_persistence: None, ..Config::default() };
    examples.iter().for_each(|example| check(example));
    let ran = TestRunner::new(config).run(&damage::inputs(examples), |input| {
        check(&input);
        Ok(())
    });
    match ran {
        Err(TestError::Fail(why, input)) => {
            panic!("{why}\nsmallest input: {input:?}\nas text: {:?}", String::from_utf8_lossy(&input))
        }
        ran => ran.unwrap_or_else(|error| panic!("{error}")),
    }
}

/// Writes the examples into the fuzzer's corpus, and checks the inputs that it makes of them until its time is up.
#[cfg(feature = "guided")]
pub fn explore(_inputs_in_ci: u32, examples: &[Vec<u8>], check: impl Fn(&[u8])) {
    // The test harness names a test's thread after the test.
    let current = std::thread::current();
    let name = current.name().unwrap_or("unknown");
    let item_path = Box::leak(format!("fuzz::{name}::__bolero_item_path__").into_boxed_str());
    let location = bolero::TargetLocation {
        package_name: env!("CARGO_PKG_NAME"),
        manifest_dir: env!("CARGO_MANIFEST_DIR"),
        module_path: module_path!(),
        file: concat!(env!("CARGO_MANIFEST_DIR"), "/targets/main.rs"),
        line: 0,
        item_path,
        test_name: None,
    };
    let corpus = location.work_dir().expect("the sources are there").join("corpus");
    std::fs::create_dir_all(&corpus).expect("the corpus can be written");
    // Where there are no examples, noise is long enough for many steps from the beginning.
    let noise = || {
        let mut state = 1_u32;
        std::iter::repeat_with(move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            state.to_be_bytes()[0]
        })
    };
    let noise: Vec<Vec<u8>> = [100, 500, 2_000, 8_000].map(|length| noise().take(length).collect()).into();
    for (nth, example) in if examples.is_empty() { &noise } else { examples }.iter().enumerate() {
        std::fs::write(corpus.join(format!("example-{nth}")), example).expect("the corpus can be written");
    }
    if location.should_run() {
        let check = AssertUnwindSafe(check);
        bolero::test(location).for_each(move |input: &[u8]| Deref::deref(&check)(input));
    }
}

/// The same for a reader of text.
pub fn explore_text(inputs_in_ci: u32, examples: &[&str], check: impl Fn(&str)) {
    let examples: Vec<_> = examples.iter().map(|example| example.as_bytes().to_vec()).collect();
    explore(inputs_in_ci, &examples, |bytes| check(&String::from_utf8_lossy(bytes)));
}
