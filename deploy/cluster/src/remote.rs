//! Sends requests to a node's host, in as few ssh calls as possible. [`Remote::probe`] and [`Remote::copy`] are plain
//! `sh`, because no program of Skein may be there yet; everything else uses [`super::protocol`] and is answered by the
//! program that was copied.

use std::sync::Arc;
use std::time::Duration;

use serde_json::Value;
use skein_common::id::SwarmName;
use skein_common::printable::printable;

use super::host::{LAUNCHER, LEFT, START_WITHIN};
use super::program::{self, Glibc, Program};
use super::protocol::{Answer, Ask, Change, Facts, Request};
use super::ssh::{CommandOutput, Host, MAX_SENTENCE, NOT_INSTALLED, Ssh, quote};
use crate::inventory::{Node, System};

/// Time limit of a request, connecting included; what the host itself waits for, a landing or a process, comes on top.
const ANSWER: Duration = Duration::from_secs(20);
/// Time that a simulator may need in addition to load a flight.
const PLACED_WITHIN: Duration = Duration::from_secs(100);
/// Slowest network for a copy, bytes/s.
const SLOWEST: u64 = 256 * 1024;

/// Script that probes a host, and copies and runs a program of a few bytes where the folder is. It is passed to the login shell, of whatever kind, as one argument: a script without `'`,
/// line ends and csh's `!`, followed by its arguments. `$1` is the swarm's folder.
const PROBE: &str = r##"echo "skein platform $(uname -sm)"; echo "skein libc $(getconf GNU_LIBC_VERSION 2>/dev/null)"; p="$1/releases/$2/skein"; if [ -x "$p" ]; then echo "skein sum $(sha256sum < "$p")"; fi; d=$1; until [ -d "$d" ]; do d=$(dirname -- "$d"); done; echo "skein disk $(df -Pk -- "$d" | tail -n 1)"; echo "skein folder $d"; echo "skein user $(id -un 2>/dev/null || id -u)"; echo "skein owner $(set -- $(ls -ld -- "$d"); echo "$3")"; echo "skein limit $(ulimit -f)"; t="$d/.skein-probe.$$"; if w=$( { printf "#\041/bin/sh\nexit 0\n" > "$t" && chmod 700 "$t"; } 2>&1 ); then case $t in /*) ;; *) t="./$t";; esac; x=$("$t" 2>&1) || echo "skein run $x "; else echo "skein write $w "; fi; rm -f -- "$t" 2>/dev/null"##;
/// Script that copies the program: `$2` is the release, `$3` the checksum, `$4` the version that the program must
/// print. If anything fails, nothing is left.
const COPY: &str = r#"umask 077; b=$1; d="$1/releases/$2"; f="$d/draft.$$"; c() { rm -f -- "$f"; rmdir -- "$d" "$b/releases" "$b" "${b%/*}" 2>/dev/null; }; trap c EXIT; trap "exit 1" HUP INT TERM; mkdir -p -- "$d" && cat > "$f" || exit 1; s=$(sha256sum < "$f"); if [ "${s%% *}" != "$3" ]; then echo "the program was damaged during the copy" >&2; exit 1; fi; chmod 700 "$f" || exit 1; v=$("$f" --version) || exit 1; v=$(printf "%s\n" "$v" | sed 1q); if [ "$v" != "$4" ]; then echo "the program reports version $v, not $4" >&2; exit 1; fi; mv -f -- "$f" "$d/skein""#;
/// Script that passes a request to a program: `$2` is the node, without `/`. The program that the node runs next answers, or without
/// one any program of the swarm.
const NODE: &str = r#"p=$(readlink -- "$1/node-$2/current"); p=${p##*/}; for p in "$1/releases/${p%_*}/skein" "$1"/releases/*/skein; do if [ -x "$p" ]; then exec "$p" node; fi; done; echo skein: not installed"#;

/// The reason why a node's host did not fulfil a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fault {
    /// Nothing of the swarm is installed.
    NotInstalled,
    /// Anything else: one sentence.
    Failed(String),
}

impl Fault {
    /// Formats the fault as one sentence.
    pub fn sentence(self, host: &Host) -> String {
        match self {
            Self::NotInstalled => format!("{host}: nothing is installed; run `skein cluster install`"),
            Self::Failed(sentence) => sentence,
        }
    }
}

/// Properties of a host, before anything is installed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Probed {
    /// Platform in the format of `uname -sm`.
    pub platform: String,
    /// Version of its C library, if that is GNU's.
    pub glibc: Option<Glibc>,
    /// Checksum of this release's program there, if it exists.
    pub sum: Option<String>,
    /// Free space in the file system of the folder, bytes.
    pub free_bytes: u64,
    /// The rights of this user where the folder is.
    pub folder: FolderProbe,
}

