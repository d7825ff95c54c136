//! The system's OpenSSH, so that everybody's configuration, keys, jump hosts and known hosts are used as they are: at most
//! eight hosts at once, and a host that hangs ends nothing else.
//!
//! What is kept from `ssh` is no choice of anybody's: it never asks ([`CONNECT_S`] and it has failed), and on Unix the calls
//! to one host share a connection, which stays for a minute so that the next command has it too.

mod reason;

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::ffi::{OsStr, OsString};
use std::fmt;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::num::NonZeroUsize;
use std::path::Path;
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use skein_common::printable::printable;
use skein_host::parallel::in_parallel;

use crate::endpoints;
use crate::inventory::Node;
use crate::os;
use skein_host::clock;

/// A host that is not there within so many seconds is not there.
pub const CONNECT_S: u32 = 5;
/// So many hosts are called at once.
pub const AT_ONCE: NonZeroUsize = NonZeroUsize::MIN.saturating_add(7);
/// Nobody has more to say in one answer, bytes.
const MAX_ANSWER: u64 = 16 << 20;
/// Of what goes wrong so much is kept, bytes.
const MAX_ERROR_OUTPUT: u64 = 64 << 10;
/// Of a host's sentence, and of a line of its log, so much is shown, characters.
pub(super) const MAX_SENTENCE: usize = 400;
const MAX_LINE: usize = 4000;
/// How often a call is looked at.
const POLL_PERIOD: Duration = Duration::from_millis(5);
/// After the end of `ssh` its last words are there at once; a connection that stays behind may hold the pipe open.
const LAST_OUTPUT: Duration = Duration::from_millis(200);
/// A socket's path has at most 107 bytes; ssh adds 40 digits of a hash, and 17 bytes while it makes it.
const LONGEST_SOCKET: usize = 107 - 40 - 17;

/// Where somebody logs in.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Host {
    /// What `ssh` takes, aliases included.
    pub name: String,
    /// Who; `None`: as ssh's own configuration says.
    pub user: Option<String>,
}

impl fmt::Display for Host {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.user {
            Some(user) => write!(f, "{user}@{}", self.name),
            None => f.write_str(&self.name),
        }
    }
}

/// Calls hosts.
#[derive(Clone, Debug)]
pub struct Ssh {
    /// What is called, and its first arguments.
    program: Vec<OsString>,
    /// `ControlPath`, where calls can share a connection.
    sharing: Option<String>,
    /// Say every command first.
    verbose: bool,
}

/// What came of a call.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CommandOutput {
    /// Exit status of the remote command.
    pub status: i32,
    /// Its standard output.
    pub stdout: String,
    /// Its standard error, and ssh's own warnings.
    pub stderr: String,
}

impl CommandOutput {
    /// The last line of standard error that says something, fit for a terminal; else the exit status.
    pub fn error_text(&self) -> String {
        let line = self.stderr.lines().rev().map(str::trim).find(|line| !line.is_empty());
        line.map_or_else(|| format!("exit status {}", self.status), |line| printable(line, MAX_SENTENCE))
    }
}

impl Ssh {
    /// The `ssh` in the path; `verbose`: every command is said on stderr before it runs.
    pub fn new(verbose: bool) -> Self {
        Self { program: vec!["ssh".into()], sharing: sharing(&endpoints::folder()), verbose }
    }

    /// Runs a command there, gives it this standard input and waits for its end, at most `within`.
    ///
    /// # Errors
    /// One sentence, with what to do about it, if the host cannot be reached or takes longer. A remote command that fails is
    /// no error here: its status is told.
    pub fn run(
        &self,
        host: &Host,
        command: &str,
        stdin: &Arc<[u8]>,
        within: Duration,
    ) -> Result<CommandOutput, String> {
        let mut child = self.spawn(host, command)?;
        write_input(child.stdin.take(), stdin);
        let stdout = collect(child.stdout.take(), MAX_ANSWER);
        let stderr = collect(child.stderr.take(), MAX_ERROR_OUTPUT);
        let Some(status) = wait(&mut child, within).map_err(|error| format!("{host}: {error}"))? else {
            return Err(format!(
                "{host}: did not do it within {:.0} s; see with `ssh {host}` how it does",
                within.as_secs_f64()
            ));
        };
        let (stdout, stderr) = (stdout.text(), stderr.text());
        match status.code() {
            // ssh's own; a remote command of ours never ends with it.
            Some(255) => Err(reason::sentence(host, &stderr, || self.keys(host))),
            Some(status) => Ok(CommandOutput { status, stdout, stderr }),
            None => Err(format!("{host}: ssh was {}", os::how_it_ended(status))),
        }
    }

