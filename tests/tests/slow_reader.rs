//! A stranger with a link asks an agent, in the most urgent and least patient way that Zenoh has, and reads the answers as
//! slowly as it can. The agent's control thread must not notice, and the other listeners must go on hearing the agent.
#![expect(clippy::disallowed_methods, reason = "a live agent takes real time")]
#![expect(clippy::unwrap_used, reason = "what a test cannot do has failed")]

use std::fs;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant};

use skein_agent::link::{Security, Sessions};
use skein_common::id::SwarmName;
use skein_common::message::{Health, State, Trace, decode};
use skein_common::topic::all;
use zenoh::Wait;
use zenoh::handlers::FifoChannel;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::Sample;

const PROGRAM: &str = env!("CARGO_BIN_EXE_skein-under-test");
/// How long the agent is watched before the attack, and then under it.
const WATCHED: Duration = Duration::from_secs(10);
/// Control may come this much later than without the attack, s.
const JITTER_S: f64 = 0.020;
/// The agent's states may be this much farther apart than without the attack, s.
const SILENCE_S: f64 = 1.0;
/// What the stranger reads of the answers, bytes a second: enough for its link to live.
const READS_BYTES_S: usize = 20_000;

/// Between the stranger and the agent: what the agent sends passes slowly.
fn slow_way(agent: SocketAddr, read: Arc<AtomicU64>) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let carry = move |stranger: TcpStream| {
        let Ok(agent) = TcpStream::connect(agent) else { return };
        let (mut from_stranger, mut to_agent) = (stranger.try_clone().unwrap(), agent.try_clone().unwrap());
        thread::spawn(move || {
            let _ = std::io::copy(&mut from_stranger, &mut to_agent);
            let _ = to_agent.shutdown(std::net::Shutdown::Both);
        });
        let (mut from_agent, mut to_stranger, read) = (agent, stranger, read.clone());
        thread::spawn(move || {
            let mut some = [0; READS_BYTES_S / 20];
            while let Ok(count @ 1..) = from_agent.read(&mut some) {
                read.fetch_add(count as u64, Relaxed);
                if to_stranger.write_all(&some[..count]).is_err() {
                    break;
                }
                thread::sleep(Duration::from_millis(50));
            }
            let _ = to_stranger.shutdown(std::net::Shutdown::Both);
        });
    };
    thread::spawn(move || listener.incoming().map_while(Result::ok).for_each(carry));
    address
}

/// An agent's process, which ends with its value.
struct Agent(Child);

impl Drop for Agent {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn agent(swarm: &SwarmName, port: u16, folder: &std::path::Path) -> Agent {
    let scenario = format!("[swarm]\nname = {:?}\nvehicles = 1\n", swarm.as_str());
    fs::write(folder.join("scenario.toml"), scenario).unwrap();
    let file = format!("scenario = \"scenario.toml\"\nid = 1\nlisten = [\"tcp/127.0.0.1:{port}\"]\ndial = []\n");
    fs::write(folder.join("agent.toml"), file).unwrap();
    let mut command = Command::new(PROGRAM);
    command.arg("agent").arg("--config").arg(folder.join("agent.toml")).env_remove("RUST_LOG");
    Agent(command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap())
}

/// What an observer has seen of the agent in a while.
#[derive(Debug, Default)]
struct Watched {
    /// The longest delay of a frame beyond its period, of those that the agent reports, s.
    jitter_s: f64,
    /// The longest time between two steps, by the agent's own clock, s.
    step_s: f64,
    /// The longest time between two states that arrive, s.
    silence_s: f64,
    healths: usize,
    states: usize,
}

struct Observer {
    healths: zenoh::pubsub::Subscriber<zenoh::handlers::FifoChannelHandler<Sample>>,
    traces: zenoh::pubsub::Subscriber<zenoh::handlers::FifoChannelHandler<Sample>>,
    states: zenoh::pubsub::Subscriber<zenoh::handlers::FifoChannelHandler<Sample>>,
    _sessions: Sessions,
}

impl Observer {
    fn open(swarm: &SwarmName, agent: &str) -> Self {
        let sessions = Sessions::open(swarm, &[], &[agent.to_owned()], &Security::Plain).unwrap();
        let listen = |key: &str| sessions.first().declare_subscriber(key).with(FifoChannel::new(4096)).wait().unwrap();
        let (healths, traces, states) = (listen(all::HEALTH), listen(all::TRACES), listen(all::STATES));
        Self { healths, traces, states, _sessions: sessions }
    }

