//! Installs and removes a node's files. Whenever it is interrupted, what would run next is complete, and the same
//! request finishes the work.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use super::files::{self, at};
use super::node::{self, ACTIVE, CURRENT, INSTALLS, NodeFolder, PREVIOUS, SETTINGS, Settings, install_name, linked};
use super::place::{LAUNCHER, PROGRAM, SwarmFolder};
use crate::bundle::{Bundle, BundleFile};
use crate::os;
use crate::protocol::Installed;

/// Installs these files with the program of this release, for the next start. Returns whether anything was written.
pub(super) fn apply(
    place: &SwarmFolder,
    node: &NodeFolder,
    bundle: &Bundle,
    settings: &Settings,
) -> Result<bool, String> {
    check(bundle)?;
    let installed = Installed { release: place.release.clone(), bundle: bundle.id() };
    let program = place.releases().join(&installed.release).join(PROGRAM);
    if !program.is_file() {
        return Err(format!("{}: this program does not exist", program.display()));
    }
    let mut changed = write_install(node, &installed, bundle)?;
    if node.settings().as_ref() != Some(settings) {
        node.write(SETTINGS, settings)?;
        changed = true;
    }
    let current = linked(&node.file(CURRENT));
    if current.as_ref() != Some(&installed) {
        if let Some(current) = current {
            files::link(&node.file(PREVIOUS), &link_to(&current))?;
        }
        files::link(&node.file(CURRENT), &link_to(&installed))?;
        changed = true;
    }
    if cfg!(windows) {
        let text = format!("@\"%~dp0releases\\{}\\{PROGRAM}\" %*\r\n", place.release);
        files::write(&place.folder.join(LAUNCHER), text.as_bytes(), false)?;
    }
    prune(place, node)?;
    Ok(changed)
}

/// Switches back to what was installed before, for the next start.
pub(super) fn rollback(node: &NodeFolder) -> Result<(), String> {
    let (current, previous) = (linked(&node.file(CURRENT)), linked(&node.file(PREVIOUS)));
    let Some((current, previous)) = current.zip(previous).filter(|(current, previous)| current != previous) else {
        return Err(format!("node {} has no earlier version to go back to", node.id));
    };
    files::link(&node.file(CURRENT), &link_to(&previous))?;
    files::link(&node.file(PREVIOUS), &link_to(&current))
}

/// Removes the node's folder, what no other node of this host needs, and folders that are empty then. Returns whether
/// the node existed. The agent must have ended, and the node's lock be held.
pub(super) fn remove(place: &SwarmFolder, node: &NodeFolder) -> Result<bool, String> {
    let _shared = place.lock()?;
    let was_there = node.path.exists();
    place.set_aside(&node.lock_path())?;
    // First remove the links that mark the node as installed.
    for path in [node.file(CURRENT), node.file(PREVIOUS), node.path.clone()] {
        files::remove(&path).map_err(at(&path))?;
    }
    let is_last = !files::entries(&place.folder).iter().any(|path| is_node(path));
    if !is_last {
        prune_releases(place, None)?;
        return Ok(was_there);
    }
    // The program that runs here.
    place.set_aside(&place.releases().join(&place.release).join(PROGRAM))?;
    place.set_aside(&place.lock_path())?;
    for path in [place.lock_path(), place.releases(), place.folder.join(LAUNCHER)] {
        files::remove(&path).map_err(at(&path))?;
    }
    // Files of others stay, and so do the folders that contain them.
    let parents = [Some(place.folder.as_path()), place.folder.parent()];
    let _ = parents.into_iter().flatten().try_for_each(fs::remove_dir);
    Ok(was_there)
}

/// Checks that all paths are plain names with `/` between them, and none is reserved.
fn check(bundle: &Bundle) -> Result<(), String> {
    let is_plain = |name: &str| {
        let is_odd = |c: char| c.is_control() || c == '\\' || c == ':';
        !name.is_empty() && name != "." && name != ".." && !name.contains(is_odd)
    };
    let is_ours = |path: &str| path == PROGRAM || path.starts_with("skein/");
    match bundle.files.keys().find(|path| is_ours(path) || !path.split('/').all(is_plain)) {
        Some(path) => Err(format!("{path:?} cannot be a file of a node")),
        None => Ok(()),
    }
}

