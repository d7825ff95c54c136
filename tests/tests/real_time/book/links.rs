//! Every link leads to a file or a heading, and every chapter is in the summary.

use std::collections::BTreeMap;
use std::path::{Component, Path};

use crate::book::markdown::{Link, Page};
use crate::book::{BOOK, root};

/// The path from the root to which a relative link of a page leads; `None` if it leads out of the checkout.
fn resolved(page: &str, target: &str) -> Option<String> {
    let mut parts: Vec<&str> = page.split('/').collect();
    parts.pop();
    for part in Path::new(target).components() {
        match part {
            Component::Normal(name) => parts.push(name.to_str()?),
            Component::ParentDir => drop(parts.pop()?),
            Component::CurDir => {}
            Component::RootDir | Component::Prefix(_) => return None,
        }
    }
    Some(parts.join("/"))
}

/// Whether an address of the web is well formed.
fn is_address(target: &str) -> bool {
    let Some(rest) = target.strip_prefix("https://").or_else(|| target.strip_prefix("http://")) else { return false };
    let host = rest.split(['/', '?', '#']).next().unwrap_or_default();
    let is_plain = |letter: char| letter.is_ascii_graphic() && !matches!(letter, '<' | '>' | '"' | '\\' | '`');
    host.contains('.') && !host.starts_with('.') && !host.ends_with('.') && rest.chars().all(is_plain)
}

/// The error of a link; `None` if it is valid.
fn fault(page: &Page, link: &Link, anchors: &BTreeMap<&str, Vec<String>>) -> Option<String> {
    let target = &link.target;
    if target.contains("://") {
        return (!is_address(target)).then(|| "not a well-formed address".to_owned());
    }
    let (path, anchor) = target.split_once('#').map_or((&**target, None), |(path, anchor)| (path, Some(anchor)));
    let Some(path) = (if path.is_empty() { Some(page.path.clone()) } else { resolved(&page.path, path) }) else {
        return Some("leads out of the checkout".to_owned());
    };
    if !root().join(&path).exists() {
        return Some(format!("{path} does not exist"));
    }
    let anchor = anchor?;
    let Some(headings) = anchors.get(&*path) else {
        return Some(format!("{path} is not a page, so that it has no heading #{anchor}"));
    };
    (!headings.iter().any(|heading| heading == anchor)).then(|| format!("{path} has no heading #{anchor}"))
}

#[test]
fn every_link_leads_to_a_file_and_every_anchor_to_a_heading() {
    let pages = Page::all();
    let anchors = pages.iter().map(|page| (&*page.path, page.anchors())).collect();
    let mut wrong = String::new();
    for page in &pages {
        for link in page.links() {
            if let Some(fault) = fault(page, &link, &anchors) {
                wrong += &format!("{}:{}: {}: {fault}\n", page.path, link.line, link.target);
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong}");
}

#[test]
fn every_chapter_is_in_the_summary_once() {
    let summary = format!("{BOOK}/SUMMARY.md");
    let linked: Vec<_> =
        Page::read(&summary).links().iter().filter_map(|link| resolved(&summary, &link.target)).collect();
    for page in Page::all().iter().filter(|page| page.path.starts_with(BOOK) && page.path != summary) {
        let times = linked.iter().filter(|path| **path == page.path).count();
        assert_eq!(times, 1, "{} is {times} times in {summary}", page.path);
    }
}

#[test]
fn links_are_resolved_from_the_folder_of_their_page() {
    assert_eq!(resolved("README.md", "deploy/x.toml").as_deref(), Some("deploy/x.toml"));
    assert_eq!(resolved("deploy/book/src/a.md", "../../scenarios/b.toml").as_deref(), Some("deploy/scenarios/b.toml"));
    assert_eq!(resolved("README.md", "../x"), None);
    assert_eq!(resolved("README.md", "/x"), None);
    assert!(is_address("https://zenoh.io") && is_address("http://a.b/c?d#e"));
    assert!(!is_address("https://zenoh io") && !is_address("https:/a.b") && !is_address("https://nowhere"));
}