/// The rights of this user in a node's folder, or in the nearest one above it that exists.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FolderProbe {
    /// The path of that folder.
    pub path: String,
    /// The user who has logged in.
    pub user: String,
    /// The user to whom the folder belongs.
    pub owner: String,
    /// The reason why no file can be written there, if that is so.
    pub unwritable: Option<String>,
    /// The reason why a small program that was copied there does not run, if that is so.
    pub unrunnable: Option<String>,
    /// Size limit of this user's files, bytes.
    pub limit_bytes: Option<u64>,
}

impl FolderProbe {
    /// Checks that a program of this size, bytes, can be copied there and run.
    ///
    /// # Errors
    /// If not: `what is wrong; what to do`, with the path, its owner and the cause.
    pub fn usable(&self, size: u64) -> Result<(), String> {
        let Self { path, user, owner, .. } = self;
        if let Some(why) = &self.unwritable {
            return Err(format!(
                "{user} cannot write in {path}, which belongs to {owner}: {why}; set `folder` to a folder of {user} on a file \
                 system that can be written, or let `sudo chown {user} {path}` or a remount make this one so"
            ));
        }
        if let Some(why) = &self.unrunnable {
            return Err(format!(
                "a program in {path}, which belongs to {owner}, does not run: {why}; set `folder` to one on a file system without \
                 `noexec` (`findmnt -T {path}` shows its options)"
            ));
        }
        if let Some(limit) = self.limit_bytes.filter(|limit| *limit < size) {
            return Err(format!(
                "files of {user} in {path} may have {limit} bytes, and the program has {size}; raise the limit `ulimit -f` of \
                 this account (/etc/security/limits.conf, `fsize`)"
            ));
        }
        Ok(())
    }
}

/// Sends requests to the hosts of one swarm.
#[derive(Clone, Debug)]
pub struct Remote<'a> {
    /// The caller of hosts.
    pub ssh: &'a Ssh,
    /// Name of the swarm.
    pub swarm: &'a SwarmName,
}

