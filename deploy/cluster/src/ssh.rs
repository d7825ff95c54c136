//! Runs the system's OpenSSH, so that the user's configuration, keys, jump hosts and known hosts apply: at most eight hosts at
//! once, and a host that hangs does not hold up the others.
//!
//! Settings of the session are overridden: ssh never asks, forwards nothing, runs only the given command, and a connection
//! fails after [`CONNECT_S`]. On Unix the calls to one host share a connection, which stays open for a minute, so that the
//! next command can use it too. The output of a command lies between marks, because the account's shell may print more.

mod marks;
mod reason;
mod settings;

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::ffi::{OsStr, OsString};
use std::fmt;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::iter;
use std::num::NonZeroUsize;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::Duration;

use skein_common::printable::printable;
use skein_host::parallel::in_parallel;

use marks::Marks;

use crate::endpoints;
use crate::inventory::{Node, System};
use crate::os;
use skein_host::clock;

/// Time limit of a connection, s: a busy PC may answer after several seconds.
pub const CONNECT_S: u32 = 10;
/// Number of hosts that are called at once.
pub const AT_ONCE: NonZeroUsize = NonZeroUsize::MIN.saturating_add(7);
/// Size limit of an answer, bytes.
const MAX_ANSWER: u64 = 16 << 20;
/// Size limit of the standard error that is kept, bytes.
const MAX_ERROR_OUTPUT: u64 = 64 << 10;
/// Length limit of a host's message that is shown, characters.
pub(super) const MAX_SENTENCE: usize = 400;
/// Length limit of a line of a host's log that is shown, characters.
const MAX_LINE: usize = 4000;
/// Interval at which a call is checked.
const POLL_PERIOD: Duration = Duration::from_millis(5);
/// Time for a program on Windows to end after its answer: until then it may hold locks.
const AFTER_ANSWER: Duration = Duration::from_secs(1);
/// Time to wait for the end of the error output after `ssh` has ended: it is there at once, but a connection that stays open may
/// hold the pipe.
const LAST_ERROR_OUTPUT: Duration = Duration::from_millis(200);
/// Time to wait for the end of the answer. No connection holds its pipe, so only a busy computer needs the time.
const LAST_ANSWER: Duration = Duration::from_secs(5);
/// Length limit of the socket's path: 107 bytes, of which ssh needs 40 for a hash and 17 while it creates the socket.
const LONGEST_SOCKET: usize = 107 - 40 - 17;

/// Output in the place of that of a program of Skein which is not installed.
pub(super) const NOT_INSTALLED: &str = "skein: not installed";

/// A host to log in to.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Host {
    /// The host as given to `ssh`; may be an alias.
    pub name: String,
    /// User; `None`: according to ssh's own configuration.
    pub user: Option<String>,
    /// Its system.
    pub system: System,
}

impl fmt::Display for Host {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.user {
            Some(user) => write!(f, "{user}@{}", self.name),
            None => f.write_str(&self.name),
        }
    }
}

/// Runs commands on hosts over ssh.
#[derive(Clone, Debug)]
pub struct Ssh {
    /// The program and its first arguments.
    program: Vec<OsString>,
    /// Arguments that override settings of the session.
    session: Vec<String>,
    /// `ControlPath` of shared connections, if calls can share one.
    sharing: Option<String>,
    /// Print every command before it runs.
    verbose: bool,
}

/// Output of a remote command.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CommandOutput {
    /// Exit status of the remote command.
    pub status: i32,
    /// Its standard output.
    pub stdout: String,
    /// Its standard error.
    pub stderr: String,
    /// The text that the account's shell printed on standard output before and after the command, made safe for a terminal.
    pub of_shell: String,
}

impl CommandOutput {
    /// The last line of standard error that is not empty, made safe for a terminal; else the exit status.
    pub fn error_text(&self) -> String {
        reason::last_line(&self.stderr).unwrap_or_else(|| format!("exit status {}", self.status))
    }
}

impl Ssh {
    /// Uses the `ssh` in the path. With `verbose` every command is printed on stderr before it runs.
    pub fn new(verbose: bool) -> Self {
        let program = vec!["ssh".into()];
        let session = settings::of_session(&program);
        Self { program, session, sharing: sharing(&endpoints::folder()), verbose }
    }

