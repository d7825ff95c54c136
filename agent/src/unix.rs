//! What only a Unix has, and what takes its place elsewhere. The only file that knows the difference.

#[cfg(unix)]
pub use on_unix::*;
#[cfg(not(unix))]
pub use plain::*;

#[cfg(unix)]
mod on_unix {
    use std::env;
    use std::ffi::OsStr;
    use std::io;
    use std::os::unix::ffi::OsStrExt;
    use std::os::unix::fs::PermissionsExt;
    use std::os::unix::net::UnixDatagram;
    use std::os::unix::process::CommandExt;
    use std::path::Path;
    use std::process::Command;

    use thread_priority::{
        RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
        set_thread_priority_and_policy, thread_native_id,
    };
    use tokio::signal::unix::{Signal, SignalKind, signal};

    /// Above ordinary processes, below the kernel's own threads, in percent of the range.
    const PRIORITY: u8 = 30;

    /// Puts this thread before all ordinary ones (SCHED_FIFO), if that is allowed. Says in words what was obtained.
    pub fn raise_this_thread() -> String {
        let fifo = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
        let raised = ThreadPriorityValue::try_from(PRIORITY).map_err(|what| what.to_owned()).and_then(|priority| {
            set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Crossplatform(priority), fifo)
                .map_err(|error| error.to_string())
        });
        match raised {
            Ok(()) => "real-time priority (SCHED_FIFO)".to_owned(),
            Err(error) => format!("ordinary priority (SCHED_FIFO is not allowed: {error})"),
        }
    }

    /// Keeps this process's pages in memory, if that is allowed. Says in words what was obtained.
    pub fn lock_memory() -> String {
        match try_to_lock_memory() {
            Ok(what) => what.to_owned(),
            Err(error) => format!("memory not locked ({error})"),
        }
    }

    /// Pages are locked as they are touched, or every thread's whole stack would be filled. Under a limit only what is
    /// mapped now is locked: beyond the limit an allocation would fail instead of being merely pageable.
    #[cfg(target_os = "linux")]
    fn try_to_lock_memory() -> Result<&'static str, rustix::io::Errno> {
        use rustix::mm::{MlockAllFlags, mlockall};
        use rustix::process::{Resource, getrlimit};

        let now = MlockAllFlags::CURRENT | MlockAllFlags::ONFAULT;
        if getrlimit(Resource::Memlock).current.is_none() {
            mlockall(now | MlockAllFlags::FUTURE).map(|()| "memory locked")
        } else {
            mlockall(now).map(|()| "memory locked as far as mapped by now")
        }
    }

    #[cfg(not(target_os = "linux"))]
    fn try_to_lock_memory() -> Result<&'static str, &'static str> {
        Err("not on this system")
    }

    /// Starts this program over with an environment variable, if it is missing. Does nothing if that cannot be done.
    pub fn restart_with((name, value): (&str, &str)) {
        if env::var_os(name).is_none()
            && let Ok(program) = env::current_exe()
        {
            let mut arguments = env::args_os();
            let own_name = arguments.next().unwrap_or_else(|| program.clone().into());
            // It returns only if it has failed, and then this process goes on as it is.
            let _ = Command::new(program).arg0(own_name).args(arguments).env(name, value).exec();
        }
    }

    /// A connection ends when what was sent on it is not acknowledged, or not taken, for this long. Only Linux can; elsewhere
    /// Zenoh's lease ends it.
    ///
    /// # Errors
    /// If the system refuses.
    #[cfg_attr(not(any(target_os = "linux", target_os = "android")), expect(unused_variables))]
    pub fn give_up_unacknowledged(socket: &tokio::net::TcpStream, after: std::time::Duration) -> io::Result<()> {
        #[cfg(any(target_os = "linux", target_os = "android"))]
        socket2::SockRef::from(socket).set_tcp_user_timeout(Some(after))?;
        Ok(())
    }

    /// Whether this file is more than its owner's.
    pub fn others_can_read(path: &Path) -> bool {
        std::fs::metadata(path).is_ok_and(|about| about.permissions().mode() & 0o077 != 0)
    }

    /// Tells systemd, if it has started this process and listens. Never waits.
    pub fn tell_service(what: &str) {
        if let Some(socket) = env::var_os("NOTIFY_SOCKET") {
            // A service manager that does not hear is none of ours to mend.
            let _ = notify(&socket, what);
        }
    }

    /// The name of a socket, or after an `@` one that is in no file system.
    fn notify(socket: &OsStr, what: &str) -> io::Result<usize> {
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

    /// SIGINT, SIGTERM and SIGHUP (a terminal that is closed): all mean that the agent shall end.
    pub struct Signals([Signal; 3]);

    impl Signals {
        /// From now on they no longer end the process. Within Tokio.
        ///
        /// # Errors
        /// If the system refuses.
        pub fn catch() -> io::Result<Self> {
            let kinds = [SignalKind::interrupt(), SignalKind::terminate(), SignalKind::hangup()];
            let [interrupt, terminate, hangup] = kinds.map(signal);
            Ok(Self([interrupt?, terminate?, hangup?]))
        }

        /// The next one.
        pub async fn next(&mut self) {
            let [interrupt, terminate, hangup] = &mut self.0;
            tokio::select! {
                _ = interrupt.recv() => {}
                _ = terminate.recv() => {}
                _ = hangup.recv() => {}
            }
        }
    }

    #[cfg(test)]
    mod tests {
        use super::*;

        fn hears(service: &UnixDatagram, name: &OsStr) {
            let mut heard = [0; 64];
            for what in ["READY=1", "WATCHDOG=1"] {
                assert_eq!(notify(name, what).unwrap(), what.len());
                let length = service.recv(&mut heard).unwrap();
                assert_eq!(&heard[..length], what.as_bytes());
            }
        }

        #[test]
        fn a_service_manager_is_told() {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("notify");
            hears(&UnixDatagram::bind(&path).unwrap(), path.as_os_str());
            assert!(notify(path.with_extension("not").as_os_str(), "READY=1").is_err());
        }

        #[cfg(target_os = "linux")]
        #[test]
        fn a_service_manager_in_no_file_system_is_told() {
            use std::os::linux::net::SocketAddrExt;
            let name = format!("skein-notify-{}", std::process::id());
            let address = std::os::unix::net::SocketAddr::from_abstract_name(&name).unwrap();
            hears(&UnixDatagram::bind_addr(&address).unwrap(), OsStr::new(&format!("@{name}")));
        }

        #[test]
        fn a_key_that_others_can_read_is_noticed() {
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
}

#[cfg(not(unix))]
mod plain {
    /// The priority stays as it is. Says so in words.
    pub fn raise_this_thread() -> String {
        "ordinary priority".to_owned()
    }

    /// Memory stays pageable. Says so in words.
    pub fn lock_memory() -> String {
        "memory not locked".to_owned()
    }

    /// Does nothing: Zenoh's defaults serve.
    pub fn restart_with(_variable: (&str, &str)) {}

    /// Does nothing: nobody asks.
    pub fn tell_service(_what: &str) {}

    /// Does nothing: Zenoh's lease ends a connection that was cut.
    ///
    /// # Errors
    /// Never.
    pub fn give_up_unacknowledged(_socket: &tokio::net::TcpStream, _after: std::time::Duration) -> std::io::Result<()> {
        Ok(())
    }

    /// Not known: there are no such modes.
    pub fn others_can_read(_path: &std::path::Path) -> bool {
        false
    }

    /// Ctrl-C.
    pub struct Signals;

    impl Signals {
        /// From now on it no longer ends the process.
        ///
        /// # Errors
        /// Never.
        pub fn catch() -> std::io::Result<Self> {
            Ok(Self)
        }

        /// The next one.
        pub async fn next(&mut self) {
            if tokio::signal::ctrl_c().await.is_err() {
                std::future::pending::<()>().await;
            }
        }
    }
}
