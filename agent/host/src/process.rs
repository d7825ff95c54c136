//! Options for starting child processes.

use std::process::Command;

/// Puts the child into a process group of its own, so that it does not get the terminal's Ctrl-C. Only Unix has such
/// groups.
pub fn in_own_group(command: &mut Command) {
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(command, 0);
    #[cfg(not(unix))]
    let _ = command;
}
