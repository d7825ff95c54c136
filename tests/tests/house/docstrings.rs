//! A rule for the docstrings of items and modules: their beginning says what is returned, held or done. `Whether` is allowed: it
//! is the usual beginning for a bool.

use std::fs;
use std::path::{Path, PathBuf};

/// Beginnings of a question or half a sentence.
const REFUSED: [&str; 9] = ["What", "Which", "Of", "As", "How", "Where", "Why", "When", "Who"];
/// Marks of the docstrings of items and of modules.
const MARKS: [&str; 2] = ["///", "//!"];

/// Collects the Rust sources below a folder, without tests and build results.
fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        if path.is_dir() && !["target", "tests", "node_modules"].contains(&name) {
            sources(&path, found);
        } else if name.ends_with(".rs") && !name.starts_with("tests") {
            found.push(path);
        }
    }
}

/// The first lines of docstrings, with their line numbers, that begin in a refused way.
fn refused(source: &str) -> Vec<(usize, &str)> {
    let mut found = Vec::new();
    let mut before = None;
    for (nth, line) in source.lines().enumerate() {
        let line = line.trim_start();
        let mark = MARKS.into_iter().find(|mark| line.starts_with(mark));
        let text = mark.map_or("", |mark| line[mark.len()..].trim_start());
        let first = text.split(|letter: char| !letter.is_alphanumeric()).next().unwrap_or_default();
        if mark.is_some() && mark != before && REFUSED.contains(&first) {
            found.push((nth + 1, line));
        }
        before = mark;
    }
    found
}

#[test]
fn docstrings_begin_with_a_verb_or_a_noun_phrase() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut paths = Vec::new();
    for folder in ["common", "agent", "deploy"] {
        sources(&root.join(folder), &mut paths);
    }
    assert!(paths.len() > 400, "{} sources", paths.len());
    paths.sort();
    let mut wrong = Vec::new();
    for path in &paths {
        let source = fs::read_to_string(path).unwrap();
        wrong.extend(refused(&source).iter().map(|(nth, line)| format!("{}:{nth}: {line}", path.display())));
    }
    assert!(wrong.is_empty(), "{} docstrings begin a question or half a sentence:\n{}", wrong.len(), wrong.join("\n"));

    let source =
        "/// What it does.\n/// Which is this.\nfn f() {}\n/// Assigns.\n    /// As below.\n\n    /// As above.\n";
    assert_eq!(refused(source), [(1, "/// What it does."), (7, "/// As above.")]);
    let source =
        "//! How it flies.\n//! When it lands.\n\n/// Whether it flies.\nfn f() {}\n    /// Why not.\n// Where.\n";
    assert_eq!(refused(source), [(1, "//! How it flies."), (6, "/// Why not.")]);
}