/// Target of a node's link to an install.
fn link_to(installed: &Installed) -> PathBuf {
    Path::new("installs").join(install_name(installed))
}

/// Writes the install, unless it is complete already. Returns whether anything was written.
fn write_install(node: &NodeFolder, installed: &Installed, bundle: &Bundle) -> Result<bool, String> {
    let path = node.install(installed);
    if is_whole(&path, bundle) {
        return Ok(false);
    }
    let draft = files::draft(&path);
    files::remove(&draft).map_err(at(&draft))?;
    // The draft, and every folder between it and one of its files.
    let mut folders = BTreeSet::from([draft.clone()]);
    for name in bundle.files.keys() {
        let above = draft.join(name).ancestors().skip(1).map(Path::to_owned).collect::<Vec<_>>();
        folders.extend(above.into_iter().take_while(|folder| *folder != draft));
    }
    node::make_folders(&Vec::from_iter(folders.iter().cloned()))?;
    for (name, file) in &bundle.files {
        let path = draft.join(name);
        files::write_through(&path, &file.content, mode(file)).map_err(at(&path))?;
    }
    let program = Path::new("../../../releases").join(&installed.release).join(PROGRAM);
    files::new_link(&program, &draft.join(PROGRAM)).map_err(at(&draft))?;
    folders.iter().try_for_each(|folder| files::sync(&folder.join(PROGRAM))).map_err(at(&draft))?;
    // The name identifies the contents, so an existing folder that is not complete is damaged.
    let damaged = files::draft(&draft);
    if path.exists() {
        files::remove(&damaged).and_then(|()| files::rename(&path, &damaged)).map_err(at(&damaged))?;
    }
    files::rename(&draft, &path).and_then(|()| files::sync(&path)).map_err(at(&path))?;
    files::remove(&damaged).map_err(at(&damaged))?;
    Ok(true)
}

fn mode(file: &BundleFile) -> u32 {
    match (file.is_secret, file.is_executable) {
        (true, _) => 0o600,
        (false, true) => 0o755,
        (false, false) => 0o644,
    }
}

/// Whether every file exists with its contents and mode, and the program too.
fn is_whole(path: &Path, bundle: &Bundle) -> bool {
    let is_there = |(name, file): (&String, &BundleFile)| {
        let path = path.join(name);
        fs::read(&path).is_ok_and(|content| content == file.content) && os::has_mode(&path, mode(file))
    };
    path.join(PROGRAM).is_file() && bundle.files.iter().all(is_there)
}

/// Removes installs and releases that are not needed, and drafts.
fn prune(place: &SwarmFolder, node: &NodeFolder) -> Result<(), String> {
    let running = node.agent().and_then(|_| linked(&node.file(ACTIVE)));
    let needed = [linked(&node.file(CURRENT)), linked(&node.file(PREVIOUS)), running];
    for path in files::entries(&node.file(INSTALLS)) {
        let installed = node::installed(&path);
        if installed.is_none() || !needed.contains(&installed) {
            files::remove(&path).map_err(at(&path))?;
        }
    }
    // Drafts were left by a crash, because no other request is running.
    let drafts = files::entries(&node.path).into_iter().filter(|path| files::is_draft(path));
    drafts.into_iter().try_for_each(|path| files::remove(&path).map_err(at(&path)))?;
    let _shared = place.lock()?;
    prune_releases(place, Some(&place.release))
}

/// Removes the releases that no install of any node needs. A release without a program is just being copied.
fn prune_releases(place: &SwarmFolder, also: Option<&str>) -> Result<(), String> {
    let nodes = files::entries(&place.folder).into_iter().filter(|path| is_node(path));
    let installs = nodes.flat_map(|node| files::entries(&node.join("installs")));
    let needed: BTreeSet<_> = installs.filter_map(|path| Some(node::installed(&path)?.release)).collect();
    for path in files::entries(&place.releases()) {
        let is_needed = files::name(&path).is_some_and(|name| needed.contains(name) || also == Some(name));
        if !is_needed && path.join(PROGRAM).exists() {
            files::remove(&path).map_err(at(&path))?;
        }
    }
    Ok(())
}

fn is_node(path: &Path) -> bool {
    files::name(path).is_some_and(|name| name.starts_with("node-"))
}

#[cfg(test)]
#[cfg(unix)]
mod tests;
