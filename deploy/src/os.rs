//! What differs between operating systems: signals, process groups, whose a folder is. Elsewhere than on Unix a plain
//! alternative serves.

use std::io;
use std::path::Path;
use std::process::{Child, Command, ExitStatus};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use tokio::runtime::Runtime;

/// Counts how often this process was asked to end.
#[derive(Debug)]
pub struct Interrupts {
    count: Arc<AtomicU32>,
    /// Listens; ends with this value.
    _runtime: Runtime,
}

impl Interrupts {
    /// From now on Ctrl-C, and on Unix SIGTERM and SIGHUP, are counted and end nothing.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn listen() -> io::Result<Self> {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
        let count = Arc::new(AtomicU32::new(0));
        let _inside = runtime.enter();
        imp::on_interrupt(&count)?;
        Ok(Self { count, _runtime: runtime })
    }

    /// How often so far.
    pub fn count(&self) -> u32 {
        self.count.load(Relaxed)
    }

    /// As if it had been asked once more: the Ctrl-C of a terminal that hands keys out one by one.
    pub fn add(&self) {
        self.count.fetch_add(1, Relaxed);
    }
}

/// Ctrl-C at the terminal is not to reach this child.
pub fn in_own_group(command: &mut Command) {
    imp::in_own_group(command);
}

/// How a process ended, in words.
pub fn how_it_ended(status: ExitStatus) -> String {
    match (status.code(), imp::signal(status)) {
        (Some(0), _) => "ended".to_owned(),
        (Some(code), _) => format!("ended with exit status {code}"),
        (None, Some(signal)) => format!("killed by signal {signal}"),
        (None, None) => "killed".to_owned(),
    }
}

/// Whether processes can be made to stand still here.
pub const CAN_FREEZE: bool = cfg!(unix);

/// Makes a child stand still, or lets it go on.
///
/// # Errors
/// If the system cannot, or the child is gone.
pub fn freeze(child: &Child, frozen: bool) -> io::Result<()> {
    imp::freeze(child, frozen)
}

/// Makes a folder that is only this user's, or makes sure that it is.
///
/// # Errors
/// If it cannot be made, or is somebody else's.
pub fn private_folder(path: &Path) -> io::Result<()> {
    imp::private_folder(path)
}

/// Names the user in a file's name.
pub fn user_name() -> String {
    imp::user_name()
}

#[cfg(unix)]
mod imp {
    use std::fs;
    use std::io;
    use std::os::unix::fs::{DirBuilderExt, MetadataExt};
    use std::os::unix::process::{CommandExt, ExitStatusExt};
    use std::path::Path;
    use std::process::{Child, Command, ExitStatus};
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

    use rustix::process::{Pid, Signal, kill_process};
    use tokio::signal::unix::SignalKind;

    pub(super) fn on_interrupt(count: &Arc<AtomicU32>) -> io::Result<()> {
        for kind in [SignalKind::interrupt(), SignalKind::terminate(), SignalKind::hangup()] {
            let mut asked = tokio::signal::unix::signal(kind)?;
            let count = count.clone();
            tokio::spawn(async move {
                while asked.recv().await.is_some() {
                    count.fetch_add(1, Relaxed);
                }
            });
        }
        Ok(())
    }

    pub(super) fn in_own_group(command: &mut Command) {
        command.process_group(0);
    }

    pub(super) fn signal(status: ExitStatus) -> Option<i32> {
        status.signal()
    }

    pub(super) fn freeze(child: &Child, frozen: bool) -> io::Result<()> {
        Ok(kill_process(Pid::from_child(child), if frozen { Signal::STOP } else { Signal::CONT })?)
    }

    pub(super) fn private_folder(path: &Path) -> io::Result<()> {
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent)?;
        }
        match fs::DirBuilder::new().mode(0o700).create(path) {
            Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(error),
            _ => {}
        }
        let found = fs::symlink_metadata(path)?;
        if found.is_dir() && found.uid() == rustix::process::getuid().as_raw() {
            return Ok(());
        }
        Err(io::Error::new(io::ErrorKind::PermissionDenied, format!("{} is not this user's folder", path.display())))
    }

    pub(super) fn user_name() -> String {
        rustix::process::getuid().as_raw().to_string()
    }
}

#[cfg(not(unix))]
mod imp {
    use std::io;
    use std::path::Path;
    use std::process::{Child, Command, ExitStatus};
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

    pub(super) fn on_interrupt(count: &Arc<AtomicU32>) -> io::Result<()> {
        let count = count.clone();
        tokio::spawn(async move {
            while tokio::signal::ctrl_c().await.is_ok() {
                count.fetch_add(1, Relaxed);
            }
        });
        Ok(())
    }

    pub(super) fn in_own_group(_command: &mut Command) {}

    pub(super) fn signal(_status: ExitStatus) -> Option<i32> {
        None
    }

    pub(super) fn freeze(_child: &Child, _frozen: bool) -> io::Result<()> {
        Err(io::ErrorKind::Unsupported.into())
    }

    pub(super) fn private_folder(path: &Path) -> io::Result<()> {
        std::fs::create_dir_all(path)
    }

    pub(super) fn user_name() -> String {
        let name = std::env::var("USERNAME").unwrap_or_default();
        name.chars().filter(char::is_ascii_alphanumeric).collect()
    }
}