impl Remote<'_> {
    /// Sends a request to one node and returns an answer that is not [`Answer::Failed`].
    ///
    /// # Errors
    /// If the host cannot be reached, nothing is installed, or the node answers that it failed.
    pub fn ask(&self, host: &Host, node: &Node, ask: Ask) -> Result<Answer, Fault> {
        self.ask_program(host, &self.installed(node), node, ask)
    }

    /// Asks what is installed and running of a node.
    ///
    /// # Errors
    /// The errors of [`Self::ask`], and any other answer.
    pub fn facts(&self, host: &Host, node: &Node) -> Result<Facts, Fault> {
        match self.ask(host, node, Ask::Facts)? {
            Answer::Facts(facts) => Ok(facts),
            other => Err(unexpected(host, &other)),
        }
    }

    /// Sends a request that changes something.
    ///
    /// # Errors
    /// The errors of [`Self::ask`], and any other answer.
    pub fn change(&self, host: &Host, node: &Node, ask: Ask) -> Result<Change, Fault> {
        changed(host, self.ask(host, node, ask)?)
    }

    /// Like [`Self::change`], but the program of this release answers.
    ///
    /// # Errors
    /// The errors of [`Self::change`].
    pub fn change_by(&self, host: &Host, node: &Node, release: &str, ask: Ask) -> Result<Change, Fault> {
        changed(host, self.ask_program(host, &self.released(node, release), node, ask)?)
    }

    fn ask_program(&self, host: &Host, command: &str, node: &Node, ask: Ask) -> Result<Answer, Fault> {
        let within = match ask {
            Ask::Stop { within_s } | Ask::Remove { within_s } => ANSWER + Duration::from_secs_f64(within_s.max(0.0)),
            // The host's own sentence says more than that it did not answer, so it has the time to send it.
            Ask::Start { .. } => ANSWER + START_WITHIN,
            Ask::Place { .. } => ANSWER + PLACED_WITHIN,
            _ => ANSWER,
        };
        let output = self.ssh.run(host, command, &self.request(node, ask), within).map_err(Fault::Failed)?;
        answer(host, &output)
    }

    /// Passes each line of a node's log to `line`.
    ///
    /// # Errors
    /// The errors of [`Self::ask`].
    pub fn log(
        &self,
        host: &Host,
        node: &Node,
        (lines, follow): (usize, bool),
        mut line: impl FnMut(&str),
    ) -> Result<(), Fault> {
        let script = self.installed(node);
        let mut is_installed = true;
        let request = self.request(node, Ask::Log { lines, follow });
        let ended = self.ssh.lines(host, &script, &request, |text| match text == NOT_INSTALLED {
            true => is_installed = false,
            false => line(text),
        });
        if is_installed { ended.map_err(Fault::Failed) } else { Err(Fault::NotInstalled) }
    }

    /// Probes a host before anything is installed.
    ///
    /// # Errors
    /// If the host cannot be reached, or its answer is incomplete.
    pub fn probe(&self, host: &Host, node: &Node, release: &str) -> Result<Probed, String> {
        if node.system == System::Windows {
            return self.probe_windows(host, node, release);
        }
        let output = self.ssh.run(host, &self.script(node, PROBE, &[release]), &Arc::default(), ANSWER)?;
        probed(&output.stdout).ok_or_else(|| format!("{host}: did not report its platform ({})", output.error_text()))
    }

    /// Copies the program, verifies its checksum and its version there, and then moves it into place.
    ///
    /// # Errors
    /// If any of it fails; nothing is left there then.
    pub fn copy(&self, host: &Host, node: &Node, program: &Program) -> Result<(), String> {
        let version = concat!("skein ", env!("CARGO_PKG_VERSION"));
        let script = self.script(node, COPY, &[&program.release, &program.sum, version]);
        let within = ANSWER + Duration::from_secs(program.bytes.len() as u64 / SLOWEST);
        if node.system == System::Windows {
            return self.copy_to_windows(host, node, program, within);
        }
        let output = self.ssh.run(host, &script, &program.bytes, within)?;
        if output.status == 0 { Ok(()) } else { Err(format!("{host}: {}", output.error_text())) }
    }

    /// Asks the program of this release on a Windows host, if it is there: nothing else runs on every version of Windows.
    fn probe_windows(&self, host: &Host, node: &Node, release: &str) -> Result<Probed, String> {
        match self.ask_program(host, &self.released(node, release), node, Ask::Program) {
            Ok(Answer::Program { platform, sum, free_bytes }) => {
                Ok(Probed { platform, glibc: None, sum: Some(sum), free_bytes, folder: FolderProbe::default() })
            }
            // The copy reports what prevents it.
            Err(Fault::NotInstalled) => {
                let platform = program::WINDOWS.to_owned();
                Ok(Probed { platform, glibc: None, sum: None, free_bytes: u64::MAX, folder: FolderProbe::default() })
            }
            Ok(other) => Err(unexpected(host, &other).sentence(host)),
            Err(fault) => Err(fault.sentence(host)),
        }
    }

    /// Copies the program under another name, renames it, and lets it name its own checksum.
    fn copy_to_windows(&self, host: &Host, node: &Node, program: &Program, within: Duration) -> Result<(), String> {
        let folder = format!("{}/releases/{}", self.folder(node), program.release);
        let above: Vec<String> = {
            let parts: Vec<&str> = folder.split('/').collect();
            (1..=parts.len()).map(|count| parts[..count].join("/")).filter(|path| !path.is_empty()).collect()
        };
        // A folder may exist: a `-` before a command lets it fail.
        let made: String = above.iter().map(|path| format!("-mkdir \"{path}\"\n")).collect();
        let local = program.path.display();
        let commands = format!(
            "{made}put \"{local}\" \"{folder}/draft.exe\"\nrename \"{folder}/draft.exe\" \"{folder}/skein.exe\"\n"
        );
        self.ssh.transfer(host, &commands, within)?;
        match self.probe_windows(host, node, &program.release)?.sum {
            Some(sum) if sum == program.sum => Ok(()),
            Some(_) => Err(format!("{host}: the program was damaged during the copy")),
            None => Err(format!("{host}: the program does not run in {folder}; a program for security may forbid it")),
        }
    }

    /// Deletes what a removal had open on a Windows host, and the folders that are empty then. The files of another removal that still
    /// runs stay until its own call of this.
    ///
    /// # Errors
    /// If the host cannot be reached.
    pub fn clear(&self, host: &Host, node: &Node) -> Result<(), String> {
        if node.system != System::Windows {
            return Ok(());
        }
        let folder = self.folder(node);
        // A quoted `*` is that letter.
        let commands = format!(
            "-rm \"{folder}/{LEFT}/\"*\n-rmdir \"{folder}/{LEFT}\"\n-rmdir \"{folder}\"\n-rmdir \"{}\"\n",
            node.folder
        );
        self.ssh.transfer(host, &commands, ANSWER)
    }

    /// The command that passes a request to the program that the node runs next.
    pub(crate) fn installed(&self, node: &Node) -> String {
        match node.system {
            System::Unix => self.script(node, NODE, &[&node.id.dashed()]),
            System::Windows => format!("{}\\{LAUNCHER} node", self.folder(node).replace('/', "\\")),
        }
    }

    /// The command that passes a request to the program of a release.
    fn released(&self, node: &Node, release: &str) -> String {
        let folder = format!("{}/releases/{release}", self.folder(node));
        match node.system {
            System::Unix => format!("{} node", quote(&format!("{folder}/skein"))),
            System::Windows => format!("{}\\skein.exe node", folder.replace('/', "\\")),
        }
    }

    fn folder(&self, node: &Node) -> String {
        format!("{}/{}", node.folder, self.swarm)
    }

    fn script(&self, node: &Node, script: &str, arguments: &[&str]) -> String {
        let folder = self.folder(node);
        let parts = [script, "skein", &folder].into_iter().chain(arguments.iter().copied());
        format!("sh -c {}", parts.map(quote).collect::<Vec<_>>().join(" "))
    }

    pub(crate) fn request(&self, node: &Node, ask: Ask) -> Arc<[u8]> {
        let request = Request { swarm: self.swarm.clone(), id: node.id, ask };
        // A request has only texts, numbers and maps with text keys, so JSON never fails; the host would refuse `null`.
        let line = serde_json::to_string(&request).unwrap_or_else(|_| "null".to_owned()) + "\n";
        line.into_bytes().into()
    }
}

