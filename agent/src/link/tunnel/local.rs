//! Sockets between Zenoh and the tunnel on one host: Unix sockets in a folder that only the own user can enter. A
//! system without them uses TCP on the loopback, which every user of the PC can reach; messages from there are refused
//! without their sender's signature.

use std::io;

use zenoh::Session;

#[cfg(unix)]
pub(super) use unix::{Address, Listener, Place, Stream, accept, connect};

#[cfg(not(unix))]
pub(super) use loopback::{Address, Listener, Place, Stream, accept, connect};

/// Names of the sockets that the session of the vehicles and the feed listen on.
pub(super) const FLIGHT: &str = "zenoh";
pub(super) const FEED: &str = "feed";

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
    pub(in super::super) type Listener = UnixListener;
    pub(in super::super) type Address = PathBuf;

    /// Longest path of a socket, bytes (the system's limit, with the final NUL, is 108 on Linux and 104 on macOS).
    const MAX_PATH: usize = 100;
    /// The longest file name that we use in the folder.
    const LONGEST: &str = "/skein-4294967295-4294967295/dial-250.lock";

    /// The folder of one tunnel's sockets, which is removed with them.
    pub(in super::super) struct Place(PathBuf);

    impl Place {
        pub(in super::super) fn new() -> io::Result<Self> {
            new_folder().map(Self)
        }

        /// A socket for Zenoh to dial, and its endpoint.
        pub(in super::super) fn bind(&self, nth: usize) -> io::Result<(Listener, String)> {
            let name = format!("dial-{nth}");
            Ok((UnixListener::bind(self.0.join(&name))?, self.endpoint(&name)))
        }

        /// The endpoint of a socket with this name.
        pub(in super::super) fn endpoint(&self, name: &str) -> String {
            format!("unixsock-stream/{}", self.0.join(name).display())
        }

        /// The address at which a session listens that was given the endpoint with this name.
        pub(in super::super) fn address(&self, name: &str, _: &Session) -> io::Result<Address> {
            Ok(self.0.join(name))
        }
    }

    impl Drop for Place {
        fn drop(&mut self) {
            // A folder that cannot be removed does no harm.
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    pub(in super::super) async fn accept(listener: &Listener) -> io::Result<Stream> {
        listener.accept().await.map(|(stream, _)| stream)
    }

    pub(in super::super) async fn connect(address: &Address) -> io::Result<Stream> {
        UnixStream::connect(address).await
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
    pub(in super::super) type Listener = TcpListener;
    pub(in super::super) type Address = SocketAddr;

    /// The loopback, on which the system chooses the ports.
    pub(in super::super) struct Place;

    impl Place {
        pub(in super::super) fn new() -> io::Result<Self> {
            Ok(Self)
        }

        /// A socket for Zenoh to dial, and its endpoint.
        pub(in super::super) fn bind(&self, _: usize) -> io::Result<(Listener, String)> {
            let listener = std::net::TcpListener::bind("127.0.0.1:0")?;
            listener.set_nonblocking(true)?;
            let endpoint = format!("tcp/{}", listener.local_addr()?);
            Ok((TcpListener::from_std(listener)?, endpoint))
        }

        /// An endpoint for a session to listen on.
        pub(in super::super) fn endpoint(&self, _: &str) -> String {
            "tcp/127.0.0.1:0".to_owned()
        }

        /// The address at which this session listens.
        pub(in super::super) fn address(&self, _: &str, session: &Session) -> io::Result<Address> {
            let locators = session.info().locators().wait();
            let address = locators.iter().find_map(|locator| locator.address().as_str().parse().ok());
            address.ok_or_else(|| io::Error::other("Zenoh reports no address that it listens on"))
        }
    }

    pub(in super::super) async fn accept(listener: &Listener) -> io::Result<Stream> {
        let (stream, _) = listener.accept().await?;
        stream.set_nodelay(true)?;
        Ok(stream)
    }

    pub(in super::super) async fn connect(address: &Address) -> io::Result<Stream> {
        let stream = TcpStream::connect(address).await?;
        stream.set_nodelay(true)?;
        Ok(stream)
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
