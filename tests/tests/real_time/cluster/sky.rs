//! Independent observation of the flight: another PC on the bridge subscribes to the swarm with only the observers'
//! certificate, so that the test does not rely on the output of `skein`'s commands.

use skein_common::math;
use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::{self, sleep};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use serde_json::{Value, json};
use skein_cluster::inventory::Inventory;
use skein_cluster::keys::Role;
use skein_cluster::mesh::observe::{Observer, SwarmMessage};
use skein_common::message::Trace;
use skein_common::state::PeerStatus;

use super::lab::Lab;

/// Files of an observer.
const OBSERVERS: [&str; 7] = [
    "cluster.toml",
    "ring.toml",
    "keys/authority.pem",
    "keys/observer.pem",
    "keys/observer.key",
    "keys/orders.pub",
    "keys/names.toml",
];
/// Time between two snapshots.
const PERIOD: Duration = Duration::from_millis(50);
/// A vehicle whose newest trace is older than this is out of contact, s.
const NEW_S: f64 = 1.0;
/// Vehicles below this height do not count for collisions, m.
const AIRBORNE_M: f64 = 2.0;

/// State of one vehicle at one instant.
#[derive(Clone, Debug)]
pub(super) struct Vehicle {
    pub(super) id: u8,
    /// Whether its liveliness token exists and a trace of it arrived recently.
    pub(super) is_there: bool,
    pub(super) height_m: f64,
    pub(super) north_m: f64,
    pub(super) east_m: f64,
    pub(super) is_active: bool,
    pub(super) step: u64,
    /// Incarnation of its agent.
    pub(super) incarnation: u64,
    pub(super) order: String,
    pub(super) release: String,
    /// What the vehicle measures of its own loop and of the network.
    pub(super) measured: Measured,
}

/// What one vehicle measures of its own loop and of the network.
#[derive(Clone, Copy, Debug)]
pub(super) struct Measured {
    /// Time from a frame's arrival to its last control output, µs.
    pub(super) step_us: f64,
    /// Steps that ended too late since the agent started.
    pub(super) late: f64,
    /// Largest excess of the time between two frames over their period, over the last second, ms.
    pub(super) jitter_ms: f64,
    /// Age of the oldest state of a peer in contact, ms.
    pub(super) oldest_ms: f64,
}

impl Vehicle {
    /// Horizontal distance from the ring's centre, m.
    pub(super) fn radius_m(&self) -> f64 {
        math::hypot(self.north_m, self.east_m)
    }

    pub(super) fn flies(&self) -> bool {
        self.is_there && self.height_m > AIRBORNE_M
    }
}

/// State of all vehicles at one instant.
#[derive(Clone, Debug)]
pub(super) struct Snapshot {
    /// Unix time, s.
    pub(super) at_s: f64,
    pub(super) vehicles: Vec<Vehicle>,
}

impl Snapshot {
    pub(super) fn of(&self, id: u8) -> Option<&Vehicle> {
        self.vehicles.iter().find(|vehicle| vehicle.id == id)
    }

    /// Whether at least this many vehicles are in contact and satisfy the condition.
    pub(super) fn all(&self, count: usize, are: impl Fn(&Vehicle) -> bool) -> bool {
        self.vehicles.iter().filter(|vehicle| vehicle.is_there && are(vehicle)).count() >= count
    }

    /// Least distance between two airborne vehicles, m.
    pub(super) fn least_m(&self) -> f64 {
        let mut least_m = f64::INFINITY;
        for (nth, one) in self.vehicles.iter().enumerate() {
            for other in self.vehicles[..nth].iter().filter(|other| other.flies() && one.flies()) {
                let level_m = math::hypot(one.north_m - other.north_m, one.east_m - other.east_m);
                least_m = least_m.min(math::hypot(level_m, one.height_m - other.height_m));
            }
        }
        least_m
    }
}

