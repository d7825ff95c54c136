//! Rules for dependencies between crates and modules, checked against the sources and cargo.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Path of a module below its crate; empty for the crate itself.
type Module = Vec<String>;

pub(super) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Collects the sources of a crate by their modules' paths, without tests.
fn sources(folder: &Path, module: &[String], found: &mut BTreeMap<Module, String>) {
    let mut entries: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
        if name == "tests" || name == "bin" {
            continue;
        }
        let own = || module.iter().cloned().chain([name.clone()]).collect::<Module>();
        if path.is_dir() {
            sources(&path, &own(), found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            let own = if ["lib", "main"].contains(&name.as_str()) { module.to_vec() } else { own() };
            found.insert(own, code_of(&fs::read_to_string(&path).unwrap()));
        }
    }
}

/// The folders of the crates that have rules for their modules.
const CRATES: [&str; 9] =
    ["common", "agent/core", "agent/host", "agent", "deploy/lab", "deploy/cluster", "deploy/view", "deploy", "tests"];

/// The sources of the crate in this folder.
fn modules_of(member: &str) -> BTreeMap<Module, String> {
    let mut modules = BTreeMap::from([(Module::new(), String::new())]);
    sources(&root().join(member).join("src"), &[], &mut modules);
    modules
}

/// A source without comments and without code that is compiled only for tests.
pub(super) fn code_of(source: &str) -> String {
    let lines: String =
        source.lines().filter(|line| !line.trim_start().starts_with("//")).fold(String::new(), |mut code, line| {
            code.push_str(line);
            code.push('\n');
            code
        });
    let mut code = String::new();
    let mut rest = lines.as_str();
    while let Some(at) = rest.find("#[cfg(test)]") {
        code.push_str(&rest[..at]);
        rest = after_item(&rest[at + "#[cfg(test)]".len()..]);
    }
    code + rest
}

/// The code after the first item: after its `;` or its closing brace, whichever is first.
fn after_item(code: &str) -> &str {
    let mut depth = 0;
    for (at, letter) in code.char_indices() {
        match letter {
            ';' if depth == 0 => return &code[at + 1..],
            '{' => depth += 1,
            '}' => {
                depth -= 1;
                if depth == 0 {
                    return &code[at + 1..];
                }
            }
            _ => {}
        }
    }
    ""
}

/// The paths that begin with `crate`, `super` or `self`, with groups expanded: `crate::a::{b, c::d}` gives two.
fn paths(code: &str) -> Vec<Vec<String>> {
    let is_name = |letter: char| letter.is_alphanumeric() || letter == '_';
    let mut found = Vec::new();
    for keyword in ["crate::", "super::", "self::"] {
        for (at, _) in code.match_indices(keyword) {
            let before = code[..at].chars().next_back();
            // `super::super::a` counts once, from its beginning.
            if before.is_some_and(|letter| is_name(letter) || letter == ':' || letter == '$') {
                continue;
            }
            open(&code[at..], Vec::new(), &mut found);
        }
    }
    found
}

/// Reads one path, with a group in braces after it, and returns the rest of the code.
fn open<'a>(mut code: &'a str, mut path: Vec<String>, found: &mut Vec<Vec<String>>) -> &'a str {
    loop {
        code = code.trim_start();
        let end = code.find(|letter: char| !letter.is_alphanumeric() && letter != '_').unwrap_or(code.len());
        if end > 0 {
            path.push(code[..end].to_owned());
            code = &code[end..];
        }
        let Some(next) = code.strip_prefix("::") else { break };
        code = next.trim_start();
        let Some(mut inner) = code.strip_prefix('{') else { continue };
        loop {
            inner = open(inner, path.clone(), found).trim_start();
            let after_name = inner.find([',', '}']).unwrap_or(inner.len());
            inner = &inner[after_name..];
            match inner.strip_prefix(',') {
                Some(more) if !more.trim_start().starts_with('}') => inner = more,
                Some(last) => return last.trim_start().strip_prefix('}').unwrap_or(last),
                None => return inner.strip_prefix('}').unwrap_or(inner),
            }
        }
    }
    found.push(path);
    code
}

