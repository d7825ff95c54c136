//! Tests with this PC as the host and a script as the program.

use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;

use super::*;
use crate::ssh::tests::{heli, local, node};

const VERSION: &str = concat!("skein ", env!("CARGO_PKG_VERSION"));

/// A program that prints this version and records each request that it answers.
fn program(folder: &Path, version: &str) -> Program {
    let path = folder.join("program");
    let echo = r#"[ "$1" = node ] && read -r asked && printf '%s %s\n' "$0" "$asked" > asked; echo '{"Simulator":{"Ok":"it"}}'"#;
    fs::write(&path, format!("#!/bin/sh\n[ \"$1\" = --version ] && {{ echo {version}; exit; }}\n{echo}\n")).unwrap();
    Program::read(Some(&path)).unwrap()
}

/// All paths below the home folder, sorted.
fn tree(folder: &Path) -> Vec<String> {
    let mut all = Vec::new();
    let mut folders = vec![folder.join("home")];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            all.push(path.strip_prefix(folder.join("home")).unwrap().to_str().unwrap().to_owned());
            folders.extend((path.is_dir() && !path.is_symlink()).then_some(path));
        }
    }
    all.sort();
    all
}

#[test]
fn a_program_is_copied_completely_or_not_at_all() {
    let folder = tempfile::tempdir().unwrap();
    let ssh = local(folder.path());
    let swarm = SwarmName::new("lab").unwrap();
    let remote = Remote { ssh: &ssh, swarm: &swarm };
    let (host, mut node) = (heli("heli1"), node(3, Some("heli1")));
    let good = program(folder.path(), VERSION);

    let before = remote.probe(&host, &node, &good.release).unwrap();
    let uname = std::process::Command::new("uname").arg("-sm").output().unwrap();
    assert_eq!(before.platform, String::from_utf8(uname.stdout).unwrap().trim());
    assert_eq!(before.sum, None);
    assert!(before.free_bytes > 0);
    assert_eq!(before.folder.usable(1), Ok(()), "{before:?}");
    assert!(before.folder.path == "." && !before.folder.owner.is_empty() && before.folder.user == before.folder.owner);
    assert!(tree(folder.path()).is_empty(), "a probe writes nothing");

    // Damaged during the copy: another checksum.
    let damaged = Program { bytes: good.bytes[1..].into(), ..good.clone() };
    let error = remote.copy(&host, &node, &damaged).unwrap_err();
    assert_eq!(error, "heli1: the program was damaged during the copy");
    assert!(tree(folder.path()).is_empty(), "{:?}", tree(folder.path()));
    // Another version.
    let old = program(folder.path(), "skein 0.0.1");
    let error = remote.copy(&host, &node, &old).unwrap_err();
    assert_eq!(error, format!("heli1: the program reports version skein 0.0.1, not {VERSION}"));
    assert!(tree(folder.path()).is_empty(), "{:?}", tree(folder.path()));
    // A program that cannot run there.
    let mut none = program(folder.path(), VERSION);
    none.bytes = b"\x7fELF".as_slice().into();
    none.sum = Program::read(Some(&{
        let path = folder.path().join("none");
        fs::write(&path, &none.bytes).unwrap();
        path
    }))
    .unwrap()
    .sum;
    assert!(remote.copy(&host, &node, &none).is_err());
    assert!(tree(folder.path()).is_empty(), "{:?}", tree(folder.path()));

    remote.copy(&host, &node, &good).unwrap();
    let release = format!(".skein/lab/releases/{}", good.release);
    let file = format!("{release}/skein");
    let all = [".skein", ".skein/lab", ".skein/lab/releases", release.as_str(), file.as_str()];
    assert_eq!(tree(folder.path()), all);
    let path = folder.path().join("home").join(&file);
    assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o700);
    assert_eq!(remote.probe(&host, &node, &good.release).unwrap().sum.as_deref(), Some(good.sum.as_str()));
    // Again: nothing changes, and other files there are kept.
    remote.copy(&host, &node, &good).unwrap();
    remote.copy(&host, &node, &damaged).unwrap_err();
    assert_eq!(tree(folder.path()), all);

    // A folder with special characters, and an absolute one.
    for name in ["it's a $HOME", "/absolute"] {
        node.folder = match name.strip_prefix('/') {
            Some(name) => folder.path().join("home").join(name).display().to_string(),
            None => name.to_owned(),
        };
        remote.copy(&host, &node, &good).unwrap();
        assert!(remote.probe(&host, &node, &good.release).unwrap().sum.is_some(), "{name}");
        let name = name.trim_start_matches('/');
        assert!(folder.path().join("home").join(name).join("lab/releases").is_dir(), "{name}");
    }
}

