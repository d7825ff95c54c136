//! Garbage on every port of a flying agent: on the port for its simulator, on its Zenoh listener, in the names of its
//! peers. The agent counts every message of it and believes none, keeps every control within its travel, and flies on
//! afterwards.

use skein_tests::share::Share;
use std::io::Write;
use std::net::{SocketAddr, TcpStream, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant};

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use skein_agent::config::Node;
use skein_agent::link::{Security, Sessions};
use skein_agent::plant::PlantChoice;
use skein_agent::plant::xplane::standin::{Standin, StandinOptions};
use skein_agent::plant::xplane::wire::dref::Write as DrefWrite;
use skein_agent::plant::xplane::wire::prel::Placement;
use skein_agent::plant::xplane::wire::rpos::{self, Position};
use skein_agent::plant::xplane::wire::{decode_rate, rref};
use skein_agent::run::{self, Stop};
use skein_common::frame::{Geodetic, VelocityNed};
use skein_common::id::{Incarnation, SwarmName, VehicleId, VehicleSet};
use skein_common::message::{
    Drops, Header, Health, Heartbeat, MAX_STEP, Order, State, Trace, VERSION, Verb, decode, encode,
};
use skein_common::scenario::{Source, load};
use skein_common::state::{Activity, Membership, VehicleState};
use skein_common::time::SenderStamp;
use skein_common::topic::{Cell, Topic, all};
use skein_core::aircraft::Aircraft;
use skein_core::control::Rules;
use zenoh::Wait;
use zenoh::handlers::FifoChannel;
use zenoh::qos::CongestionControl;

fn id(number: u8) -> VehicleId {
    VehicleId::new(number).unwrap()
}

fn noise(rng: &mut ChaCha8Rng, most: usize) -> Vec<u8> {
    let mut bytes = vec![0; rng.next_u32() as usize % most];
    rng.fill_bytes(&mut bytes);
    bytes
}

/// A relay between an agent and its stand-in: it forwards both ways, checks every control, and adds garbage.
struct Meddler {
    agent_side: UdpSocket,
    simulator_side: UdpSocket,
    simulator: SocketAddr,
    agent: Option<SocketAddr>,
    last_position: Vec<u8>,
    rng: ChaCha8Rng,
    seen: Arc<Seen>,
}

/// Counts of the meddler, and the request to stop adding garbage.
#[derive(Default)]
struct Seen {
    /// Number of controls that the agent wrote.
    controls: AtomicU64,
    /// Number of datagrams of garbage that were sent to the agent.
    garbage: AtomicU64,
    /// Whether the meddler adds no more garbage.
    is_over: AtomicBool,
}

impl Meddler {
    fn new(simulator: SocketAddr) -> Self {
        let socket = || {
            let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
            socket.set_nonblocking(true).unwrap();
            socket
        };
        let (agent_side, simulator_side) = (socket(), socket());
        let rng = ChaCha8Rng::seed_from_u64(1);
        let (agent, last_position) = (None, Vec::new());
        Self { agent_side, simulator_side, simulator, agent, last_position, rng, seen: Arc::default() }
    }

    fn run(mut self, stop: &AtomicBool) {
        let mut buffer = [0; 2048];
        while !stop.load(Relaxed) {
            while let Ok((size, from)) = self.agent_side.recv_from(&mut buffer) {
                // A simulator of an earlier program may still send positions to this port.
                if self.agent != Some(from) && Position::decode(&buffer[..size]).is_ok() {
                    continue;
                }
                self.agent = Some(from);
                self.check(&buffer[..size]);
                self.simulator_side.send_to(&buffer[..size], self.simulator).unwrap();
            }
            while let Ok((size, _)) = self.simulator_side.recv_from(&mut buffer) {
                let Some(agent) = self.agent else { continue };
                if buffer.starts_with(b"RPOS") {
                    self.last_position = buffer[..size].to_vec();
                }
                self.agent_side.send_to(&buffer[..size], agent).unwrap();
                if !self.seen.is_over.load(Relaxed) {
                    self.meddle(agent);
                }
            }
            thread::sleep(Duration::from_micros(300));
        }
    }

