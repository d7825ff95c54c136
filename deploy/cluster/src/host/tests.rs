use std::fs;
use std::path::Path;

use skein_common::id::SwarmName;

use super::node::AGENT;
use super::systemd::Systemd;
use super::*;
use crate::bundle::{Bundle, BundleFile};
use crate::inventory::ServiceKind;
use crate::protocol::{Facts, Service};
use crate::ssh::tests::write_script;

const REMOVE: Ask = Ask::Remove { within_s: 20.0 };

/// A host as the operator's PC leaves it before the first request.
fn place(folder: &Path) -> SwarmFolder {
    let release = folder.join("skein/lab/releases/r1");
    fs::create_dir_all(&release).unwrap();
    fs::write(release.join("skein"), "a program").unwrap();
    SwarmFolder::of(&release.join("skein")).unwrap()
}

fn ask(place: &SwarmFolder, ask: Ask) -> Result<Answer, String> {
    let request = Request { swarm: place.swarm.clone(), id: "1".parse().unwrap(), ask };
    // Encoded as for a real request.
    let line = serde_json::to_vec(&request).unwrap();
    answer(place, read(&line[..])?)
}

fn apply() -> Ask {
    apply_with(ServiceKind::Own)
}

fn apply_with(service: ServiceKind) -> Ask {
    let file = BundleFile { is_secret: false, is_executable: false, content: b"id = 1".to_vec() };
    let bundle = Bundle { files: [("agent.toml".to_owned(), file)].into() };
    Ask::Apply(Setup { bundle, service, log: Some("info".to_owned()) })
}

