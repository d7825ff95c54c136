//! One cluster from installation to removal, as its operator handles it; every part begins where the one before ended.

use skein_common::math;
use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::process::Stdio;
use std::thread::sleep;
use std::time::Duration;

use super::faults::other_release;
use super::finished::Finished;
use super::fleet::{self, ALTITUDE_M, BAND_M, Fleet, RADIUS_M};
use super::host::{Host, kill};
use super::intruders;
use super::lab::{HOSTS, Lab};
use super::ordered;
use super::print_line;
use super::sky::{ReportedEvent, Sky, Snapshot, Vehicle, now_s};

/// A vehicle above this height has taken off, m.
const OFF_M: f64 = 1.5;
/// Time without a frame after which a helicopter may have left the air, ms.
const FALLS_AFTER_MS: f64 = 1000.0;
/// Largest time from an empty host to the take-off of all vehicles, without the time for copying, on a busy PC, s. An
/// idle PC needs a quarter of it.
const OFF_WITHIN_S: f64 = 30.0;
/// Two vehicles closer than this have collided, m.
const COLLISION_M: f64 = 2.0;
/// Least distance of neighbours on a complete ring, as a share of an even spacing.
const EVEN: f64 = 0.8;
/// A vehicle that continues to fly stays above this height, m.
const ALOFT_M: f64 = ALTITUDE_M - 2.0;

/// Least duration of a mission step, s.
const DWELL_S: f64 = 2.0;
/// The node whose log the test reads.
const LOGGED: u8 = 1;
const ALL: [u8; HOSTS as usize] = [1, 2, 3, 4, 5, 6, 7, 8];

pub(super) struct Flight {
    pub(super) lab: Lab,
    pub(super) fleet: Fleet,
    /// Files of the hosts before the installation.
    before: Vec<Vec<String>>,
    /// Time from empty hosts to the take-off of all vehicles, without the time for copying, s.
    off_s: f64,
}

impl Flight {
    /// Eight hosts with a helicopter each, and the operator's two files.
    pub(super) fn prepare() -> Self {
        let lab = Lab::new("flight", |_| &[]);
        fleet::describe(&lab, HOSTS);
        let fleet = Fleet::start(&lab, ALL);
        let before = lab.hosts.iter().map(Host::files).collect();
        Self { lab, fleet, before, off_s: f64::NAN }
    }

    /// `skein cluster ... -f lab/cluster.toml --json`
    pub(super) fn cluster(&self, arguments: &str, within_s: u64) -> Finished {
        self.lab.skein(&format!("cluster {arguments} -f lab/cluster.toml --json"), within_s)
    }

    /// Makes keys, installs the program on all hosts, and waits for the take-off of all vehicles. From then on an
    /// observer watches.
    pub(super) fn start(&mut self) -> Sky {
        let keys = self.cluster("keys", 30).succeeded();
        let mode = |name: &str| {
            let path = self.lab.operator().path("/root/lab/keys").join(name);
            fs::metadata(path).unwrap().permissions().mode() & 0o777
        };
        let secrets = ["authority.key", "vehicle-1.key", "operator.key", "observer.key", "orders.key"];
        secrets.iter().for_each(|secret| assert_eq!(mode(secret), 0o600, "{secret}"));

        let install = self.cluster("install", 180).succeeded();
        let done = install.json();
        let each = |key: &str| -> Vec<f64> { rows(&done).iter().map(|row| row[key].as_f64().unwrap()).collect() };
        assert!(
            rows(&done).len() == ALL.len() && rows(&done).iter().all(|row| row["done"] == "installed"),
            "{install}"
        );
        let copying_s = each("copy_s").into_iter().fold(0.0, f64::max);
        let again = self.cluster("install", 60).succeeded();
        let unchanged = rows(&again.json()).iter().all(|row| row["done"] == "unchanged" && row["copied_bytes"] == 0);
        assert!(unchanged, "a second installation changes nothing: {again}");

        let sky = Sky::watch(&self.lab);
        let up_s = now_s();
        let up = self.cluster("up", 60).succeeded();
        let off_s = sky.wait(30, up_s, "all eight vehicles have taken off", |snapshot| {
            snapshot.all(8, |vehicle| vehicle.height_m > OFF_M)
        });
        let (install_s, off_s) = (install.took_s() - copying_s, off_s - up_s);
        print_line(&format!(
            "keys {:.2} s; installed on 8 hosts in {:.2} s, of which {:.2} s copying {:.0} MB to each; a second time, nothing \
             changed, {:.2} s; up, all ready, {:.2} s; all above {OFF_M} m {off_s:.2} s after `up` began.\n\
             From empty hosts to all eight above {OFF_M} m, without copying: {:.2} s",
            keys.took_s(),
            install.took_s(),
            copying_s,
            each("copied_bytes")[0] * 1e-6,
            again.took_s(),
            up.took_s(),
            install_s + off_s
        ));
        self.off_s = install_s + off_s;
        sky
    }

