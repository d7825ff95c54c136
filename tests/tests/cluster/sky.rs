//! What really goes on in the sky, whatever the product's own commands say: another PC on the bridge that holds the observers'
//! certificate and nothing else, and looks on.

use skein_common::math;
use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::{self, sleep};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use serde_json::{Value, json};
use skein::inventory::Inventory;
use skein::keys::Role;
use skein::observe::{Heard, Observer, Steps};

use super::lab::Lab;

/// What an observer holds.
const OBSERVERS: [&str; 7] = [
    "cluster.toml",
    "ring.toml",
    "keys/authority.pem",
    "keys/observer.pem",
    "keys/observer.key",
    "keys/orders.pub",
    "keys/names.toml",
];
/// Between two looks.
const LOOK: Duration = Duration::from_millis(50);
/// Who has said nothing for so long is not seen, s.
const NEW_S: f64 = 1.0;
/// Below this height nothing collides, m.
const AIRBORNE_M: f64 = 2.0;

/// One vehicle at one moment.
#[derive(Clone, Debug)]
pub(super) struct Vehicle {
    pub(super) id: u8,
    /// Its token is there, and it has said something just now.
    pub(super) is_there: bool,
    pub(super) height_m: f64,
    pub(super) north_m: f64,
    pub(super) east_m: f64,
    pub(super) is_active: bool,
    pub(super) step: u64,
    /// Grows with every start of its agent.
    pub(super) life: u64,
    pub(super) order: String,
    pub(super) release: String,
}

impl Vehicle {
    /// From the ring's centre, m.
    pub(super) fn radius_m(&self) -> f64 {
        math::hypot(self.north_m, self.east_m)
    }

    pub(super) fn flies(&self) -> bool {
        self.is_there && self.height_m > AIRBORNE_M
    }
}

/// Everybody at one moment.
#[derive(Clone, Debug)]
pub(super) struct Look {
    /// Unix time.
    pub(super) at_s: f64,
    pub(super) vehicles: Vec<Vehicle>,
}

impl Look {
    pub(super) fn of(&self, id: u8) -> Option<&Vehicle> {
        self.vehicles.iter().find(|vehicle| vehicle.id == id)
    }

    /// So many are there, and all of them are like this.
    pub(super) fn all(&self, count: usize, are: impl Fn(&Vehicle) -> bool) -> bool {
        self.vehicles.iter().filter(|vehicle| vehicle.is_there && are(vehicle)).count() >= count
    }

