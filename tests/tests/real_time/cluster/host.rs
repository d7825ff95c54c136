//! One host: its own network, process tree, name, home and sshd. It shares everything else with the computer that runs
//! the test.

use std::fs::{self, Permissions};
use std::io::{BufRead, BufReader};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};

use super::finished::Finished;

/// Folders below `/` that a host does not share.
const OWN: [&str; 4] = ["root", "run", "tmp", "opt"];
/// No account has a password, and none is locked.
const SHADOW: &str = "root:*:19000:0:99999:7:::\nsshd:!:19000::::::\n";
/// The only file that a login changes.
const SSHD_LOG: &str = "/run/sshd.log ";
/// Search path for programs on the host.
const PATH: &str = "/opt:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin";

pub(super) struct Host {
    pub(super) name: String,
    pub(super) address: String,
    /// Folder of the host's own files, as the test sees it.
    pub(super) folder: PathBuf,
    init: Child,
    /// Process id of the host's first process, as the test sees it.
    pid: u32,
}

/// Settings of a host.
pub(super) struct HostSetup<'a> {
    pub(super) name: &'a str,
    pub(super) address: &'a str,
    /// The public keys that may log in; without keys the host has no sshd.
    pub(super) authorized: &'a str,
    /// Variables that sshd sets for every login, `NAME=value`.
    pub(super) environment: &'a [&'a str],
}