    /// Waits until the vehicles have formed the ring.
    pub(super) fn form(&self, sky: &Sky) {
        let from_s = now_s();
        let gap_m = 2.0 * RADIUS_M * math::sin(std::f64::consts::PI / f64::from(HOSTS));
        let is_ring = |snapshot: &Snapshot| {
            let in_band = |radius_m: f64| (radius_m - RADIUS_M).abs() < BAND_M;
            snapshot.all(8, |vehicle| in_band(vehicle.radius_m()) && vehicle.height_m > ALOFT_M)
                && snapshot.least_m() > EVEN * gap_m
        };
        let ring_s = sky.wait(60, from_s, "the ring is complete", is_ring) - from_s;
        print_line(&format!("a ring of eight, neighbours {gap_m:.0} m apart, {ring_s:.1} s later"));
    }

    /// Kills the agent of this vehicle. Returns the time until all others are in contact with it again, s.
    pub(super) fn restart(&self, sky: &Sky, id: u8) -> f64 {
        let killed_s = now_s();
        self.lab.host(id).processes(&["skein", "agent"]).into_iter().for_each(kill);
        let others = others(id);
        let lost = || sky.all_reported(&others, killed_s, &format!("lost contact with vehicle {id}"));
        let lost_s = sky.wait_for(10, "its peers lose contact", lost);
        let found = || sky.all_reported(&others, lost_s, &format!("in contact with vehicle {id}"));
        sky.wait_for(30, "its peers are in contact again", found) - killed_s
    }

    /// Kills one agent.
    pub(super) fn kill_one(&self, sky: &Sky) {
        let (killed, others) = (4, others(4));
        let incarnation = sky.now().of(killed).unwrap().incarnation;
        let agents = self.lab.host(killed).processes(&["skein", "agent"]);
        assert_eq!(agents.len(), 1, "{agents:?}");
        let killed_s = now_s();
        kill(agents[0]);
        let lost_s = sky.wait_for(10, "its peers lose contact", || {
            sky.all_reported(&others, killed_s, "lost contact with vehicle 4")
        });
        let found_s = sky.wait_for(20, "its peers are in contact again", || {
            sky.all_reported(&others, lost_s, "in contact with vehicle 4")
        });
        let back = |snapshot: &Snapshot| {
            snapshot.of(killed).is_some_and(|vehicle| {
                vehicle.is_there && vehicle.incarnation > incarnation && vehicle.is_active && vehicle.height_m > ALOFT_M
            })
        };
        let back_s = sky.wait(30, killed_s, "the vehicle is active again in a new incarnation", back);
        self.others_fly_on(sky, &others, killed_s);
        print_line(&format!(
            "kill -9 of an agent: lost by all after {:.2} s, started again by its supervisor, in contact with all after {:.2} s, \
             active again at its height after {:.2} s",
            lost_s - killed_s,
            found_s - killed_s,
            back_s - killed_s
        ));
    }

    /// Disconnects one host from the network, and connects it again.
    pub(super) fn cut_one(&self, sky: &Sky) {
        let (cut, others) = (5, others(5));
        let before = sky.now();
        let cut_s = now_s();
        self.lab.cut(cut, true);
        let lost_s = sky
            .wait_for(10, "its peers lose contact", || sky.all_reported(&others, cut_s, "lost contact with vehicle 5"));
        sleep(Duration::from_secs(1));
        let status = self.cluster("status", 20);
        let silent = |node: &serde_json::Value| node["said"].is_null().then(|| node["id"].as_u64());
        let silent: Vec<_> = rows(&status.json()).iter().filter_map(silent).flatten().collect();
        assert!(
            status.status == Some(1) && silent == [u64::from(cut)],
            "the status names the silent vehicle: {status}"
        );
        let healed_s = now_s();
        self.lab.cut(cut, false);
        let found_s = sky.wait_for(20, "its peers are in contact again", || {
            sky.all_reported(&others, healed_s, "in contact with vehicle 5")
        });
        let is_back = |snapshot: &Snapshot| {
            snapshot.of(cut).is_some_and(|vehicle| vehicle.is_there && vehicle.height_m > ALOFT_M)
        };
        sky.wait(20, healed_s, "the vehicle is at its height", is_back);
        self.others_fly_on(sky, &others, cut_s);
        assert_eq!(
            sky.now().of(cut).unwrap().incarnation,
            before.of(cut).unwrap().incarnation,
            "the agent was not restarted"
        );
        print_line(&format!(
            "a host cut off: lost by all after {:.2} s; connected again {:.1} s later: in contact with all after {:.2} s; it flew on",
            lost_s - cut_s,
            healed_s - cut_s,
            found_s - healed_s
        ));
    }