    /// Checks that the agent sends whole messages only, and that every control is finite and within its travel.
    fn check(&self, datagram: &[u8]) {
        let Ok(DrefWrite { path, value }) = DrefWrite::decode(datagram) else {
            let is_request = decode_rate(datagram, &rpos::TAG).is_ok()
                || rref::DatarefRequest::decode(datagram).is_ok()
                || Placement::decode(datagram).is_ok();
            assert!(is_request, "{datagram:?}");
            return;
        };
        let least = if path.contains("yoke") { -1.0 } else { 0.0 };
        assert!((least..=1.0).contains(&value), "{path} = {value}");
        self.seen.controls.fetch_add(1, Relaxed);
    }

    /// Sends messages that no simulator sends, from the simulator's own address and from another port.
    fn meddle(&mut self, agent: SocketAddr) {
        let mut messages = vec![noise(&mut self.rng, 200), noise(&mut self.rng, 9000), b"RPOS".to_vec()];
        let mut tagged = b"RREF,".to_vec();
        tagged.extend(noise(&mut self.rng, 64));
        messages.push(tagged);
        if !self.last_position.is_empty() {
            messages.push(self.last_position[..40].to_vec());
            let longer = [self.last_position.as_slice(), &[0; 500]].concat();
            messages.push(longer);
            for (offset, value) in [(13, f64::NAN), (13, 1e9), (21, f64::INFINITY)] {
                let mut spoilt = self.last_position.clone();
                spoilt[offset..offset + 8].copy_from_slice(&value.to_le_bytes());
                messages.push(spoilt);
            }
            for (offset, value) in [(33, f32::NAN), (45, 1e20_f32), (57, f32::INFINITY)] {
                let mut spoilt = self.last_position.clone();
                spoilt[offset..offset + 4].copy_from_slice(&value.to_le_bytes());
                messages.push(spoilt);
            }
        }
        self.spoof(agent);
        for message in messages {
            self.garbage(&self.agent_side, &message, agent);
            self.garbage(&self.simulator_side, &message, agent);
            // The stand-in receives the garbage too.
            let _ = self.agent_side.send_to(&message, self.simulator);
        }
    }
}

impl Meddler {
    /// Sends garbage to the agent, unless the queue is full.
    fn garbage(&self, from: &UdpSocket, datagram: &[u8], agent: SocketAddr) {
        self.seen.garbage.fetch_add(u64::from(from.send_to(datagram, agent).is_ok()), Relaxed);
    }

    /// Sends well-formed positions from another port of the simulator's address: one a kilometre away, and one in the
    /// right place with a false attitude and velocity.
    fn spoof(&self, agent: SocketAddr) {
        let Ok(true_one) = Position::decode(&self.last_position) else { return };
        let spoofed = Position { roll_deg: 60.0, yaw_rate_rad_s: 5.0, velocity_up_m_s: -10.0, ..true_one };
        let far = Position { latitude_deg: spoofed.latitude_deg + 0.01, height_m: 90.0, ..spoofed };
        for position in [spoofed, far] {
            let mut message = Vec::new();
            position.encode(&mut message);
            self.garbage(&self.simulator_side, &message, agent);
        }
    }
}

/// A Zenoh client outside the swarm that has a link to the agent.
struct Outsider {
    session: zenoh::Session,
    rng: ChaCha8Rng,
    sequence: u64,
    /// Counts that the agent has to report for it.
    expected: Drops,
}

impl Outsider {
    /// Opens a Zenoh session that waits for the agent instead of dropping messages.
    fn dial(swarm: &SwarmName, locator: &str) -> Self {
        let mut configuration = zenoh::Config::default();
        for (key, value) in [
            ("mode", "'peer'".to_owned()),
            ("namespace", format!("{:?}", swarm.as_str())),
            ("connect/endpoints", format!("[{locator:?}]")),
            ("listen/endpoints", "[]".to_owned()),
            ("scouting/multicast/enabled", "false".to_owned()),
            ("scouting/gossip/enabled", "false".to_owned()),
            ("transport/link/tx/queue/congestion_control/block/wait_before_close", "20000000".to_owned()),
        ] {
            configuration.insert_json5(key, &value).unwrap();
        }
        let session = zenoh::open(configuration).wait().unwrap();
        Self { session, rng: ChaCha8Rng::seed_from_u64(2), sequence: 0, expected: Drops::default() }
    }

