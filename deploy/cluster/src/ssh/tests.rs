//! Tests with a script in place of `ssh`.

use std::fs;
use std::io::Write;
use std::process::{Command, Stdio};
use std::sync::atomic::AtomicBool;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use skein_common::scenario::PlantKind;

use super::*;
use crate::inventory::{Install, ServiceKind, System};

/// Makes a program of a shell script. Another process writes the file: programs that other tests start have copies of the files that
/// this process has open, for a moment, and a program that is open for writing does not start.
pub(crate) fn write_script(path: &Path, text: &str) {
    let mut writer = Command::new("sh")
        .args(["-c", "cat >\"$0\" && chmod 755 \"$0\""])
        .arg(path)
        .stdin(Stdio::piped())
        .spawn()
        .unwrap();
    writer.stdin.take().unwrap().write_all(format!("#!/bin/sh\n{text}\n").as_bytes()).unwrap();
    assert!(writer.wait().unwrap().success());
}

/// An `ssh` that writes its arguments to the file `arguments`, one a line, and then runs this script with the command in
/// `$command`.
pub(crate) fn fake(folder: &Path, script: &str) -> Ssh {
    let path = folder.join("ssh");
    let arguments = folder.join("arguments");
    let text = format!(
        "cd '{}' || exit\nprintf '%s\\n' \"$@\" >> '{}'\nfor command; do :; done\n{script}\n",
        folder.display(),
        arguments.display()
    );
    fs::write(&path, text).unwrap();
    Ssh { program: vec!["sh".into(), path.into()], session: Vec::new(), sharing: None, verbose: false }
}

/// A host that is this PC, with its home folder in `folder`.
pub(crate) fn local(folder: &Path) -> Ssh {
    fs::create_dir_all(folder.join("home")).unwrap();
    fake(folder, "export HOME=\"$PWD/home\"; cd home; exec sh -c \"$command\"")
}

pub(crate) fn node(id: u8, host: Option<&str>) -> Node {
    Node {
        id: skein_common::id::VehicleId::new(id).unwrap().into(),
        host: host.map(str::to_owned),
        user: None,
        system: System::Unix,
        address: format!("10.0.0.{id}"),
        port: 7446 + u16::from(id),
        plant: PlantKind::Builtin,
        xplane: None,
        install: Install::Ssh,
        binary: None,
        folder: ".skein".to_owned(),
        service: ServiceKind::Auto,
        log: None,
    }
}

pub(crate) fn heli(name: &str) -> Host {
    Host { name: name.to_owned(), user: None, system: System::Unix }
}

const LONG: Duration = Duration::from_secs(30);

fn none() -> Arc<[u8]> {
    Arc::default()
}

#[test]
fn the_command_line_overrides_only_the_session_in_the_users_configuration() {
    let folder = tempfile::tempdir().unwrap();
    let mut ssh = fake(folder.path(), "exit 0");
    ssh.session = vec!["-o".to_owned(), "SessionType=default".to_owned()];
    let error = ssh.run(&heli("heli1"), "uname -sm", &none(), LONG).unwrap_err();
    assert!(error.starts_with("heli1: the login shell of this account ended with status 0 without running"), "{error}");
    ssh.sharing = Some("/run/user/7/skein/s-%C".to_owned());
    let host = Host { name: "heli2".to_owned(), user: Some("lab".to_owned()), system: System::Unix };
    ssh.run(&host, "sh -c 'x y'", &none(), LONG).unwrap_err();
    ssh.close(&host);
    let arguments = fs::read_to_string(folder.path().join("arguments")).unwrap();
    let is_mark = |part: &&str| part.starts_with("skein-");
    let arguments = arguments.replace('\n', " ");
    let given: Vec<&str> =
        arguments.trim_end().split(' ').map(|part| if is_mark(&part) { "MARK" } else { part }).collect();
    let marked = |command: &str| format!("sh -c {} MARK {}", quote(marks::SCRIPT), quote(command));
    let plain = "-T -o BatchMode=yes -o ConnectTimeout=10 -o SessionType=default";
    let shared = format!(
        "{plain} -o ControlMaster=auto -o ControlPersist=60 -o ControlPath=/run/user/7/skein/s-%C -o ServerAliveInterval=5 \
         -o ServerAliveCountMax=2 -l lab"
    );
    let (first, second) = (marked("uname -sm"), marked("sh -c 'x y'"));
    let expected = [plain, "-- heli1", &first, &shared, "-- heli2", &second, &shared, "-O exit -- heli2"];
    assert_eq!(given.join(" "), expected.join(" "));
    assert!(!arguments.contains("KnownHosts") && !arguments.contains("StrictHostKey"));
    let typed = shown(Command::new("ssh").args(["-o", "A=b", "--", "heli1", "sh -c 'x'"]));
    assert_eq!(typed, r"ssh -o A=b -- heli1 'sh -c '\''x'\'''");
}