    /// Messages of intruders without a valid certificate do not reach the swarm.
    pub(super) fn intrude(&self, sky: &Sky) {
        intruders::equip(&self.lab);
        let before = sky.now();
        let outcomes = intruders::start(&self.lab, &intruders::UNINVITED);
        assert!(outcomes.iter().all(|outcome| outcome.links == 0 && outcome.sent > 0), "{outcomes:?}");
        self.nothing_has_changed(sky, &before);
        print_line(&format!(
            "intruders over {:.0} s: without a certificate, with another authority's and with an expired one: no link, {:?} messages \
             sent: all eight fly on; in the log of one node:\n{}\n{}\n{}",
            now_s() - before.at_s,
            outcomes.iter().map(|outcome| outcome.sent).collect::<Vec<_>>(),
            self.logged(["no link with", "peer sent no certificates"]),
            self.logged(["no link with", "BadSignature"]),
            self.logged(["no link with", "xpired"]),
        ));
    }

    /// An intruder with the key of one node cannot send in the name of another vehicle, nor give orders.
    pub(super) fn take_over_one(&self, sky: &Sky) {
        let before = sky.now();
        let outcomes = intruders::start(&self.lab, &[intruders::TAKEN_OVER]);
        assert!(outcomes[0].links > 0 && outcomes[0].sent > 0, "{outcomes:?}");
        sleep(Duration::from_millis(1500));
        self.nothing_has_changed(sky, &before);

        let status = wait_until_good(|| self.cluster("status", 20));
        let status_json = status.json();
        let refusals: Vec<_> = rows(&status_json)
            .iter()
            .flat_map(|node| node["said"]["refusals"].as_array().cloned().unwrap_or_default())
            .collect();
        let count = |reason: &str, key: &str| {
            let counted = refusals.iter().filter(|refusal| refusal["reason"] == reason && refusal["key"] == key);
            counted.filter_map(|refusal| refusal["count"].as_u64()).sum::<u64>()
        };
        let of = |reason: &str, id: u8| {
            ["mission", "state"].map(|kind| count(reason, &format!("vehicle/{id}/{kind}"))).iter().sum::<u64>()
        };
        let own = intruders::OWN;
        let (orders, in_register) =
            (count("order without a valid signature", "order"), of("order without a valid signature", own));
        let (in_others_name, under_own_key) = (of("forged", intruders::VICTIM), of("forged", own));
        let replayed = of("old or replayed", own) + of("old or replayed", intruders::VICTIM);
        let all = [orders, in_register, in_others_name, under_own_key, replayed];
        assert!(all.iter().all(|count| *count > 0), "{all:?} {status}");
        print_line(&format!(
            "with node {own}'s key, {} messages over {} links: all eight fly on, no vehicle accepts an order; counted in the \
             status: {orders} orders and {in_register} in its own heartbeat without a valid signature, {in_others_name} messages forged in \
             another's name, {under_own_key} of another's under its own, {replayed} replayed",
            outcomes[0].sent, outcomes[0].links,
        ));
    }

    /// Checks that since then all eight have continued the mission, in the same incarnation, under the same order and
    /// no faster than possible.
    fn nothing_has_changed(&self, sky: &Sky, before: &Snapshot) {
        let advances = |snapshot: &Snapshot| {
            snapshot.vehicles.iter().zip(&before.vehicles).all(|(after, before)| after.step > before.step)
        };
        sky.wait(40, before.at_s, "all continue the mission", advances);
        self.others_fly_on(sky, &ALL, before.at_s);
        let after = sky.now();
        let most = (after.at_s - before.at_s) / DWELL_S + 2.0;
        for (before, after) in before.vehicles.iter().zip(&after.vehicles) {
            assert!(after.incarnation == before.incarnation && after.order == before.order, "{before:?}, {after:?}");
            assert!(after.step > before.step && ((after.step - before.step) as f64) < most, "{before:?}, {after:?}");
        }
        for event in sky.events_since(before.at_s) {
            let is_harmless = !event.what.starts_with("lost") && !event.what.starts_with("accepts the order");
            assert!(is_harmless, "{event:?}\n{}", self.lab.skein("cluster logs -n 60 --file lab/cluster.toml", 20));
        }
    }