    fn put(&self, topic: Topic, bytes: Vec<u8>) {
        self.session.put(topic.key(), bytes).congestion_control(CongestionControl::Block).wait().unwrap();
    }

    /// Publishes bytes that are not a message. The first byte, if any, is the version.
    fn put_garbage(&mut self, topic: Topic, bytes: Vec<u8>) {
        match bytes.first() {
            Some(&VERSION) | None => self.expected.undecodable += 1,
            Some(_) => self.expected.other_version += 1,
        }
        self.put(topic, bytes);
    }

    fn header(&mut self, sender: u8) -> Header {
        self.sequence += 1;
        Header { sender: id(sender), incarnation: Incarnation(5), sequence: self.sequence, stamp: SenderStamp::ZERO }
    }

    fn state(&mut self, sender: u8) -> State {
        let position = Geodetic::from_degrees(28.0, -82.001, 30.0);
        let state = VehicleState { position, velocity: VelocityNed::default(), heading_rad: 0.0 };
        State { header: self.header(sender), state }
    }

    fn meddle(&mut self) {
        let cell = Cell::default();
        for sender in [1, 2, 3, 200] {
            for bytes in [noise(&mut self.rng, 300), vec![], vec![1; 100_000]] {
                self.put_garbage(Topic::State(id(sender), cell), bytes.clone());
                self.put_garbage(Topic::Mission(id(sender)), bytes.clone());
                self.put_garbage(Topic::Order(7), bytes);
            }
        }
        let good = self.state(2);
        let mut other_version = encode(&good);
        other_version[0] = 77;
        self.put_garbage(Topic::State(id(2), cell), other_version);
        let mut nowhere = good;
        nowhere.state.position.latitude_rad = f64::NAN;
        self.put_garbage(Topic::State(id(2), cell), encode(&nowhere));
        // Vehicle 2 under vehicle 3's key; in the agent's own name; of a vehicle that is not in the swarm.
        self.put(Topic::State(id(3), cell), encode(&good));
        let own = self.state(1);
        self.put(Topic::State(id(1), cell), encode(&own));
        let alien = self.state(200);
        self.put(Topic::State(id(200), cell), encode(&alien));
        let order = Order { epoch: u64::MAX, issuer: 1, verb: Verb::Land, vehicles: None, signature: None };
        let mission = Heartbeat {
            header: self.header(3),
            plan: 1,
            membership: Membership::Active,
            step: MAX_STEP,
            vouched: MAX_STEP,
            reached: Some(MAX_STEP),
            progress_m: 1e8,
            order: Some(order),
            orders: 0,
            echo: None,
            lost: VehicleSet::default(),
        };
        self.put(Topic::Mission(id(3)), encode(&mission));
        // The same message twice: a replay.
        self.put(Topic::State(id(2), cell), encode(&good));
        self.put(Topic::State(id(2), cell), encode(&good));
        self.expected.forged += 3;
        self.expected.other_plan += 1;
        self.expected.old += 1;
    }
}

