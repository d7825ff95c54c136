//! Measures the messages between agents, with real Zenoh sessions in this process behind the agents' own [`Link`], over
//! loopback TCP.

use std::net::SocketAddr;
use std::process;
use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use serde::Serialize;
use skein_agent::link::signature::messages::KeyRing;
use skein_agent::link::{Link, Messages, Security, Sessions, Trust};
use skein_common::frame::{Geodetic, Origin, PositionNed, VelocityNed};
use skein_common::id::{Incarnation, SwarmName, VehicleId, VehicleSet};
use skein_common::message::{self, Echo, Header, Heartbeat, State};
use skein_common::state::{Membership, VehicleState};
use skein_common::topic::Cell;
use skein_core::peers::{PeerMessage, Received};
use skein_host::clock::{LocalClock, new_incarnation, now, sleep_until};

use super::relay;
use crate::os::cpu_s;

/// Rate of the states of an agent that sends one every frame, Hz.
pub const FRAME_HZ: f64 = 50.0;
/// Number of sessions that send to each other while processor time is measured.
const SESSIONS: u8 = 4;
/// The plan that all of them fly.
const PLAN: u64 = u64::MAX / 3;
/// Time limit for the arrival of messages.
const TIMEOUT: Duration = Duration::from_secs(20);
/// Time after which a message that has not arrived is sent again.
const REPEAT: Duration = Duration::from_millis(500);
/// The reason why nothing can be measured.
const NOT_RECEIVED: &str = "messages between sessions over loopback do not arrive";
/// Pause between two looks at the received messages, and between messages that are counted.
const PAUSE: Duration = Duration::from_millis(2);

/// Size of one kind of message.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MessageSize {
    /// Size of the encoded message, bytes.
    pub encoded_bytes: usize,
    /// Size on a TCP link, with its key and Zenoh's overhead, bytes.
    pub segment_bytes: f64,
}

/// Processor time of a message.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MessageTime {
    /// Processor time from one agent to another, both ends together, µs; `None` where the system does not report it.
    #[serde(rename = "word_us")]
    pub message_us: Option<f64>,
    /// Number of messages that were timed.
    pub deliveries: u64,
}

/// Measures the size of a state and of a heartbeat, each from `count` messages over one link.
///
/// # Errors
/// If sessions cannot be opened, or their messages do not arrive.
pub(super) fn sizes(count: u32) -> Result<[MessageSize; 2], String> {
    let mut first = None;
    let mut pair = LinkEnd::mesh(2, |listener| {
        let (address, to_dialler) = relay::open(listener)?;
        first.get_or_insert(to_dialler);
        Ok(address)
    })?;
    let to_dialler = first.ok_or("no link to count on")?;
    let [one, two] = pair.as_mut_slice() else { return Err("not two sessions".to_owned()) };
    // The second dials the first.
    Ok([
        size(one, two, &to_dialler, count, LinkEnd::send_state)?,
        size(one, two, &to_dialler, count, LinkEnd::send_heartbeat)?,
    ])
}

fn size(
    one: &mut LinkEnd,
    two: &mut LinkEnd,
    bytes: &AtomicU64,
    count: u32,
    send: fn(&mut LinkEnd) -> usize,
) -> Result<MessageSize, String> {
    // The first message introduces a key and is larger: it does not count.
    send_until_received(one, two, send)?;
    let (mut encoded_bytes, mut all_bytes, mut counted) = (0, 0, 0);
    for _ in 0..count {
        let (sent, before) = (one.sent, bytes.load(Relaxed));
        // On a loaded computer, the next message would replace one that has not been sent yet.
        encoded_bytes = send_until_received(one, two, send)?;
        // A message that was sent again would count twice.
        if one.sent == sent + 1 {
            (all_bytes, counted) = (all_bytes + bytes.load(Relaxed) - before, counted + 1);
        }
    }
    if counted == 0 {
        return Err(NOT_RECEIVED.to_owned());
    }
    Ok(MessageSize { encoded_bytes, segment_bytes: all_bytes as f64 / f64::from(counted) })
}