    /// A line of one node's log that contains both texts.
    fn logged(&self, texts: [&str; 2]) -> String {
        let log = self.lab.host(LOGGED).sh("cat /root/.skein/lab/node-1/log/agent.log*").succeeded().out;
        let line = log.lines().find(|line| texts.iter().all(|text| line.contains(text)));
        line.unwrap_or_else(|| panic!("nothing in the log of node {LOGGED} with {texts:?}:\n{log}")).to_owned()
    }

    /// Removes the operator's PC while its commands run; another PC with the same keys takes over.
    pub(super) fn unplug_the_operator(&mut self, sky: &Sky) {
        let incarnations = |snapshot: &Snapshot| {
            snapshot.vehicles.iter().map(|vehicle| (vehicle.id, vehicle.incarnation)).collect::<Vec<_>>()
        };
        let before = incarnations(&sky.now());
        let busy = ["cluster up -f lab/cluster.toml", "cluster status -w -f lab/cluster.toml"].map(|arguments| {
            let mut command = self.lab.operator().command("skein");
            let silent = command.args(arguments.split(' ')).stdin(Stdio::null()).stdout(Stdio::null());
            silent.stderr(Stdio::null()).spawn().unwrap()
        });
        sleep(Duration::from_secs(1));
        let gone_s = now_s();
        self.lab.take_operator();
        for mut busy in busy {
            busy.wait().unwrap();
        }
        sleep(Duration::from_secs(5));
        assert_eq!(incarnations(&sky.now()), before, "no agent was restarted");
        assert_eq!(
            sky.events_since(gone_s).iter().find(|event| event.what.starts_with("lost")).map(|event| &event.what),
            None
        );
        self.others_fly_on(sky, &ALL, gone_s);
        assert!(sky.now().vehicles.iter().all(|vehicle| vehicle.order.is_empty()), "no order was given");

        self.lab.put_operator();
        let order = |verb: &str| self.lab.skein(&format!("order {verb} -f lab/cluster.toml"), 20).succeeded();
        let hold = order("hold");
        sky.wait(20, gone_s, "all hold", |snapshot| snapshot.all(8, |vehicle| vehicle.order == "hold"));
        let step = sky.now().vehicles.iter().map(|vehicle| vehicle.step).max().unwrap() + 1;
        order(&format!("goto {step}"));
        sky.wait(20, gone_s, "all continue", |snapshot| {
            snapshot.all(8, |vehicle| vehicle.step >= step && vehicle.order.starts_with("goto"))
        });
        print_line(&format!(
            "the operator's PC removed in flight: nothing changed in 5 s; from another PC with its keys: {}",
            hold.out.trim()
        ));
    }

    /// Holds the swarm from the page of the operator's PC, which signs the order, and sends it on.
    pub(super) fn order_from_the_page(&self, sky: &Sky) {
        let from_s = now_s();
        let shown = ordered::from_the_page(&self.lab, "hold");
        let text = shown["text"].as_str().unwrap_or_default();
        assert!(shown["ok"] == true && text.starts_with("hold: taken by 8 of 8"), "{shown}");
        sky.wait(20, from_s, "all hold", |snapshot| snapshot.all(8, |vehicle| vehicle.order == "hold"));
        let step = sky.now().vehicles.iter().map(|vehicle| vehicle.step).max().unwrap() + 1;
        self.lab.skein(&format!("order goto {step} -f lab/cluster.toml"), 20).succeeded();
        sky.wait(20, from_s, "all continue", |snapshot| snapshot.all(8, |vehicle| vehicle.step >= step));
        print_line(&format!("an order from the page, signed at the operator's PC: {text}"));
    }

