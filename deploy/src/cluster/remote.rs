//! What is asked of a node's host, in as few calls as it takes: [`Remote::probe`] and [`Remote::copy`] are plain `sh`, because
//! nothing of ours may be there yet; everything else is [`super::protocol`], answered by the program that was copied.

use std::sync::Arc;
use std::time::Duration;

use serde_json::Value;
use skein_common::id::SwarmName;
use skein_common::printable::printable;

use super::program::{self, Glibc, Program};
use super::protocol::{Answer, Ask, Request};
use super::ssh::{CommandOutput, Host, MAX_SENTENCE, Ssh, quote};
use crate::inventory::Node;

/// Within this time every question is answered, connecting included; in addition to a landing that is part of it.
const ANSWER: Duration = Duration::from_secs(20);
/// A copy takes longer, by the slowest network that is still one, bytes/s.
const SLOWEST: u64 = 256 * 1024;

/// What `ssh` runs is one word for the login shell, whichever that is: a script without `'`, line ends and csh's `!`, and its
/// arguments. `$1` is the swarm's folder.
const PROBE: &str = r#"echo "skein platform $(uname -sm)"; echo "skein libc $(getconf GNU_LIBC_VERSION 2>/dev/null)"; p="$1/releases/$2/skein"; if [ -x "$p" ]; then echo "skein sum $(sha256sum < "$p")"; fi; d=$1; until [ -d "$d" ]; do d=$(dirname -- "$d"); done; echo "skein disk $(df -Pk -- "$d" | tail -n 1)""#;
/// `$2` the release, `$3` the checksum, `$4` what the program says of its version. Whatever goes wrong: nothing is left.
const COPY: &str = r#"umask 077; b=$1; d="$1/releases/$2"; f="$d/draft.$$"; c() { rm -f -- "$f"; rmdir -- "$d" "$b/releases" "$b" "${b%/*}" 2>/dev/null; }; trap c EXIT; trap "exit 1" HUP INT TERM; mkdir -p -- "$d" && cat > "$f" || exit 1; s=$(sha256sum < "$f"); if [ "${s%% *}" != "$3" ]; then echo "the program was damaged on its way" >&2; exit 1; fi; chmod 700 "$f" || exit 1; v=$("$f" --version) || exit 1; if [ "$v" != "$4" ]; then echo "the program says it is $v, not $4" >&2; exit 1; fi; mv -f -- "$f" "$d/skein""#;
/// `$2` the node. What it runs next answers; without that whatever program of the swarm there is.
const NODE: &str = r#"p=$(readlink -- "$1/node-$2/current"); p=${p##*/}; for p in "$1/releases/${p%_*}/skein" "$1"/releases/*/skein; do if [ -x "$p" ]; then exec "$p" node; fi; done; echo skein: not installed"#;

/// What [`NODE`] says where there is nothing of the swarm.
const NOT_INSTALLED: &str = "skein: not installed";

/// Why a node's host did not do what it was asked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fault {
    /// Nothing of the swarm is there.
    NotInstalled,
    /// One sentence.
    Failed(String),
}

impl Fault {
    /// In words.
    pub fn sentence(self, host: &Host) -> String {
        match self {
            Self::NotInstalled => format!("{host}: nothing is installed there; `skein cluster install`"),
            Self::Failed(sentence) => sentence,
        }
    }
}

/// What a host says of itself before anything of ours is there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Probed {
    /// As `uname -sm` says it.
    pub platform: String,
    /// Its C library, if that is GNU's.
    pub glibc: Option<Glibc>,
    /// Checksum of the program of this release, if there is one.
    pub sum: Option<String>,
    /// Free space where the folder is or will be, bytes.
    pub free_bytes: u64,
}

/// Asks the hosts of one swarm.
#[derive(Clone, Debug)]
pub struct Remote<'a> {
    /// How.
    pub ssh: &'a Ssh,
    /// The swarm.
    pub swarm: &'a SwarmName,
}