/// The module to which a path in module `here` leads.
fn target(path: &[String], here: &[String], modules: &BTreeMap<Module, String>) -> Module {
    let mut at: Module = here.to_vec();
    for (nth, name) in path.iter().enumerate() {
        match name.as_str() {
            "crate" if nth == 0 => at.clear(),
            "self" => {}
            "super" => drop(at.pop()),
            name => {
                at.push(name.to_owned());
                if !modules.contains_key(&at) {
                    at.pop();
                    break;
                }
            }
        }
    }
    at
}

/// Pairs of sibling modules of which the first uses the second, each with a module in which it does.
fn uses(modules: &BTreeMap<Module, String>) -> BTreeMap<(Module, Module), Module> {
    let mut uses = BTreeMap::new();
    for (here, code) in modules {
        for path in paths(code) {
            let there = target(&path, here, modules);
            let common = here.iter().zip(&there).take_while(|(one, other)| one == other).count();
            if here.len() > common && there.len() > common {
                let pair = (here[..=common].to_vec(), there[..=common].to_vec());
                uses.entry(pair).or_insert_with(|| here.clone());
            }
        }
    }
    uses
}

/// A cycle of modules that use each other; `None` if the uses have no cycle.
fn cycle_of(uses: &BTreeMap<(Module, Module), Module>) -> Option<Vec<Module>> {
    let all: BTreeSet<&Module> = uses.keys().map(|(from, _)| from).collect();
    let next =
        |from: &Module| uses.keys().filter(move |(one, _)| one == from).map(|(_, to)| to.clone()).collect::<Vec<_>>();
    for start in all {
        let mut seen = BTreeSet::new();
        let mut paths = vec![vec![start.clone()]];
        while let Some(path) = paths.pop() {
            for to in next(path.last().unwrap()) {
                let longer: Vec<_> = path.iter().cloned().chain([to.clone()]).collect();
                if to == *start {
                    return Some(longer);
                }
                if seen.insert(to) {
                    paths.push(longer);
                }
            }
        }
    }
    None
}

#[test]
fn no_two_modules_import_each_other() {
    let mut cycles = Vec::new();
    for member in CRATES {
        let modules = modules_of(member);
        assert!(modules.len() > 3, "{member} has {} modules", modules.len());
        let mut uses = uses(&modules);
        while let Some(cycle) = cycle_of(&uses) {
            let arrows: Vec<_> = cycle.iter().map(|module| module.join("::")).collect();
            let step = |pair: &[Module]| (pair[0].clone(), pair[1].clone());
            let places: Vec<_> = cycle.windows(2).map(|pair| uses[&step(pair)].join("::")).collect();
            cycles.push(format!("{member}: {} (in {})", arrows.join(" -> "), places.join(", ")));
            uses.remove(&step(&cycle[..2]));
        }
    }
    assert!(cycles.is_empty(), "modules that import each other:\n{}", cycles.join("\n"));
}

/// The longest chain of modules from this one on of which each uses the next; `known` keeps those that were found. A circle ends it.
fn chain_from(
    module: &Module,
    uses: &BTreeMap<(Module, Module), Module>,
    known: &mut BTreeMap<Module, Vec<Module>>,
) -> Vec<Module> {
    if let Some(chain) = known.get(module) {
        return chain.clone();
    }
    known.insert(module.clone(), Vec::new());
    let next = uses.keys().filter(|(from, _)| from == module).map(|(_, to)| chain_from(to, uses, known));
    let rest = next.max_by_key(Vec::len).unwrap_or_default();
    let chain: Vec<Module> = std::iter::once(module.clone()).chain(rest).collect();
    known.insert(module.clone(), chain.clone());
    chain
}

/// The longest chain of modules of which each uses the next.
fn longest_chain(uses: &BTreeMap<(Module, Module), Module>) -> Vec<Module> {
    let mut known = BTreeMap::new();
    uses.keys().map(|(from, _)| chain_from(from, uses, &mut known)).max_by_key(Vec::len).unwrap_or_default()
}

/// Longest chain of imports that a reader of a crate of the operator's side has to follow, modules.
const LONGEST_CHAIN: usize = 8;

