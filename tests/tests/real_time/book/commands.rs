//! Every `console` block prints the output that the chapter shows.

use std::collections::BTreeSet;

use snapbox::Data;
use snapbox::filter::{Filter, FilterNewlines, NormalizeToExpected};
use snapbox::report::{Palette, write_diff};

use crate::book::markdown::Page;
use crate::book::runner::Folder;
use crate::book::{is_long, is_writing};
use skein_tests::share::Share;

/// Makes a test for each page, so that they run in parallel and a failure names its page.
macro_rules! pages {
    ($($test:ident: $path:literal,)*) => {
        const PAGES: &[&str] = &[$($path),*];
        $(
            #[test]
            fn $test() {
                let _share = Share::of(60);
                run($path);
            }
        )*
    };
}

pages! {
    readme: "README.md",
    start: "deploy/book/src/start.md",
    for_operators: "deploy/book/src/for-operators.md",
    for_law_authors: "deploy/book/src/for-law-authors.md",
    install: "deploy/book/src/install.md",
    scenarios: "deploy/book/src/scenarios.md",
    laws: "deploy/book/src/laws.md",
    laws_rust: "deploy/book/src/laws-rust.md",
    laws_python: "deploy/book/src/laws-python.md",
    laws_matlab: "deploy/book/src/laws-matlab.md",
    missions: "deploy/book/src/missions.md",
    faults: "deploy/book/src/faults.md",
    fleets: "deploy/book/src/fleets.md",
    fleets_live: "deploy/book/src/fleets-live.md",
    studies: "deploy/book/src/studies.md",
    view: "deploy/book/src/view.md",
    recordings: "deploy/book/src/recordings.md",
    programs: "deploy/book/src/programs.md",
    xplane: "deploy/book/src/xplane.md",
    xplane_web: "deploy/book/src/xplane-web.md",
    cluster: "deploy/book/src/cluster.md",
    cluster_fleets: "deploy/book/src/cluster-fleets.md",
    cluster_operate: "deploy/book/src/cluster-operate.md",
    cluster_security: "deploy/book/src/cluster-security.md",
    cluster_troubleshoot: "deploy/book/src/cluster-troubleshoot.md",
    commands: "deploy/book/src/reference/commands.md",
    keys: "deploy/book/src/reference/keys.md",
    figures: "deploy/book/src/reference/figures.md",
    exit_statuses: "deploy/book/src/reference/exit-statuses.md",
    messages: "deploy/book/src/reference/messages.md",
    glossary: "deploy/book/src/reference/glossary.md",
    results: "deploy/book/src/results.md",
    architecture: "deploy/book/src/architecture.md",
    extend: "deploy/book/src/extend.md",
    changes: "deploy/book/src/changes.md",
}

#[test]
fn every_page_with_commands_has_a_test() {
    let listed: BTreeSet<&str> = PAGES.iter().copied().collect();
    let has_commands = |page: &Page| page.blocks().iter().any(|block| block.is("console"));
    let missing: Vec<_> =
        Page::all().into_iter().filter(|page| !listed.contains(&*page.path) && has_commands(page)).collect();
    let missing: Vec<_> = missing.iter().map(|page| &page.path).collect();
    assert!(missing.is_empty(), "add to the list in tests/tests/book/commands.rs: {missing:?}");
}

/// A command of a block, the output that the page shows for it, and the place of that output in the block's lines.
#[derive(Debug, PartialEq)]
struct Step {
    command: String,
    expected: String,
    at: usize,
    lines: usize,
}

/// The commands of a block. A command continues on the next line after a backslash at the end of its line.
fn steps(lines: &[String]) -> Result<Vec<Step>, String> {
    let mut steps: Vec<Step> = Vec::new();
    let mut is_continued = false;
    for (nth, line) in lines.iter().enumerate() {
        if is_continued && let Some(step) = steps.last_mut() {
            step.command += &format!("\n{}", line.strip_prefix("> ").unwrap_or(line));
            step.at = nth + 1;
        } else if let Some(command) = line.strip_prefix("$ ") {
            steps.push(Step { command: command.to_owned(), expected: String::new(), at: nth + 1, lines: 0 });
        } else if let Some(step) = steps.last_mut() {
            step.expected += &format!("{line}\n");
            step.lines += 1;
            continue;
        } else {
            return Err(format!("the block begins with output: {line}"));
        }
        is_continued = line.ends_with('\\');
    }
    // An empty line above the next command belongs to the layout, not to the output.
    for step in &mut steps {
        while step.expected == "\n" || step.expected.ends_with("\n\n") {
            step.expected.pop();
            step.lines -= 1;
        }
    }
    if steps.is_empty() { Err("the block has no line that begins with `$ `".to_owned()) } else { Ok(steps) }
}

