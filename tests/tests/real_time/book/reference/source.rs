//! Structs and enums with their docstrings, read from a source that `cargo fmt` has formatted.

/// A struct or an enum.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Item {
    /// Its name.
    pub(super) name: String,
    /// The first paragraph of its docstring.
    pub(super) about: String,
    /// Whether it is an enum: then its fields are the variants.
    pub(super) is_enum: bool,
    /// In the order of the source, which is that of the encoding.
    pub(super) fields: Vec<Field>,
}

/// A field of a struct, or a variant of an enum.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Field {
    /// Its name.
    pub(super) name: String,
    /// Its Rust type; of a variant, the types that it holds.
    pub(super) kind: String,
    /// The first paragraph of its docstring.
    pub(super) about: String,
}

/// Every public struct with named fields and every public enum of a source.
pub(super) fn items(source: &str) -> Vec<Item> {
    let mut items = Vec::new();
    let (mut docs, mut item) = (Vec::new(), None::<Item>);
    for line in source.lines() {
        if let Some(text) = line.trim_start().strip_prefix("///") {
            docs.push(text.trim());
        } else if line == "}" {
            items.extend(item.take());
            docs.clear();
        } else if let Some(open) = &mut item {
            if take_field(open, line, &docs) {
                docs.clear();
            }
        } else if let Some((is_enum, name)) = opened(line) {
            item = Some(Item { name: name.to_owned(), about: paragraph(&docs), is_enum, fields: Vec::new() });
            docs.clear();
        } else if !line.starts_with("#[") {
            docs.clear();
        }
    }
    items
}

/// The name of the item that this line opens, and whether it is an enum.
fn opened(line: &str) -> Option<(bool, &str)> {
    let name = |keyword: &str| line.strip_prefix(keyword)?.strip_suffix(" {").filter(|name| !name.contains('<'));
    name("pub struct ").map(|name| (false, name)).or_else(|| name("pub enum ").map(|name| (true, name)))
}

/// Takes up a line inside an item; false if its docstring belongs to what follows.
fn take_field(item: &mut Item, line: &str, docs: &[&str]) -> bool {
    let depth = line.len() - line.trim_start().len();
    let line = line.trim().trim_end_matches(',');
    if line.is_empty() || line.starts_with("#[") || line.starts_with("//") {
        return line.is_empty();
    }
    if !item.is_enum {
        if let Some((name, kind)) = line.strip_prefix("pub ").and_then(|field| field.split_once(": ")) {
            item.fields.push(Field { name: name.to_owned(), kind: kind.to_owned(), about: paragraph(docs) });
        }
    } else if depth > 4 {
        // A field of a variant.
        if let Some(variant) = item.fields.last_mut() {
            let comma = if variant.kind.is_empty() { "" } else { ", " };
            variant.kind += &format!("{comma}{line}");
        }
    } else if line != "}" {
        let end = line.find([' ', '(']).unwrap_or(line.len());
        let held = line[end..].trim_start_matches(['(', ' ', '{']).trim_end_matches(')');
        item.fields.push(Field { name: line[..end].to_owned(), kind: held.to_owned(), about: paragraph(docs) });
    }
    true
}

/// The first paragraph of a docstring, links to code as code: [`Self::x`] is `x`.
fn paragraph(docs: &[&str]) -> String {
    let lines: Vec<&str> = docs.iter().copied().take_while(|line| !line.is_empty()).collect();
    lines.join(" ").replace("[`", "`").replace("`]", "`").replace("`Self::", "`")
}

#[test]
fn items_are_read_with_their_docstrings() {
    let source = "/// A thing:\n/// [`Self::b`].\n///\n/// More.\n#[derive(Debug)]\npub struct Thing {\n    /// One.\n    \
                  #[serde(default)]\n    pub a: Option<u8>,\n    /// Two.\n    pub b: [f64; 2],\n}\n\nimpl Thing {\n    pub fn c() {}\n}\n\n\
                  pub enum Kind {\n    /// No.\n    Empty,\n    Held(u32),\n    /// Both.\n    Both {\n        /// To.\n        to: u32,\n        \
                  of: Id,\n    },\n}\npub struct Tuple(u8);\n";
    let field =
        |name: &str, kind: &str, about: &str| Field { name: name.into(), kind: kind.into(), about: about.into() };
    let thing = [field("a", "Option<u8>", "One."), field("b", "[f64; 2]", "Two.")];
    let kind = [field("Empty", "", "No."), field("Held", "u32", ""), field("Both", "to: u32, of: Id", "Both.")];
    let found = items(source);
    assert_eq!((found[0].about.as_str(), found.len()), ("A thing: `b`.", 2));
    assert_eq!((&found[0].fields[..], &found[1].fields[..], found[1].is_enum), (&thing[..], &kind[..], true));
}
