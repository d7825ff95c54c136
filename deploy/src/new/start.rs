//! The files of each kind of start.

use std::path::Path;

use skein_agent::plant::xplane::discovery::FoundSimulator;
use skein_cluster::simulators::survey::version_text;
use skein_common::scenario::Source;
use skein_core::aircraft::Aircraft;
use skein_lab::error::Error;
use skein_lab::shipped::{self, CLUSTER, HOVER, LAWS, MATLAB_STUDY, TABLE_READER};

use super::discover;
use super::{Language, Name, NewKind, ScriptLanguage};

/// A file to be written.
#[derive(Clone, Debug)]
pub(super) struct NewFile {
    /// Its path from the working directory.
    pub(super) path: String,
    /// Its text.
    pub(super) text: String,
    /// A short description of it.
    pub(super) about: &'static str,
    /// Whether it can be run.
    pub(super) is_program: bool,
}

impl NewFile {
    fn new(path: impl Into<String>, text: impl Into<String>, about: &'static str) -> Self {
        Self { path: path.into(), text: text.into(), about, is_program: false }
    }
}

/// The files of a start, and the commands that use them.
#[derive(Clone, Debug)]
pub(super) struct Start {
    pub(super) files: Vec<NewFile>,
    pub(super) next: Vec<(String, &'static str)>,
}

impl Start {
    /// The start for this kind.
    ///
    /// # Errors
    /// If it is made of a scenario that is not shipped, or no X-Plane is found.
    pub(super) fn of(kind: &NewKind) -> Result<Self, Error> {
        Ok(match kind {
            NewKind::Scenario { name, from } => scenario(name, from)?,
            NewKind::Law { name, lang, source } => law(name, *lang, source.as_deref()),
            NewKind::Aircraft { name } => aircraft(name),
            NewKind::Cluster { name, discover: false, .. } => cluster(name),
            NewKind::Cluster { name, wait, .. } => found_cluster(name, &discover::listen(*wait)?),
            NewKind::Study { name, lang: ScriptLanguage::Sh } => study(name),
            NewKind::Study { name, lang: ScriptLanguage::Python } => study_in_python(name),
            NewKind::Study { name, lang: ScriptLanguage::Matlab } => study_in_matlab(name),
        })
    }
}

fn scenario(name: &Name, from: &str) -> Result<Start, Error> {
    let shipped = shipped::find(from)?;
    let file = format!("{name}.toml");
    let check = (format!("skein check {file}"), "every value and where it comes from");
    let next = std::iter::once(check).chain(study_and_fly(&file)).collect();
    Ok(Start { files: vec![NewFile::new(file, renamed(&shipped, name), "the scenario")], next })
}

/// The text of a shipped scenario with this name in it.
fn renamed(shipped: &Source<'static>, name: &Name) -> String {
    let line = |line: &str| match line.starts_with("name = ") {
        true => format!("name = \"{name}\"\n"),
        false => format!("{line}\n"),
    };
    shipped.text.lines().map(line).collect()
}

fn law(name: &Name, lang: Language, source: Option<&Path>) -> Start {
    let file = format!("{name}.toml");
    let [ring_py, ring_m, goto_tcp] = LAWS;
    let external = |transport: String, parameters: &str| {
        format!(
            "# Four helicopters under a law of your own.\nname = \"{name}\"\nduration_s = 400\n\n[swarm]\nvehicles = 4\n\n\
             [formation]\nlaw = \"external\"\nradius_m = 100\naltitude_m = 30\n\n[formation.external]\n{transport}\n\
             period_s = 0.1                              # time between two questions to the law\n\
             fallback = \"ring\"                           # flies while the law does not answer\n\
             parameters = {parameters}\n"
        )
    };
    let ring = "{ inner_width_m = 20, outer_width_m = 20 }";
    let (law, scenario) = match lang {
        Language::Python | Language::Octave => {
            let (program, file, text, space) = match lang {
                Language::Python => ("\"python3\"", format!("{name}.py"), ring_py.text, "        "),
                _ => ("\"octave-cli\", \"--quiet\"", format!("{name}.m"), ring_m.text, "    "),
            };
            let command = format!("command = [{program}, \"{file}\"]{space}# a process for each vehicle");
            (NewFile::new(file, text, "the law: the shipped ring, to be changed"), external(command, ring))
        }
        Language::Matlab => {
            let listen = "listen = \"tcp/127.0.0.1:5600\"              # Matlab connects; in a study one program serves all vehicles";
            let law = NewFile::new(format!("{name}.m"), goto_tcp.text, "the law: every vehicle flies to the centre");
            (law, external(listen.to_owned(), "{ gain = 0.3 }"))
        }
        Language::Rust => return rust_law(name, source.unwrap_or(Path::new(""))),
    };
    let mut next = study_and_fly(&file).to_vec();
    if lang == Language::Matlab {
        next[0].1 = "in virtual time; it waits until the law runs";
        next[1].1 = "in real time; then run the law once for each vehicle, with its id in it";
        next.insert(1, (format!("run {name}.m in Matlab"), "the law, which connects to the study on port 5600"));
    }
    Start { files: vec![law, NewFile::new(file, scenario, "a scenario that flies it")], next }
}

/// The commands that fly a scenario.
fn study_and_fly(file: &str) -> [(String, &'static str); 2] {
    [(format!("skein study {file} --seeds 0..5"), "in virtual time"), (format!("skein fly {file}"), "in real time")]
}

fn rust_law(name: &Name, source: &Path) -> Start {
    let source = std::path::absolute(source).unwrap_or_else(|_| source.to_owned());
    let lab = toml::Value::from(source.join("deploy").join("lab").display().to_string());
    let manifest = format!(
        "[package]\nname = \"{name}\"\nversion = \"0.1.0\"\nedition = \"2024\"\n\n[workspace]\n\n[dependencies]\n\
         # `skein = {{ path = \"...\" }}` beside it also flies in real time: see the book, \"A law in Rust\".\n\
         skein-lab = {{ path = {lab} }}\n"
    );
    let main = include_str!("../../../tests/own-law/src/main.rs").replace("\"pursuit\"", &format!("\"{name}\""));
    let scenario = format!(
        "# Four helicopters under a law of your own.\nname = \"{name}\"\nduration_s = 400\n\n[swarm]\nvehicles = 4\n\n\
         [formation]\nlaw = \"{name}\"\nradius_m = 100\naltitude_m = 30\n\n[formation.parameters]              # the law's own\n\
         speed_m_s = 3.0\n"
    );
    let files = vec![
        NewFile::new(format!("{name}/Cargo.toml"), manifest, "a program with this law"),
        NewFile::new(format!("{name}/src/main.rs"), main, "the law: pursuit on a circle, to be changed"),
        NewFile::new(format!("{name}/{name}.toml"), scenario, "a scenario that flies it"),
    ];
    let fly = format!("cd {name} && cargo run --release -- study {name}.toml --seeds 0..5");
    Start { files, next: vec![(fly, "in virtual time")] }
}

fn aircraft(name: &Name) -> Start {
    let (_, aircraft) = Aircraft::SHIPPED[0];
    let scenario = format!("{name}-hover");
    let swarm = format!("[swarm]\naircraft = \"{name}\"            # {name}.toml beside this file\n");
    let text = HOVER.text.replace("name = \"hover\"", &format!("name = \"{scenario}\"")).replace("[swarm]\n", &swarm);
    let file = format!("{scenario}.toml");
    let next = study_and_fly(&file).to_vec();
    let files = vec![
        NewFile::new(format!("{name}.toml"), aircraft, "the aircraft: the shipped X-Cell .60, to be changed"),
        NewFile::new(file, text, "a scenario that flies it"),
    ];
    Start { files, next }
}

/// The commands that bring a cluster into the air.
fn cluster_commands() -> Vec<(String, &'static str)> {
    vec![
        ("skein cluster keys".to_owned(), "the certificates"),
        ("skein check -f cluster.toml".to_owned(), "what would stop a flight"),
        ("skein cluster install".to_owned(), "the program on every node"),
        ("skein cluster up".to_owned(), "start"),
    ]
}

fn cluster(name: &Name) -> Start {
    let text = CLUSTER.text.replace("swarm = \"lab\" ", &format!("swarm = \"{name}\" "));
    let text = text.replace("scenario = \"scenarios/hover.toml\"  ", "scenario = \"hover.toml\"            ");
    let files = vec![
        NewFile::new("cluster.toml", text, "the cluster file: put your hosts in"),
        NewFile::new(HOVER.name, HOVER.text, "the scenario that it flies"),
    ];
    Start { files, next: cluster_commands() }
}

fn found_cluster(name: &Name, found: &[FoundSimulator]) -> Start {
    let mut text = format!(
        "# A cluster: the host of each vehicle, one for each X-Plane that was found. Each `xplane` is where X-Plane\n\
         # runs. Its agent may run on another PC: put that PC in as `host`, and keep `xplane`.\n\
         swarm = \"{name}\"                             # namespace of all traffic, name of the service\n\
         scenario = \"hover.toml\"                     # from this file's folder\n\n\
         [defaults]                                  # any key of a node\nplant = \"xplane\"\n\
         # user = \"lab\"                              # login name; default: that of ssh's own configuration\n"
    );
    for (nth, xplane) in found.iter().enumerate() {
        let FoundSimulator { address, port, computer, .. } = xplane;
        let version = version_text(xplane.version);
        text += &format!(
            "\n[node.{}]                                    # X-Plane {version} on {computer}\nhost = \"{address}\"\n\
             xplane = \"{address}:{port}\"                 # as seen from the node, which may be another PC\n",
            nth + 1
        );
    }
    let scenario = HOVER.text.replace("vehicles = 4 ", &format!("vehicles = {} ", found.len()));
    let scenario = scenario.replace("# ids 1..4;", &format!("# ids 1..{};", found.len()));
    let files = vec![
        NewFile::new("cluster.toml", text, "the cluster file: a node for each X-Plane that was found"),
        NewFile::new(HOVER.name, scenario, "the scenario that it flies"),
    ];
    Start { files, next: cluster_commands() }
}

fn study(name: &Name) -> Start {
    let text = format!(
        "#!/bin/sh\n# A study of the shipped hover formation: how much loss on the network does it bear?\nset -eu\n\n\
         # Twenty seeds at each of three losses. A second start of an interrupted study continues it.\n\
         skein study hover --seeds 0..20 --sweep network.loss=0,0.1,0.3 --out {name}\n\n\
         # The same without the safety filter, and the two side by side, seed by seed. `compare` ends with status 1 if\n\
         # a figure is worse.\n\
         skein study hover --seeds 0..20 --sweep network.loss=0,0.1,0.3 --set formation.safety_filter=none --out {name}-bare\n\
         skein compare {name} {name}-bare || true\n\n\
         # Pictures and tables on one page.\nskein report {name}\n"
    );
    let script = NewFile { is_program: true, ..NewFile::new(format!("{name}.sh"), text, "the study") };
    Start { next: vec![(format!("./{name}.sh"), "fly it")], files: vec![script] }
}

/// The script of the Python package's examples, under this name.
fn study_in_python(name: &Name) -> Start {
    let text =
        include_str!("../../python/examples/study.py").replace("NAME = \"study\"", &format!("NAME = \"{name}\""));
    let script = NewFile { is_program: true, ..NewFile::new(format!("{name}.py"), text, "the study") };
    let next = vec![
        (format!("python3 {name}.py --seeds 6"), "a first look, with the package skein-swarm"),
        (format!("python3 {name}.py"), "fly it"),
    ];
    Start { next, files: vec![script] }
}

/// The shipped script for Matlab and Octave, under this name. A hyphen cannot be part of a script's name there.
fn study_in_matlab(name: &Name) -> Start {
    let script = name.to_string().replace('-', "_");
    let text = MATLAB_STUDY.text.replace("study.m", &format!("{script}.m"));
    let text = text.replace("`study` in Matlab", &format!("`{script}` in Matlab"));
    let text = text.replace("name = 'study';", &format!("name = '{name}';"));
    let files = vec![
        NewFile::new(format!("{script}.m"), text, "the study"),
        NewFile::new(TABLE_READER.name, TABLE_READER.text, "reads tables of studies and recordings"),
    ];
    let next = vec![
        (format!("octave-cli {script}.m"), "fly it from Octave"),
        (format!("matlab -batch {script}"), "or from Matlab"),
    ];
    Start { next, files }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cluster_has_a_node_for_each_x_plane_that_was_found() {
        let found = |last: u8, port: u16| FoundSimulator {
            address: [10, 0, 0, last].into(),
            port,
            version: 121_400,
            computer: "heli".to_owned(),
            interface: None,
        };
        let start = found_cluster(&"mine".parse().unwrap(), &[found(11, 49_000), found(12, 49_010)]);
        let folder = tempfile::tempdir().unwrap();
        super::super::write(folder.path(), &start).unwrap();
        let cluster = skein_cluster::inventory::Inventory::read(&folder.path().join("cluster.toml")).unwrap();
        let nodes: Vec<_> =
            cluster.nodes.values().map(|node| (node.address.as_str(), node.xplane.as_deref().unwrap())).collect();
        assert_eq!(nodes, [("10.0.0.11", "10.0.0.11:49000"), ("10.0.0.12", "10.0.0.12:49010")]);
        assert_eq!(cluster.swarm.as_str(), "mine");
    }

    #[test]
    fn a_law_in_rust_names_the_source_that_it_is_compiled_with() {
        let start = law(&"mine".parse().unwrap(), Language::Rust, Some(Path::new("/src/skein")));
        assert!(
            start.files[0].text.contains("skein-lab = { path = \"/src/skein/deploy/lab\" }"),
            "{:?}",
            start.files[0]
        );
        assert!(start.files[1].text.contains("with(\"mine\", Pursuit::make)"));
    }
}
