use std::io::{BufRead, BufReader, Write};
use std::net::{TcpStream, UdpSocket};

use nalgebra::Vector3;
use skein_common::scenario::{Source, load};

use super::*;
use skein_core::formation::external::{OwnState, ReplyCommand};
use skein_core::formation::law::Goal;
use skein_host::clock::sleep_until;

/// Time limit of a wait.
const TIMEOUT: Duration = Duration::from_secs(30);

fn id(number: u8) -> VehicleId {
    VehicleId::new(number).unwrap()
}

/// The law of vehicle 2 with this transport. Replies are late only after ten seconds, unless `external` sets another
/// deadline.
fn law(external: &str) -> Result<LiveLaw, ExternalError> {
    let text =
        format!("swarm.vehicles = 2\nformation.law = 'external'\n[formation.external]\nperiod_s = 10\n{external}");
    let source = Source { name: "test.toml", text: &text };
    LiveLaw::start(&load(&source, &[]).unwrap().scenario, id(2)).map(Option::unwrap)
}

/// A shell script that is ready and then replies to each query with the output of `answer`.
fn shell(answer: &str) -> LiveLaw {
    let script = format!(
        r#"read hello; echo '{{"say":"ready","protocol":1}}'; while read ask; do tick=$(echo "$ask" | sed 's/.*"tick":\([0-9]*\).*/\1/'); {answer}; done"#
    );
    law(&format!("deadline_s = 10\ncommand = ['sh', '-c', '''{script}''']")).unwrap()
}

const GOOD: &str = r#"echo "{\"say\":\"answer\",\"vehicle\":2,\"tick\":$tick,\"velocity_ned_m_s\":[1,2,3]}""#;

fn ask(tick: u64) -> LawQuery {
    let own = OwnState { position: [0.0; 3].into(), velocity: [0.0; 3].into(), heading_rad: 0.0, age_s: 0.0 };
    let goal = Goal {
        step: 0,
        centre: [0.0; 3].into(),
        centre_velocity: [0.0; 3].into(),
        heading_rad: 0.0,
        radius_m: 100.0,
        gamma: 1.0,
    };
    LawQuery { vehicle: id(2), tick, time_s: 0.0, dt_s: 0.1, own, peers: Vec::new(), goal }
}

/// Queries repeatedly, as a vehicle does, starting at this tick; returns the first reply, or `None` after `within`.
fn answer_to(law: &LiveLaw, mut tick: u64, within: Duration) -> Option<LawReply> {
    let until = now() + within;
    let mut next = now();
    while now() < until {
        if now() >= next {
            law.ask(ask(tick));
            (tick, next) = (tick + 1, now() + Duration::from_millis(200));
        }
        if let Some(answer) = law.take().0 {
            return Some(answer);
        }
        sleep_until(now() + Duration::from_millis(5));
    }
    None
}

#[test]
fn a_law_process_replies() {
    let law = shell(GOOD);
    let answer = answer_to(&law, 40, TIMEOUT).unwrap();
    assert_eq!((answer.vehicle, answer.command), (id(2), ReplyCommand::VelocityNed(Vector3::new(1.0, 2.0, 3.0))));
    assert!(answer.tick >= 40);
    assert_eq!(law.take().0, None, "every reply is returned once");
}

/// Asserts that no reply of these programs to a query is passed on. The programs run side by side.
fn assert_no_replies(scripts: &[&str]) {
    thread::scope(|scope| {
        for script in scripts {
            scope.spawn(move || assert_eq!(answer_to(&shell(script), 1, Duration::from_secs(2)), None, "{script}"));
        }
    });
}

