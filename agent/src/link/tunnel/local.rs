//! Sockets between Zenoh and the tunnel on one host: Unix sockets in a folder that only the own user can enter. A
//! system without them uses TCP on the loopback, which every user of the PC can reach; messages from there are refused
//! without their sender's signature.

use std::io;

use zenoh::Session;

#[cfg(unix)]
pub(super) use unix::{Locals, Stream, ZenohListener};

#[cfg(not(unix))]
pub(super) use loopback::{Locals, Stream, ZenohListener};

#[cfg(unix)]
mod unix {
    use std::env;
    use std::fs::{self, DirBuilder};
    use std::os::unix::fs::{DirBuilderExt, MetadataExt};
    use std::path::{Path, PathBuf};
    use std::process;
    use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

    use tokio::net::{UnixListener, UnixStream};

    use super::{Session, io};

    pub(in super::super) type Stream = UnixStream;

    /// Longest path of a socket, bytes (the system's limit, with the final NUL, is 108 on Linux and 104 on macOS).
    const MAX_PATH: usize = 100;
    /// Names of the sockets that the session of the vehicles and the feed listen on.
    const FLIGHT: &str = "zenoh";
    const FEED: &str = "feed";
    /// The longest file name that we use in the folder.
    const LONGEST: &str = "/skein-4294967295-4294967295/dial-250.lock";

    /// The local sockets of one tunnel, in a folder that is removed with them.
    pub(in super::super) struct Locals {
        folder: PathBuf,
        outgoing: Vec<(DialSocket, String)>,
        dials: Vec<String>,
    }

    impl Locals {
        pub(in super::super) fn open(dial: &[String]) -> io::Result<Self> {
            let mut locals = Self { folder: new_folder()?, outgoing: Vec::new(), dials: Vec::new() };
            for (nth, endpoint) in dial.iter().enumerate() {
                let path = locals.folder.join(format!("dial-{nth}"));
                locals.dials.push(zenoh_endpoint(&path));
                locals.outgoing.push((DialSocket(UnixListener::bind(path)?), endpoint.clone()));
            }
            Ok(locals)
        }

        pub(in super::super) fn zenoh_listens(&self) -> String {
            zenoh_endpoint(&self.folder.join(FLIGHT))
        }

        pub(in super::super) fn feed_listens(&self) -> String {
            zenoh_endpoint(&self.folder.join(FEED))
        }

        pub(in super::super) fn zenoh_dials(&self) -> Vec<String> {
            self.dials.clone()
        }

        pub(in super::super) fn take_dial_sockets(&mut self) -> Vec<(DialSocket, String)> {
            std::mem::take(&mut self.outgoing)
        }

        pub(in super::super) fn zenoh(&self, _: &Session) -> io::Result<ZenohListener> {
            Ok(ZenohListener(self.folder.join(FLIGHT)))
        }

        pub(in super::super) fn feed(&self, _: &Session) -> io::Result<ZenohListener> {
            Ok(ZenohListener(self.folder.join(FEED)))
        }
    }

    impl Drop for Locals {
        fn drop(&mut self) {
            // A folder that cannot be removed does no harm.
            let _ = fs::remove_dir_all(&self.folder);
        }
    }

    /// Local socket that Zenoh dials to reach one other host.
    pub(in super::super) struct DialSocket(UnixListener);

    impl DialSocket {
        pub(in super::super) async fn accept(&self) -> io::Result<Stream> {
            self.0.accept().await.map(|(stream, _)| stream)
        }
    }

    /// Local socket that Zenoh listens on.
    pub(in super::super) struct ZenohListener(PathBuf);

    impl ZenohListener {
        pub(in super::super) async fn connect(&self) -> io::Result<Stream> {
            UnixStream::connect(&self.0).await
        }
    }

    fn zenoh_endpoint(path: &Path) -> String {
        format!("unixsock-stream/{}", path.display())
    }

    /// Whether no other user can replace a folder made in here: only this user can write to it, or its sticky bit lets
    /// each user change only their own entries, as in `/tmp`.
    pub(super) fn is_trusted(folder: &Path) -> bool {
        let own = rustix::process::getuid().as_raw();
        let is_sticky = |mode: u32| mode & 0o1000 != 0;
        fs::metadata(folder).is_ok_and(|found| {
            let is_ours_or_roots = [own, 0].contains(&found.uid());
            found.is_dir() && is_ours_or_roots && (found.mode() & 0o022 == 0 || is_sticky(found.mode()))
        })
    }

