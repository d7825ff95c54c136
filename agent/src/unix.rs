//! What only a Unix has, and what takes its place elsewhere. The only file that knows the difference.

#[cfg(unix)]
pub use on_unix::*;
#[cfg(not(unix))]
pub use plain::*;

#[cfg(unix)]
mod on_unix {
    use std::env;
    use std::os::unix::process::CommandExt;
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

    /// SIGINT, SIGTERM and SIGHUP (a terminal that is closed): all mean that the agent shall end.
    pub struct Signals([Signal; 3]);

    impl Signals {
        /// From now on they no longer end the process. Within Tokio.
        ///
        /// # Errors
        /// If the system refuses.
        pub fn catch() -> std::io::Result<Self> {
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