impl Remote<'_> {
    /// Asks one node, and gives an answer that is not [`Answer::Failed`].
    ///
    /// # Errors
    /// If the host cannot be reached, nothing is installed, or the node says that it could not be done.
    pub fn ask(&self, host: &Host, node: &Node, ask: Ask) -> Result<Answer, Fault> {
        self.ask_program(host, &self.script(node, NODE, &[&node.id.to_string()]), node, ask)
    }

    /// As [`Self::ask`], of the program of this release.
    ///
    /// # Errors
    /// As there.
    pub fn ask_release(&self, host: &Host, node: &Node, release: &str, ask: Ask) -> Result<Answer, Fault> {
        let program = format!("{}/releases/{release}/skein", self.folder(node));
        self.ask_program(host, &format!("{} node", quote(&program)), node, ask)
    }

    fn ask_program(&self, host: &Host, command: &str, node: &Node, ask: Ask) -> Result<Answer, Fault> {
        let within = match ask {
            Ask::Stop { within_s } | Ask::Remove { within_s } => ANSWER + Duration::from_secs_f64(within_s.max(0.0)),
            _ => ANSWER,
        };
        let output = self.ssh.run(host, command, &self.request(node, ask), within).map_err(Fault::Failed)?;
        answer(host, &output)
    }

    /// Hands over the lines of a node's log.
    ///
    /// # Errors
    /// As [`Self::ask`].
    pub fn log(
        &self,
        host: &Host,
        node: &Node,
        (lines, follow): (usize, bool),
        mut line: impl FnMut(&str),
    ) -> Result<(), Fault> {
        let script = self.script(node, NODE, &[&node.id.to_string()]);
        let mut is_installed = true;
        let request = self.request(node, Ask::Log { lines, follow });
        let ended = self.ssh.lines(host, &script, &request, |text| match text == NOT_INSTALLED {
            true => is_installed = false,
            false => line(text),
        });
        if is_installed { ended.map_err(Fault::Failed) } else { Err(Fault::NotInstalled) }
    }

    /// What there is before anything of ours is.
    ///
    /// # Errors
    /// If the host cannot be reached, or does not say it.
    pub fn probe(&self, host: &Host, node: &Node, release: &str) -> Result<Probed, String> {
        let output = self.ssh.run(host, &self.script(node, PROBE, &[release]), &Arc::default(), ANSWER)?;
        probed(&output.stdout).ok_or_else(|| format!("{host}: does not say what it is ({})", output.error_text()))
    }

    /// Copies the program, verifies its checksum and its version there, and only then puts it in its place.
    ///
    /// # Errors
    /// If any of it fails: nothing is left there then.
    pub fn copy(&self, host: &Host, node: &Node, program: &Program) -> Result<(), String> {
        let version = concat!("skein ", env!("CARGO_PKG_VERSION"));
        let script = self.script(node, COPY, &[&program.release, &program.sum, version]);
        let within = ANSWER + Duration::from_secs(program.bytes.len() as u64 / SLOWEST);
        let output = self.ssh.run(host, &script, &program.bytes, within)?;
        if output.status == 0 { Ok(()) } else { Err(format!("{host}: {}", output.error_text())) }
    }

    fn folder(&self, node: &Node) -> String {
        format!("{}/{}", node.folder, self.swarm)
    }

    fn script(&self, node: &Node, script: &str, arguments: &[&str]) -> String {
        let folder = self.folder(node);
        let fields = [script, "skein", &folder].into_iter().chain(arguments.iter().copied());
        format!("sh -c {}", fields.map(quote).collect::<Vec<_>>().join(" "))
    }

    fn request(&self, node: &Node, ask: Ask) -> Arc<[u8]> {
        let request = Request { swarm: self.swarm.clone(), id: node.id, ask };
        // Texts, numbers and maps by text always have a form in JSON; `null` would be refused there.
        let line = serde_json::to_string(&request).unwrap_or_else(|_| "null".to_owned()) + "\n";
        line.into_bytes().into()
    }
}

/// The last line that says something: what a login shell writes before it is none of ours. Every text in it is fit for a
/// terminal.
fn answer(host: &Host, output: &CommandOutput) -> Result<Answer, Fault> {
    let last = output.stdout.lines().rev().map(str::trim).find(|line| !line.is_empty());
    let read =
        |line: &str| serde_json::from_str(line).and_then(|output| serde_json::from_value(with_printable(output)));
    match last.map(|line| (line, read(line))) {
        Some((NOT_INSTALLED, _)) => Err(Fault::NotInstalled),
        // Other nodes of this host are.
        Some((_, Ok(Answer::Failed(why)))) if why.starts_with("nothing is installed") => Err(Fault::NotInstalled),
        Some((_, Ok(Answer::Failed(why)))) => Err(Fault::Failed(format!("{host}: {why}"))),
        Some((_, Ok(answer))) => Ok(answer),
        _ => Err(Fault::Failed(format!("{host}: {}", output.error_text()))),
    }
}

/// The same with every text as it may be shown.
fn with_printable(output: Value) -> Value {
    match output {
        Value::String(text) => Value::String(printable(&text, MAX_SENTENCE)),
        Value::Array(all) => all.into_iter().map(with_printable).collect(),
        Value::Object(all) => all.into_iter().map(|(key, value)| (key, with_printable(value))).collect(),
        other => other,
    }
}

fn probed(stdout: &str) -> Option<Probed> {
    let value = |name: &str| {
        let mut lines = stdout.lines().filter_map(|line| line.trim().strip_prefix("skein ")?.strip_prefix(name));
        lines.next_back().map(str::trim)
    };
    Some(Probed {
        platform: printable(value("platform")?, MAX_SENTENCE),
        glibc: value("libc").and_then(program::glibc),
        sum: value("sum").and_then(|sum| sum.split(' ').next()).map(str::to_owned),
        free_bytes: free_bytes(value("disk")?)?,
    })
}

/// Of a line of `df -Pk`: what stands before the share that is used.
fn free_bytes(line: &str) -> Option<u64> {
    let fields: Vec<&str> = line.split_whitespace().collect();
    let share = fields.iter().position(|field| field.ends_with('%'))?;
    fields.get(share.checked_sub(1)?)?.parse::<u64>().ok()?.checked_mul(1024)
}

#[cfg(test)]
#[cfg(unix)]
mod tests;