/// Measures the processor time of a state, from sessions that are silent for `sending_s` and then send one state each
/// frame for as long.
///
/// # Errors
/// The errors of [`sizes`].
pub(super) fn time(sending_s: f64) -> Result<MessageTime, String> {
    let mut mesh = LinkEnd::mesh(SESSIONS, Ok)?;
    let silent_s = run_for(&mut mesh, sending_s, false);
    let before = sent(&mesh);
    let active_s = run_for(&mut mesh, sending_s, true);
    let sent = sent(&mesh);
    let has_arrived = |mesh: &mut Vec<LinkEnd>| mesh.iter_mut().all(|receiver| receiver.has_received_up_to(&sent));
    let send_again = |mesh: &mut Vec<LinkEnd>| mesh.iter_mut().for_each(|sender| _ = sender.send_state());
    until(&mut mesh, has_arrived, send_again)?;
    // Every message counts that was sent while the time was taken, and none that was repeated later.
    let deliveries = (sent.iter().sum::<u64>() - before.iter().sum::<u64>()) * (u64::from(SESSIONS) - 1);
    let spent_s = active_s.zip(silent_s).map(|(active_s, silent_s)| (active_s - silent_s).max(0.0));
    Ok(MessageTime { message_us: spent_s.map(|spent_s| spent_s * 1e6 / deliveries.max(1) as f64), deliveries })
}

/// Processor time of this process over `sending_s` in which the sessions take turns, and send states or do not, s.
fn run_for(mesh: &mut [LinkEnd], sending_s: f64, is_sending: bool) -> Option<f64> {
    let begin_s = cpu_s();
    let interval = Duration::from_secs_f64(1.0 / (FRAME_HZ * mesh.len() as f64));
    let mut next = now();
    for _ in 0..(sending_s * FRAME_HZ) as u64 {
        for sender in mesh.iter_mut() {
            sleep_until(next);
            next += interval;
            sender.listen();
            if is_sending {
                sender.send_state();
            }
        }
    }
    cpu_s().zip(begin_s).map(|(end_s, begin_s)| end_s - begin_s)
}

/// Number of messages that each session has sent.
fn sent(mesh: &[LinkEnd]) -> Vec<u64> {
    mesh.iter().map(|sender| sender.sent).collect()
}

/// Sends a message until the other end has it; returns the length of the encoded message, bytes.
fn send_until_received(one: &mut LinkEnd, two: &mut LinkEnd, send: fn(&mut LinkEnd) -> usize) -> Result<usize, String> {
    let encoded_bytes = send(one);
    until(&mut (one, two), |(one, two)| two.has_received_up_to(&[one.sent, two.sent]), |(one, _)| _ = send(one))?;
    Ok(encoded_bytes)
}

/// Waits until the messages between these ends have arrived. From time to time it sends again, because on a loaded computer Zenoh may
/// drop a message.
fn until<Ends>(
    ends: &mut Ends,
    mut have_arrived: impl FnMut(&mut Ends) -> bool,
    mut send_again: impl FnMut(&mut Ends),
) -> Result<(), String> {
    let deadline = now() + TIMEOUT;
    let mut next = now() + REPEAT;
    while !have_arrived(ends) {
        if now() > deadline {
            return Err(NOT_RECEIVED.to_owned());
        }
        if now() > next {
            send_again(ends);
            next += REPEAT;
        }
        sleep_until(now() + PAUSE);
    }
    Ok(())
}

/// An agent's end of its links to the others.
struct LinkEnd {
    link: Link,
    id: VehicleId,
    incarnation: Incarnation,
    clock: LocalClock,
    /// Number of messages sent so far, of all kinds: they are numbered from 1.
    sent: u64,
    /// The number of the newest message received from each vehicle, in the order of ids.
    newest: Vec<u64>,
    received: Vec<Received>,
}

impl LinkEnd {
    /// Opens vehicles 1 to `count` and waits until all receive from each other. Each dials the vehicles before it, at
    /// the address that `through` returns for theirs.
    fn mesh(
        count: u8,
        mut through: impl FnMut(SocketAddr) -> std::io::Result<SocketAddr>,
    ) -> Result<Vec<Self>, String> {
        let incarnation = new_incarnation();
        // A unique name, so that no other swarm has it.
        let swarm = SwarmName::new(format!("{}-{}", process::id(), incarnation.0)).map_err(to_text)?;
        let clock = LocalClock::start();
        let (mut mesh, mut dial) = (Vec::new(), Vec::new());
        for id in VehicleId::first(count.into()) {
            let sessions =
                Sessions::open(&swarm, &["tcp/127.0.0.1:0".to_owned()], &dial, &Security::Plain).map_err(to_text)?;
            let listens = sessions.endpoints().into_iter().next().unwrap_or_default();
            let listens = listens.trim_start_matches("tcp/").parse().map_err(to_text)?;
            dial.push(format!("tcp/{}", through(listens).map_err(to_text)?));
            let trust = Trust {
                team: None,
                swarm: swarm.clone(),
                // No position is used.
                origin: Origin::new(Geodetic::from_degrees(0.0, 0.0, 0.0)),
                vehicles: count.into(),
                plan: PLAN,
                orders: None,
                run: 0,
                key_ring: KeyRing::plain(swarm.clone()),
                signing_key: None,
            };
            let link = Link::new(sessions, id, clock, trust).map_err(to_text)?;
            let (sent, newest, received) = (0, vec![0; count.into()], Vec::new());
            mesh.push(Self { link, id, incarnation, clock, sent, newest, received });
        }
        let receives_from_all = |end: &mut Self| {
            end.listen();
            end.newest.iter().filter(|&&number| number > 0).count() + 1 == usize::from(count)
        };
        // No link may be open yet, so that every look sends again.
        let all_receive = |mesh: &mut Vec<Self>| {
            mesh.iter_mut().for_each(|sender| _ = sender.send_state());
            sleep_until(now() + 5 * PAUSE);
            mesh.iter_mut().all(receives_from_all)
        };
        until(&mut mesh, all_receive, |_| ())?;
        Ok(mesh)
    }

