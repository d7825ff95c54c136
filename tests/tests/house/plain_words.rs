//! The vocabulary of the project, checked against comments, texts and documents: words that a reader of robotics does not
//! expect, or that leave open which vehicle, agent or message is meant, are refused with their place.

use std::fs;
use std::path::{Path, PathBuf};

/// Words and phrases that no comment, text or document uses, and what to write instead.
const BANNED: [(&str, &str); 35] = [
    ("whoever", "the vehicle, the agent, the peer"),
    ("nobody", "no vehicle, no agent, no peer"),
    ("somebody", "a vehicle, an agent, a peer"),
    ("anybody", "any vehicle, any agent, any peer"),
    ("everybody", "all vehicles, all agents"),
    ("someone", "a person, a vehicle, an agent"),
    ("anyone", "any person, any vehicle"),
    ("everyone", "all persons, all vehicles"),
    ("word", "message, name, text"),
    ("words", "messages, names, texts"),
    ("said", "sent, published, reported"),
    ("heard", "received"),
    ("hears", "receives"),
    ("unheard", "silent"),
    ("hearer", "receiver"),
    ("told", "reported, sent, ordered"),
    ("tells", "reports, sends"),
    ("speaker", "sender"),
    ("speaks", "sends, uses"),
    ("deaf", "unresponsive"),
    ("set-point", "setpoint"),
    ("set-points", "setpoints"),
    ("takes part", "is an active member"),
    ("take part", "are active members"),
    ("goes on", "continues"),
    ("go on", "continue"),
    ("went on", "continued"),
    ("is none", "the positive fact"),
    ("as it is", "the state that is meant"),
    ("that is what", "the thing itself"),
    ("comes down", "descends, lands, autorotates"),
    ("come down", "descend, land, autorotate"),
    ("reckons on", "dead-reckons"),
    ("one machine", "the central controller"),
    ("patience", "timeout"),
];

/// Texts with a banned word that stay, because other programs read them: bytes that signatures cover.
const ALLOWED: [&str; 1] = ["skein word v1"];

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Code,
    Comment,
    Text,
}

/// Splits Rust source into code, comments and string literals, in their order.
fn parts(source: &str) -> Vec<(Kind, &str)> {
    let (mut found, mut rest) = (Vec::new(), source);
    while !rest.is_empty() {
        let (kind, end) = first_part(rest);
        found.push((kind, &rest[..end]));
        rest = &rest[end..];
    }
    found
}

/// Kind and length of the part with which this source begins, bytes.
fn first_part(source: &str) -> (Kind, usize) {
    let until = |mark: &str, from: usize| source[from..].find(mark).map_or(source.len(), |at| from + at + mark.len());
    if source.starts_with("//") {
        return (Kind::Comment, until("\n", 0));
    }
    if source.starts_with("/*") {
        return (Kind::Comment, until("*/", 0));
    }
    if source.starts_with('"') {
        return (Kind::Text, end_of_string(source));
    }
    let hashes = source.strip_prefix('r').map_or(0, |raw| raw.len() - raw.trim_start_matches('#').len());
    if source.starts_with('r') && source[1 + hashes..].starts_with('"') {
        return (Kind::Text, until(&format!("\"{}", "#".repeat(hashes)), 2 + hashes));
    }
    if let Some(literal) = source.strip_prefix('\'') {
        let escaped = usize::from(literal.starts_with('\\'));
        let first = literal.chars().nth(escaped).map_or(1, char::len_utf8);
        let end = literal[escaped + first..].find('\'').filter(|at| *at == 0 || escaped == 1);
        return (Kind::Code, end.map_or(1, |at| 1 + escaped + first + at + 1));
    }
    // A name is one part, so that a name that ends with `r` does not begin a raw string.
    let name = source.chars().take_while(|letter| letter.is_alphanumeric() || *letter == '_').map(char::len_utf8).sum();
    (Kind::Code, usize::max(name, source.chars().next().map_or(1, char::len_utf8)))
}

fn end_of_string(source: &str) -> usize {
    let mut is_escaped = false;
    for (at, letter) in source.char_indices().skip(1) {
        match letter {
            '"' if !is_escaped => return at + 1,
            '\\' => is_escaped = !is_escaped,
            _ => is_escaped = false,
        }
    }
    source.len()
}

/// Replaces quoted code, `like this`, by a space, also over the ends of lines.
fn without_code(text: &str) -> String {
    text.split('`').step_by(2).collect::<Vec<_>>().join(" ")
}