    /// Runs a command on a host with this standard input and waits until it ends, at most `within`.
    ///
    /// # Errors
    /// If the host cannot be reached or the command takes too long: one sentence with the remedy. If the remote command
    /// fails, its status is returned instead.
    pub fn run(
        &self,
        host: &Host,
        command: &str,
        stdin: &Arc<[u8]>,
        within: Duration,
    ) -> Result<CommandOutput, String> {
        let (mut child, marks) = self.spawn(host, command)?;
        if let Some(mut pipe) = child.stdin.take() {
            let bytes = stdin.clone();
            // In a thread, which ends with the child, because it can take long. An error is ignored: a command that does not read
            // its input reports why or returns a status.
            thread::spawn(move || pipe.write_all(&bytes));
        }
        let mut stdout = collect(child.stdout.take(), MAX_ANSWER);
        let stderr = collect(child.stderr.take(), MAX_ERROR_OUTPUT);
        // What the command has started on Windows inherits its pipes, and the server of ssh waits until they are closed.
        let is_answered = || host.system == System::Windows && stdout.contains(marks.end());
        let Some(status) = wait(&mut child, within, is_answered).map_err(|error| format!("{host}: {error}"))? else {
            return Err(format!(
                "{host}: the command took longer than {:.0} s; check the host with `ssh {host}`",
                within.as_secs_f64()
            ));
        };
        let (stdout, stderr) = (stdout.text(LAST_ANSWER), stderr.text(LAST_ERROR_OUTPUT));
        let divided = marks.divide(&stdout);
        let ended = divided.as_ref().and_then(|divided| divided.end);
        let status = self.status(host, ended.map(|(_, status)| status), status, &stderr)?;
        let Some(divided) = divided else {
            return match host.system {
                System::Unix => Err(not_begun(host, status, &stdout, &stderr)),
                System::Windows => Ok(CommandOutput {
                    status,
                    stdout: NOT_INSTALLED.to_owned(),
                    stderr,
                    of_shell: printable(stdout.trim(), MAX_SENTENCE),
                }),
            };
        };
        let around = joined([divided.before.trim(), ended.map_or("", |(after, _)| after)]);
        let (stdout, stderr) = (divided.own.to_owned(), marks.error(&stderr).to_owned());
        Ok(CommandOutput { status, stdout, stderr, of_shell: printable(&around, MAX_SENTENCE) })
    }

    /// Runs a command on a host and passes each line of its output to `line` until it ends. Standard input stays open
    /// until then.
    ///
    /// # Errors
    /// The errors of [`Self::run`]; and if the command fails, its last line of standard error.
    pub fn lines(&self, host: &Host, command: &str, stdin: &[u8], mut line: impl FnMut(&str)) -> Result<(), String> {
        let (mut child, marks) = self.spawn(host, command)?;
        let mut given = child.stdin.take();
        // An error is ignored: a command that does not read its input reports why or returns a status. The pipe stays
        // open, because closing it would end the command.
        let _ = given.as_mut().map(|given| given.write_all(stdin));
        let stderr = collect(child.stderr.take(), MAX_ERROR_OUTPUT);
        let mut stdout = BufReader::new(child.stdout.take().ok_or_else(|| format!("{host}: no pipe"))?);
        let mut line = |text: &str| line(&printable(text.trim_end_matches(['\r', '\n']), MAX_LINE));
        let is_begun = marks.skip(&mut stdout);
        let mut ended = None;
        let mut bytes = Vec::new();
        // Bytes that are not text and control characters are shown as escapes.
        while stdout.read_until(b'\n', &mut bytes).is_ok_and(|read| read > 0) {
            let text = String::from_utf8_lossy(&bytes);
            match marks.ended(&text) {
                _ if ended.is_some() => (),
                None => line(&text),
                Some((last, (_, status))) => {
                    ended = Some(status);
                    if !last.is_empty() {
                        line(last);
                    }
                }
            }
            bytes.clear();
        }
        let status = child.wait().map_err(|error| format!("{host}: {error}"))?;
        let stderr = stderr.text(LAST_ERROR_OUTPUT);
        match self.status(host, ended, status, &stderr)? {
            _ if !is_begun && host.system == System::Windows => {
                line(NOT_INSTALLED);
                Ok(())
            }
            status if !is_begun => Err(not_begun(host, status, "", &stderr)),
            0 => Ok(()),
            status => {
                let why = reason::last_line(marks.error(&stderr));
                Err(format!("{host}: {}", why.unwrap_or_else(|| format!("exit status {status}"))))
            }
        }
    }

