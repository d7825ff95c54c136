//! Hands a check to the fuzzer.

use std::ops::Deref;
use std::panic::AssertUnwindSafe;
use std::{fs, iter, thread};

/// Writes the examples into the fuzzer's corpus, and checks the inputs that it makes of them until its time is up.
pub fn explore(_inputs_in_ci: u32, examples: &[Vec<u8>], check: impl Fn(&[u8])) {
    // The test harness names a test's thread after the test.
    let current = thread::current();
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
    fs::create_dir_all(&corpus).expect("the corpus can be written");
    // Where there are no examples, noise is long enough for many steps from the beginning.
    let noise = [100, 500, 2_000, 8_000].map(|length| noise().take(length).collect());
    for (nth, example) in if examples.is_empty() { &noise } else { examples }.iter().enumerate() {
        fs::write(corpus.join(format!("example-{nth}")), example).expect("the corpus can be written");
    }
    if location.should_run() {
        let check = AssertUnwindSafe(check);
        bolero::test(location).for_each(move |input: &[u8]| Deref::deref(&check)(input));
    }
}

/// Pseudorandom bytes, always the same.
fn noise() -> impl Iterator<Item = u8> {
    let mut state = 1_u32;
    iter::repeat_with(move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        state.to_be_bytes()[0]
    })
}