/// A shell command that replies with these values.
fn answering(vehicle: &str, tick: &str, velocity: &str) -> String {
    format!(r#"echo "{{\"say\":\"answer\",\"vehicle\":{vehicle},\"tick\":{tick},\"velocity_ned_m_s\":{velocity}}}""#)
}

#[test]
fn lines_that_are_not_json_are_not_passed_on() {
    let zeros = "head -c 200000 /dev/zero; echo";
    assert_no_replies(&["echo '{'", "echo 'Traceback'", zeros, "head -c 1000 /dev/urandom; echo"]);
}

#[test]
fn replies_for_another_vehicle_or_tick_are_not_passed_on() {
    // On a busy PC the next tick may have been asked when the reply arrives, but never one so far ahead.
    let answers = [("1", "$tick"), ("2", "$((tick+1000))"), ("2", "0")];
    let [vehicle, later, earlier] = answers.map(|(vehicle, tick)| answering(vehicle, tick, "[1,2,3]"));
    assert_no_replies(&[&vehicle, &later, &earlier]);
}

#[test]
fn replies_without_three_finite_numbers_are_not_passed_on() {
    let [nan, huge, two] = ["[NaN,2,3]", "[1e300,2,3]", "[1,2]"].map(|velocity| answering("2", "$tick", velocity));
    assert_no_replies(&[&nan, &huge, &two]);
}

#[test]
fn the_reason_of_a_refused_reply_is_passed_on_once() {
    let law = shell(&answering("2", "$tick", "[1,2]"));
    let (mut reasons, mut tick) = (Vec::new(), 1);
    let until = now() + TIMEOUT;
    // Some more queries after the first reason.
    let mut left = 5;
    while left > 0 && now() < until {
        law.ask(ask(tick));
        sleep_until(now() + Duration::from_millis(100));
        reasons.extend(law.take().1.map(|reason| reason.to_string()));
        (tick, left) = (tick + 1, left - u64::from(!reasons.is_empty()));
    }
    assert_eq!(reasons, ["a reply whose velocity_ned_m_s is not three finite numbers"]);
}

#[test]
fn a_program_that_never_replies_does_not_delay_the_vehicle() {
    let always_ready = r#"while true; do echo '{"say":"ready","protocol":1}'; done"#;
    assert_no_replies(&["true", "exec <&-; sleep 1000", "exec >&-; sleep 1000", always_ready]);
}

#[test]
fn a_late_reply_is_dropped_and_the_next_in_time_is_used() {
    // The first reply takes a second, all others come at once.
    let late = format!(r#"if [ "$tick" = 1 ]; then sleep 1; fi; {GOOD}"#);
    let script = format!(
        r#"read hello; echo '{{"say":"ready","protocol":1}}'; while read ask; do tick=$(echo "$ask" | sed 's/.*"tick":\([0-9]*\).*/\1/'); {late}; done"#
    );
    let law = law(&format!("deadline_s = 0.5\ncommand = ['sh', '-c', '''{script}''']")).unwrap();
    let until = now() + TIMEOUT;
    let mut tick = 1;
    let answer = loop {
        // Each query is given up before the next.
        law.ask(ask(tick));
        sleep_until(now() + Duration::from_millis(700));
        if let Some(answer) = law.take().0 {
            break answer;
        }
        assert!(now() < until);
        tick += 1;
    };
    assert!(answer.tick > 1, "{answer:?}");
}

#[test]
fn a_law_process_that_ends_is_started_again() {
    let law = shell(&format!("{GOOD}; exit 1"));
    let first = answer_to(&law, 1, TIMEOUT).unwrap();
    let second = answer_to(&law, first.tick + 1, TIMEOUT).expect("a reply after the restart");
    assert!(second.tick > first.tick);
}

#[test]
fn a_law_that_does_not_start_is_an_error_at_once() {
    let error = law("command = ['no-such-program-7']").unwrap_err();
    assert_eq!(error.to_string(), "formation.external.command: program \"no-such-program-7\" not found");
    let folder = tempfile::tempdir().unwrap();
    let error = law(&format!("command = ['{}/']", folder.path().display())).unwrap_err();
    assert!(error.to_string().contains("not found"), "{error}");
    let taken = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let held = TcpListener::bind(("127.0.0.1", taken)).unwrap();
    let error = law(&format!("listen = 'tcp/127.0.0.1:{}'", taken - 2)).unwrap_err();
    assert!(error.to_string().starts_with(&format!("formation.external: 127.0.0.1:{taken}: ")), "{error}");
    drop(held);
}

/// Finds a port such that vehicle 2's port, two above it, is free.
fn ports(bind: impl Fn(u16) -> bool) -> u16 {
    let free = || UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    (0..100).map(|_| free()).find(|&port| port < 60_000 && bind(port + 2)).unwrap()
}

#[test]
fn a_law_that_connects_is_queried_and_may_reconnect() {
    let port = ports(|port| TcpListener::bind(("127.0.0.1", port)).is_ok());
    let law = law(&format!("deadline_s = 10\nlisten = 'tcp/127.0.0.1:{port}'")).unwrap();
    assert_eq!(answer_to(&law, 1, Duration::from_millis(300)), None, "the law has not connected yet");
    for life in 1..=2 {
        let stream = TcpStream::connect(("127.0.0.1", port + 2)).unwrap();
        let mut to = stream.try_clone().unwrap();
        let program = thread::spawn(move || {
            let mut lines = BufReader::new(stream).lines().map_while(Result::ok);
            assert!(lines.next().unwrap().starts_with("{\"say\":\"hello\""));
            writeln!(to, "{{\"say\":\"ready\",\"protocol\":1}}").unwrap();
            for line in lines.take(5) {
                let asked: serde_json::Value = serde_json::from_str(&line).unwrap();
                let tick = &asked["tick"];
                let answer = format!("{{\"say\":\"answer\",\"vehicle\":2,\"tick\":{tick},\"field_ne\":[0.5,{life}]}}");
                writeln!(to, "{answer}").unwrap();
            }
        });
        let answer = answer_to(&law, 1000 * life, TIMEOUT).unwrap();
        assert_eq!(answer.command, ReplyCommand::FieldNe(nalgebra::Vector2::new(0.5, life as f64)));
        while !program.is_finished() {
            answer_to(&law, 1000 * life + 500, Duration::from_millis(300));
        }
        program.join().unwrap();
    }
}

#[test]
fn vector_queries_are_repeated_and_replies_accepted_from_any_port() {
    let port = ports(|port| {
        let free = |port| UdpSocket::bind(("127.0.0.1", port)).is_ok();
        free(port) && free(port + 100)
    });
    let model = UdpSocket::bind(("127.0.0.1", port + 2)).unwrap();
    model.set_read_timeout(Some(TIMEOUT)).unwrap();
    let udp = format!("udp = {{ ask = '127.0.0.1:{port}', answer = '127.0.0.1:{}' }}", port + 100);
    let law = law(&format!("deadline_s = 10\n{udp}")).unwrap();
    law.ask(ask(7));
    let mut datagram = [0; 2000];
    for _ in 0..2 {
        assert_eq!(model.recv(&mut datagram).unwrap(), 8 * vector::ASK, "an unanswered query is sent again");
        assert_eq!(datagram[16..24], 7.0_f64.to_le_bytes());
    }
    let elsewhere = UdpSocket::bind("127.0.0.1:0").unwrap();
    let answer: Vec<u8> =
        [1.0, 2.0, 7.0, 1.0, 0.5, 0.25, -0.5, 0.0, 0.0].iter().flat_map(|x: &f64| x.to_le_bytes()).collect();
    elsewhere.send_to(&answer[1..], ("127.0.0.1", port + 102)).unwrap();
    let until = now() + TIMEOUT;
    let answered = loop {
        // The malformed datagram has closed the query.
        law.ask(ask(7));
        elsewhere.send_to(&answer, ("127.0.0.1", port + 102)).unwrap();
        sleep_until(now() + Duration::from_millis(50));
        if let Some(answered) = law.take().0 {
            break answered;
        }
        assert!(now() < until);
    };
    assert_eq!((answered.tick, answered.command), (7, ReplyCommand::VelocityNed(Vector3::new(0.5, 0.25, -0.5))));
}
