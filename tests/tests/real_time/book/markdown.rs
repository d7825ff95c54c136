//! Markdown files as the tests read them: fences, tables, links, headings, and the markers above fences and tables.
//!
//! * A fence ```` ```console ```` is run: lines that begin with `$ ` are commands, the lines below each are its output.
//!   Its info string may also have `status=N`, the exit status of the block's last command, `needs=MODULE`, a module of
//!   Python without which the block is skipped, and `long`: the block is run only with `SKEIN_BOOK=long` in the
//!   environment, as `.ci/long` does.
//! * A fence with `file=NAME` is written into the folder in which later blocks of the chapter run.
//! * `<!-- golden: NAME -->` names a file of `tests/golden`, and `<!-- same as: PATH -->` a file of the checkout, from
//!   which the fence or table below it comes.

use std::collections::BTreeMap;
use std::fs;
use std::ops::Range;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use pulldown_cmark::{CodeBlockKind, Event, Options, Parser, Tag, TagEnd};

use crate::book::{BOOK, root};

/// A Markdown file.
pub(crate) struct Page {
    /// Its path from the root of the checkout, with `/`.
    pub(crate) path: String,
    /// Its text.
    pub(crate) text: String,
}

/// A fence or a table.
pub(crate) struct Block {
    /// The info string of a fence; `None` for a table.
    pub(crate) info: Option<String>,
    /// The lines inside, without indentation.
    pub(crate) lines: Vec<String>,
    /// The number of columns by which the source indents it.
    pub(crate) indent: usize,
    /// The number of the first of these lines in the file, from 1.
    pub(crate) first_line: usize,
    /// The comment directly above it, without its brackets.
    pub(crate) marker: Option<String>,
}

impl Block {
    /// Whether it is a fence of this language.
    pub(crate) fn is(&self, language: &str) -> bool {
        self.info.as_ref().is_some_and(|info| info.split_whitespace().next() == Some(language))
    }

    /// Whether the info string has this flag after the language.
    pub(crate) fn has(&self, flag: &str) -> bool {
        self.info.as_ref().is_some_and(|info| info.split_whitespace().skip(1).any(|part| part == flag))
    }

    /// The value of `name=value` in the info string.
    pub(crate) fn option(&self, name: &str) -> Option<&str> {
        let parts = self.info.as_deref()?.split_whitespace();
        parts.skip(1).find_map(|part| part.strip_prefix(name)?.strip_prefix('='))
    }

    /// Lines with the indentation that they have in the file.
    pub(crate) fn indented<'a>(&self, lines: impl Iterator<Item = &'a str>) -> Vec<String> {
        let indent = " ".repeat(self.indent);
        lines.map(|line| format!("{indent}{line}").trim_end().to_owned()).collect()
    }

    /// The text of the marker after this name and a colon.
    pub(crate) fn marked(&self, name: &str) -> Option<&str> {
        Some(self.marker.as_deref()?.strip_prefix(name)?.strip_prefix(':')?.trim())
    }
}

/// A link or a picture.
pub(crate) struct Link {
    /// Where it leads.
    pub(crate) target: String,
    /// The number of its line, from 1.
    pub(crate) line: usize,
}

/// The names of markers.
const MARKERS: [&str; 2] = ["golden:", "same as:"];

impl Page {
    /// Reads the file at a path from the root.
    pub(crate) fn read(path: &str) -> Self {
        let text = fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"));
        Self { path: path.to_owned(), text: text.replace('\r', "") }
    }

    /// The README, the papers for contributors and every chapter, the summary included.
    pub(crate) fn all() -> Vec<Self> {
        let mut paths = vec!["README.md".to_owned()];
        find(&root().join(".github"), ".github", &mut paths);
        find(&root().join(BOOK), BOOK, &mut paths);
        paths.iter().map(|path| Self::read(path)).collect()
    }

    /// Replaces lines of the file: each edit has the number of the first line, from 1, how many lines it takes out, and
    /// what it puts there. The edits are in the order of the file.
    ///
    /// # Panics
    /// If the file has changed since it was read: another test has written it.
    pub(crate) fn edit(&self, edits: &[(usize, usize, Vec<String>)]) {
        static WRITING: Mutex<()> = Mutex::new(());
        let mut lines: Vec<String> = self.text.lines().map(str::to_owned).collect();
        for (first, count, new) in edits.iter().rev() {
            lines.splice(first - 1..first - 1 + count, new.iter().cloned());
        }
        let _alone = WRITING.lock().unwrap_or_else(PoisonError::into_inner);
        assert_eq!(Self::read(&self.path).text, self.text, "{} was written meanwhile: run this again", self.path);
        fs::write(root().join(&self.path), lines.join("\n") + "\n").unwrap();
    }

    fn events(&self) -> impl Iterator<Item = (Event<'_>, Range<usize>)> {
        Parser::new_ext(&self.text, Options::ENABLE_TABLES).into_offset_iter()
    }

    fn line_of(&self, byte: usize) -> usize {
        self.text[..byte].matches('\n').count() + 1
    }