#[test]
fn no_chain_of_imports_is_too_long_to_follow() {
    for member in ["deploy/cluster", "deploy/view", "deploy"] {
        let chain = longest_chain(&uses(&modules_of(member)));
        let arrows: Vec<_> = chain.iter().map(|module| module.join("::")).collect();
        println!("{member}: {} modules: {}", chain.len(), arrows.join(" -> "));
        assert!((3..=LONGEST_CHAIN).contains(&chain.len()), "{member}: {}", arrows.join(" -> "));
    }
    let code =
        [("a", "use crate::b::X; use crate::d::Y;"), ("b", "use crate::c::X;"), ("c", "use super::d;"), ("d", "")];
    let modules = code.map(|(name, code)| (vec![name.to_owned()], code.to_owned())).into();
    assert_eq!(longest_chain(&uses(&modules)), ["a", "b", "c", "d"].map(|name| vec![name.to_owned()]));
}

/// The stages of the agent's loop, in the order in which it calls them.
const STAGES: [&str; 7] = ["estimate", "diagnosis", "peers", "mission", "formation", "control", "outbox"];

/// The pairs of stages of which the first uses the second, which is called after it.
fn uses_of_later_stages(uses: &BTreeMap<(Module, Module), Module>) -> Vec<String> {
    let nth = |module: &Module| STAGES.iter().position(|stage| *module == [*stage]);
    let later = uses.iter().filter(|((from, to), _)| nth(from).zip(nth(to)).is_some_and(|(from, to)| from < to));
    later.map(|((from, to), by)| format!("{} -> {} (in {})", from.join("::"), to.join("::"), by.join("::"))).collect()
}

#[test]
fn no_stage_of_the_loop_uses_a_later_one() {
    let modules = modules_of("agent/core");
    assert!(STAGES.iter().all(|stage| modules.contains_key(&vec![(*stage).to_owned()])), "a stage has another name");
    assert_eq!(uses_of_later_stages(&uses(&modules)), Vec::<String>::new());
    let code = [("mission", "use crate::control::X;"), ("control", "use crate::mission::Y;")];
    let modules = code.map(|(name, code)| (vec![name.to_owned()], code.to_owned())).into();
    assert_eq!(uses_of_later_stages(&uses(&modules)), ["mission -> control (in mission)"]);
}

/// The names of the types that are declared at the top of modules, public or not, with the number of modules that declare one.
fn types(modules: &BTreeMap<Module, String>) -> BTreeMap<String, usize> {
    let mut found = BTreeMap::new();
    for code in modules.values() {
        let declared = |line: &str| {
            let line =
                ["pub(crate) ", "pub(super) ", "pub "].iter().find_map(|seen| line.strip_prefix(seen)).unwrap_or(line);
            let kinds = ["struct ", "enum ", "trait ", "type "];
            let name = kinds.iter().find_map(|kind| line.strip_prefix(kind))?;
            Some(name.chars().take_while(|letter| letter.is_alphanumeric()).collect::<String>())
        };
        // One module may declare a type for each operating system.
        for name in code.lines().filter_map(declared).collect::<BTreeSet<_>>() {
            *found.entry(name).or_insert(0) += 1;
        }
    }
    found
}

#[test]
fn no_two_types_of_a_crate_share_a_name() {
    for member in CRATES {
        let types = types(&modules_of(member));
        assert!(types.len() > 5, "{member}: {types:?}");
        let shared: Vec<_> = types.into_iter().filter(|(_, count)| *count > 1).collect();
        assert!(shared.is_empty(), "{member}: {shared:?}");
    }
    let twice =
        [(vec!["a".to_owned()], "pub struct Same;".to_owned()), (vec!["b".to_owned()], "enum Same {".to_owned())];
    assert_eq!(types(&twice.into()), BTreeMap::from([("Same".to_owned(), 2)]));
}

#[test]
fn paths_in_the_sources_are_read_correctly() {
    let module = |path: &str| path.split("::").map(str::to_owned).collect::<Module>();
    let code = "use crate::a::{self, b::{C, d}, E};\nuse super::super::f;\n#[cfg(test)]\nmod tests { use crate::g; }\nlet x = self::h::I;";
    let read = paths(&code_of(code));
    let expected =
        ["crate::a::self", "crate::a::b::C", "crate::a::b::d", "crate::a::E", "super::super::f", "self::h::I"];
    assert_eq!(read, expected.map(module));
    let both = [("one", "use crate::two::X;"), ("two", "fn f() { super::one::y() }"), ("three", "use super::one;")];
    let modules = both.map(|(name, code)| (module(name), code.to_owned())).into_iter().collect();
    assert_eq!(cycle_of(&uses(&modules)), Some(["one", "two", "one"].map(module).to_vec()));
}

