//! Writes the files of a node without ssh into a folder, to be carried there.

use std::fs;
use std::io;
use std::path::Path;

use super::row::{InstalledNode, UNCHANGED};
use super::{InstallArgs, Payload};
use crate::bundle::BundleFile;
use crate::inventory::Node;
use crate::nodes::ChosenNodes;
use crate::os;
use skein_host::atomic_file::{self, Durability};

/// Writes the folder of a node, with everything that it needs.
pub(super) fn write(args: &InstallArgs, chosen: &ChosenNodes, node: &Node, given: Option<&Payload>) -> InstalledNode {
    let mut row = InstalledNode::new(node);
    let Some(given) = given else {
        row.outcome.note = Some("installed by hand: bring back by hand what it had".to_owned());
        return row;
    };
    let folder = args.out.join(format!("node-{}", node.id.dashed()));
    match write_all(&folder, chosen, node, given, args.dry_run) {
        Ok(changed) => {
            row.outcome.done = if changed { "written" } else { UNCHANGED };
            row.outcome.runs = Some(given.installed());
            row.outcome.note = Some(format!("carry {} there, see its README.txt", folder.display()));
        }
        Err(error) => row.outcome.fail(format!("{}: {error}", folder.display())),
    }
    row
}

fn write_all(folder: &Path, chosen: &ChosenNodes, node: &Node, given: &Payload, dry_run: bool) -> io::Result<bool> {
    let is_windows = given.program.bytes.starts_with(b"MZ");
    let name = if is_windows { "skein.exe" } else { "skein" };
    let file = |content: &[u8], is_executable| BundleFile { is_secret: false, is_executable, content: content.into() };
    let mut files = given.bundle.files.clone();
    files.insert("README.txt".to_owned(), file(readme(chosen, node, name).as_bytes(), false));
    if node.binary.is_some() {
        files.insert(name.to_owned(), file(&given.program.bytes, true));
    }
    let mut changed = false;
    for (path, file) in files {
        let path = folder.join(path);
        if fs::read(&path).is_ok_and(|there| there == file.content) {
            continue;
        }
        changed = true;
        if !dry_run {
            os::private_folder(folder)?;
            path.parent().map_or(Ok(()), fs::create_dir_all)?;
            atomic_file::write(&path, &file.content, Durability::of(file.is_secret))?;
            if file.is_executable {
                os::set_mode(&path, if file.is_secret { 0o700 } else { 0o755 })?;
            }
        }
    }
    Ok(changed)
}

fn readme(chosen: &ChosenNodes, node: &Node, program: &str) -> String {
    let swarm = &chosen.inventory.swarm;
    let (id, address, port) = (node.id, &node.address, node.port);
    let own = match node.binary {
        Some(_) => String::new(),
        None => format!(
            "Put the program `{program}` for its platform in here: `binary` in the cluster's file would have.\n"
        ),
    };
    let (dot, elsewhere) = match (program, &node.binary) {
        ("skein", Some(_)) => ("./", ""),
        // The program for its platform is not known here.
        ("skein", None) => {
            ("./", "On Windows the program is `skein.exe`, and the commands begin with `.\\skein.exe`.\n\n")
        }
        _ => (".\\", ""),
    };
    format!(
        "Node {id} of the swarm {swarm}. Carry this folder to the PC at {address}: it holds a secret key, so only \
         that PC's operator may read it there.\n{own}\n\
         Peers reach it at {address}, TCP port {port}: open that port in its firewall.\n\n\
         `skein cluster up` prints a number for the run that it begins. In this folder, with that number:\n\n    \
         {dot}{program} agent --config agent.toml --run RUN\n\n\
         {elsewhere}It becomes active once it is in contact with the others, and ends when it has landed. It takes orders over \
         the network like every other; Ctrl-C lands it.\n\n    \
         {dot}{program} cluster status -f cluster.toml\n\n\
         shows the swarm from there.\n"
    )
}
