//! The program that the tests start: `skein`.

use std::process::ExitCode;

fn main() -> ExitCode {
    skein::cli::main()
}
