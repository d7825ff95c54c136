use std::net::TcpListener;
use std::sync::mpsc::{Receiver, channel};

use skein_common::id::VehicleId;

use super::*;
use crate::external::protocol::{Hello, Time};
use skein_core::formation::external::{LawQuery, OwnState};
use skein_core::formation::law::Goal;

/// Time limit of a wait.
const TIMEOUT: Duration = Duration::from_secs(20);

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
    let vehicle = VehicleId::new(1).unwrap();
    LawQuery { vehicle, tick, time_s: 0.0, dt_s: 0.1, own, peers: Vec::new(), goal }
}

fn collector() -> (impl Sink, Receiver<LawInput>) {
    let (sender, messages) = channel();
    (move |_, message| sender.send(message).is_ok(), messages)
}

fn lines_of(bytes: &[u8]) -> Vec<LawInput> {
    let (sink, messages) = collector();
    read_lines(bytes, sink);
    messages.iter().collect()
}

#[test]
fn lines_are_split_from_a_stream_in_bounded_memory() {
    let data = |line: &str| LawInput::Data(line.as_bytes().to_vec());
    assert_eq!(lines_of(b"one\n\ntwo\r\nrest"), [data("one"), data(""), data("two\r"), LawInput::End]);
    let mut long = vec![b'x'; 3 * MAX_LINE];
    long.extend(b"\nshort\n");
    assert_eq!(lines_of(&long), [LawInput::TooLong, data("short"), LawInput::End]);
    let just = [vec![b'y'; MAX_LINE], b"\n".to_vec()].concat();
    assert_eq!(lines_of(&just).len(), 2);
    assert!(matches!(&lines_of(&just)[0], LawInput::Data(line) if line.len() == MAX_LINE));
}

#[cfg(unix)]
#[test]
fn a_law_process_exchanges_lines_and_leaves_nothing_behind() {
    let (sink, messages) = collector();
    let (errors, stderr) = channel();
    let echo = ["sh", "-c", "echo warned >&2; while read line; do echo \"$line\"; done"].map(str::to_owned);
    let session = LawSession::process(&echo, true, sink, move |line| drop(errors.send(line.to_owned()))).unwrap();
    let Partner::Process(process, _) = &session.partner else { panic!("a process") };
    let id = process.id();
    session.send(&MessageToLaw::LawQuery(&ask(7))).unwrap();
    let Ok(LawInput::Data(line)) = messages.recv_timeout(TIMEOUT) else { panic!("an echo") };
    assert_eq!([line, b"\n".to_vec()].concat(), MessageToLaw::LawQuery(&ask(7)).line());
    assert_eq!(stderr.recv_timeout(TIMEOUT).unwrap(), "warned");
    drop(session);
    assert_eq!(
        messages.recv_timeout(TIMEOUT),
        Ok(LawInput::Data(b"{\"say\":\"bye\"}".to_vec())),
        "the bye precedes the end"
    );
    assert_eq!(messages.recv_timeout(TIMEOUT), Ok(LawInput::End));
    let listed = Command::new("ps").args(["-p", &id.to_string()]).output().unwrap();
    assert!(!listed.status.success(), "{}", String::from_utf8_lossy(&listed.stdout));
}

#[cfg(unix)]
#[test]
fn a_process_that_reads_nothing_blocks_nothing_and_is_killed() {
    let (sink, messages) = collector();
    let silent = ["sleep", "1000"].map(str::to_owned);
    let session = LawSession::process(&silent, true, sink, |_| {}).unwrap();
    for tick in 0..3 * QUEUE as u64 {
        assert_eq!(session.send(&MessageToLaw::LawQuery(&ask(tick))), Ok(()));
    }
    let begin = now();
    drop(session);
    assert!(now() < begin + END_TIMEOUT + TIMEOUT);
    assert_eq!(messages.recv_timeout(TIMEOUT), Ok(LawInput::End));
}

#[cfg(unix)]
#[test]
fn the_exit_status_of_an_ended_process_is_described() {
    let (sink, messages) = collector();
    let mut session = LawSession::process(&["sh", "-c", "exit 3"].map(str::to_owned), false, sink, |_| {}).unwrap();
    assert_eq!(messages.recv_timeout(TIMEOUT), Ok(LawInput::End));
    assert_eq!(session.how_it_ended(), "has ended (exit status: 3)");
    assert!(LawSession::process(&["no-such-program".to_owned()], false, |_, _| true, |_| {}).is_err());
}

#[test]
fn lines_flow_both_ways_over_a_connection() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let mut law = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
    let (sink, messages) = collector();
    let session = LawSession::connection(listener.accept().unwrap().0, sink).unwrap();
    let scenario = skein_common::scenario::Source { name: "test.toml", text: "swarm.vehicles = 1" };
    let scenario = skein_common::scenario::load(&scenario, &[]).unwrap().scenario;
    let hello = Hello::new(&scenario, VehicleId::new(1).unwrap(), Time::Real);
    session.send(&MessageToLaw::Hello(&hello)).unwrap();
    law.write_all(b"ready\n").unwrap();
    assert_eq!(messages.recv_timeout(TIMEOUT), Ok(LawInput::Data(b"ready".to_vec())));
    drop(session);
    let mut received = Vec::new();
    law.read_to_end(&mut received).unwrap();
    assert_eq!(received, [MessageToLaw::Hello(&hello).line(), MessageToLaw::Bye.line()].concat());
}

#[test]
fn datagrams_flow_both_ways_and_carry_only_queries() {
    let law = UdpSocket::bind("127.0.0.1:0").unwrap();
    law.set_read_timeout(Some(TIMEOUT)).unwrap();
    let free = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let (sink, messages) = collector();
    let to = ("127.0.0.1", law.local_addr().unwrap().port());
    let session = LawSession::datagrams(to, ("127.0.0.1", free), sink).unwrap();
    session.send(&MessageToLaw::Bye).unwrap();
    session.send(&MessageToLaw::LawQuery(&ask(7))).unwrap();
    let mut datagram = [0; 2000];
    let length = law.recv(&mut datagram).unwrap();
    assert_eq!(&datagram[..length], vector::write(&ask(7)));
    law.send_to(b"any", ("127.0.0.1", free)).unwrap();
    assert_eq!(messages.recv_timeout(TIMEOUT), Ok(LawInput::Data(b"any".to_vec())));
    drop(session);
    assert_eq!(messages.recv_timeout(TIMEOUT), Ok(LawInput::End));
}