    fn watch(&self, how_long: Duration) -> Watched {
        let mut watched = Watched::default();
        let until = Instant::now() + how_long;
        let (mut last_step, mut last_state) = (None::<Trace>, None::<Instant>);
        while Instant::now() < until {
            for sample in self.healths.drain() {
                let health: Health = decode(&sample.payload().to_bytes()).unwrap();
                watched.jitter_s = watched.jitter_s.max(health.jitter_ms / 1e3);
                watched.healths += 1;
            }
            for sample in self.traces.drain() {
                let step: Trace = decode(&sample.payload().to_bytes()).unwrap();
                if let Some(last) = last_step.filter(|last| last.header.sequence + 1 == step.header.sequence) {
                    let took_s = step.header.stamp.seconds() - last.header.stamp.seconds();
                    watched.step_s = watched.step_s.max(took_s);
                }
                last_step = Some(step);
            }
            for sample in self.states.drain() {
                decode::<State>(&sample.payload().to_bytes()).unwrap();
                let now = Instant::now();
                if let Some(last) = last_state.replace(now) {
                    watched.silence_s = watched.silence_s.max((now - last).as_secs_f64());
                }
                watched.states += 1;
            }
            thread::sleep(Duration::from_millis(2));
        }
        watched
    }
}

#[test]
fn a_stranger_that_asks_urgently_and_reads_slowly_delays_no_step_of_an_agent() {
    let swarm = SwarmName::new(format!("slow-{}", std::process::id())).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let _agent = agent(&swarm, port, folder.path());
    let observer = Observer::open(&swarm, &format!("tcp/127.0.0.1:{port}"));
    let until = Instant::now() + Duration::from_secs(30);
    while observer.watch(Duration::from_millis(500)).states == 0 {
        assert!(Instant::now() < until, "the agent is not heard");
    }
    let calm = observer.watch(WATCHED);

    let (read, asked, is_over) = (Arc::<AtomicU64>::default(), Arc::<AtomicU64>::default(), AtomicBool::new(false));
    let way = slow_way(SocketAddr::from(([127, 0, 0, 1], port)), read.clone());
    let stranger = Sessions::open(&swarm, &[], &[format!("tcp/{way}")], &Security::Plain).unwrap();
    // States are sent to whoever subscribes to them.
    stranger.first().declare_subscriber("vehicle/*/**").callback(|_| {}).background().wait().unwrap();
    let under_attack = thread::scope(|scope| {
        scope.spawn(|| {
            while !is_over.load(Relaxed) {
                let question = stranger
                    .first()
                    .get("vehicle/*/**")
                    .payload(vec![0; 8])
                    .target(QueryTarget::All)
                    .consolidation(ConsolidationMode::None)
                    .congestion_control(CongestionControl::Block)
                    .priority(Priority::RealTime)
                    .express(true)
                    .timeout(Duration::from_secs(1))
                    .callback(|_| {});
                if question.wait().is_ok() {
                    asked.fetch_add(1, Relaxed);
                }
                thread::sleep(Duration::from_micros(200));
            }
        });
        let watched = observer.watch(WATCHED);
        is_over.store(true, Relaxed);
        watched
    });
    println!(
        "calm: {calm:?}\nunder attack: {under_attack:?}\nasked {} times, read {} bytes",
        asked.load(Relaxed),
        read.load(Relaxed)
    );
    assert!(asked.load(Relaxed) > 1000 && read.load(Relaxed) > 1000, "there was no attack");
    assert!(calm.healths > 5 && under_attack.healths > 5, "the agent tells how it does");
    assert!(under_attack.jitter_s < calm.jitter_s + JITTER_S);
    assert!(under_attack.step_s < calm.step_s + JITTER_S);
    assert!(under_attack.silence_s < calm.silence_s + SILENCE_S);
}
