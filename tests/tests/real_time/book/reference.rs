//! Generated pages of the reference: made again from the source, and compared with the files.

mod commands;
mod figures;
mod keys;
mod messages;
mod source;
mod vectors;

use std::fs;

use crate::book::{BOOK, is_writing, root};

/// The command that writes the pages.
const WRITES: &str = "SKEIN_GOLDEN=write cargo test --release -p skein-tests --test real_time book::reference";

/// The text of a page: title, purpose, a comment about its source, then the rest.
fn page(title: &str, purpose: &str, from: &str, body: &str) -> String {
    format!(
        "# {title}\n\n{purpose}\n\n<!-- Made from {from} by `{WRITES}`: change that instead. -->\n\n{}\n",
        body.trim()
    )
}

/// A row of a table.
fn row(cells: &[&str]) -> String {
    let cells: Vec<_> = cells.iter().map(|cell| cell.replace('|', "\\|").replace('<', "&lt;")).collect();
    format!("| {} |\n", cells.join(" | "))
}

/// The head of a table.
fn head(cells: &[&str]) -> String {
    format!("{}{}", row(cells), row(&vec!["---"; cells.len()]))
}

/// Compares a page with its file, or writes it into the file.
fn compare(name: &str, made: &str) {
    let path = root().join(BOOK).join("reference").join(name);
    if is_writing() {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, made).unwrap();
    }
    let there = fs::read_to_string(&path).unwrap_or_default().replace('\r', "");
    for (nth, (there, made)) in there.lines().zip(made.lines()).enumerate() {
        assert_eq!(there, made, "{}:{}; to write it again: {WRITES}", path.display(), nth + 1);
    }
    assert_eq!(there.len(), made.len(), "{}; to write it again: {WRITES}", path.display());
}

#[test]
fn the_reference_has_every_command() {
    compare("commands.md", &commands::page());
}

#[test]
fn the_reference_has_every_key() {
    compare("keys.md", &keys::page());
}

#[test]
fn the_reference_has_every_figure() {
    compare("figures.md", &figures::page());
}

#[test]
fn the_reference_has_every_message() {
    compare("messages.md", &messages::page());
}

#[test]
fn the_reference_has_every_value_of_the_vectors() {
    compare("vectors.md", &vectors::page());
}