    /// Runs a command there and hands over every line that it writes, until it ends. Its standard input has no end before.
    ///
    /// # Errors
    /// As [`Self::run`]; and if the command fails, with what it complained of.
    pub fn lines(&self, host: &Host, command: &str, stdin: &[u8], mut line: impl FnMut(&str)) -> Result<(), String> {
        let mut child = self.spawn(host, command)?;
        let mut given = child.stdin.take();
        // Who does not read it says why, or ends with a status. It stays open: the end of it would end what is there.
        let _ = given.as_mut().map(|given| given.write_all(stdin));
        let stderr = collect(child.stderr.take(), MAX_ERROR_OUTPUT);
        let mut stdout = BufReader::new(child.stdout.take().ok_or_else(|| format!("{host}: no pipe"))?);
        let mut bytes = Vec::new();
        // What is no text in it, or would be obeyed by a terminal, is shown as well as it can be.
        while stdout.read_until(b'\n', &mut bytes).is_ok_and(|read| read > 0) {
            line(&printable(String::from_utf8_lossy(&bytes).trim_end_matches(['\r', '\n']), MAX_LINE));
            bytes.clear();
        }
        let status = child.wait().map_err(|error| format!("{host}: {error}"))?;
        let stderr = stderr.text();
        match status.code() {
            Some(0) => Ok(()),
            Some(255) => Err(reason::sentence(host, &stderr, || self.keys(host))),
            Some(status) => {
                Err(format!("{host}: {}", CommandOutput { status, stdout: String::new(), stderr }.error_text()))
            }
            None => Err(format!("{host}: ssh was {}", os::how_it_ended(status))),
        }
    }

    /// Ends the connection that was kept for the next command.
    pub fn close(&self, host: &Host) {
        self.control_shared(host, "exit");
    }

    /// The next call logs in anew. Calls on the kept connection go on.
    pub fn forget(&self, host: &Host) {
        self.control_shared(host, "stop");
    }

    fn control_shared(&self, host: &Host, what: &str) {
        if self.sharing.is_some() {
            let mut command = self.options(host);
            command.args(["-O", what, "--", &host.name]);
            let _ = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).status();
        }
    }

    fn options(&self, host: &Host) -> Command {
        let mut command = Command::new(self.program.first().map_or(OsStr::new("ssh"), OsString::as_os_str));
        command.args(self.program.iter().skip(1));
        command.args(["-T", "-o", "BatchMode=yes", "-o", &format!("ConnectTimeout={CONNECT_S}")]);
        if let Some(path) = &self.sharing {
            let path = format!("ControlPath={path}");
            command.args(["-o", "ControlMaster=auto", "-o", "ControlPersist=60", "-o", &path]);
            // A shared connection whose host is gone is found out within 10 s.
            command.args(["-o", "ServerAliveInterval=5", "-o", "ServerAliveCountMax=2"]);
        }
        if let Some(user) = &host.user {
            command.args(["-l", user]);
        }
        command
    }

    /// Begins a command there, for who talks with it.
    ///
    /// # Errors
    /// If there is no ssh here.
    pub fn spawn(&self, host: &Host, command: &str) -> Result<Child, String> {
        let mut ssh = self.options(host);
        ssh.args(["--", &host.name, command]);
        if self.verbose {
            eprintln!("{}", shown(&ssh));
        }
        ssh.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        ssh.spawn().map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => "there is no `ssh` here; install OpenSSH's client".to_owned(),
            _ => format!("ssh: {error}"),
        })
    }

    /// The key files that ssh tries for this host.
    fn keys(&self, host: &Host) -> Vec<String> {
        let mut command = self.options(host);
        let output = command.args(["-G", "--", &host.name]).stdin(Stdio::null()).output();
        output.map_or_else(|_| Vec::new(), |output| reason::keys(&String::from_utf8_lossy(&output.stdout)))
    }
}

