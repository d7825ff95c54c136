//! Options for starting child processes.

use std::process::Command;

/// The child has no console (`CREATE_NO_WINDOW`).
#[cfg(windows)]
const NO_CONSOLE: u32 = 0x0800_0000;
/// A process group of its own (`CREATE_NEW_PROCESS_GROUP`).
#[cfg(windows)]
const OWN_GROUP: u32 = 0x0000_0200;
/// Outside of the job of this process (`CREATE_BREAKAWAY_FROM_JOB`).
#[cfg(windows)]
const OUTSIDE_JOB: u32 = 0x0100_0000;

/// Keeps the terminal's Ctrl-C from the child: puts it into a process group of its own, on Windows also apart from the console, whose
/// end would end it within seconds.
pub fn in_own_group(command: &mut Command) {
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(command, 0);
    #[cfg(windows)]
    std::os::windows::process::CommandExt::creation_flags(command, OWN_GROUP | NO_CONSOLE);
}

/// Lets the child outlive the session in which it is started. On Windows the server of ssh ends all processes of a session's job but
/// those that have left it; on Unix the child leaves its session itself.
pub fn outlives_session(command: &mut Command) {
    #[cfg(unix)]
    let _ = command;
    #[cfg(windows)]
    std::os::windows::process::CommandExt::creation_flags(command, OWN_GROUP | NO_CONSOLE | OUTSIDE_JOB);
}
