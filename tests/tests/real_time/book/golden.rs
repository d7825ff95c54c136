//! The tables below `<!-- golden: NAME -->` are those of `tests/golden/NAME`, which `.ci/long` flies again.

use std::fs;

use skein_tests::{central, formation_error, laws, tour, variants};

use crate::book::markdown::Page;
use crate::book::{is_writing, root};

/// The table that is made from a golden file with figures.
fn made_from(name: &str) -> Option<String> {
    (name == "formation_error.csv").then(|| formation_error::markdown(&formation_error::golden()))
}

/// The text from which a table with this marker comes.
///
/// # Errors
/// If the marker names no golden file.
fn whole(name: &str) -> Result<String, String> {
    match made_from(name) {
        Some(made) => Ok(made),
        None if !name.ends_with(".txt") => Err(format!("no table is made from {name}")),
        None => {
            let path = root().join("tests/golden").join(name);
            fs::read_to_string(path).map_err(|error| format!("tests/golden/{name}: {error}"))
        }
    }
}

/// Whether a line of an excerpt marks omitted lines.
fn is_gap(line: &str) -> bool {
    matches!(line.trim(), "" | "…" | "...")
}

/// The first line of an excerpt that is not a line of the whole, or not in its order.
fn first_other<'a>(excerpt: &'a [String], whole: &str) -> Option<&'a str> {
    let mut rest = whole.lines().map(str::trim_end);
    let shown = excerpt.iter().map(|line| line.trim_end()).filter(|line| !is_gap(line));
    let mut others = shown.filter(|line| !rest.any(|other| other == *line));
    others.next()
}

/// The excerpt with each row replaced by the row of the whole with the longest equal beginning, because the first
/// columns name the row; of those behind the last one taken, because another table may have the same first columns.
fn renewed<'a>(excerpt: &'a [String], whole: &'a str) -> Vec<&'a str> {
    let common =
        |one: &str, other: &str| one.chars().zip(other.chars()).take_while(|(one, other)| one == other).count();
    let rows: Vec<&str> = whole.lines().filter(|row| !is_gap(row)).collect();
    let mut taken = 0;
    let mut nearest = |line: &'a str| {
        let found = (taken..rows.len()).rev().max_by_key(|&nth| common(rows[nth], line));
        taken = found.map_or(taken, |nth| nth + 1);
        found.map_or(line, |nth| rows[nth])
    };
    excerpt.iter().map(|line| if is_gap(line) { line } else { nearest(line) }).collect()
}

#[test]
fn every_marked_table_is_that_of_its_golden_file() {
    let mut wrong = String::new();
    let mut shown = 0;
    for page in Page::all() {
        let mut edits = Vec::new();
        for block in page.blocks() {
            let Some(name) = block.marked("golden") else { continue };
            shown += usize::from(made_from(name).is_some());
            let place = format!("{}:{}", page.path, block.first_line);
            let whole = match whole(name) {
                Ok(whole) => whole,
                Err(fault) => {
                    wrong += &format!("{place}: {fault}\n");
                    continue;
                }
            };
            let Some(other) = first_other(&block.lines, &whole) else { continue };
            if is_writing() {
                let new = renewed(&block.lines, &whole).into_iter();
                edits.push((block.first_line, block.lines.len(), block.indented(new)));
            } else {
                wrong += &format!("{place}: {name} does not have this line there: {other}\n");
            }
        }
        if !edits.is_empty() {
            page.edit(&edits);
        }
    }
    assert!(wrong.is_empty(), "{wrong}SKEIN_GOLDEN=write puts the rows of the golden files into the pages");
    assert!(shown > 0, "the table of loss, delay and size is in no page");
}

/// Rows that are flown in a second or two; `.ci/long` flies the others.
#[test]
fn rows_flown_again_equal_those_of_their_golden_files() {
    let flown = [
        ("tour.txt", tour::table(&[2], &[0.0], &[0.0], 5)),
        ("central-limits.txt", central::limits(8, &[0.12], &[], 4)),
        ("laws.txt", laws::markdown(&["ring"], &[4], 10)),
        ("variants.txt", variants::markdown(&variants::VARIANTS[1..2], 20)),
    ];
    for (name, rows) in flown {
        let whole = fs::read_to_string(root().join("tests/golden").join(name)).unwrap();
        let rows: Vec<String> = rows.lines().map(str::to_owned).collect();
        assert_eq!(first_other(&rows, &whole), None, "{name} does not have this row");
    }
}

#[test]
fn an_excerpt_keeps_the_order_of_its_table() {
    let other = |excerpt: &[&str]| {
        let lines: Vec<String> = excerpt.iter().map(|&line| line.to_owned()).collect();
        first_other(&lines, "head\none\ntwo  \nthree\n").map(str::to_owned)
    };
    assert_eq!(other(&["head", "two", "…", "three"]), None);
    assert_eq!(other(&["two", "one"]).as_deref(), Some("one"));
    assert_eq!(other(&["four"]).as_deref(), Some("four"));
}

#[test]
fn rows_are_renewed_by_their_first_columns() {
    let whole = "case  figure\n   1    1.25\n   2    3.00\n  12    4.00\n";
    let old: Vec<String> = ["case  figure", "   1    1.20", "…", "  12    4.10"].map(str::to_owned).to_vec();
    assert_eq!(renewed(&old, whole), ["case  figure", "   1    1.25", "…", "  12    4.00"]);
    let whole = "first\n1  one\n2  two\nsecond\n1  eins\n2  zwei\n";
    let old: Vec<String> = ["second", "1  uno", "2  due"].map(str::to_owned).to_vec();
    assert_eq!(renewed(&old, whole), ["second", "1  eins", "2  zwei"]);
}