    /// Copies files to a Windows host, whose shells have no syntax in common, by the commands of `sftp`, one a line.
    ///
    /// # Errors
    /// If the host cannot be reached, a command fails or they take too long: one sentence.
    pub fn transfer(&self, host: &Host, commands: &str, within: Duration) -> Result<(), String> {
        let mut sftp = Command::new("sftp");
        let ssh = self.program.first().map_or(OsStr::new("ssh"), OsString::as_os_str);
        sftp.arg("-S").arg(ssh).args(["-q", "-b", "-", "-o", &format!("ConnectTimeout={CONNECT_S}")]);
        if let Some(path) = &self.sharing {
            sftp.args(["-o", "ControlMaster=auto", "-o", "ControlPersist=60", "-o", &format!("ControlPath={path}")]);
        }
        if let Some(user) = &host.user {
            sftp.args(["-o", &format!("User={user}")]);
        }
        sftp.args(["--", &host.name]).stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
        if self.verbose {
            eprintln!("{}", shown(&sftp));
        }
        let mut child = sftp.spawn().map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => "`sftp` was not found on this PC; install OpenSSH's client".to_owned(),
            _ => format!("sftp: {error}"),
        })?;
        if let Some(mut pipe) = child.stdin.take() {
            let commands = commands.to_owned();
            thread::spawn(move || pipe.write_all(commands.as_bytes()));
        }
        let stderr = collect(child.stderr.take(), MAX_ERROR_OUTPUT);
        match wait(&mut child, within, || false).map_err(|error| format!("{host}: {error}"))? {
            Some(status) if status.success() => Ok(()),
            Some(_) => Err(reason::sentence(host, &stderr.text(LAST_ERROR_OUTPUT), || self.keys(host))),
            None => Err(format!("{host}: copying took longer than {:.0} s", within.as_secs_f64())),
        }
    }

    /// The exit status of the command, if the mark at its end says it, else that of the account's shell, which may be another.
    fn status(&self, host: &Host, marked: Option<i32>, ssh: ExitStatus, stderr: &str) -> Result<i32, String> {
        match marked.or_else(|| ssh.code()) {
            // ssh's own.
            Some(255) if marked.is_none() => Err(reason::sentence(host, stderr, || self.keys(host))),
            Some(status) => Ok(status),
            None => Err(format!("{host}: ssh was {}", os::how_it_ended(ssh))),
        }
    }

    /// Closes the shared connection.
    pub fn close(&self, host: &Host) {
        self.control_shared(host, "exit");
    }

    /// Makes the next call log in again. Calls on the shared connection continue.
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
        command.args(&self.session);
        if let Some(path) = &self.sharing {
            let path = format!("ControlPath={path}");
            command.args(["-o", "ControlMaster=auto", "-o", "ControlPersist=60", "-o", &path]);
            // A shared connection to a host that has disappeared is detected within 10 s.
            command.args(["-o", "ServerAliveInterval=5", "-o", "ServerAliveCountMax=2"]);
        }
        if let Some(user) = &host.user {
            command.args(["-l", user]);
        }
        command
    }

    /// Starts a command on a host for a dialogue over its pipes. Its output begins after the first of the marks.
    ///
    /// # Errors
    /// If `ssh` cannot be started.
    pub fn spawn(&self, host: &Host, command: &str) -> Result<(Child, Marks), String> {
        let marks = Marks::draw()?;
        let mut ssh = self.options(host);
        ssh.args(["--", &host.name, &marks.around(host.system, command)]);
        if self.verbose {
            eprintln!("{}", shown(&ssh));
        }
        ssh.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let child = ssh.spawn().map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => "`ssh` was not found on this PC; install OpenSSH's client".to_owned(),
            _ => format!("ssh: {error}"),
        })?;
        Ok((child, marks))
    }

    /// The key files that ssh tries for this host.
    fn keys(&self, host: &Host) -> Vec<String> {
        let mut command = self.options(host);
        let output = command.args(["-G", "--", &host.name]).stdin(Stdio::null()).output();
        output.map_or_else(|_| Vec::new(), |output| reason::keys(&String::from_utf8_lossy(&output.stdout)))
    }
}

/// The sentence for a login shell that ended without running the command.
fn not_begun(host: &Host, status: i32, stdout: &str, stderr: &str) -> String {
    let printed = match joined([stdout.trim(), stderr.trim()]).as_str() {
        "" => String::new(),
        printed => format!(" and printed \"{}\"", printable(printed, MAX_SENTENCE)),
    };
    format!(
        "{host}: the login shell of this account ended with status {status} without running the command{printed}; check the \
         shell and its startup files with `ssh {host} true`"
    )
}

