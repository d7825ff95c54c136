//! Functions that differ between operating systems. No other file of the agent distinguishes them.

use std::io;
use std::path::Path;
use std::time::Duration;

use tokio::net::TcpStream;

#[cfg(unix)]
pub use on_unix::*;
#[cfg(windows)]
pub use on_windows::*;

/// Ends a connection when data sent on it was not acknowledged, or not accepted, for this long. Only Linux supports
/// this; on other systems Zenoh's lease ends the connection.
///
/// # Errors
/// If the system refuses the option.
#[cfg_attr(not(any(target_os = "linux", target_os = "android")), expect(unused_variables))]
pub fn set_unacknowledged_timeout(socket: &TcpStream, after: Duration) -> io::Result<()> {
    #[cfg(any(target_os = "linux", target_os = "android"))]
    socket2::SockRef::from(socket).set_tcp_user_timeout(Some(after))?;
    Ok(())
}

/// Whether users other than the owner can access this file; never where files have no such modes.
#[cfg_attr(not(unix), expect(unused_variables))]
pub fn others_can_read(path: &Path) -> bool {
    #[cfg(unix)]
    let mode = std::fs::metadata(path).map_or(0, |about| std::os::unix::fs::MetadataExt::mode(&about));
    #[cfg(not(unix))]
    let mode = 0;
    mode & 0o077 != 0
}

#[cfg(unix)]
mod on_unix {
    use std::env;
    use std::ffi::OsStr;
    use std::io;
    use std::os::unix::ffi::OsStrExt;
    use std::os::unix::net::UnixDatagram;
    use std::os::unix::process::CommandExt;
    use std::process::Command;

    use thread_priority::{
        RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
        set_thread_priority_and_policy, thread_native_id,
    };
    use tokio::signal::unix::{Signal, SignalKind, signal};

    /// Real-time priority in percent of the range: above ordinary processes, below the kernel's own threads.
    const PRIORITY: u8 = 30;

    /// Gives this thread real-time priority (SCHED_FIFO), if permitted. Returns a description of the result.
    pub fn raise_thread_priority() -> String {
        let fifo = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
        let raised = ThreadPriorityValue::try_from(PRIORITY).map_err(|what| what.to_owned()).and_then(|priority| {
            set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Crossplatform(priority), fifo)
                .map_err(|error| error.to_string())
        });
        match raised {
            Ok(()) => "real-time priority (SCHED_FIFO)".to_owned(),
            Err(error) => format!("ordinary priority (SCHED_FIFO is not permitted: {error})"),
        }
    }

    /// Locks this process's pages in memory, if permitted. Returns a description of the result.
    pub fn lock_memory() -> String {
        match try_to_lock_memory() {
            Ok(what) => what.to_owned(),
            Err(error) => format!("memory not locked ({error})"),
        }
    }

    /// Locks pages as they are touched, because otherwise every thread's whole stack would be filled. Under a limit
    /// only the pages mapped now are locked: beyond the limit an allocation would fail instead of merely being
    /// pageable.
    #[cfg(target_os = "linux")]
    fn try_to_lock_memory() -> Result<&'static str, rustix::io::Errno> {
        use rustix::mm::{MlockAllFlags, mlockall};
        use rustix::process::{Resource, getrlimit};

        let now = MlockAllFlags::CURRENT | MlockAllFlags::ONFAULT;
        if getrlimit(Resource::Memlock).current.is_none() {
            mlockall(now | MlockAllFlags::FUTURE).map(|()| "memory locked")
        } else {
            mlockall(now).map(|()| "memory mapped so far locked")
        }
    }

    #[cfg(not(target_os = "linux"))]
    fn try_to_lock_memory() -> Result<&'static str, &'static str> {
        Err("not supported on this system")
    }

    /// Restarts this program with an environment variable, if the variable is missing. Does nothing if the restart
    /// fails.
    pub fn restart_with((name, value): (&str, &str)) {
        if env::var_os(name).is_none()
            && let Ok(program) = env::current_exe()
        {
            let mut arguments = env::args_os();
            let own_name = arguments.next().unwrap_or_else(|| program.clone().into());
            // `exec` returns only if it has failed; this process then continues without the variable.
            let _ = Command::new(program).arg0(own_name).args(arguments).env(name, value).exec();
        }
    }

    /// Notifies systemd, if it has started this process and asked for notifications. Never waits.
    pub fn notify_service_manager(what: &str) {
        if let Some(socket) = env::var_os("NOTIFY_SOCKET") {
            // The agent flies on if the service manager does not receive it.
            let _ = notify(&socket, what);
        }
    }

    /// Sends a notification to a socket named by its path, or by an abstract name after an `@`.
    pub(super) fn notify(socket: &OsStr, what: &str) -> io::Result<usize> {
        let datagram = UnixDatagram::unbound()?;
        datagram.set_nonblocking(true)?;
        #[cfg(target_os = "linux")]
        if let Some(name) = socket.as_bytes().strip_prefix(b"@") {
            use std::os::linux::net::SocketAddrExt;
            let address = std::os::unix::net::SocketAddr::from_abstract_name(name)?;
            return datagram.send_to_addr(what.as_bytes(), &address);
        }
        datagram.send_to(what.as_bytes(), socket)
    }

    /// SIGINT, SIGTERM and SIGHUP (a closed terminal), which all request the end of the agent.
    pub struct Signals([Signal; 3]);

    impl Signals {
        /// Catches the signals, so that they no longer end the process. Call it within Tokio.
        ///
        /// # Errors
        /// If the system refuses.
        pub fn catch() -> io::Result<Self> {
            let kinds = [SignalKind::interrupt(), SignalKind::terminate(), SignalKind::hangup()];
            let [interrupt, terminate, hangup] = kinds.map(signal);
            Ok(Self([interrupt?, terminate?, hangup?]))
        }

        /// Waits for the next signal.
        pub async fn next(&mut self) {
            let [interrupt, terminate, hangup] = &mut self.0;
            tokio::select! {
                _ = interrupt.recv() => {}
                _ = terminate.recv() => {}
                _ = hangup.recv() => {}
            }
        }
    }
}