/// The banned words of a text, each with the number of its line, from 0.
fn banned(text: &str) -> Vec<(usize, &'static str, &'static str)> {
    let mut found = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let line = format!(" {} ", line.to_lowercase());
        let is_inside = |letter: char| letter.is_alphanumeric() || "_-".contains(letter);
        for (phrase, instead) in BANNED {
            let stands_alone =
                |at: usize| !line[..at].ends_with(is_inside) && !line[at + phrase.len()..].starts_with(is_inside);
            if line.match_indices(phrase).any(|(at, _)| stands_alone(at)) {
                found.push((number, phrase, instead));
            }
        }
    }
    found
}

/// The texts of a file that a person reads, each with the number of its first line, from 1.
fn texts(path: &Path, content: &str) -> Vec<(usize, String)> {
    match path.extension().and_then(|extension| extension.to_str()) {
        // Their comments and strings are written alike.
        Some("rs" | "js" | "mjs" | "css") => {
            let mut line = 1;
            let mut found = Vec::new();
            for (kind, part) in parts(content) {
                // A text without a space is a key or a name.
                let is_read = kind == Kind::Comment || kind == Kind::Text && part.contains(' ');
                if is_read && !ALLOWED.iter().any(|allowed| part.contains(allowed)) {
                    // Arguments in braces are code.
                    let text: String = part
                        .split('{')
                        .map(|piece| piece.split_once('}').map_or(piece, |(_, rest)| rest))
                        .collect::<Vec<_>>()
                        .join(" ");
                    found.push((line, without_code(&text)));
                }
                line += part.matches('\n').count();
            }
            found
        }
        Some("md" | "html") => {
            // Fences are commands and their output.
            let mut is_fence = false;
            let prose = content.lines().map(|line| {
                let is_mark = line.trim_start().starts_with("```");
                is_fence ^= is_mark;
                if is_mark || is_fence { "" } else { line }
            });
            vec![(1, prose.map(without_code).collect::<Vec<_>>().join("\n"))]
        }
        _ => {
            let comment = |line: &str| line.find('#').map_or(String::new(), |at| without_code(&line[at..]));
            vec![(1, content.lines().map(comment).collect::<Vec<_>>().join("\n"))]
        }
    }
}

fn files(folder: &Path, found: &mut Vec<PathBuf>) {
    let mut entries: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        let name = path.file_name().unwrap().to_str().unwrap();
        if matches!(name, "target" | ".git" | "golden" | "node_modules" | "html" | "plain_words.rs") {
            continue;
        }
        let is_read = ["rs", "js", "mjs", "css", "md", "html", "toml", "yml", "py", "sh", "service"]
            .iter()
            .any(|kind| path.extension().is_some_and(|own| own == *kind));
        if path.is_dir() {
            files(&path, found);
        } else if is_read || path.parent().is_some_and(|folder| folder.file_name().is_some_and(|name| name == ".ci")) {
            found.push(path);
        }
    }
}

#[test]
fn comments_texts_and_documents_use_no_banned_word() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut all = Vec::new();
    files(&root, &mut all);
    assert!(all.len() > 300, "{} files", all.len());
    let mut faults = Vec::new();
    for path in all {
        let content = fs::read_to_string(&path).unwrap();
        let name = path.strip_prefix(&root).unwrap().display().to_string();
        for (first, text) in texts(&path, &content) {
            for (line, phrase, instead) in banned(&text) {
                faults.push(format!("{name}:{}: \"{phrase}\": write {instead}", first + line));
            }
        }
    }
    assert!(faults.is_empty(), "{} banned words:\n{}", faults.len(), faults.join("\n"));
}

#[test]
fn a_banned_word_is_found_in_comments_and_texts_and_not_in_code() {
    let found = |source: &str| {
        let texts = texts(Path::new("a.rs"), source);
        texts
            .iter()
            .flat_map(|(first, text)| banned(text).into_iter().map(move |(line, phrase, _)| (first + line, phrase)))
            .collect::<Vec<_>>()
    };
    assert_eq!(found("let said = 1; // The vehicle said\nx"), [(1, "said")]);
    assert_eq!(found("a\n/// Nobody\n/// goes on.\nfn f() {}"), [(2, "nobody"), (3, "goes on")]);
    assert_eq!(found(r##"let a = 'r'; f("a word", r#"some "told" text"#, "said");"##), [(1, "word"), (1, "told")]);
    assert_eq!(
        found("// `said` and {heard} and keyword and set-pointed\nlet b = '\"'; let word = f(\"{said} a\");"),
        []
    );
    let prose = texts(Path::new("a.md"), "A text.\n```text\nnobody\n```\nHe `said` it is a deaf one.");
    assert_eq!(banned(&prose[0].1), [(4, "deaf", "unresponsive")]);
}