/// Where the sockets of shared connections are, if that can be a folder of this user's alone, with a short path.
fn sharing(folder: &Path) -> Option<String> {
    let path = folder
        .join("s-")
        .to_str()
        .filter(|path| path.len() <= LONGEST_SOCKET && !path.contains([' ', '%', '"']))?
        .to_owned();
    (cfg!(unix) && os::private_folder(folder).is_ok()).then(|| path + "%C")
}

/// A command as somebody could type it.
fn shown(command: &Command) -> String {
    let arguments = [command.get_program()].into_iter().chain(command.get_args());
    let quoted = arguments.map(|argument| {
        let argument = argument.to_string_lossy();
        let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_=./@:%".contains(c);
        if argument.chars().all(is_plain) && !argument.is_empty() { argument.into_owned() } else { quote(&argument) }
    });
    quoted.collect::<Vec<_>>().join(" ")
}

/// One word for a shell, whatever is in it.
pub fn quote(argument: &str) -> String {
    format!("'{}'", argument.replace('\'', r"'\''"))
}

/// Writes it to the child, on a thread: it may take long, and ends with the child.
fn write_input(stdin: Option<ChildStdin>, bytes: &Arc<[u8]>) {
    let bytes = bytes.clone();
    if let Some(mut stdin) = stdin {
        // Who does not read all of it says why, or ends with a status.
        thread::spawn(move || stdin.write_all(&bytes));
    }
}

/// What a child writes, collected on a thread.
struct Collected {
    bytes: Arc<Mutex<Vec<u8>>>,
    ended: Receiver<()>,
}

impl Collected {
    /// All of it, once the child has ended.
    fn text(self) -> String {
        // Either way: what is there is there.
        let _ = self.ended.recv_timeout(LAST_OUTPUT);
        let bytes = self.bytes.lock().unwrap_or_else(PoisonError::into_inner);
        String::from_utf8_lossy(&bytes).into_owned()
    }
}

/// Collects until the end, keeps at most so many bytes.
fn collect(pipe: Option<impl Read + Send + 'static>, max: u64) -> Collected {
    let bytes = Arc::new(Mutex::new(Vec::new()));
    let (end, ended) = channel();
    let kept = bytes.clone();
    thread::spawn(move || {
        let mut some = [0; 8192];
        let mut pipe = pipe;
        while let Some(read) = pipe.as_mut().and_then(|pipe| pipe.read(&mut some).ok()).filter(|read| *read > 0) {
            let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
            if kept.len() as u64 + read as u64 <= max {
                kept.extend_from_slice(&some[..read]);
            }
        }
        let _ = end.send(());
    });
    Collected { bytes, ended }
}

/// Waits for the child; ends it after that time and gives nothing.
fn wait(child: &mut Child, within: Duration) -> io::Result<Option<ExitStatus>> {
    let until = clock::now() + within;
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(Some(status));
        }
        if clock::now() >= until {
            child.kill()?;
            child.wait()?;
            return Ok(None);
        }
        clock::sleep(POLL_PERIOD);
    }
}

/// These nodes, by the host that they are on; those without one are left out.
pub fn by_host<'a>(nodes: impl IntoIterator<Item = &'a Node>) -> Vec<(Host, Vec<&'a Node>)> {
    let mut hosts = BTreeMap::<Host, Vec<&Node>>::new();
    for node in nodes {
        if let Some(name) = node.host.clone() {
            hosts.entry(Host { name, user: node.user.clone() }).or_default().push(node);
        }
    }
    let mut hosts: Vec<_> = hosts.into_iter().collect();
    hosts.sort_by_key(|(_, nodes)| nodes.first().map(|node| node.id));
    hosts
}

/// Does it for all of them, at most [`AT_ONCE`] at a time. What came of it, in their order.
pub fn at_once<T: Sync, R: Send>(all: &[T], task: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let Ok(done) = in_parallel(all.len(), AT_ONCE, |nth| Ok::<_, Infallible>(task(&all[nth])));
    done
}

#[cfg(test)]
#[cfg(unix)]
pub(super) mod tests;
