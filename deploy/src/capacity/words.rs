//! Words between agents, measured: real Zenoh sessions of this process, behind the agents' own [`Link`], over loopback TCP.

use std::net::SocketAddr;
use std::process;
use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use serde::Serialize;
use skein_agent::link::seal::words::Voices;
use skein_agent::link::{Link, Security, Sessions, Trust};
use skein_common::frame::{Geodetic, PositionNed, VelocityNed};
use skein_common::id::{Incarnation, SwarmName, VehicleId};
use skein_common::message::{self, Echo, Header, Mission, State};
use skein_common::state::{Membership, VehicleState};
use skein_common::topic::Cell;
use skein_core::peers::{Heard, Word};
use skein_host::clock::{LocalClock, new_incarnation, sleep_until};

use super::relay;
use crate::os::cpu_s;
use skein_host::clock::now;

/// How often agents speak that send every frame, Hz.
pub(super) const FRAME_HZ: f64 = 50.0;
/// Sessions that talk to each other while their processor time is measured.
const SESSIONS: u8 = 4;
/// What all of them fly.
const PLAN: u64 = u64::MAX / 3;
/// How long words may take, s.
const PATIENCE: Duration = Duration::from_secs(5);
/// Pause before looking again, and between words that are counted.
const PAUSE: Duration = Duration::from_millis(2);

/// One kind of word on its way.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WordSize {
    /// Encoded, bytes.
    pub encoded_bytes: usize,
    /// With its key and what Zenoh adds, on a TCP link, bytes.
    pub segment_bytes: f64,
}

/// What a word costs the processor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WordTime {
    /// From one agent's hands into another's, both ends together, µs; `None` where the system does not tell.
    pub word_us: Option<f64>,
    /// How many words were timed.
    pub deliveries: u64,
}

/// The size of a state and of a register, each from `count` of them that went over one link.
///
/// # Errors
/// If sessions cannot be opened, or what they say does not come through.
pub(super) fn sizes(count: u32) -> Result<[WordSize; 2], String> {
    let mut counts = None;
    let mut pair = Speaker::mesh(2, |listener| {
        let (address, counted) = relay::open(listener)?;
        counts.get_or_insert(counted);
        Ok(address)
    })?;
    let counts = counts.ok_or("no link to count on")?;
    let [one, two] = pair.as_mut_slice() else { return Err("not two sessions".to_owned()) };
    // The second dials the first.
    Ok([
        size(one, two, &counts.to_dialler, count, Speaker::publish_state)?,
        size(one, two, &counts.to_dialler, count, Speaker::say_register)?,
    ])
}

fn size(
    one: &mut Speaker,
    two: &mut Speaker,
    bytes: &AtomicU64,
    count: u32,
    say: fn(&mut Speaker) -> usize,
) -> Result<WordSize, String> {
    // What is said once, to introduce a key, does not count.
    say(one);
    until(|| two.has_heard(one))?;
    let before = bytes.load(Relaxed);
    let mut encoded_bytes = 0;
    for _ in 0..count {
        encoded_bytes = say(one);
        sleep_until(now() + PAUSE);
    }
    until(|| two.has_heard(one))?;
    Ok(WordSize { encoded_bytes, segment_bytes: (bytes.load(Relaxed) - before) as f64 / f64::from(count) })
}

/// The time of a state, from sessions that are silent for so long, and then say one each frame for as long.
///
/// # Errors
/// As [`sizes`].
pub(super) fn time(talk_s: f64) -> Result<WordTime, String> {
    let mut mesh = Speaker::mesh(SESSIONS, Ok)?;
    let silent_s = talk(&mut mesh, talk_s, false);
    let before = delivered(&mesh);
    let talking_s = talk(&mut mesh, talk_s, true);
    let heard_all = |mesh: &mut [Speaker]| {
        let said: Vec<_> = mesh.iter().map(|speaker| speaker.said).collect();
        mesh.iter_mut().all(|speaker| speaker.hears_up_to(&said))
    };
    until(|| heard_all(&mut mesh))?;
    let deliveries = delivered(&mesh) - before;
    let spent_s = talking_s.zip(silent_s).map(|(talking_s, silent_s)| (talking_s - silent_s).max(0.0));
    Ok(WordTime { word_us: spent_s.map(|spent_s| spent_s * 1e6 / deliveries.max(1) as f64), deliveries })
}

/// Processor time of this process while the sessions take their turns, one after the other, and speak or do not.
fn talk(mesh: &mut [Speaker], talk_s: f64, aloud: bool) -> Option<f64> {
    let begin_s = cpu_s();
    let turn = Duration::from_secs_f64(1.0 / (FRAME_HZ * mesh.len() as f64));
    let mut next = now();
    for _ in 0..(talk_s * FRAME_HZ) as u64 {
        for speaker in mesh.iter_mut() {
            sleep_until(next);
            next += turn;
            speaker.listen();
            if aloud {
                speaker.publish_state();
            }
        }
    }
    cpu_s().zip(begin_s).map(|(end_s, begin_s)| end_s - begin_s)
}

/// Words that have arrived at anybody.
fn delivered(mesh: &[Speaker]) -> u64 {
    mesh.iter().flat_map(|speaker| &speaker.heard_of).sum()
}

fn until(mut done: impl FnMut() -> bool) -> Result<(), String> {
    let deadline = now() + PATIENCE;
    while !done() {
        if now() > deadline {
            return Err("what sessions say over loopback does not come through".to_owned());
        }
        sleep_until(now() + PAUSE);
    }
    Ok(())
}

