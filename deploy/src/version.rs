//! The lines of `skein --version` and `skein -V`.

use std::sync::LazyLock;

use skein_lab::{REVISION, TARGET, VERSION, ZENOH};

use skein_cluster::program::Program;

/// Version and revision, for `-V`: one line.
pub fn line() -> &'static str {
    static LINE: LazyLock<String> = LazyLock::new(|| format!("{VERSION} ({REVISION})"));
    &LINE
}

/// The lines of `--version`: how this program was built, and the C library that its own file asks for.
pub fn details() -> String {
    // The symbol versions in the file decide where it runs: the target does not name them.
    let c_library = match Program::read(None) {
        Ok(Program { glibc: Some((major, minor)), .. }) => format!("glibc {major}.{minor} or newer"),
        Ok(_) => "not the GNU C library".to_owned(),
        Err(_) => "unknown: the program's own file cannot be read".to_owned(),
    };
    format!("skein {VERSION}\nrevision   {REVISION}\ntarget     {TARGET}\nC library  {c_library}\nZenoh      {ZENOH}\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_version_names_revision_target_c_library_and_zenoh() {
        let details = details();
        let value = |name: &str| details.lines().find_map(|line| line.strip_prefix(name)).map(str::trim);
        assert_eq!(value("skein"), Some(env!("CARGO_PKG_VERSION")));
        assert!(
            value("revision").is_some_and(|revision| line().contains(revision) && revision != "unknown"),
            "{details}"
        );
        assert!(value("target").is_some_and(|target| target.starts_with(std::env::consts::ARCH)), "{details}");
        if cfg!(target_env = "gnu") {
            assert!(value("C library").is_some_and(|wanted| wanted.starts_with("glibc 2.")), "{details}");
        }
        // Routing changed silently between minor releases, so that the manifest names one version.
        let manifest = include_str!("../../Cargo.toml");
        let zenoh = value("Zenoh").map(|version| format!("zenoh = {{ version = \"={version}\""));
        assert!(zenoh.is_some_and(|pinned| manifest.contains(&pinned)), "{details}");
    }
}
