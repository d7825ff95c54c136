//! A fence below `<!-- same as: PATH -->` shows a piece of that file of the checkout.

use std::fs;

use crate::book::markdown::Page;
use crate::book::root;

/// Whether the file has these lines one below the other, blanks at their ends aside.
fn has(file: &str, lines: &[String]) -> bool {
    let file: Vec<&str> = file.lines().map(str::trim_end).collect();
    let lines: Vec<&str> = lines.iter().map(|line| line.trim_end()).collect();
    !lines.is_empty() && file.windows(lines.len()).any(|window| window == lines)
}

#[test]
fn every_piece_of_a_file_is_as_in_the_file() {
    let mut wrong = String::new();
    for page in Page::all() {
        for block in page.blocks() {
            let Some(path) = block.marked("same as") else { continue };
            let place = format!("{}:{}", page.path, block.first_line);
            match fs::read_to_string(root().join(path)) {
                Ok(file) if has(&file, &block.lines) => {}
                Ok(_) => wrong += &format!("{place}: {path} does not have these lines\n"),
                Err(error) => wrong += &format!("{place}: {path}: {error}\n"),
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong}");
}

#[test]
fn a_piece_is_contiguous() {
    let lines = |text: &str| text.lines().map(str::to_owned).collect::<Vec<_>>();
    assert!(has("a\nb  \n\nc\n", &lines("b\n\nc ")) && has("a\n", &lines("a")));
    assert!(!has("a\nb\nc\n", &lines("a\nc")) && !has("a", &[]));
}
