//! Every line of the table of threats names the tests that show it, and these tests exist.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use crate::book::markdown::Page;
use crate::book::{BOOK, root};

/// The names of all tests below this folder.
fn collect_tests(folder: &Path, names: &mut BTreeSet<String>) {
    for path in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        if path.is_dir() && !path.ends_with("target") {
            collect_tests(&path, names);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            names.extend(tests_in(&fs::read_to_string(&path).unwrap()));
        }
    }
}

/// The names of the tests in a source.
fn tests_in(source: &str) -> Vec<String> {
    let after_mark = source.split("#[test]").skip(1);
    after_mark.filter_map(|rest| Some(rest.split_once("fn ")?.1.split_once('(')?.0.to_owned())).collect()
}

/// The rows of the table of threats: the threat, and the cell with its tests.
fn rows(page: &str) -> Vec<(String, String)> {
    let table = page.split("\n## Threats\n").nth(1).unwrap_or_default().lines();
    let rows = table.skip_while(|line| !line.starts_with("| ---")).skip(1).take_while(|line| line.starts_with('|'));
    let cells = rows.map(|row| row.trim_matches('|').split(" | ").map(str::trim).collect::<Vec<_>>());
    cells.map(|cells| (cells[0].to_owned(), cells[cells.len() - 1].to_owned())).collect()
}

/// What is wrong with the tests of a threat.
fn fault(cell: &str, tests: &BTreeSet<String>) -> Option<String> {
    let named: Vec<&str> = cell.split('`').skip(1).step_by(2).collect();
    if named.is_empty() && !cell.starts_with("none: ") {
        return Some("names no test, and no reason why it has none".to_owned());
    }
    let missing = named.into_iter().find(|name| !tests.contains(*name))?;
    Some(format!("{missing} is no test"))
}

#[test]
fn every_threat_has_tests_that_exist() {
    let mut tests = BTreeSet::new();
    ["agent", "common", "deploy", "tests"].iter().for_each(|folder| collect_tests(&root().join(folder), &mut tests));
    let path = format!("{BOOK}/cluster-security.md");
    let rows = rows(&Page::read(&path).text);
    assert!(rows.len() > 15, "{rows:?}");
    let faults = rows.iter().filter_map(|(threat, cell)| Some(format!("{threat}: {}", fault(cell, &tests)?)));
    let faults: Vec<_> = faults.collect();
    assert!(faults.is_empty(), "{path}: {faults:#?}");
}

#[test]
fn a_threat_without_an_existing_test_is_found() {
    let tests = tests_in("#[test]\nfn one() {}\n#[cfg(unix)]\n#[test]\n#[ignore]\nfn two() {}\nfn three() {}\n");
    assert_eq!(tests, ["one", "two"]);
    let tests = tests.into_iter().collect();
    let rows =
        rows("\n## Threats\n\n| threat | test |\n| --- | --- |\n| A | `one`, `two` |\n| B | `three` |\n\n| C | |\n");
    assert_eq!(rows.len(), 2);
    let faults = rows.iter().map(|(_, cell)| fault(cell, &tests)).collect::<Vec<_>>();
    assert_eq!(faults, [None, Some("three is no test".to_owned())]);
    assert!(fault("none: nothing stops it", &tests).is_none() && fault("", &tests).is_some());
}
