//! Flies the default scenario for a second in virtual time and prints a figure. It draws nothing: the test of repeatability
//! looks at what a flight and its figures take from the C library.

fn main() {
    match skein_tests::study("hover.toml", &["duration_s=1"]).fly(0) {
        Ok(report) => println!("{}", report.duration_s),
        Err(error) => eprintln!("{error}"),
    }
}