    /// Sends a state, as an agent in flight does; returns the length of the encoded message, bytes.
    fn send_state(&mut self) -> usize {
        let position = Geodetic::from_degrees(28.000_1, -82.000_1, 30.1);
        let velocity = VelocityNed::new(0.1, -0.2, 0.01);
        let state = State { header: self.header(), state: VehicleState { position, velocity, heading_rad: 1.0 } };
        let cell = Cell::of(PositionNed::new(10.0, -10.0, -30.0));
        self.link.send(Messages { state: Some((state, cell)), ..Messages::default() });
        message::encode(&state).len()
    }

    /// Sends a heartbeat; returns the length of the encoded message, bytes.
    fn send_heartbeat(&mut self) -> usize {
        let (header, membership) = (self.header(), Membership::Active);
        let echo = Some(Echo { of: header.sender, stamp: header.stamp, held_us: 100_000 });
        let heartbeat = Heartbeat {
            header,
            plan: PLAN,
            membership,
            step: 0,
            vouched: 0,
            reached: Some(0),
            progress_m: 0.0,
            order: None,
            orders: 0,
            echo,
            lost: VehicleSet::default(),
        };
        self.link.send(Messages { mission: Some(heartbeat), ..Messages::default() });
        message::encode(&heartbeat).len()
    }

    fn header(&mut self) -> Header {
        self.sent += 1;
        let (sender, incarnation, sequence) = (self.id, self.incarnation, self.sent);
        Header { sender, incarnation, sequence, stamp: self.clock.now().into() }
    }

    /// Processes the messages that have arrived, as an agent does once a step.
    fn listen(&mut self) {
        self.received.clear();
        self.link.drain(&mut self.received);
        for received in &self.received {
            let header = match &received.message {
                PeerMessage::State(state) => state.header,
                PeerMessage::Mission(mission) => mission.header,
                PeerMessage::Order(_) | PeerMessage::Appeared(_) | PeerMessage::Vanished(_) => continue,
            };
            if let Some(newest) = self.newest.get_mut(usize::from(header.sender.get()) - 1) {
                *newest = header.sequence.max(*newest);
            }
        }
    }

    /// Whether the last message of every other vehicle has arrived; `sent` has the numbers of these messages, in the order of ids.
    fn has_received_up_to(&mut self, sent: &[u64]) -> bool {
        self.listen();
        let own = usize::from(self.id.get()) - 1;
        self.newest.iter().zip(sent).enumerate().all(|(nth, (newest, sent))| nth == own || newest >= sent)
    }
}

fn to_text(error: impl std::fmt::Display) -> String {
    error.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_larger_on_the_wire_than_encoded() {
        let [state, heartbeat] = sizes(40).unwrap();
        for size in [state, heartbeat] {
            let encoded = size.encoded_bytes as f64;
            assert!(encoded > 30.0 && size.segment_bytes > encoded, "{size:?}");
            assert!(size.segment_bytes < encoded + 200.0, "{size:?}: something else was counted");
        }
        assert!(state.encoded_bytes > heartbeat.encoded_bytes, "{state:?}, {heartbeat:?}");
    }

    #[test]
    fn every_message_is_delivered_and_takes_time() {
        let time = time(0.4).unwrap();
        assert_eq!(time.deliveries, 20 * 4 * 3, "twenty frames, each of four to the three others");
        if cfg!(unix) {
            assert!(time.message_us.is_some_and(|message_us| message_us < 20_000.0), "{time:?}");
        }
    }
}