/// An agent's edge to the others.
struct Speaker {
    link: Link,
    id: VehicleId,
    incarnation: Incarnation,
    clock: LocalClock,
    /// Its words so far, of whatever kind: they are numbered from 1.
    said: u64,
    /// The number of each one's newest word, in the order of ids.
    heard_of: Vec<u64>,
    heard: Vec<Heard>,
}

impl Speaker {
    /// Vehicles 1 to `count`, each of which dials those before it at `through` of their address; all hear each other.
    fn mesh(
        count: u8,
        mut through: impl FnMut(SocketAddr) -> std::io::Result<SocketAddr>,
    ) -> Result<Vec<Self>, String> {
        let incarnation = new_incarnation();
        // Nobody else's swarm has this name.
        let swarm = SwarmName::new(format!("{}-{}", process::id(), incarnation.0)).map_err(in_words)?;
        let clock = LocalClock::start();
        let (mut mesh, mut dial) = (Vec::new(), Vec::new());
        for id in VehicleId::first(count.into()) {
            let sessions =
                Sessions::open(&swarm, &["tcp/127.0.0.1:0".to_owned()], &dial, &Security::Plain).map_err(in_words)?;
            let listens = sessions.endpoints().into_iter().next().unwrap_or_default();
            let listens = listens.trim_start_matches("tcp/").parse().map_err(in_words)?;
            dial.push(format!("tcp/{}", through(listens).map_err(in_words)?));
            let trust = Trust {
                swarm: swarm.clone(),
                vehicles: count.into(),
                plan: PLAN,
                orders: None,
                run: 0,
                voices: Voices::plain(swarm.clone()),
                sealer: None,
            };
            let link = Link::new(sessions, id, clock, trust).map_err(in_words)?;
            let (said, heard_of, heard) = (0, vec![0; count.into()], Vec::new());
            mesh.push(Self { link, id, incarnation, clock, said, heard_of, heard });
        }
        until(|| {
            mesh.iter_mut().for_each(|speaker| _ = speaker.publish_state());
            sleep_until(now() + 5 * PAUSE);
            mesh.iter_mut().all(|speaker| {
                speaker.listen();
                speaker.heard_of.iter().filter(|&&number| number > 0).count() + 1 == usize::from(count)
            })
        })?;
        Ok(mesh)
    }

    /// Says where it is, as an agent in flight does; gives the encoding's length, bytes.
    fn publish_state(&mut self) -> usize {
        let position = Geodetic::from_degrees(28.000_1, -82.000_1, 30.1);
        let velocity = VelocityNed::new(0.1, -0.2, 0.01);
        let state = State { header: self.header(), state: VehicleState { position, velocity, heading_rad: 1.0 } };
        self.link.publish_state(&state, Cell::of(PositionNed::new(10.0, -10.0, -30.0)));
        message::encode(&state).len()
    }

    /// Says its part in the agreement.
    fn say_register(&mut self) -> usize {
        let (header, membership) = (self.header(), Membership::Active);
        let echo = Some(Echo { of: header.sender, stamp: header.stamp, held_us: 100_000 });
        let said = Mission {
            header,
            plan: PLAN,
            membership,
            step: 0,
            vouched: 0,
            reached: Some(0),
            progress_m: 0.0,
            order: None,
            echo,
        };
        self.link.publish_mission(&said);
        message::encode(&said).len()
    }

    fn header(&mut self) -> Header {
        self.said += 1;
        let (sender, incarnation, sequence) = (self.id, self.incarnation, self.said);
        Header { sender, incarnation, sequence, stamp: self.clock.now().into() }
    }

    /// Takes up what has arrived, as an agent does once a step.
    fn listen(&mut self) {
        self.heard.clear();
        self.link.drain(&mut self.heard);
        for heard in &self.heard {
            let header = match &heard.word {
                Word::State(said) => said.header,
                Word::Mission(said) => said.header,
                Word::Order(_) | Word::Appeared(_) | Word::Vanished(_) => continue,
            };
            if let Some(newest) = self.heard_of.get_mut(usize::from(header.sender.get()) - 1) {
                *newest = header.sequence.max(*newest);
            }
        }
    }

    /// Whether everybody else's last word is here, `said` being their numbers.
    fn hears_up_to(&mut self, said: &[u64]) -> bool {
        self.listen();
        let own = usize::from(self.id.get()) - 1;
        self.heard_of.iter().zip(said).enumerate().all(|(nth, (heard, said))| nth == own || heard == said)
    }

    fn has_heard(&mut self, other: &Self) -> bool {
        self.listen();
        self.heard_of.get(usize::from(other.id.get()) - 1) == Some(&other.said)
    }
}

fn in_words(error: impl std::fmt::Display) -> String {
    error.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_larger_on_the_wire_than_encoded() {
        let [state, register] = sizes(40).unwrap();
        for size in [state, register] {
            let encoded = size.encoded_bytes as f64;
            assert!(encoded > 30.0 && size.segment_bytes > encoded, "{size:?}");
            assert!(size.segment_bytes < encoded + 200.0, "{size:?}: something else was counted");
        }
        assert!(state.encoded_bytes > register.encoded_bytes, "{state:?}, {register:?}");
    }

    #[test]
    fn every_word_is_delivered_and_takes_time() {
        let time = time(0.4).unwrap();
        assert_eq!(time.deliveries, 20 * 4 * 3, "twenty frames, each of four to the three others");
        if cfg!(unix) {
            assert!(time.word_us.is_some_and(|word_us| word_us < 20_000.0), "{time:?}");
        }
    }
}