#[test]
fn an_answer_from_windows_ends_the_call_although_what_it_started_holds_the_pipes() {
    let folder = tempfile::tempdir().unwrap();
    let mut host = heli("heli1");
    let script = r#"set -- $command; printf '%s-begin\nstarted%s-end 3.\n' "$4" "$4"; exec sleep 60"#;
    let ssh = fake(folder.path(), script);
    host.system = System::Windows;
    let begin = clock::now();
    let output = ssh.run(&host, "skein.cmd node", &none(), LONG).unwrap();
    assert_eq!((output.status, output.stdout.as_str()), (3, "started"));
    assert!(clock::now() - begin < LONG / 2);
}

#[test]
fn connections_are_shared_only_if_the_sockets_path_is_short() {
    let folder = tempfile::tempdir().unwrap();
    let short = folder.path().join("r");
    assert_eq!(sharing(&short), Some(format!("{}/s-%C", short.display())));
    assert!(os::private_folder(&short).is_ok());
    assert_eq!(sharing(&folder.path().join("x".repeat(50))), None);
    assert_eq!(sharing(&folder.path().join("a b")), None, "ssh would read two arguments");
}

#[test]
fn input_and_output_are_complete() {
    let folder = tempfile::tempdir().unwrap();
    let ssh = local(folder.path());
    let bytes: Arc<[u8]> = (0..2_000_000_u32).map(|n| b'a' + (n % 26) as u8).collect();
    let output = ssh.run(&heli("h"), "echo one >&2; echo two >&2; echo >&2; cat; exit 3", &bytes, LONG).unwrap();
    assert_eq!((output.status, output.stdout.as_bytes() == &*bytes, output.error_text().as_str()), (3, true, "two"));
    // Input that the command does not read neither blocks nor fails.
    assert_eq!(ssh.run(&heli("h"), "echo done", &bytes, LONG).unwrap().stdout, "done\n");
    // Output beyond the limit is dropped.
    let output = ssh.run(&heli("h"), "head -c 40000000 /dev/zero", &none(), LONG).unwrap();
    assert!(output.stdout.len() as u64 <= MAX_ANSWER, "{}", output.stdout.len());
    let silent = ssh.run(&heli("h"), "exit 7", &none(), LONG).unwrap();
    assert_eq!(silent.error_text(), "exit status 7");
}

#[test]
fn what_the_accounts_shell_prints_is_no_part_of_the_output() {
    let folder = tempfile::tempdir().unwrap();
    for (before, after) in [
        ("printf '\\033]0;title\\007'", ""),
        ("echo Welcome; echo tired >&2", "printf bye; echo late >&2"),
        ("printf '{'", "echo '}'; exit 255"),
        ("set -x", "exit 9"),
    ] {
        let ssh = fake(folder.path(), &format!("{before}; sh -c \"$command\"; {after}"));
        let output = ssh.run(&heli("h"), "printf 'a\\nb'; echo no >&2; exit 3", &none(), LONG).unwrap();
        assert_eq!(
            (output.status, output.stdout.as_str(), output.stderr.as_str()),
            (3, "a\nb", "no\n"),
            "{before} {after}"
        );
        assert_eq!(output.of_shell.is_empty(), before == "set -x", "{before} {after}: {output:?}");
        let mut lines = Vec::new();
        let ended = ssh.lines(&heli("h"), "printf 'a\\nb'", &none(), |line| lines.push(line.to_owned()));
        assert_eq!((ended, lines), (Ok(()), vec!["a".to_owned(), "b".to_owned()]), "{before} {after}");
    }
    let ssh = fake(folder.path(), "echo 'This account is not available.'; exit 1");
    let error = ssh.run(&heli("h"), "true", &none(), LONG).unwrap_err();
    assert!(
        error.contains("status 1 without running the command and printed \"This account is not available.\""),
        "{error}"
    );
}

