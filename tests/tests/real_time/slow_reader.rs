//! An intruder with a link queries an agent with Zenoh's most urgent settings and reads the answers as slowly as
//! possible. The attack must not delay the agent's control thread, nor its messages to other receivers.

use skein_tests::share::Share;
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
/// Duration of the observation before the attack, and of that under attack.
const WATCHED: Duration = Duration::from_secs(10);
/// Largest additional delay of the control under attack, s.
const JITTER_S: f64 = 0.020;
/// Largest additional time between two states of the agent under attack, s.
const SILENCE_S: f64 = 1.0;
/// Rate at which the intruder reads the answers, bytes/s: enough to keep its link alive.
const READS_BYTES_S: usize = 20_000;

/// Starts a proxy between the intruder and the agent that passes the agent's data slowly.
fn slow_proxy(agent: SocketAddr, read: Arc<AtomicU64>) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let carry = move |intruder: TcpStream| {
        let Ok(agent) = TcpStream::connect(agent) else { return };
        let (mut from_intruder, mut to_agent) = (intruder.try_clone().unwrap(), agent.try_clone().unwrap());
        thread::spawn(move || {
            let _ = std::io::copy(&mut from_intruder, &mut to_agent);
            let _ = to_agent.shutdown(std::net::Shutdown::Both);
        });
        let (mut from_agent, mut to_intruder, read) = (agent, intruder, read.clone());
        thread::spawn(move || {
            let mut some = [0; READS_BYTES_S / 20];
            while let Ok(count @ 1..) = from_agent.read(&mut some) {
                read.fetch_add(count as u64, Relaxed);
                if to_intruder.write_all(&some[..count]).is_err() {
                    break;
                }
                thread::sleep(Duration::from_millis(50));
            }
            let _ = to_intruder.shutdown(std::net::Shutdown::Both);
        });
    };
    thread::spawn(move || listener.incoming().map_while(Result::ok).for_each(carry));
    address
}

/// The process of an agent, killed when it is dropped.
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

/// Measurements of an observer.
#[derive(Debug, Default)]
struct Watched {
    /// Times between two steps, by the agent's own clock, s.
    steps_s: Vec<f64>,
    /// Times between two states that arrive, s.
    silences_s: Vec<f64>,
    healths: usize,
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
                decode::<Health>(&sample.payload().to_bytes()).unwrap();
                watched.healths += 1;
            }
            for sample in self.traces.drain() {
                let step: Trace = decode(&sample.payload().to_bytes()).unwrap();
                if let Some(last) = last_step.filter(|last| last.header.sequence + 1 == step.header.sequence) {
                    watched.steps_s.push(step.header.stamp.seconds() - last.header.stamp.seconds());
                }
                last_step = Some(step);
            }
            for sample in self.states.drain() {
                decode::<State>(&sample.payload().to_bytes()).unwrap();
                let now = Instant::now();
                if let Some(last) = last_state.replace(now) {
                    watched.silences_s.push((now - last).as_secs_f64());
                }
            }
            thread::sleep(Duration::from_millis(2));
        }
        watched
    }
}

/// The time that 19 of 20 do not exceed, s: a few late ones are those of a busy PC.
fn usual_s(times_s: &[f64]) -> f64 {
    let mut sorted = times_s.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() * 19 / 20]
}

#[test]
fn urgent_queries_of_a_slow_reader_delay_no_step_of_an_agent() {
    let _share = Share::of(60);
    let swarm = SwarmName::new(format!("slow-{}", std::process::id())).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let _agent = agent(&swarm, port, folder.path());
    let observer = Observer::open(&swarm, &format!("tcp/127.0.0.1:{port}"));
    let until = Instant::now() + Duration::from_secs(30);
    while observer.watch(Duration::from_millis(500)).silences_s.is_empty() {
        assert!(Instant::now() < until, "no state of the agent arrives");
    }
    let calm = observer.watch(WATCHED);

    let (read, asked, is_over) = (Arc::<AtomicU64>::default(), Arc::<AtomicU64>::default(), AtomicBool::new(false));
    let proxy = slow_proxy(SocketAddr::from(([127, 0, 0, 1], port)), read.clone());
    let intruder = Sessions::open(&swarm, &[], &[format!("tcp/{proxy}")], &Security::Plain).unwrap();
    // The agent sends states to every subscriber.
    intruder.first().declare_subscriber("vehicle/*/**").callback(|_| {}).background().wait().unwrap();
    let under_attack = thread::scope(|scope| {
        scopeguard::defer! { is_over.store(true, Relaxed) }
        scope.spawn(|| {
            while !is_over.load(Relaxed) {
                let question = intruder
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
        observer.watch(WATCHED)
    });
    let usual = |watched: &Watched| (usual_s(&watched.steps_s), usual_s(&watched.silences_s));
    let ((step_s, silence_s), (attacked_step_s, attacked_silence_s)) = (usual(&calm), usual(&under_attack));
    println!(
        "a step and a silence, calm {step_s:.4} and {silence_s:.3} s, under attack {attacked_step_s:.4} and {attacked_silence_s:.3} s; \
         asked {} times, read {} bytes",
        asked.load(Relaxed),
        read.load(Relaxed)
    );
    assert!(asked.load(Relaxed) > 1000 && read.load(Relaxed) > 1000, "the attack did not take place");
    assert!(calm.healths > 5 && under_attack.healths > 5, "the agent sends health reports");
    assert!(attacked_step_s < step_s + JITTER_S && attacked_silence_s < silence_s + SILENCE_S);
}
