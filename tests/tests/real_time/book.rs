//! Checks of the documentation: every `console` block of the README and the book is run, links are followed, measured
//! tables are compared with `tests/golden`, and the generated pages are made again and compared.
//!
//! With `SKEIN_BOOK=long` in this test's environment it also runs the blocks of studies that take minutes.
//! `SKEIN_GOLDEN=write` in this test's environment writes what the commands print and the generated pages into the
//! files. [`markdown`] describes the markers of a chapter.

mod commands;
mod golden;
mod links;
mod markdown;
mod reference;
mod runner;
mod same;
mod threats;

use std::path::PathBuf;

/// The root of the checkout.
fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap()
}

/// The folder of the chapters, from the root.
const BOOK: &str = "deploy/book/src";

/// The program that the blocks call `skein`.
const PROGRAM: &str = env!("CARGO_BIN_EXE_skein-under-test");

/// Whether the blocks of long studies are run too.
fn is_long() -> bool {
    std::env::var("SKEIN_BOOK").is_ok_and(|what| what == "long")
}

/// Whether the files have to be written instead of compared.
fn is_writing() -> bool {
    std::env::var("SKEIN_GOLDEN").is_ok_and(|what| what == "write")
}