    /// Every fence and table, in order.
    ///
    /// # Panics
    /// If a marker has neither below it.
    pub(crate) fn blocks(&self) -> Vec<Block> {
        let mut blocks = Vec::new();
        let mut marker: Option<String> = None;
        let mut depth_in_block = 0;
        for (event, range) in self.events() {
            match event {
                Event::Html(html) => {
                    let comment = html.trim().strip_prefix("<!--").and_then(|rest| rest.strip_suffix("-->"));
                    if let Some(comment) = comment.map(str::trim)
                        && MARKERS.iter().any(|name| comment.starts_with(name))
                    {
                        marker = Some(comment.to_owned());
                    }
                }
                Event::Start(Tag::HtmlBlock) | Event::End(TagEnd::HtmlBlock) => {}
                Event::Start(Tag::CodeBlock(CodeBlockKind::Fenced(info))) => {
                    depth_in_block += 1;
                    blocks.push(self.fence(info.to_string(), &range, marker.take()));
                }
                Event::Start(Tag::Table(_)) => {
                    depth_in_block += 1;
                    blocks.push(self.block(None, self.text[range.clone()].trim_end(), &range, 0, marker.take()));
                }
                Event::End(TagEnd::CodeBlock | TagEnd::Table) => depth_in_block -= 1,
                _ if depth_in_block > 0 => {}
                _ => {
                    let place = || format!("{}:{}", self.path, self.line_of(range.start));
                    assert!(marker.is_none(), "{}: no fence or table below <!-- {marker:?} -->", place());
                }
            }
        }
        assert!(marker.is_none(), "{}: nothing below <!-- {marker:?} -->", self.path);
        blocks
    }

    fn fence(&self, info: String, range: &Range<usize>, marker: Option<String>) -> Block {
        let source = self.text[range.clone()].trim_end();
        let (first, last) = (source.find('\n'), source.rfind('\n'));
        let is_closed = last.is_some_and(|last| source[last..].trim().starts_with(['`', '~']));
        assert!(is_closed, "{}:{}: a fence without an end", self.path, self.line_of(range.start));
        let inside = match (first, last) {
            (Some(first), Some(last)) if first < last => &source[first + 1..last],
            _ => "",
        };
        self.block(Some(info), inside, range, 1, marker)
    }

    fn block(
        &self,
        info: Option<String>,
        inside: &str,
        range: &Range<usize>,
        above: usize,
        marker: Option<String>,
    ) -> Block {
        let indent = range.start - self.text[..range.start].rfind('\n').map_or(0, |end| end + 1);
        let unindented = |line: &str| {
            let spaces = line.len() - line.trim_start_matches(' ').len();
            line[spaces.min(indent)..].to_owned()
        };
        let lines = inside.lines().map(unindented).collect();
        Block { info, lines, indent, first_line: self.line_of(range.start) + above, marker }
    }

    /// Every link and picture.
    pub(crate) fn links(&self) -> Vec<Link> {
        let target = |(event, range): (Event<'_>, Range<usize>)| match event {
            Event::Start(Tag::Link { dest_url, .. } | Tag::Image { dest_url, .. }) => {
                Some(Link { target: dest_url.to_string(), line: self.line_of(range.start) })
            }
            _ => None,
        };
        self.events().filter_map(target).collect()
    }

    /// The anchors of all headings, as GitHub makes them.
    pub(crate) fn anchors(&self) -> Vec<String> {
        let mut seen: BTreeMap<String, usize> = BTreeMap::new();
        let (mut anchors, mut heading) = (Vec::new(), None::<String>);
        for (event, _) in self.events() {
            match (event, &mut heading) {
                (Event::Start(Tag::Heading { .. }), heading) => *heading = Some(String::new()),
                (Event::Text(text) | Event::Code(text), Some(heading)) => *heading += &text,
                (Event::End(TagEnd::Heading(_)), heading) => {
                    let slug = slug(&heading.take().unwrap_or_default());
                    let count = seen.entry(slug.clone()).or_default();
                    anchors.push(if *count == 0 { slug } else { format!("{slug}-{count}") });
                    *count += 1;
                }
                _ => {}
            }
        }
        anchors
    }
}

/// GitHub's anchor of a heading: lower case, punctuation left out, a hyphen for each space.
fn slug(heading: &str) -> String {
    let kept = |letter: char| letter.is_alphanumeric() || matches!(letter, '-' | '_' | ' ');
    heading.trim().to_lowercase().chars().filter(|&letter| kept(letter)).collect::<String>().replace(' ', "-")
}

/// Adds every Markdown file below a folder, sorted.
fn find(folder: &Path, path: &str, found: &mut Vec<String>) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    let mut entries: Vec<_> = entries.map(|entry| entry.unwrap()).collect();
    entries.sort_by_key(fs::DirEntry::file_name);
    for entry in entries {
        let path = format!("{path}/{}", entry.file_name().to_string_lossy());
        if entry.path().is_dir() {
            find(&entry.path(), &path, found);
        } else if path.ends_with(".md") {
            found.push(path);
        }
    }
}

#[test]
fn a_page_is_read_with_the_lines_of_its_parts() {
    let text = "# A *b* `c_d`, e!\n\n<!-- golden: x.txt -->\n```text\none\n\ntwo\n```\n- list\n  ```console long status=2\n  $ no\n    \
                x\n  ```\n\n<!-- same as: y -->\n\n| a | b |\n| --- | --- |\n| 1 | 2 |\n\n## Über 10 m/s\n## Über 10 m/s\n";
    let page = Page { path: "x.md".to_owned(), text: text.to_owned() };
    let blocks = page.blocks();
    let lines = |nth: usize| blocks[nth].lines.join("|");
    assert_eq!((lines(0), blocks[0].first_line, blocks[0].marked("golden")), ("one||two".into(), 5, Some("x.txt")));
    assert_eq!((lines(1), blocks[1].first_line, blocks[1].option("status")), ("$ no|  x".into(), 11, Some("2")));
    assert!(blocks[1].is("console") && blocks[1].has("long") && !blocks[1].has("console"));
    assert!(!blocks[1].is("text") && blocks[1].indent == 2);
    assert_eq!((lines(2), blocks[2].marked("same as")), ("| a | b ||| --- | --- ||| 1 | 2 |".into(), Some("y")));
    assert_eq!(page.anchors(), ["a-b-c_d-e", "über-10-ms", "über-10-ms-1"]);
}