#[test]
fn garbage_on_every_port_is_counted_and_never_believed() {
    let _share = Share::of(60);
    let swarm = SwarmName::new(format!("garbage-{}", std::process::id())).unwrap();
    let text = format!("swarm.vehicles = 4\nswarm.name = {:?}\nformation.altitude_m = 8", swarm.as_str());
    let scenario = load(&Source { name: "garbage.toml", text: &text }, &[]).unwrap().scenario;

    let options = <StandinOptions as clap::FromArgMatches>::from_arg_matches(
        &<StandinOptions as clap::Args>::augment_args(clap::Command::new("standin"))
            .get_matches_from(["standin", "--port", "0", "--beacon", "false"]),
    )
    .unwrap();
    let mut standin = Standin::open(&options).unwrap();
    let simulator = SocketAddr::from(([127, 0, 0, 1], standin.address.port()));
    let meddler = Meddler::new(simulator);
    let seen = meddler.seen.clone();
    let between = meddler.agent_side.local_addr().unwrap();

    let stop_edges = Arc::new(AtomicBool::new(false));
    let edges = [
        thread::spawn({
            let stop = stop_edges.clone();
            move || standin.run(&stop)
        }),
        thread::spawn({
            let stop = stop_edges.clone();
            move || meddler.run(&stop)
        }),
    ];

    let sessions = Sessions::open(&swarm, &["tcp/127.0.0.1:0".to_owned()], &[], &Security::Plain).unwrap();
    let locator = sessions.endpoints()[0].clone();
    let node = Node {
        scenario,
        notes: Vec::new(),
        id: id(1),
        listen: Vec::new(),
        dial: Vec::new(),
        aircraft: Aircraft::shipped("xcell60").unwrap().unwrap(),
        rules: Rules::shipped(),
        plant: PlantChoice::Standin(between),
        flown_s: None,
        security: Security::Plain,
        orders_key: None,
        run: 0,
        inputs: None,
    };
    let tokio = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let stop = Arc::new(Stop::default());
    let flight = thread::spawn({
        let (stop, handle) = (stop.clone(), tokio.handle().clone());
        move || run::fly(&node, sessions, &stop, &handle)
    });

    let mut outsider = Outsider::dial(&swarm, &locator);
    let healths = outsider.session.declare_subscriber(all::HEALTH).with(FifoChannel::new(256)).wait().unwrap();
    let traces = outsider.session.declare_subscriber(all::TRACES).with(FifoChannel::new(4096)).wait().unwrap();
    // Zenoh drops messages sent before the agent's subscriptions are known here: they would be missing in the agent's
    // counts.
    while healths.recv_timeout(Duration::from_secs(10)).unwrap().is_none() {}
    let port: SocketAddr = locator.trim_start_matches("tcp/").parse().unwrap();

    let (mut drops, mut highest_m, mut height_m) = (Drops::default(), 0.0_f64, 0.0);
    let mut activities = Vec::new();
    let meddled = Instant::now() + Duration::from_secs(14);
    let timeout = meddled + Duration::from_secs(20);
    let mut controls_under_garbage = 0;
    let counted = |drops: &Drops| Drops { plant_malformed: 0, plant_foreign: 0, ..*drops };
    loop {
        assert!(!flight.is_finished(), "the agent has ended");
        let is_over = Instant::now() >= meddled;
        if !is_over {
            outsider.meddle();
            if let Ok(mut raw) = TcpStream::connect(port) {
                let _ = raw.write_all(&noise(&mut outsider.rng, 4096));
            }
            controls_under_garbage = seen.controls.load(Relaxed);
        }
        seen.is_over.store(is_over, Relaxed);
        for sample in healths.drain() {
            drops = decode::<Health>(&sample.payload().to_bytes()).unwrap().drops;
        }
        for sample in traces.drain() {
            let trace: Trace = decode(&sample.payload().to_bytes()).unwrap();
            (height_m, highest_m) = (trace.height_m, highest_m.max(trace.height_m));
            if activities.last() != Some(&trace.activity) {
                activities.push(trace.activity);
            }
        }
        let is_counted = is_over && counted(&drops) == outsider.expected;
        if is_counted && seen.controls.load(Relaxed) > controls_under_garbage + 500 || Instant::now() > timeout {
            break;
        }
        thread::sleep(Duration::from_millis(50));
    }
    let (controls, garbage) = (seen.controls.load(Relaxed), seen.garbage.load(Relaxed));
    stop.request();
    flight.join().unwrap().unwrap();
    stop_edges.store(true, Relaxed);
    edges.into_iter().for_each(|edge| edge.join().unwrap());

    println!("{drops:?} of {garbage} datagrams, {activities:?}, highest {highest_m:.1} m, {controls} controls");
    assert_eq!(counted(&drops), outsider.expected, "each message is counted once, for what is wrong with it");
    let plant = drops.plant_malformed + drops.plant_foreign;
    assert!(plant <= garbage, "nothing of the simulator's own is refused: {plant} of {garbage}");
    // What a full queue lost on its way, and what one frame's positions left of each other, is not counted.
    assert!(plant > garbage / 2 && drops.plant_malformed > 100 && drops.plant_foreign > 100, "{plant} of {garbage}");
    assert!(controls_under_garbage > 1000 && controls > controls_under_garbage + 500, "{controls}: it flies on");
    assert!((7.0..11.0).contains(&highest_m), "climbs as it does undisturbed: {highest_m}");
    assert!((6.0..11.0).contains(&height_m), "and stays there: {height_m}");
    assert!(!activities.contains(&Activity::Landing), "another plan orders nothing: {activities:?}");
}
