use std::net::TcpListener;
use std::sync::mpsc::{Receiver, channel};

use skein_common::id::VehicleId;

use super::*;
use crate::external::protocol::{Hello, Time};
use skein_core::formation::external::{Ask, Goal, Own};

/// Time limit of a wait.
const PATIENCE: Duration = Duration::from_secs(20);

fn ask(tick: u64) -> Ask {
    let own = Own { position_ned_m: [0.0; 3], velocity_ned_m_s: [0.0; 3], heading_rad: 0.0, age_s: 0.0 };
    let goal = Goal {
        step: 0,
        centre_ned_m: [0.0; 3],
        centre_velocity_ned_m_s: [0.0; 3],
        heading_rad: 0.0,
        radius_m: 100.0,
        gamma: 1.0,
    };
    let vehicle = VehicleId::new(1).unwrap();
    Ask { vehicle, tick, time_s: 0.0, dt_s: 0.1, own, peers: Vec::new(), goal }
}

fn ear() -> (impl Sink, Receiver<Word>) {
    let (sender, words) = channel();
    (move |_, word| sender.send(word).is_ok(), words)
}

fn lines_of(bytes: &[u8]) -> Vec<Word> {
    let (sink, words) = ear();
    read_lines(bytes, sink);
    words.iter().collect()
}

#[test]
fn lines_are_split_from_a_stream_in_bounded_memory() {
    let said = |line: &str| Word::Said(line.as_bytes().to_vec());
    assert_eq!(lines_of(b"one\n\ntwo\r\nrest"), [said("one"), said(""), said("two\r"), Word::End]);
    let mut long = vec![b'x'; 3 * MAX_LINE];
    long.extend(b"\nshort\n");
    assert_eq!(lines_of(&long), [Word::TooLong, said("short"), Word::End]);
    let just = [vec![b'y'; MAX_LINE], b"\n".to_vec()].concat();
    assert_eq!(lines_of(&just).len(), 2);
    assert!(matches!(&lines_of(&just)[0], Word::Said(line) if line.len() == MAX_LINE));
}

#[cfg(unix)]
#[test]
fn a_law_process_exchanges_lines_and_leaves_nothing_behind() {
    let (sink, words) = ear();
    let (told, stderr) = channel();
    let echo = ["sh", "-c", "echo warned >&2; while read line; do echo \"$line\"; done"].map(str::to_owned);
    let talk = Talk::process(&echo, true, sink, move |line| drop(told.send(line.to_owned()))).unwrap();
    let Partner::Process(process) = &talk.partner else { panic!("a process") };
    let id = process.id();
    talk.say(&Said::Ask(&ask(7))).unwrap();
    let Ok(Word::Said(line)) = words.recv_timeout(PATIENCE) else { panic!("an echo") };
    assert_eq!([line, b"\n".to_vec()].concat(), Said::Ask(&ask(7)).line());
    assert_eq!(stderr.recv_timeout(PATIENCE).unwrap(), "warned");
    drop(talk);
    assert_eq!(words.recv_timeout(PATIENCE), Ok(Word::Said(b"{\"say\":\"bye\"}".to_vec())), "the bye precedes the end");
    assert_eq!(words.recv_timeout(PATIENCE), Ok(Word::End));
    let listed = Command::new("ps").args(["-p", &id.to_string()]).output().unwrap();
    assert!(!listed.status.success(), "{}", String::from_utf8_lossy(&listed.stdout));
}

#[cfg(unix)]
#[test]
fn a_process_that_reads_nothing_blocks_nothing_and_is_killed() {
    let (sink, words) = ear();
    let deaf = ["sleep", "1000"].map(str::to_owned);
    let talk = Talk::process(&deaf, true, sink, |_| {}).unwrap();
    for tick in 0..3 * QUEUE as u64 {
        assert_eq!(talk.say(&Said::Ask(&ask(tick))), Ok(()));
    }
    let begin = now();
    drop(talk);
    assert!(now() < begin + END_WITHIN + PATIENCE);
    assert_eq!(words.recv_timeout(PATIENCE), Ok(Word::End));
}

#[cfg(unix)]
#[test]
fn the_exit_status_of_an_ended_process_is_described() {
    let (sink, words) = ear();
    let mut talk = Talk::process(&["sh", "-c", "exit 3"].map(str::to_owned), false, sink, |_| {}).unwrap();
    assert_eq!(words.recv_timeout(PATIENCE), Ok(Word::End));
    assert_eq!(talk.how_it_ended(), "has ended (exit status: 3)");
    assert!(Talk::process(&["no-such-program".to_owned()], false, |_, _| true, |_| {}).is_err());
}

#[test]
fn lines_flow_both_ways_over_a_connection() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let mut law = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
    let (sink, words) = ear();
    let talk = Talk::connection(listener.accept().unwrap().0, sink).unwrap();
    let scenario = skein_common::scenario::Source { name: "test.toml", text: "swarm.vehicles = 1" };
    let scenario = skein_common::scenario::load(&scenario, &[]).unwrap().scenario;
    let hello = Hello::new(&scenario, VehicleId::new(1).unwrap(), Time::Real);
    talk.say(&Said::Hello(&hello)).unwrap();
    law.write_all(b"ready\n").unwrap();
    assert_eq!(words.recv_timeout(PATIENCE), Ok(Word::Said(b"ready".to_vec())));
    drop(talk);
    let mut heard = Vec::new();
    law.read_to_end(&mut heard).unwrap();
    assert_eq!(heard, [Said::Hello(&hello).line(), Said::Bye.line()].concat());
}

#[test]
fn datagrams_flow_both_ways_and_carry_only_queries() {
    let law = UdpSocket::bind("127.0.0.1:0").unwrap();
    law.set_read_timeout(Some(PATIENCE)).unwrap();
    let free = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let (sink, words) = ear();
    let to = ("127.0.0.1", law.local_addr().unwrap().port());
    let talk = Talk::datagrams(to, ("127.0.0.1", free), sink).unwrap();
    talk.say(&Said::Bye).unwrap();
    talk.say(&Said::Ask(&ask(7))).unwrap();
    let mut datagram = [0; 2000];
    let length = law.recv(&mut datagram).unwrap();
    assert_eq!(&datagram[..length], vector::write(&ask(7)));
    law.send_to(b"any", ("127.0.0.1", free)).unwrap();
    assert_eq!(words.recv_timeout(PATIENCE), Ok(Word::Said(b"any".to_vec())));
    drop(talk);
    assert_eq!(words.recv_timeout(PATIENCE), Ok(Word::End));
}