#[test]
fn a_request_is_answered_by_the_program_that_the_node_runs() {
    let folder = tempfile::tempdir().unwrap();
    let ssh = local(folder.path());
    let swarm = SwarmName::new("lab").unwrap();
    let remote = Remote { ssh: &ssh, swarm: &swarm };
    let (host, node) = (heli("heli1"), node(3, Some("heli1")));
    assert_eq!(remote.ask(&host, &node, Ask::Facts), Err(Fault::NotInstalled));
    assert_eq!(remote.log(&host, &node, (5, false), |_| ()), Err(Fault::NotInstalled));

    let first = program(folder.path(), VERSION);
    remote.copy(&host, &node, &first).unwrap();
    let second = Program { release: "9.9.9-abc".to_owned(), ..first.clone() };
    remote.copy(&host, &node, &second).unwrap();
    let asked = |with: &Program, ask: Ask| {
        let asked = fs::read_to_string(folder.path().join("home/asked")).unwrap();
        let request = Request { swarm: swarm.clone(), id: node.id, ask };
        let json = serde_json::to_string(&request).unwrap();
        assert_eq!(asked, format!(".skein/lab/releases/{}/skein {json}\n", with.release));
    };
    let simulator = Ok(Answer::Simulator(Ok("it".to_owned())));
    // No program is current, so any may answer.
    assert_eq!(remote.ask(&host, &node, Ask::Rollback), simulator);
    asked(&first, Ask::Rollback);
    let unexpected = Err(Fault::Failed(r#"heli1: answers Simulator(Ok("it"))"#.to_owned()));
    assert_eq!(remote.change_by(&host, &node, &second.release, Ask::Facts), unexpected);
    asked(&second, Ask::Facts);
    let home = folder.path().join("home/.skein/lab/node-3");
    fs::create_dir_all(&home).unwrap();
    symlink("installs/9.9.9-abc_0123456789abcdef", home.join("current")).unwrap();
    assert_eq!(remote.ask(&host, &node, Ask::Start { run: 7, note: None }), simulator);
    asked(&second, Ask::Start { run: 7, note: None });
    let mut lines = Vec::new();
    remote.log(&host, &node, (5, true), |line| lines.push(line.to_owned())).unwrap();
    asked(&second, Ask::Log { lines: 5, follow: true });
    assert_eq!(lines, [r#"{"Simulator":{"Ok":"it"}}"#]);
    let error = remote.change_by(&host, &node, "none", Ask::Facts).unwrap_err();
    assert!(matches!(error, Fault::Failed(_)), "{error:?}");
}

#[test]
fn a_probe_is_read_by_the_names_of_its_lines() {
    let output = "skein platform Linux x86_64\nskein libc glibc 2.36\nskein sum 00ff  -\n\
                skein disk /dev/my disk 1000 400 600 40% /\nskein folder .\n\
                skein user lab\nskein owner root\nskein limit 8\nskein write sh: 1: cannot create ./x: Permission denied \n";
    let full = probed(output).unwrap();
    let glibc = Some((2, 36));
    let sum = Some("00ff".to_owned());
    let folder = FolderProbe {
        path: ".".to_owned(),
        user: "lab".to_owned(),
        owner: "root".to_owned(),
        unwritable: Some("Permission denied".to_owned()),
        unrunnable: None,
        limit_bytes: Some(4096),
    };
    let why = folder.usable(1).unwrap_err();
    assert!(
        why.starts_with("lab cannot write in ., which belongs to root: Permission denied; set `folder` to"),
        "{why}"
    );
    let small = FolderProbe { unwritable: None, ..folder.clone() };
    assert!(small.usable(4096).is_ok() && small.usable(4097).unwrap_err().contains("may have 4096 bytes"));
    assert_eq!(full, Probed { platform: "Linux x86_64".to_owned(), glibc, sum, free_bytes: 600 * 1024, folder });
    let bare = output.replace("skein sum 00ff  -\n", "").replace("glibc 2.36", "");
    let bare = probed(&bare).unwrap();
    assert_eq!((bare.glibc, bare.sum), (None, None));
    assert_eq!(probed("skein platform Linux x86_64\n"), None);
}

#[test]
fn every_text_of_an_answer_is_made_safe_for_a_terminal() {
    let hostile = r#"{"Facts":{"current":{"release":"r\u001b[2J","bundle":"b\nnode 9"},"previous":null,"service":null,"agent":null,"free_bytes":1}}"#;
    let output =
        CommandOutput { status: 0, stdout: hostile.to_owned(), stderr: String::new(), of_shell: String::new() };
    let Ok(Answer::Facts(facts)) = answer(&heli("h"), &output) else { panic!("facts") };
    let current = facts.current.unwrap();
    assert_eq!((current.release.as_str(), current.bundle.as_str()), ("r\\u001b[2J", "b\\u000anode 9"));
    let output = CommandOutput { stdout: "{\"Failed\":\"\\u009b31m\"}".to_owned(), ..output };
    assert_eq!(answer(&heli("h"), &output), Err(Fault::Failed("h: \\u009b31m".to_owned())));
    let output = CommandOutput { status: 1, stdout: String::new(), stderr: "no\u{7}\n".to_owned(), ..output };
    assert_eq!(answer(&heli("h"), &output), Err(Fault::Failed("h: no\\u0007".to_owned())));
}

#[test]
fn the_answer_is_all_of_the_output() {
    let output = |status, stdout: &str, stderr: &str| CommandOutput {
        status,
        stdout: stdout.to_owned(),
        stderr: stderr.to_owned(),
        of_shell: String::new(),
    };
    let answered = |output: CommandOutput| answer(&heli("heli1"), &output);
    let simulator = Answer::Simulator(Ok("X-Plane".to_owned()));
    let line = serde_json::to_string(&simulator).unwrap();
    assert_eq!(answered(output(0, &format!("{line}\n"), "")), Ok(simulator));
    assert_eq!(answered(output(0, "skein: not installed\n", "")), Err(Fault::NotInstalled));
    let failed = |why: &str| Err(Fault::Failed(format!("heli1: {why}")));
    assert_eq!(answered(output(0, "{\"Failed\":\"no room\"}\n", "")), failed("no room"));
    let none = "{\"Failed\":\"nothing is installed for node 3\"}\n";
    assert_eq!(answered(output(0, none, "")), Err(Fault::NotInstalled));
    assert_eq!(answered(output(127, "", "sh: 1: x: not found\n")), failed("sh: 1: x: not found"));
    assert_eq!(answered(output(3, "", "")), failed("exit status 3"));
}

#[test]
fn scripts_are_one_argument_for_any_shell() {
    for script in [PROBE, COPY, NODE] {
        assert!(!script.contains(['\'', '\n']), "{script}");
        // csh does not expand `!` before `=`.
        assert!(!script.replace("!=", "").contains('!'), "{script}");
    }
}
