//! The book's page about a new plant, checked against the places where the source decides by the kind of plant.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use super::house::{code_of, root};

/// The Rust sources below this folder, without tests.
fn files(folder: &Path, found: &mut Vec<PathBuf>) {
    for path in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        let name = path.file_stem().unwrap().to_str().unwrap();
        match path.extension().and_then(|extension| extension.to_str()) {
            None if path.is_dir() && !["tests", "target"].contains(&name) => files(&path, found),
            Some("rs") if name != "tests" => found.push(path),
            _ => {}
        }
    }
}

/// Whether this code has an arm of a `match` for one kind of plant. A comparison with one kind does not count.
fn decides_by_kind(code: &str) -> bool {
    code.match_indices("PlantKind::").any(|(at, found)| {
        let name = |letter: char| letter.is_alphanumeric() || letter == '_';
        let (before, rest) = (code[..at].trim_end(), &code[at + found.len()..]);
        let is_variant = rest.starts_with(char::is_uppercase) && !rest.starts_with("NAMES");
        let after = rest.trim_start_matches(name).trim_start_matches(')').trim_start();
        let is_arm = after.starts_with("=>") || after.starts_with("| ");
        is_variant && is_arm && !before.ends_with('=')
    })
}

#[test]
fn a_new_plant_changes_the_files_that_the_book_names_and_no_others() {
    let root = root().canonicalize().unwrap();
    let mut sources = Vec::new();
    ["common", "agent", "deploy"].iter().for_each(|folder| files(&root.join(folder), &mut sources));
    let decide: BTreeSet<_> = sources
        .iter()
        .filter(|path| decides_by_kind(&code_of(&fs::read_to_string(path).unwrap())))
        .map(|path| path.strip_prefix(&root).unwrap().to_str().unwrap().to_owned())
        .collect();
    assert_eq!(decide, BTreeSet::from(["agent/src/plant.rs".to_owned()]), "a `PlantSpec` says what differs elsewhere");
    let page = fs::read_to_string(root.join("deploy/book/src/extend.md")).unwrap();
    let steps = page.split("\n## ").find(|section| section.starts_with("Add a plant")).unwrap();
    let steps = steps.split("Then the tests and papers").next().unwrap();
    for file in ["agent/src/plant.rs", "common/src/scenario/model/plant.rs"] {
        assert!(steps.contains(&format!("](../../../{file})")), "the page does not name {file}");
    }
    assert!(
        decides_by_kind("match kind { PlantKind::Kite => 1 }") && decides_by_kind("PlantKind::Kite | PlantKind::X")
    );
    assert!(
        !decides_by_kind("(Some(kind), _) if kind != PlantKind::Kite => {}") && !decides_by_kind("PlantKind::NAMES")
    );
}