#[cfg(windows)]
mod on_windows {
    use std::env;
    use std::io;
    use std::net::UdpSocket;
    use std::process;

    use thread_priority::{ThreadPriority, WinAPIThreadPriority, set_current_thread_priority};
    use tokio::net::windows::named_pipe::{NamedPipeServer, ServerOptions};
    use tokio::signal::windows::{
        CtrlBreak, CtrlC, CtrlClose, CtrlLogoff, CtrlShutdown, ctrl_break, ctrl_c, ctrl_close, ctrl_logoff,
        ctrl_shutdown,
    };

    /// Gives this thread the highest priority that a process may give without asking (time critical). Returns a description of the
    /// result.
    pub fn raise_thread_priority() -> String {
        let critical = ThreadPriority::Os(WinAPIThreadPriority::TimeCritical.into());
        match set_current_thread_priority(critical) {
            Ok(()) => "real-time priority (time critical)".to_owned(),
            Err(error) => format!("ordinary priority (time critical is not permitted: {error})"),
        }
    }

    /// Leaves memory pageable: Windows keeps what a process uses in its working set. Returns a description of that.
    pub fn lock_memory() -> String {
        "memory in the working set, which Windows does not lock".to_owned()
    }

    /// Does nothing: Zenoh's defaults suffice.
    pub fn restart_with(_variable: (&str, &str)) {}

    /// Notifies Skein's supervisor, if it has started this process and asked for notifications. Never waits.
    pub fn notify_service_manager(what: &str) {
        if let Some(port) = env::var("NOTIFY_SOCKET").ok().and_then(|port| port.parse::<u16>().ok()) {
            // The agent flies on if the supervisor does not receive it.
            let _ = notify(port, what);
        }
    }

    fn notify(port: u16, what: &str) -> io::Result<usize> {
        let socket = UdpSocket::bind("127.0.0.1:0")?;
        socket.set_nonblocking(true)?;
        socket.send_to(what.as_bytes(), ("127.0.0.1", port))
    }

    /// The name of the pipe that a process opens to ask this one to end: Windows has no signal that reaches a process without a
    /// console. Only this user and administrators can open it for writing.
    pub fn pipe_to_end(pid: u32) -> String {
        format!(r"\\.\pipe\skein-end-{pid}")
    }

    /// All that asks this process to end: Ctrl-C and Ctrl-Break, a closed console, the end of the session or of the system, and a
    /// process that opens [`pipe_to_end`].
    pub struct Signals {
        keys: (CtrlC, CtrlBreak),
        closed: CtrlClose,
        ends: (CtrlLogoff, CtrlShutdown),
        pipe: NamedPipeServer,
    }

    impl Signals {
        /// Catches them, so that they no longer end the process. Call it within Tokio.
        ///
        /// # Errors
        /// If the system refuses.
        pub fn catch() -> io::Result<Self> {
            let pipe = ServerOptions::new().create(pipe_to_end(process::id()))?;
            Ok(Self {
                keys: (ctrl_c()?, ctrl_break()?),
                closed: ctrl_close()?,
                ends: (ctrl_logoff()?, ctrl_shutdown()?),
                pipe,
            })
        }

        /// Waits for the next of them.
        pub async fn next(&mut self) {
            tokio::select! {
                _ = self.keys.0.recv() => {}
                _ = self.keys.1.recv() => {}
                _ = self.closed.recv() => {}
                _ = self.ends.0.recv() => {}
                _ = self.ends.1.recv() => {}
                _ = self.pipe.connect() => { let _ = self.pipe.disconnect(); }
            }
        }
    }
}

#[cfg(unix)]
#[cfg(test)]
mod tests {
    use std::ffi::OsStr;
    use std::os::unix::fs::PermissionsExt;
    use std::os::unix::net::UnixDatagram;

    use super::on_unix::notify;
    use super::*;

    fn receives(service: &UnixDatagram, name: &OsStr) {
        let mut received = [0; 64];
        for what in ["READY=1", "WATCHDOG=1"] {
            assert_eq!(notify(name, what).unwrap(), what.len());
            let length = service.recv(&mut received).unwrap();
            assert_eq!(&received[..length], what.as_bytes());
        }
    }

    #[test]
    fn a_service_manager_is_notified() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        receives(&UnixDatagram::bind(&path).unwrap(), path.as_os_str());
        assert!(notify(path.with_extension("not").as_os_str(), "READY=1").is_err());
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_service_manager_with_an_abstract_socket_is_notified() {
        use std::os::linux::net::SocketAddrExt;
        let name = format!("skein-notify-{}", std::process::id());
        let address = std::os::unix::net::SocketAddr::from_abstract_name(&name).unwrap();
        receives(&UnixDatagram::bind_addr(&address).unwrap(), OsStr::new(&format!("@{name}")));
    }

    #[test]
    fn a_key_that_other_users_can_read_is_detected() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("key");
        std::fs::write(&path, "").unwrap();
        for (mode, others_can) in [(0o600, false), (0o640, true), (0o604, true), (0o400, false)] {
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
            assert_eq!(others_can_read(&path), others_can, "{mode:o}");
        }
        assert!(!others_can_read(&folder.path().join("none")));
    }
}