/// The lines of `cargo tree` with these arguments, one for each package, without repetitions.
fn cargo_tree(arguments: &[&str]) -> BTreeSet<String> {
    let mut cargo = Command::new(env!("CARGO"));
    cargo.current_dir(root()).args(["tree", "--locked", "--offline", "--prefix", "none"]);
    let output = cargo.args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    text.lines().map(|line| line.trim_end_matches(" (*)").to_owned()).collect()
}

/// The names of all packages from which this one is built.
fn built_from(package: &str) -> BTreeSet<String> {
    let lines = cargo_tree(&["--edges", "normal", "--format", "{p}", "-p", package]);
    lines.iter().filter_map(|line| line.split_whitespace().next()).map(str::to_owned).collect()
}

#[test]
fn the_command_the_wheel_and_the_tests_share_one_build_of_every_dependency() {
    let with_features = |arguments: &[&str]| cargo_tree(&[&["--format", "{p} {f}"], arguments].concat());
    let of_tests = with_features(&["--workspace"]);
    // A wheel is built without network, and the page's server needs that of foxglove.
    for (package, but) in [("skein", None), ("skein-python", Some("foxglove"))] {
        let of_package = with_features(&["--edges", "normal,build", "-p", package]);
        let twice = of_package.difference(&of_tests).filter(|line| line.split_whitespace().next() != but);
        let twice: Vec<_> = twice.collect();
        assert!(of_package.len() > 100, "{of_package:?}");
        assert!(twice.is_empty(), "{package} needs these with other features than `cargo test --workspace`: {twice:?}");
    }
}

#[test]
fn the_core_and_the_lab_are_built_without_network() {
    let network = ["tokio", "zenoh", "rustls", "socket2", "skein-agent", "skein-cluster", "skein-view", "skein"];
    // The lab's terminal uses system calls; the core must not.
    let core = [&network[..], &["rustix", "libc", "skein-host"]].concat();
    let packages = [
        ("skein-common", &core[..]),
        ("skein-core", &core),
        ("skein-host", &network),
        ("skein-lab", &network),
        ("skein-python", &network),
    ];
    for (package, edges) in packages {
        let parts = built_from(package);
        assert!(parts.contains(package) && parts.contains("serde"), "{parts:?}");
        let wrong: Vec<_> = edges.iter().filter(|edge| parts.contains(**edge)).collect();
        assert!(wrong.is_empty(), "{package} is built from {wrong:?}");
    }
    assert!(built_from("skein-agent").contains("zenoh"), "cargo names what a package is built from");
}

#[test]
fn agents_know_nothing_of_operations_and_the_cluster_nothing_of_the_page() {
    let packages = [
        ("skein-agent", &["skein-lab", "skein-cluster", "skein-view", "skein"][..]),
        ("skein-cluster", &["skein-view", "skein"]),
        ("skein-view", &["skein"]),
    ];
    for (package, later) in packages {
        let parts = built_from(package);
        let wrong: Vec<_> = later.iter().filter(|later| parts.contains(**later)).collect();
        assert!(parts.contains("skein-core") && wrong.is_empty(), "{package} is built from {wrong:?}");
    }
}

#[test]
fn every_text_for_stdout_passes_through_one_place() {
    for member in ["agent/host", "agent", "deploy/lab", "deploy/cluster", "deploy/view", "deploy"] {
        let modules = modules_of(member);
        let prints = |code: &str| {
            code.match_indices("print").any(|(at, _)| {
                let is_name = code[..at].ends_with(|letter: char| letter.is_alphanumeric() || letter == '_');
                !is_name && ["print!(", "println!("].iter().any(|call| code[at..].starts_with(call))
            })
        };
        assert!(prints("println!(\"a\")") && !prints("eprintln!(\"a\")"));
        let wrong: Vec<_> =
            modules.iter().filter(|(_, code)| prints(code)).map(|(module, _)| module.join("::")).collect();
        assert!(wrong.is_empty(), "{member}: {wrong:?} print past skein_lab::terminal, where an error is noticed");
    }
}