    /// Installs another release and a ninth vehicle, node by node while the others fly. Host 8 then runs two agents and
    /// no X-Plane.
    pub(super) fn upgrade(&mut self, sky: Sky) -> Sky {
        let program = self.lab.operator().path("/opt/skein");
        fs::rename(other_release(&program), &program).unwrap();
        let ninth = HOSTS + 1;
        fleet::describe(&self.lab, ninth);
        self.fleet.add(&self.lab, ninth);
        self.cluster("keys", 30).succeeded();

        let releases =
            |snapshot: &Snapshot| snapshot.vehicles.iter().map(|vehicle| vehicle.release.clone()).collect::<Vec<_>>();
        let old = releases(&sky.now());
        let begun_s = now_s();
        let install = self.cluster("install", 600).succeeded();
        let done = install.json();
        let restarted = rows(&done).iter().filter_map(|row| row["restart_s"].as_f64()).collect::<Vec<_>>();
        assert_eq!(restarted.len(), usize::from(HOSTS), "{install}");
        assert!(rows(&done)[..8].iter().all(|row| row["done"] == "upgraded"), "{install}");
        assert_eq!(rows(&done)[8]["done"], "installed", "{install}");
        // On a busy PC, a helicopter whose agent gets no frames in flight descends by itself: the roll has no part in it. An agent
        // that has just started had no frames either, and has not flown.
        let (mut flown, mut uncontrolled) = (BTreeSet::new(), BTreeSet::new());
        for snapshot in sky.since(begun_s) {
            for one in &snapshot.vehicles {
                let agent = (one.id, one.incarnation);
                flown.extend((one.height_m > OFF_M).then_some(agent));
                let froze = one.measured.jitter_ms > FALLS_AFTER_MS && flown.contains(&agent);
                uncontrolled.extend(froze.then_some(agent));
            }
            // The last height of a vehicle that the observer does not receive may be old: on a busy PC for many seconds.
            let is_down = |vehicle: &&Vehicle| {
                let is_controlled = !uncontrolled.contains(&(vehicle.id, vehicle.incarnation));
                vehicle.is_there && vehicle.height_m < OFF_M && is_controlled
            };
            let down: Vec<_> = snapshot.vehicles.iter().filter(is_down).map(|vehicle| vehicle.id).collect();
            let events = || sky.events_since(begun_s);
            assert!(down.len() <= 1, "one after the other: {down:?} were down at {} s: {:#?}", snapshot.at_s, events());
        }
        let check = self.lab.skein("check -f lab/cluster.toml --json", 60);
        let simulator = format!("aircraft at {}", fleet::place(ninth));
        let checked = check.json();
        let has_simulator = |line: &serde_json::Value| {
            line["place"] == format!("node {ninth}")
                && line["what"] == "X-Plane"
                && line["state"] == "good"
                && line["found"].as_str().is_some_and(|found| found.contains(&simulator))
        };
        assert!(checked.as_array().unwrap().iter().any(has_simulator), "no {simulator} in {check}");
        self.cluster("up", 60).succeeded();
        drop(sky);
        // The observer needs the new files, which list the ninth vehicle.
        let sky = Sky::watch(&self.lab);
        self.wait_until_all_fly(&sky, ninth);
        assert!(releases(&sky.now()).iter().all(|release| !old.contains(release)), "{:?}", sky.now());
        let shared = self.lab.host(HOSTS);
        let of_host = [&["skein", "agent"][..], &["x-plane"]].map(|names| shared.processes(names).len());
        assert_eq!(of_host, [2, 0], "agents and X-Planes on {}", shared.name);
        for id in [HOSTS, ninth] {
            let of_pc = [&["x-plane"][..], &["skein"]].map(|names| self.lab.pc(id).processes(names).len());
            assert_eq!(of_pc, [1, 0], "X-Planes and agents on {}", self.lab.pc(id).name);
        }
        print_line(&format!(
            "another release and a ninth vehicle: all in {:.1} s, each lands, starts and is back within {:.1} s (the slowest), \
             one after the other while the rest fly on; then nine fly, two of them from one host over X-Planes on other PCs",
            install.took_s(),
            restarted.iter().copied().fold(0.0, f64::max)
        ));
        sky
    }