fn changed(host: &Host, answer: Answer) -> Result<Change, Fault> {
    match answer {
        Answer::Done(change) => Ok(change),
        other => Err(unexpected(host, &other)),
    }
}

/// The fault of a host that answers something else than what it was asked.
pub(crate) fn unexpected(host: &Host, answer: &Answer) -> Fault {
    Fault::Failed(format!("{host}: answers {answer:?}"))
}

/// Reads the answer. Every text in it is made safe for a terminal.
fn answer(host: &Host, output: &CommandOutput) -> Result<Answer, Fault> {
    let own = output.stdout.trim();
    if own == NOT_INSTALLED {
        return Err(Fault::NotInstalled);
    }
    match serde_json::from_str(own).and_then(|value| serde_json::from_value(with_printable(value))) {
        // Other nodes of this host are installed.
        Ok(Answer::Failed(why)) if why.starts_with("nothing is installed") => Err(Fault::NotInstalled),
        Ok(Answer::Failed(why)) => Err(Fault::Failed(format!("{host}: {why}"))),
        Ok(answer) => Ok(answer),
        _ => Err(Fault::Failed(format!("{host}: {}", output.error_text()))),
    }
}

/// Returns the value with every text made safe for a terminal.
fn with_printable(value: Value) -> Value {
    match value {
        Value::String(text) => Value::String(printable(&text, MAX_SENTENCE)),
        Value::Array(all) => all.into_iter().map(with_printable).collect(),
        Value::Object(all) => all.into_iter().map(|(key, value)| (key, with_printable(value))).collect(),
        other => other,
    }
}

fn probed(stdout: &str) -> Option<Probed> {
    let value = |name: &str| {
        let mut lines =
            stdout.lines().filter_map(|line| line.trim().strip_prefix("skein ")?.strip_prefix(name)?.strip_prefix(' '));
        lines.next().map(str::trim)
    };
    let text = |name: &str| printable(value(name).unwrap_or_default(), MAX_SENTENCE);
    let why = |name: &str| {
        let all = value(name)?;
        // A shell puts its own name and the file before the cause.
        let cause = all.rsplit(": ").next().filter(|cause| !cause.is_empty()).unwrap_or("no reason given");
        Some(printable(cause, MAX_SENTENCE))
    };
    let folder = FolderProbe {
        path: text("folder"),
        user: text("user"),
        owner: text("owner"),
        unwritable: why("write"),
        unrunnable: why("run"),
        // In blocks of 512 bytes.
        limit_bytes: value("limit").and_then(|blocks| blocks.parse::<u64>().ok()?.checked_mul(512)),
    };
    Some(Probed {
        folder,
        platform: printable(value("platform")?, MAX_SENTENCE),
        glibc: value("libc").and_then(program::glibc),
        sum: value("sum").and_then(|sum| sum.split(' ').next()).map(str::to_owned),
        free_bytes: free_bytes(value("disk")?)?,
    })
}

/// Reads the free space from a line of `df -Pk`: the column before the percentage.
fn free_bytes(line: &str) -> Option<u64> {
    let fields: Vec<&str> = line.split_whitespace().collect();
    let share = fields.iter().position(|field| field.ends_with('%'))?;
    fields.get(share.checked_sub(1)?)?.parse::<u64>().ok()?.checked_mul(1024)
}

#[cfg(test)]
#[cfg(unix)]
mod tests;