/// Runs the blocks of a page one after the other in one folder.
fn run(path: &str) {
    let page = Page::read(path);
    let blocks = page.blocks();
    if !blocks.iter().any(|block| block.is("console")) {
        return;
    }
    let mut folder = Folder::new();
    let (mut wrong, mut edits) = (Vec::new(), Vec::new());
    for block in &blocks {
        if let Some(name) = block.option("file") {
            folder.write(name, &(block.lines.join("\n") + "\n"));
        }
        let is_too_long = block.has("long") && !is_long();
        let lacks_module = || block.option("needs").is_some_and(|module| !folder.has_python(module));
        if !block.is("console") || is_too_long || lacks_module() {
            continue;
        }
        let steps = steps(&block.lines).unwrap_or_else(|why| panic!("{path}:{}: {why}", block.first_line));
        for (nth, step) in steps.iter().enumerate() {
            let status = if nth + 1 == steps.len() { block.option("status").unwrap_or("0") } else { "0" };
            let printed = folder.run(&step.command);
            let line = block.first_line + step.at;
            let place = format!("{path}:{line}");
            if printed.status.map(|code| code.to_string()).as_deref() != Some(status) {
                let (command, text) = (&step.command, &printed.text);
                wrong.push(format!("{place}: `{command}` ended with {:?}, not {status}:\n{text}", printed.status));
                continue;
            }
            let Some(new) = difference(&place, &step.expected, &printed.text, &mut wrong) else { continue };
            edits.push((line, step.lines, block.indented(new.lines())));
        }
    }
    if is_writing() && !edits.is_empty() {
        page.edit(&edits);
        wrong.retain(|what| what.contains("` ended with "));
    }
    assert!(wrong.is_empty(), "{}\nSKEIN_GOLDEN=write writes what is printed into the page", wrong.join("\n"));
}

/// Compares the output. If it differs, notes the difference and returns the output, in which matching lines are kept as
/// the page has them.
fn difference(place: &str, expected: &str, printed: &str, wrong: &mut Vec<String>) -> Option<String> {
    // Blanks at the end of a line are invisible in a page.
    let printed: String = printed.lines().map(|line| format!("{}\n", line.trim_end())).collect();
    let printed = printed.trim_end_matches('\n').to_owned() + if printed.trim().is_empty() { "" } else { "\n" };
    let expected = Data::text(expected.to_owned());
    let printed = FilterNewlines.filter(Data::text(printed));
    let printed = NormalizeToExpected::new().redact().normalize(printed, &expected);
    if printed == expected {
        return None;
    }
    let mut text = String::new();
    let names: [&dyn std::fmt::Display; 2] = [&place, &"printed"];
    let _ = write_diff(&mut text, &expected, &printed, Some(names[0]), Some(names[1]), Palette::plain());
    wrong.push(format!("{place}: {text}"));
    printed.render()
}

#[test]
fn a_block_is_split_into_commands_and_their_output() {
    let lines = |text: &str| text.lines().map(str::to_owned).collect::<Vec<_>>();
    let step = |command: &str, expected: &str, at: usize, lines: usize| Step {
        command: command.into(),
        expected: expected.into(),
        at,
        lines,
    };
    let found = steps(&lines("$ a \\\n>   --b\none\n\ntwo\n\n$ c\n$ d\nthree")).unwrap();
    let expected = [step("a \\\n  --b", "one\n\ntwo\n", 2, 3), step("c", "", 7, 0), step("d", "three\n", 8, 1)];
    assert_eq!(found, expected);
    assert!(steps(&lines("one\n$ a")).is_err() && steps(&lines("")).is_err());
}

#[test]
fn lines_that_match_are_kept_as_the_page_has_them() {
    let mut wrong = Vec::new();
    let mut new = |expected: &str, printed: &str| difference("x.md:1", expected, printed, &mut wrong);
    assert_eq!(new("took [..] s\n...\nend\n", "took 3 s\nx\ny  \nend\n\n"), None);
    assert_eq!(new("took [..] s\nold\n", "took 3 s\nnew\n").as_deref(), Some("took [..] s\nnew\n"));
    assert_eq!(new("", "news\n").as_deref(), Some("news\n"));
    assert_eq!(wrong.len(), 2);
    assert!(wrong[0].starts_with("x.md:1: ") && wrong[0].contains("- old") && wrong[0].contains("+ new"), "{wrong:?}");
}

#[test]
fn a_folder_runs_commands_with_files_and_statuses() {
    let mut folder = Folder::new();
    folder.write("a/b.txt", "here\n");
    let printed = folder.run("cat a/b.txt; echo there >&2; pwd; exit 3");
    assert_eq!((&*printed.text, printed.status), ("here\nthere\n/home/you/lab\n", Some(3)));
    assert_eq!(folder.run("echo 1 of 2 runs, 11 s gone, about 11 s left; echo end").text, "end\n");
    assert_eq!(folder.run("sleep 60 > /dev/null 2>&1 &").status, Some(0));
    let printed = folder.run("skein files explain duration_s | head -n 1; ls deploy/scenarios/hover.toml");
    assert_eq!(printed.text, "duration_s\ndeploy/scenarios/hover.toml\n");
}