    /// The nearest two in the air, m.
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

/// Something that a vehicle said.
#[derive(Clone, Debug)]
pub(super) struct Said {
    pub(super) at_s: f64,
    pub(super) id: u8,
    pub(super) what: String,
}

#[derive(Debug, Default)]
struct Seen {
    looks: Vec<Look>,
    said: Vec<Said>,
}

/// Looks on until it is dropped.
pub(super) struct Sky {
    seen: Arc<Mutex<Seen>>,
    child: Child,
}

impl Sky {
    /// From the operator's folder, with what an observer may have of it.
    pub(super) fn watch(lab: &Lab) -> Self {
        let (from, eye) = (lab.operator().path("/root/lab"), lab.eye());
        let to = eye.path("/root/lab");
        fs::create_dir_all(to.join("keys")).unwrap();
        for file in OBSERVERS {
            fs::copy(from.join(file), to.join(file)).unwrap();
        }
        eye.put_program(&std::env::current_exe().unwrap(), "/opt/eye");
        let mut command = eye.command("/opt/eye");
        command.args(["--exact", "watcher", "--ignored", "--nocapture"]);
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let seen = Arc::<Mutex<Seen>>::default();
        let into = seen.clone();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                if let Ok(value) = serde_json::from_str::<Value>(&line) {
                    take_up(&mut into.lock().unwrap(), &value);
                }
            }
        });
        Self { seen, child }
    }

    /// The newest look.
    pub(super) fn now(&self) -> Look {
        self.seen.lock().unwrap().looks.last().cloned().expect("it looks on")
    }

    /// All looks since this time.
    pub(super) fn since(&self, from_s: f64) -> Vec<Look> {
        self.seen.lock().unwrap().looks.iter().filter(|look| look.at_s >= from_s).cloned().collect()
    }

    /// Everything said since this time.
    pub(super) fn said_since(&self, from_s: f64) -> Vec<Said> {
        self.seen.lock().unwrap().said.iter().filter(|said| said.at_s >= from_s).cloned().collect()
    }

    /// When all of these have said this since then, the last of them.
    pub(super) fn all_said(&self, ids: &[u8], from_s: f64, what: &str) -> Option<f64> {
        let said = self.said_since(from_s);
        let first = |id: &u8| said.iter().find(|said| said.id == *id && said.what == what).map(|said| said.at_s);
        ids.iter().map(first).try_fold(from_s, |latest_s, at_s| Some(at_s?.max(latest_s)))
    }

    /// Waits for a look like this after `from_s`. Gives when it was.
    #[track_caller]
    pub(super) fn wait(&self, within_s: u64, from_s: f64, what: &str, is_it: impl Fn(&Look) -> bool) -> f64 {
        let found = || self.since(from_s).iter().find(|look| is_it(look)).map(|look| look.at_s);
        self.wait_for(within_s, what, found)
    }

    /// Waits until something is found.
    #[track_caller]
    pub(super) fn wait_for<T>(&self, within_s: u64, what: &str, found: impl Fn() -> Option<T>) -> T {
        let until = Instant::now() + Duration::from_secs(within_s);
        loop {
            if let Some(found) = found() {
                return found;
            }
            if Instant::now() > until {
                let said: Vec<_> = self.said_since(now_s() - 2.0 * within_s as f64);
                let said: String =
                    said.iter().map(|said| format!("{:.2} {} {}\n", said.at_s, said.id, said.what)).collect();
                panic!("within {within_s} s it did not come that {what}:\n{:#?}\n{said}", self.since(0.0).last());
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

fn take_up(seen: &mut Seen, value: &Value) {
    let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let id = |value: &Value| u8::try_from(value["id"].as_u64().unwrap_or_default()).unwrap_or_default();
    let at_s = number(&value["at_s"]);
    let each = |name: &str| value[name].as_array().cloned().unwrap_or_default();
    let vehicles = each("vehicles").into_iter().map(|it| Vehicle {
        id: id(&it),
        is_there: it["alive"] == json!(true) && number(&it["age_s"]) < NEW_S,
        height_m: number(&it["height_m"]),
        north_m: number(&it["north_m"]),
        east_m: number(&it["east_m"]),
        is_active: it["membership"] == json!("Active"),
        step: it["step"].as_u64().unwrap_or_default(),
        life: it["life"].as_u64().unwrap_or_default(),
        order: text(&it["order"]),
        release: text(&it["release"]),
    });
    seen.looks.push(Look { at_s, vehicles: vehicles.collect() });
    seen.said.extend(each("said").iter().map(|said| Said { at_s, id: id(said), what: text(&said["what"]) }));
}

/// Unix time, as all hosts of this computer have it.
pub(super) fn now_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64()
}

/// The looker-on's own process.
pub(super) fn look_on() {
    let Ok(inventory) = Inventory::read("lab/cluster.toml".as_ref()) else { return };
    let mut observer = Observer::open(&inventory.reach(Role::Observer).unwrap(), Steps::On).unwrap();
    thread::spawn(|| {
        let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink());
        std::process::exit(0);
    });
    println!();
    loop {
        sleep(LOOK);
        let said = observer.poll().into_iter().filter_map(|heard| match heard {
            Heard::Event(event) => Some(json!({ "id": event.header.sender.get(), "what": event.what.to_string() })),
            _ => None,
        });
        let said: Vec<Value> = said.collect();
        let vehicles = observer.vehicles().iter().map(|(id, seen)| {
            let (trace, mission) = (seen.trace.as_ref(), seen.mission.as_ref());
            json!({
                "id": id.get(),
                "alive": seen.alive,
                "age_s": seen.trace_at.map(|at| at.elapsed().as_secs_f64()),
                "height_m": trace.map(|trace| trace.height_m),
                "north_m": trace.map(|trace| trace.position.north_m()),
                "east_m": trace.map(|trace| trace.position.east_m()),
                "membership": mission.map(|said| format!("{:?}", said.membership)),
                "step": mission.map(|said| said.step),
                "life": mission.map(|said| said.header.incarnation.0),
                "order": mission.and_then(|said| said.order).map(|order| order.verb.to_string()),
                "release": seen.health.as_ref().map(|health| health.version.clone()),
            })
        });
        let look = json!({ "at_s": now_s(), "vehicles": vehicles.collect::<Vec<_>>(), "said": said });
        let mut out = std::io::stdout().lock();
        if writeln!(out, "{look}").and_then(|()| out.flush()).is_err() {
            return;
        }
    }
}