#[test]
fn lines_arrive_while_the_command_runs() {
    let folder = tempfile::tempdir().unwrap();
    let ssh = local(folder.path());
    let mut lines = Vec::new();
    // The command continues only after its first line has been received.
    let command = "echo one; until [ -e taken ]; do sleep 0.01; done; printf 'two\\377\\r\\nthree'";
    let taken = folder.path().join("home/taken");
    let ended = ssh.lines(&heli("h"), command, &none(), |line| {
        fs::write(&taken, "").unwrap();
        lines.push(line.to_owned());
    });
    assert_eq!(ended, Ok(()));
    assert_eq!(lines, ["one", "two\u{fffd}", "three"]);
    let failed = ssh.lines(&heli("h"), "echo no log >&2; exit 1", &none(), |_| ());
    assert_eq!(failed, Err("h: no log".to_owned()));
}

#[test]
fn a_failure_is_reported_as_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let refuses = "echo 'ssh: connect to host heli1 port 22: Connection refused' >&2; exit 255";
    let ssh = fake(folder.path(), refuses);
    let sentence = "heli1: no ssh server answers; start its sshd, or give its port in ~/.ssh/config";
    assert_eq!(ssh.run(&heli("heli1"), "x", &none(), LONG), Err(sentence.to_owned()));
    assert_eq!(ssh.lines(&heli("heli1"), "x", &none(), |_| ()), Err(sentence.to_owned()));
    let missing =
        Ssh { program: vec![folder.path().join("none").into()], session: Vec::new(), sharing: None, verbose: false };
    let error = missing.run(&heli("heli1"), "x", &none(), LONG).unwrap_err();
    assert_eq!(error, "`ssh` was not found on this PC; install OpenSSH's client");
}

#[test]
fn a_host_that_hangs_is_given_up() {
    let folder = tempfile::tempdir().unwrap();
    let ssh = fake(folder.path(), "exec sleep 100");
    let begun = clock::now();
    let error = ssh.run(&heli("heli1"), "x", &none(), Duration::from_millis(300)).unwrap_err();
    assert!(error.starts_with("heli1: the command took longer than "), "{error}");
    assert!(clock::now() - begun < LONG);
}

#[test]
fn a_connection_that_stays_open_does_not_delay_the_result() {
    let folder = tempfile::tempdir().unwrap();
    // Older versions of ssh kept standard error open like this.
    let ssh = fake(folder.path(), "sleep 100 >/dev/null & echo $! > pid; exec sh -c \"$command\"");
    let begun = clock::now();
    let output = ssh.run(&heli("heli1"), "echo warned >&2; echo done", &none(), LONG).unwrap();
    assert_eq!((output.stdout.as_str(), output.error_text().as_str()), ("done\n", "warned"));
    assert!(clock::now() - begun < LONG);
    let pid = fs::read_to_string(folder.path().join("pid")).unwrap();
    Command::new("kill").arg(pid.trim()).status().unwrap();
}

#[test]
fn at_most_eight_hosts_are_called_at_once() {
    let all: Vec<usize> = (0..30).collect();
    let running = AtomicUsize::new(0);
    let most = AtomicUsize::new(0);
    let full = AtomicBool::new(false);
    let until = clock::now() + LONG;
    let done = at_once(&all, |nth| {
        let now = running.fetch_add(1, Relaxed) + 1;
        most.fetch_max(now, Relaxed);
        if now == AT_ONCE.get() {
            full.store(true, Relaxed);
        }
        // No task ends before eight have run together.
        while !full.load(Relaxed) && clock::now() < until {
            clock::sleep(Duration::from_millis(1));
        }
        running.fetch_sub(1, Relaxed);
        nth * 2
    });
    assert_eq!(done, all.iter().map(|nth| nth * 2).collect::<Vec<_>>(), "in their order");
    assert_eq!(most.load(Relaxed), AT_ONCE.get());
    assert!(at_once(&[], |nth: &usize| *nth).is_empty());
}

#[test]
fn nodes_are_grouped_by_host_and_user() {
    let mut nodes = [node(1, Some("b")), node(2, Some("a")), node(3, None), node(4, Some("b")), node(5, Some("b"))];
    nodes[4].user = Some("other".to_owned());
    let hosts = by_host(&nodes);
    let grouped: Vec<_> = hosts
        .iter()
        .map(|(host, nodes)| (host.to_string(), nodes.iter().map(|node| node.id.vehicle.get()).collect::<Vec<_>>()))
        .collect();
    assert_eq!(grouped, [("b".to_owned(), vec![1, 4]), ("a".to_owned(), vec![2]), ("other@b".to_owned(), vec![5])]);
}