/// These texts, those that are not empty one below the other.
fn joined(texts: [&str; 2]) -> String {
    texts.into_iter().filter(|text| !text.is_empty()).collect::<Vec<_>>().join("\n")
}

/// Returns the `ControlPath` of shared connections, if the folder can be private to this user and its path is short
/// enough.
fn sharing(folder: &Path) -> Option<String> {
    let path = folder
        .join("s-")
        .to_str()
        .filter(|path| path.len() <= LONGEST_SOCKET && !path.contains([' ', '%', '"']))?
        .to_owned();
    (cfg!(unix) && os::private_folder(folder).is_ok()).then(|| path + "%C")
}

/// Formats a command as it could be typed in a shell.
fn shown(command: &Command) -> String {
    let arguments = [command.get_program()].into_iter().chain(command.get_args());
    let quoted = arguments.map(|argument| {
        let argument = argument.to_string_lossy();
        let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_=./@:%".contains(c);
        if argument.chars().all(is_plain) && !argument.is_empty() { argument.into_owned() } else { quote(&argument) }
    });
    quoted.collect::<Vec<_>>().join(" ")
}

/// Quotes a text as one argument for a shell.
pub fn quote(argument: &str) -> String {
    format!("'{}'", argument.replace('\'', r"'\''"))
}

/// Output of a child, read in a thread and received in pieces.
struct Collected {
    pieces: Receiver<Vec<u8>>,
    received: Vec<u8>,
}

impl Collected {
    /// Whether the output so far contains this text.
    fn contains(&mut self, text: &str) -> bool {
        self.received.extend(self.pieces.try_iter().flatten());
        self.received.windows(text.len()).any(|part| part == text.as_bytes())
    }

    /// Returns the output after the child has ended, once the pipe is closed; on a timeout what has arrived.
    fn text(self, within: Duration) -> String {
        let until = clock::now() + within;
        let next = || self.pieces.recv_timeout(until.saturating_duration_since(clock::now())).ok();
        let all: Vec<u8> = self.received.into_iter().chain(iter::from_fn(next).flatten()).collect();
        String::from_utf8_lossy(&all).into_owned()
    }
}

/// Reads a pipe to its end and keeps at most `max` bytes.
fn collect(pipe: Option<impl Read + Send + 'static>, max: u64) -> Collected {
    let (pieces, received) = channel();
    thread::spawn(move || {
        let (mut some, mut kept, mut pipe) = ([0; 8192], 0, pipe);
        while let Some(read) = pipe.as_mut().and_then(|pipe| pipe.read(&mut some).ok()).filter(|read| *read > 0) {
            if kept + read as u64 <= max {
                kept += read as u64;
                // Without a receiver the rest is read all the same, so that the child can write it.
                let _ = pieces.send(some[..read].to_vec());
            }
        }
    });
    Collected { pieces: received, received: Vec::new() }
}

/// Waits for the child to end. After `within` it kills the child and returns `None`; one that is answered and does not end is killed
/// as well.
fn wait(child: &mut Child, within: Duration, mut is_answered: impl FnMut() -> bool) -> io::Result<Option<ExitStatus>> {
    let (mut until, mut answered) = (clock::now() + within, false);
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(Some(status));
        }
        if !answered && is_answered() {
            (until, answered) = (until.min(clock::now() + AFTER_ANSWER), true);
        }
        if clock::now() >= until {
            child.kill()?;
            let status = child.wait()?;
            return Ok(answered.then_some(status));
        }
        clock::sleep(POLL_PERIOD);
    }
}

/// Groups the nodes by host; nodes without a host are left out.
pub fn by_host<'a>(nodes: impl IntoIterator<Item = &'a Node>) -> Vec<(Host, Vec<&'a Node>)> {
    let mut hosts = BTreeMap::<Host, Vec<&Node>>::new();
    for node in nodes {
        if let Some(name) = node.host.clone() {
            hosts.entry(Host { name, user: node.user.clone(), system: node.system }).or_default().push(node);
        }
    }
    let mut hosts: Vec<_> = hosts.into_iter().collect();
    hosts.sort_by_key(|(_, nodes)| nodes.first().map(|node| node.id));
    hosts
}

/// Runs the task for all items, at most [`AT_ONCE`] at a time, and returns the results in the order of the items.
pub fn at_once<T: Sync, R: Send>(all: &[T], task: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let Ok(done) = in_parallel(all.len(), AT_ONCE, |nth| Ok::<_, Infallible>(task(&all[nth])));
    done
}

#[cfg(test)]
#[cfg(unix)]
pub(super) mod tests;