fn done(answer: Result<Answer, String>) -> (bool, Facts) {
    match answer {
        Ok(Answer::Done(Change { changed, facts, .. })) => (changed, facts),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_node_is_installed_and_removed_again() {
    let folder = tempfile::tempdir().unwrap();
    let place = place(folder.path());
    let before = ask(&place, Ask::Facts).unwrap();
    let Answer::Facts(facts) = before else { panic!("{before:?}") };
    assert!(facts.current.is_none() && facts.service.is_none() && facts.free_bytes > 0);
    assert!(!place.node("1".parse().unwrap()).path.exists(), "a request for facts writes nothing");

    let (changed, facts) = done(ask(&place, apply()));
    assert!(changed && facts.current.is_some() && facts.service == Some(Service::Own));
    let (changed, again) = done(ask(&place, apply()));
    assert!(!changed && again.current == facts.current);
    assert!(!done(ask(&place, Ask::Stop { within_s: 0.0 })).0, "nothing is running");

    assert!(done(ask(&place, REMOVE)).0);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn a_host_places_the_aircraft_of_its_x_plane_by_the_installed_scenario() {
    use clap::Parser;
    use skein_agent::plant::xplane::standin::{Standin, StandinOptions};

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        options: StandinOptions,
    }

    let given = ["standin", "--port", "0", "--beacon", "false", "--lat", "47.01", "--lon", "8.0"];
    let mut standin = Standin::open(&Cli::parse_from(given).options).unwrap();
    let (address, stop) = (standin.address.to_string(), Arc::new(AtomicBool::new(false)));
    let of_thread = Arc::clone(&stop);
    let thread = thread::spawn(move || standin.run(&of_thread));

    let folder = tempfile::tempdir().unwrap();
    let place = place(folder.path());
    let request = || Ask::Place { address: address.clone() };
    assert_eq!(ask(&place, request()), Err("nothing is installed for node 1".to_owned()));
    let scenario = "name = \"windy\"\n[origin]\nlatitude_deg = 47.0\nlongitude_deg = 8.0\nelevation_m = 0\n[swarm]\n\
                    vehicles = 1\n[world]\nwind_m_s = 4.0\nwind_from_deg = 300.0\n";
    let file = |content: &str| BundleFile { is_secret: false, is_executable: false, content: content.into() };
    let files = [("agent.toml".to_owned(), file("id = 1")), ("scenario.toml".to_owned(), file(scenario))];
    let bundle = Bundle { files: files.into() };
    done(ask(&place, Ask::Apply(Setup { bundle, service: ServiceKind::Own, log: None })));
    let Answer::Placed(lines) = ask(&place, request()).unwrap() else { panic!("another answer") };
    assert!(lines[0].starts_with("place ok: ") && lines[0].ends_with(" m from its start, by UDP"), "{lines:?}");
    assert!(lines[1].starts_with("wind ok: 4.0 m/s from 300°"), "{lines:?}");
    stop.store(true, Relaxed);
    thread.join().unwrap();
    let Answer::Placed(lines) = ask(&place, request()).unwrap() else { panic!("another answer") };
    assert!(
        matches!(&lines[..], [line] if line.starts_with("answer FAULT: no answer within 2 s; start X-Plane")),
        "{lines:?}"
    );
}

#[test]
fn a_node_of_another_authority_is_taken_over_only_on_purpose() {
    let folder = tempfile::tempdir().unwrap();
    let place = place(folder.path());
    let bundle = |authority: Option<&str>| {
        let file = |content: &str| BundleFile { is_secret: false, is_executable: false, content: content.into() };
        let keys = authority.map(|authority| ("keys/authority.pem".to_owned(), file(authority)));
        Bundle { files: keys.into_iter().chain([("agent.toml".to_owned(), file("id = 1"))]).collect() }
    };
    let apply = |authority| Ask::Apply(Setup { bundle: bundle(authority), service: ServiceKind::Own, log: None });
    let take_over =
        |authority| Ask::TakeOver(Setup { bundle: bundle(authority), service: ServiceKind::Own, log: None });
    // Keys can be added to a node that had none.
    done(ask(&place, apply(None)));
    let (_, facts) = done(ask(&place, apply(Some("first"))));
    assert_eq!(facts.authority, bundle(Some("first\n")).authority());
    for other in [Some("second"), None] {
        let refused = ask(&place, apply(other)).unwrap_err();
        assert!(
            refused.starts_with("node 1 belongs to another authority, ") && refused.contains("--take-over"),
            "{refused}"
        );
    }
    assert!(!done(ask(&place, apply(Some("first")))).0, "its own operator");
    // An agent that runs: this process.
    let node = place.node("1".parse().unwrap());
    node.write(AGENT, &node::AgentProcess { process: process::Process::own(), restarts: 0 }).unwrap();
    let refused = ask(&place, take_over(Some("second"))).unwrap_err();
    assert!(refused.starts_with("node 1 flies under another authority, "), "{refused}");
    fs::remove_file(node.file(AGENT)).unwrap();
    let (changed, facts) = done(ask(&place, take_over(Some("second"))));
    assert!(changed && facts.authority == bundle(Some("second")).authority());
}

#[test]
fn an_impossible_request_fails_and_writes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let place = place(folder.path());
    for asked in [Ask::Start { run: 1, note: None }, Ask::Stop { within_s: 1.0 }, Ask::Rollback] {
        assert_eq!(ask(&place, asked), Err("nothing is installed for node 1".to_owned()));
    }
    let other = SwarmFolder { swarm: SwarmName::new("other").unwrap(), ..place.clone() };
    let request = Request { swarm: other.swarm, id: "1".parse().unwrap(), ask: Ask::Facts };
    assert_eq!(answer(&place, request), Err("the request is for swarm other, but this is swarm lab".to_owned()));
    assert!(read(&b"{\"swarm\":3}"[..]).unwrap_err().starts_with("not a valid request: "));
    assert_eq!(fs::read_dir(folder.path().join("skein/lab")).unwrap().count(), 1, "only the releases");

    done(ask(&place, apply()));
    for within_s in [-1.0, f64::INFINITY] {
        assert!(ask(&place, Ask::Stop { within_s }).is_err(), "{within_s}");
    }
}

#[test]
fn sockets_are_in_the_services_folder_if_there_is_one() {
    let folder = tempfile::tempdir().unwrap();
    let node = place(folder.path()).node("1".parse().unwrap());
    let given = || Some("/run/skein-lab-1".into());
    assert_eq!(service::sockets(&node, Service::SystemdSystem, given()), Path::new("/run/skein-lab-1"));
    assert_eq!(
        service::sockets(&node, Service::SystemdSystem, None),
        node.file(RUN),
        "an older systemd has no such folder"
    );
    assert_eq!(service::sockets(&node, Service::Own, given()), node.file(RUN), "the folder of another service");
}

#[test]
fn a_request_does_not_wait_for_the_end_of_the_input() {
    let (input, mut output) = io::pipe().unwrap();
    let request = r#"{"swarm":"lab","id":1,"ask":{"Log":{"lines":3,"follow":true}}}"#;
    io::Write::write_all(&mut output, request.as_bytes()).unwrap();
    assert_eq!(read(input).unwrap().ask, Ask::Log { lines: 3, follow: true });
}

/// With a `systemctl` that starts and stops the unit's program, and an agent that does nothing.
#[test]
fn systemd_starts_and_stops_the_active_install() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let (bin, run) = (at.join("bin"), at.join("skein/lab/node-1/run"));
    fs::create_dir(&bin).unwrap();
    let run_text = run.display();
    write_script(
        &bin.join("systemctl"),
        &format!(
            "case \"$*\" in *reset-failed*) ;;\n\
             *start*) {run_text}/active/skein node --fly 1 >/dev/null 2>&1 & ;;\n\
             *stop*) kill $(cat {run_text}/pid) ;; esac"
        ),
    );
    write_script(&bin.join("loginctl"), "echo Linger=yes");
    let path = std::env::join_paths([bin, "/usr/bin".into(), "/bin".into()]).unwrap();
    let place =
        SwarmFolder { systemd: Systemd { is_users: true, units: at.join("units"), path: Some(path) }, ..place(at) };
    let agent = r#"{"process":{"pid":%s,"began":null},"restarts":0}"#;
    write_script(
        &place.releases().join("r1/skein"),
        &format!("printf '{agent}' $$ >{run_text}/agent.json; echo $$ >{run_text}/pid; exec sleep 60"),
    );

    let (changed, facts) = done(ask(&place, apply_with(ServiceKind::Systemd)));
    assert!(changed && facts.service == Some(Service::SystemdUser) && at.join("units/skein-lab-1.service").is_file());
    let (_, facts) = done(ask(&place, apply_with(ServiceKind::Auto)));
    assert_eq!(facts.service, Some(Service::SystemdUser), "an earlier choice is kept");
    let (changed, facts) = done(ask(&place, Ask::Start { run: 5, note: None }));
    assert!(changed && facts.agent.as_ref().is_some_and(|agent| agent.run == 5));
    let (changed, again) = done(ask(&place, Ask::Start { run: 6, note: None }));
    assert!(!changed && again.agent == facts.agent);
    let refused = ask(&place, apply_with(ServiceKind::Own)).unwrap_err();
    assert!(refused.contains("runs under another service"), "{refused}");
    let (changed, facts) = done(ask(&place, Ask::Stop { within_s: 20.0 }));
    assert!(changed && facts.agent.is_none());
    let (changed, facts) = done(ask(&place, apply_with(ServiceKind::Own)));
    assert!(changed && facts.service == Some(Service::Own) && fs::read_dir(at.join("units")).unwrap().count() == 0);
    assert!(done(ask(&place, REMOVE)).0 && !at.join("skein").exists());
}
