//! The X-Planes that are installed on this PC, according to the files that X-Plane's installer keeps for each user.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};

/// Names of the installer's file, of the newest version first: a line for each folder.
const FILES: [&str; 2] = ["x-plane_install_12.txt", "x-plane_install_11.txt"];

/// The folders of the installed X-Planes that still exist.
pub(super) fn folders() -> Vec<PathBuf> {
    places().iter().flat_map(|place| listed(place)).collect()
}

/// The folders in which the installer keeps its file, on the three systems on which X-Plane runs.
fn places() -> Vec<PathBuf> {
    let below = |variable: &str, folder: &str| env::var_os(variable).map(|path| PathBuf::from(path).join(folder));
    let all = if cfg!(windows) {
        [below("LOCALAPPDATA", ""), None]
    } else {
        [below("HOME", ".x-plane"), below("HOME", "Library/Preferences")]
    };
    all.into_iter().flatten().collect()
}

fn listed(place: &Path) -> Vec<PathBuf> {
    let texts = FILES.iter().filter_map(|name| fs::read(place.join(name)).ok());
    let lines = |text: Vec<u8>| {
        String::from_utf8_lossy(&text).lines().map(|line| PathBuf::from(line.trim())).collect::<Vec<_>>()
    };
    texts.flat_map(lines).filter(|folder| folder.is_absolute() && folder.is_dir()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_that_exist_are_found_and_others_are_left_out() {
        let place = tempfile::tempdir().unwrap();
        assert_eq!(listed(place.path()), Vec::<PathBuf>::new());
        let (new, old) = (place.path().join("X-Plane 12"), place.path().join("X-Plane 11"));
        for folder in [&new, &old] {
            fs::create_dir(folder).unwrap();
        }
        let gone = place.path().join("gone");
        fs::write(place.path().join(FILES[0]), format!("{}/\r\n{}\r\n\r\n", new.display(), gone.display())).unwrap();
        fs::write(place.path().join(FILES[1]), format!("{}\n", old.display())).unwrap();
        assert_eq!(listed(place.path()), [new, old]);
    }
}