impl Host {
    /// Starts a host in this network namespace. It keeps the files that an earlier host left in this folder.
    pub(super) fn start(namespace: &str, folder: &Path, setup: &HostSetup<'_>) -> Self {
        let HostSetup { name, address, authorized, environment } = setup;
        for own in OWN {
            fs::create_dir_all(folder.join(own)).unwrap();
        }
        fs::write(folder.join("shadow"), SHADOW).unwrap();
        fs::set_permissions(folder.join("root"), Permissions::from_mode(0o700)).unwrap();
        fs::set_permissions(folder.join("tmp"), Permissions::from_mode(0o1777)).unwrap();
        if !authorized.is_empty() {
            let sshd = folder.join("opt/sshd");
            fs::create_dir_all(&sshd).unwrap();
            fs::create_dir_all(folder.join("run/sshd")).unwrap();
            keygen(&sshd.join("host_key"));
            private(&sshd.join("authorized"), authorized);
            let environment = environment.iter().map(|set| format!(" \"{set}\"")).collect::<String>();
            let environment = if environment.is_empty() { String::new() } else { format!("SetEnv{environment}\n") };
            let config = format!(
                "ListenAddress {address}\nHostKey /opt/sshd/host_key\nAuthorizedKeysFile /opt/sshd/authorized\n\
                 PermitRootLogin prohibit-password\nPasswordAuthentication no\nUsePAM no\nPidFile none\n\
                 PrintMotd no\nPrintLastLog no\nUseDNS no\nSubsystem sftp internal-sftp\n{environment}"
            );
            private(&sshd.join("config"), &config);
        }
        let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        let mut init = Command::new("ip");
        init.args(["netns", "exec", namespace, "unshare", "--mount", "--propagation", "private", "--uts", "--pid"]);
        let script = folder.join("init.sh");
        fs::write(&script, include_str!("init.sh")).unwrap();
        init.args(["--fork", "--kill-child", "sh"]).arg(script).arg(folder).arg(name).arg(workspace);
        let mut init = init.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(init.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let pid = line.trim().parse().unwrap_or_else(|_| panic!("{name} does not start: {:?}", init.wait()));
        Self { name: (*name).to_owned(), address: (*address).to_owned(), folder: folder.to_owned(), init, pid }
    }

    /// A command on the host, in the environment of a new login.
    pub(super) fn command(&self, program: &str) -> Command {
        let mut command = Command::new("nsenter");
        command.args(["--target", &self.pid.to_string(), "--mount", "--net", "--uts", "--pid", "--"]);
        command.args(["env", "-i", "-C", "/root", "HOME=/root", "USER=root", "LANG=C.UTF-8", "TERM=dumb"]);
        command.arg(format!("PATH={PATH}")).arg(program);
        command
    }

    /// Runs a shell script on the host.
    pub(super) fn sh(&self, script: &str) -> Finished {
        Finished::of(self.command("sh").args(["-c", script]), Duration::from_secs(30))
    }

    /// A path on this host as the test sees it: below `/root`, `/run`, `/tmp` or `/opt`.
    pub(super) fn path(&self, path: &str) -> PathBuf {
        self.folder.join(path.trim_start_matches('/'))
    }

    /// Puts a program on the host. It is a hard link if possible, so that the file must not be written to.
    pub(super) fn put_program(&self, from: &Path, to: &str) {
        let to = self.path(to);
        fs::create_dir_all(to.parent().unwrap()).unwrap();
        let _ = fs::remove_file(&to);
        if fs::hard_link(from, &to).is_err() {
            fs::copy(from, &to).unwrap();
        }
    }

    /// `ADDRESS ssh-ed25519 ...`
    pub(super) fn known_host(&self) -> String {
        let key = fs::read_to_string(self.path("/opt/sshd/host_key.pub")).unwrap();
        format!("{} {key}", self.address)
    }

    /// The host's processes whose command line contains all these names, by their ids as the test sees them.
    pub(super) fn processes(&self, names: &[&str]) -> Vec<u32> {
        let space = |process: u32| fs::read_link(format!("/proc/{process}/ns/pid")).ok();
        let own = space(self.pid);
        let holds = |process: &u32| {
            let line = fs::read(format!("/proc/{process}/cmdline")).unwrap_or_default();
            let line = String::from_utf8_lossy(&line).replace('\0', " ");
            names.iter().all(|name| line.split(' ').any(|part| part == *name || part.ends_with(&format!("/{name}"))))
        };
        let processes = fs::read_dir("/proc").unwrap().flatten();
        let processes = processes.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
        let mut processes: Vec<_> = processes
            .filter(|process| *process != self.pid && space(*process) == own)
            .filter(|process| holds(process))
            .collect();
        processes.sort_unstable();
        processes
    }

    /// All files of the host except sshd's log, with kind, mode and size.
    pub(super) fn files(&self) -> Vec<String> {
        let mut files = Vec::new();
        for own in OWN {
            list(&self.folder, Path::new(own), &mut files);
        }
        files.retain(|file| !file.starts_with(SSHD_LOG));
        files.sort_unstable();
        files
    }
}

impl Drop for Host {
    /// Ends the host: its first process ends with its input, and the kernel has ended all other processes before `wait`
    /// returns.
    fn drop(&mut self) {
        drop(self.init.stdin.take());
        let until = Instant::now() + Duration::from_secs(5);
        while let Ok(None) = self.init.try_wait() {
            if Instant::now() > until {
                let _ = self.init.kill();
            }
            sleep(Duration::from_millis(5));
        }
    }
}

/// Kills a process.
pub(super) fn kill(process: u32) {
    let process = i32::try_from(process).ok().and_then(Pid::from_raw).unwrap();
    kill_process(process, Signal::KILL).unwrap();
}

/// Makes an ed25519 key with its `.pub` file, unless the key exists.
pub(super) fn keygen(path: &Path) {
    if path.exists() {
        return;
    }
    let made = Command::new("ssh-keygen").args(["-q", "-t", "ed25519", "-N", "", "-C", "", "-f"]).arg(path).status();
    assert!(made.unwrap().success(), "ssh-keygen");
}

/// Writes a file that only its owner can read.
pub(super) fn private(path: &Path, text: &str) {
    fs::write(path, text).unwrap();
    fs::set_permissions(path, Permissions::from_mode(0o600)).unwrap();
}

fn list(folder: &Path, path: &Path, into: &mut Vec<String>) {
    for entry in fs::read_dir(folder.join(path)).unwrap().flatten() {
        let path = path.join(entry.file_name());
        let of = fs::symlink_metadata(folder.join(&path)).unwrap();
        let size = if of.is_file() { of.len() } else { 0 };
        into.push(format!("/{} {:o} {size}", path.display(), of.permissions().mode()));
        if of.is_dir() {
            list(folder, &path, into);
        }
    }
}