/// An event that a vehicle reported.
#[derive(Clone, Debug)]
pub(super) struct ReportedEvent {
    pub(super) at_s: f64,
    pub(super) id: u8,
    pub(super) what: String,
}

#[derive(Debug, Default)]
struct Observed {
    snapshots: Vec<Snapshot>,
    events: Vec<ReportedEvent>,
}

/// Observes the swarm until it is dropped.
pub(super) struct Sky {
    observed: Arc<Mutex<Observed>>,
    child: Child,
}

impl Sky {
    /// Starts the observer with the observers' files from the operator's folder.
    pub(super) fn watch(lab: &Lab) -> Self {
        let (from, eye) = (lab.operator().path("/root/lab"), lab.eye());
        let to = eye.path("/root/lab");
        fs::create_dir_all(to.join("keys")).unwrap();
        for file in OBSERVERS {
            fs::copy(from.join(file), to.join(file)).unwrap();
        }
        eye.put_program(&std::env::current_exe().unwrap(), "/opt/eye");
        let mut command = eye.command("/opt/eye");
        command.args(["--exact", "cluster::watcher", "--ignored", "--nocapture"]);
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let observed = Arc::<Mutex<Observed>>::default();
        let into = observed.clone();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                if let Ok(value) = serde_json::from_str::<Value>(&line) {
                    take_snapshot(&mut into.lock().unwrap(), &value);
                }
            }
        });
        Self { observed, child }
    }

    /// The newest snapshot.
    pub(super) fn now(&self) -> Snapshot {
        self.observed.lock().unwrap().snapshots.last().cloned().expect("a snapshot")
    }

    /// All snapshots since this time.
    pub(super) fn since(&self, from_s: f64) -> Vec<Snapshot> {
        self.observed.lock().unwrap().snapshots.iter().filter(|snapshot| snapshot.at_s >= from_s).cloned().collect()
    }

    /// All events since this time.
    pub(super) fn events_since(&self, from_s: f64) -> Vec<ReportedEvent> {
        self.observed.lock().unwrap().events.iter().filter(|event| event.at_s >= from_s).cloned().collect()
    }

    /// Time at which the last of these vehicles reported this event, s; `None` unless all have reported it since
    /// `from_s`.
    pub(super) fn all_reported(&self, ids: &[u8], from_s: f64, what: &str) -> Option<f64> {
        let events = self.events_since(from_s);
        let first = |id: &u8| events.iter().find(|event| event.id == *id && event.what == what).map(|event| event.at_s);
        ids.iter().map(first).try_fold(from_s, |latest_s, at_s| Some(at_s?.max(latest_s)))
    }

    /// Waits for a snapshot after `from_s` that satisfies the condition, and returns its time, s.
    #[track_caller]
    pub(super) fn wait(&self, within_s: u64, from_s: f64, what: &str, is_it: impl Fn(&Snapshot) -> bool) -> f64 {
        let found = || self.since(from_s).iter().find(|snapshot| is_it(snapshot)).map(|snapshot| snapshot.at_s);
        self.wait_for(within_s, what, found)
    }

    /// Waits until `found` returns a value.
    #[track_caller]
    pub(super) fn wait_for<T>(&self, within_s: u64, what: &str, found: impl Fn() -> Option<T>) -> T {
        let until = Instant::now() + Duration::from_secs(within_s);
        loop {
            if let Some(found) = found() {
                return found;
            }
            if Instant::now() > until {
                let events: Vec<_> = self.events_since(now_s() - 2.0 * within_s as f64);
                let events: String =
                    events.iter().map(|event| format!("{:.2} {} {}\n", event.at_s, event.id, event.what)).collect();
                panic!("not within {within_s} s: {what}:\n{:#?}\n{events}", self.since(0.0).last());
            }
            sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Sky {
    fn drop(&mut self) {
        drop(self.child.stdin.take());
        let _ = self.child.wait();
    }
}

fn take_snapshot(observed: &mut Observed, value: &Value) {
    let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let id = |value: &Value| u8::try_from(value["id"].as_u64().unwrap_or_default()).unwrap_or_default();
    let at_s = number(&value["at_s"]);
    let each = |name: &str| value[name].as_array().cloned().unwrap_or_default();
    let vehicles = each("vehicles").into_iter().map(|vehicle| Vehicle {
        id: id(&vehicle),
        is_there: vehicle["alive"] == json!(true) && number(&vehicle["age_s"]) < NEW_S,
        height_m: number(&vehicle["height_m"]),
        north_m: number(&vehicle["north_m"]),
        east_m: number(&vehicle["east_m"]),
        is_active: vehicle["membership"] == json!("Active"),
        step: vehicle["step"].as_u64().unwrap_or_default(),
        incarnation: vehicle["life"].as_u64().unwrap_or_default(),
        order: text(&vehicle["order"]),
        release: text(&vehicle["release"]),
        measured: Measured {
            step_us: number(&vehicle["step_us"]),
            late: number(&vehicle["late"]),
            jitter_ms: number(&vehicle["jitter_ms"]),
            oldest_ms: number(&vehicle["oldest_ms"]),
        },
    });
    observed.snapshots.push(Snapshot { at_s, vehicles: vehicles.collect() });
    observed.events.extend(each("events").iter().map(|event| ReportedEvent {
        at_s,
        id: id(event),
        what: text(&event["what"]),
    }));
}

/// Unix time, s, which all hosts of this computer share.
pub(super) fn now_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64()
}

/// Age of the oldest state of a peer in contact, ms.
fn oldest_ms(trace: &Trace) -> f64 {
    let in_contact = trace.peers.iter().filter(|peer| peer.standing != PeerStatus::Lost);
    in_contact.map(|peer| peer.age_s * 1e3).fold(0.0, f64::max)
}

/// The process of the observer.
pub(super) fn observe_swarm() {
    let Ok(inventory) = Inventory::read("lab/cluster.toml".as_ref()) else { return };
    let mut observer = Observer::open(&inventory.reaches(Role::Observer).unwrap()[0]).unwrap();
    observer.subscribe_to_traces(true).unwrap();
    thread::spawn(|| {
        let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink());
        std::process::exit(0);
    });
    println!();
    loop {
        sleep(PERIOD);
        let events = observer.poll().into_iter().filter_map(|received| match received {
            SwarmMessage::Event(event) => {
                Some(json!({ "id": event.header.sender.get(), "what": event.what.to_string() }))
            }
            _ => None,
        });
        let events: Vec<Value> = events.collect();
        let vehicles = observer.vehicles().iter().map(|(id, observed)| {
            let (trace, mission) = (observed.trace.as_ref(), observed.mission.as_ref());
            json!({
                "id": id.get(),
                "alive": observed.alive,
                "age_s": observed.trace_at.map(|at| at.elapsed().as_secs_f64()),
                "height_m": trace.map(|trace| trace.height_m),
                "north_m": trace.map(|trace| trace.position.north_m()),
                "east_m": trace.map(|trace| trace.position.east_m()),
                "membership": mission.map(|mission| format!("{:?}", mission.membership)),
                "step": mission.map(|mission| mission.step),
                "life": mission.map(|mission| mission.header.incarnation.0),
                "order": mission.and_then(|mission| mission.order).map(|order| order.verb.to_string()),
                "release": observed.health.as_ref().map(|health| health.version.clone()),
                "step_us": trace.and_then(|trace| trace.step_us),
                "late": trace.map(|trace| trace.frame_overruns),
                "jitter_ms": observed.health.as_ref().map(|health| health.jitter_ms),
                "oldest_ms": trace.map(oldest_ms),
            })
        });
        let snapshot = json!({ "at_s": now_s(), "vehicles": vehicles.collect::<Vec<_>>(), "events": events });
        let mut out = std::io::stdout().lock();
        if writeln!(out, "{snapshot}").and_then(|()| out.flush()).is_err() {
            return;
        }
    }
}