    /// Makes a new folder in the service's runtime directory, in the user's, or else in the temporary directory. A
    /// folder left by a killed agent is removed by the agent's next start, by its uninstallation or by the system.
    fn new_folder() -> io::Result<PathBuf> {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let fits = |folder: &PathBuf| {
            let text = folder.to_str().filter(|text| !text.contains(['?', '#', ';', '|']));
            text.is_some_and(|text| text.len() + LONGEST.len() <= MAX_PATH) && is_trusted(folder)
        };
        let given = ["RUNTIME_DIRECTORY", "XDG_RUNTIME_DIR"].into_iter().filter_map(env::var_os).map(PathBuf::from);
        let base = given.chain([env::temp_dir()]).find(fits).unwrap_or_else(|| "/tmp".into());
        let id = process::id();
        loop {
            let folder = base.join(format!("skein-{id}-{}", COUNT.fetch_add(1, Relaxed)));
            match DirBuilder::new().mode(0o700).create(&folder) {
                // Left by an earlier process with this id.
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
                Ok(()) => return Ok(folder),
            }
        }
    }
}

#[cfg(not(unix))]
mod loopback {
    use std::net::SocketAddr;

    use tokio::net::{TcpListener, TcpStream};
    use zenoh::Wait;

    use super::{Session, io};

    pub(in super::super) type Stream = TcpStream;

    /// The local sockets of one tunnel.
    pub(in super::super) struct Locals {
        outgoing: Vec<(DialSocket, String)>,
        dials: Vec<String>,
    }

    impl Locals {
        pub(in super::super) fn open(dial: &[String]) -> io::Result<Self> {
            let mut locals = Self { outgoing: Vec::new(), dials: Vec::new() };
            for endpoint in dial {
                let listener = std::net::TcpListener::bind("127.0.0.1:0")?;
                listener.set_nonblocking(true)?;
                locals.dials.push(format!("tcp/{}", listener.local_addr()?));
                locals.outgoing.push((DialSocket(TcpListener::from_std(listener)?), endpoint.clone()));
            }
            Ok(locals)
        }

        pub(in super::super) fn zenoh_listens(&self) -> String {
            "tcp/127.0.0.1:0".to_owned()
        }

        pub(in super::super) fn feed_listens(&self) -> String {
            "tcp/127.0.0.1:0".to_owned()
        }

        pub(in super::super) fn zenoh_dials(&self) -> Vec<String> {
            self.dials.clone()
        }

        pub(in super::super) fn take_dial_sockets(&mut self) -> Vec<(DialSocket, String)> {
            std::mem::take(&mut self.outgoing)
        }

        pub(in super::super) fn zenoh(&self, session: &Session) -> io::Result<ZenohListener> {
            let locators = session.info().locators().wait();
            let address = locators.iter().find_map(|locator| locator.address().as_str().parse().ok());
            address.map(ZenohListener).ok_or_else(|| io::Error::other("Zenoh reports no address that it listens on"))
        }

        pub(in super::super) fn feed(&self, session: &Session) -> io::Result<ZenohListener> {
            self.zenoh(session)
        }
    }

    /// Local socket that Zenoh dials to reach one other host.
    pub(in super::super) struct DialSocket(TcpListener);

    impl DialSocket {
        pub(in super::super) async fn accept(&self) -> io::Result<Stream> {
            let (stream, _) = self.0.accept().await?;
            stream.set_nodelay(true)?;
            Ok(stream)
        }
    }

    /// Local address that Zenoh listens on.
    pub(in super::super) struct ZenohListener(SocketAddr);

    impl ZenohListener {
        pub(in super::super) async fn connect(&self) -> io::Result<Stream> {
            let stream = TcpStream::connect(self.0).await?;
            stream.set_nodelay(true)?;
            Ok(stream)
        }
    }
}

#[cfg(unix)]
#[cfg(test)]
mod tests {
    use std::fs;
    use std::os::unix::fs::{PermissionsExt, chown};

    use super::unix::is_trusted;

    #[test]
    fn sockets_are_in_a_folder_that_no_other_user_can_replace() {
        let folder = tempfile::tempdir().unwrap();
        let with_mode = |mode| {
            fs::set_permissions(folder.path(), fs::Permissions::from_mode(mode)).unwrap();
            is_trusted(folder.path())
        };
        assert!(with_mode(0o700) && with_mode(0o755) && with_mode(0o1777));
        assert!(!with_mode(0o777) && !with_mode(0o770) && !with_mode(0o702));
        assert!(!is_trusted(&folder.path().join("none")));
        if rustix::process::geteuid().is_root() {
            chown(folder.path(), Some(65534), None).unwrap();
            assert!(!with_mode(0o700) && !with_mode(0o1777));
        }
    }
}