    /// Waits until all vehicles 1 to `count` fly. On a busy PC a vehicle whose agent gets too few frames does not reach its
    /// altitude and lands by itself, as it should; then its operator starts it again.
    fn wait_until_all_fly(&self, sky: &Sky, count: u8) {
        let fly = |snapshot: &Snapshot| {
            let flying = snapshot.vehicles.iter().filter(|one| one.is_there && one.is_active && one.height_m > ALOFT_M);
            flying.map(|vehicle| vehicle.id).collect::<BTreeSet<_>>()
        };
        let mut from_s = 0.0;
        for _ in 0..5 {
            let landed = sky.wait_for(60, "all vehicles fly, or have landed by themselves", || {
                let flying = sky.since(0.0).last().map(fly).unwrap_or_default();
                let is_end = |event: &ReportedEvent| event.what == "landed" && !flying.contains(&event.id);
                let events = sky.events_since(from_s);
                let landed: BTreeSet<_> = events.iter().filter(|event| is_end(event)).map(|event| event.id).collect();
                (flying.len() + landed.len() == usize::from(count)).then_some(landed)
            });
            if landed.is_empty() {
                return;
            }
            let nodes: Vec<_> = landed.iter().map(u8::to_string).collect();
            print_line(&format!("vehicles {} had too few frames, landed, and are started again", nodes.join(", ")));
            for command in ["down", "up"] {
                self.cluster(&format!("{command} --node {}", nodes.join(" ")), 90).succeeded();
            }
            from_s = now_s();
        }
        panic!("vehicles land by themselves again and again: {:#?}", sky.events_since(0.0));
    }

    /// Runs `status` on a node itself, with the node's own files.
    pub(super) fn status_from_a_node(&self) {
        let script = "cd .skein/lab && releases/*/skein cluster status -f node-2/current/cluster.toml";
        let status = wait_until_good(|| self.lab.operator().sh(&format!("ssh heli2 '{script}'")));
        // A vehicle that was disturbed just before may be on its way back to its place. The legend is no row.
        let flies =
            |line: &&str| line.contains(" xplane ") && (line.contains("formation") || line.contains("under way"));
        let lines = status.out.lines().filter(flies).count();
        assert_eq!(lines, usize::from(HOSTS), "{status}");
        print_line(&format!("skein cluster status, on node 2 itself:\n{}", status.out));
    }

    /// Lands all vehicles and removes the installation.
    pub(super) fn end(self, sky: &Sky) {
        let begun_s = now_s();
        let down = self.cluster("down", 90).succeeded();
        let landed = sky.events_since(begun_s).iter().filter(|event| event.what == "landed").count();
        assert!(landed >= usize::from(HOSTS), "the vehicles land first: {:?}", sky.events_since(begun_s));
        let uninstall = self.cluster("uninstall", 60).succeeded();
        for (host, before) in self.lab.hosts.iter().zip(&self.before) {
            assert_eq!(&host.files(), before, "{}", host.name);
            assert_eq!(host.processes(&["skein"]), Vec::<u32>::new(), "{}", host.name);
        }
        print_line(&format!(
            "down, all landed, {:.1} s; uninstalled in {:.1} s: no file and no process is left",
            down.took_s(),
            uninstall.took_s()
        ));
        assert!(self.off_s < OFF_WITHIN_S, "{:.2} s from empty hosts to take-off, without copying", self.off_s);
    }

    /// Checks that since then these vehicles were at their height in every snapshot and no two vehicles came close.
    fn others_fly_on(&self, sky: &Sky, ids: &[u8], since_s: f64) {
        for snapshot in sky.since(since_s) {
            assert!(snapshot.least_m() > COLLISION_M, "{snapshot:?}");
            for id in ids {
                let vehicle = snapshot.of(*id).unwrap();
                assert!(vehicle.height_m > ALOFT_M, "vehicle {id} does not continue to fly: {vehicle:?}");
            }
        }
        // On a busy PC the observer may receive nothing of a vehicle for a moment.
        let all_are =
            |snapshot: &Snapshot, are: fn(&Vehicle) -> bool| ids.iter().all(|id| snapshot.of(*id).is_some_and(are));
        sky.wait(30, now_s(), "all of them are received", |snapshot| all_are(snapshot, |vehicle| vehicle.is_there));
        assert!(all_are(&sky.now(), |vehicle| vehicle.is_active));
    }
}

/// Waits for a good status: on a busy PC a simulator may falter for a moment, which the status reports.
fn wait_until_good(status: impl Fn() -> Finished) -> Finished {
    for _ in 0..10 {
        let finished = status();
        if finished.status == Some(0) {
            return finished;
        }
        sleep(Duration::from_secs(1));
    }
    status().succeeded()
}

/// The rows of a report.
pub(super) fn rows(report: &serde_json::Value) -> &[serde_json::Value] {
    report["nodes"].as_array().map_or(&[], Vec::as_slice)
}

fn others(but: u8) -> Vec<u8> {
    ALL.into_iter().filter(|id| *id != but).collect()
}
