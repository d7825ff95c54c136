//! One cluster from bare PCs to bare PCs, as its operator does it; every part begins where the one before has ended.

use skein_common::math;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::process::Stdio;
use std::thread::sleep;
use std::time::Duration;

use super::faults::other_release;
use super::fleet::{self, ALTITUDE_M, BAND_M, Fleet, RADIUS_M};
use super::host::{Host, kill};
use super::intruders;
use super::lab::{HOSTS, Lab};
use super::ran::Ran;
use super::say;
use super::sky::{Look, Sky, now_s};

/// Off the ground for good, m.
const OFF_M: f64 = 1.5;
/// From nothing installed to all off the ground, copying aside, it takes a busy PC at most so long, s; an idle one a quarter.
const OFF_WITHIN_S: f64 = 30.0;
/// Nearer than this two have collided, m.
const COLLISION_M: f64 = 2.0;
/// Eight neighbours on the ring are so far apart, at least this share of it, once it is formed.
const EVEN: f64 = 0.8;
/// Whoever flies on stays above this height, m.
const ALOFT_M: f64 = ALTITUDE_M - 2.0;

/// How long a step of the mission takes at least, s.
const DWELL_S: f64 = 2.0;
/// The node whose log is read.
const LOGGED: u8 = 1;
const ALL: [u8; HOSTS as usize] = [1, 2, 3, 4, 5, 6, 7, 8];

pub(super) struct Flight {
    pub(super) lab: Lab,
    pub(super) fleet: Fleet,
    /// What was on the hosts before anything was installed.
    before: Vec<Vec<String>>,
    /// From nothing installed to everybody off the ground, copying aside, s.
    off_s: f64,
}

impl Flight {
    /// Eight hosts with a helicopter each, and the operator's two files.
    pub(super) fn prepare() -> Self {
        let lab = Lab::new("flight", |_| &[]);
        fleet::describe(&lab, HOSTS);
        let fleet = Fleet::start(&lab, &[]);
        let before = lab.hosts.iter().map(Host::files).collect();
        Self { lab, fleet, before, off_s: f64::NAN }
    }

    /// `skein cluster ... -f lab/cluster.toml --json`
    pub(super) fn cluster(&self, words: &str, within_s: u64) -> Ran {
        self.lab.skein(&format!("cluster {words} -f lab/cluster.toml --json"), within_s)
    }

    /// Keys, the program everywhere, everybody off the ground; looks on from then on.
    pub(super) fn start(&mut self) -> Sky {
        let keys = self.cluster("keys", 30).good();
        let mode = |name: &str| {
            let path = self.lab.operator().path("/root/lab/keys").join(name);
            fs::metadata(path).unwrap().permissions().mode() & 0o777
        };
        let secrets = ["authority.key", "vehicle-1.key", "operator.key", "observer.key", "orders.key"];
        secrets.iter().for_each(|secret| assert_eq!(mode(secret), 0o600, "{secret}"));

        let install = self.cluster("install", 180).good();
        let done = install.json();
        let each = |key: &str| -> Vec<f64> { rows(&done).iter().map(|row| row[key].as_f64().unwrap()).collect() };
        assert!(
            rows(&done).len() == ALL.len() && rows(&done).iter().all(|row| row["done"] == "installed"),
            "{install}"
        );
        let copying_s = each("copy_s").into_iter().fold(0.0, f64::max);
        let again = self.cluster("install", 60).good();
        let unchanged = rows(&again.json()).iter().all(|row| row["done"] == "unchanged" && row["copied_bytes"] == 0);
        assert!(unchanged, "a second time changes nothing: {again}");

        let sky = Sky::watch(&self.lab);
        let up_s = now_s();
        let up = self.cluster("up", 60).good();
        let off_s = sky.wait(30, up_s, "all eight are off the ground", |look| look.all(8, |it| it.height_m > OFF_M));
        let (install_s, off_s) = (install.took_s() - copying_s, off_s - up_s);
        say(&format!(
            "keys {:.2} s; installed on 8 hosts in {:.2} s, of which {:.2} s copying {:.0} MB to each; a second time, nothing \
             changed, {:.2} s; up, all ready by themselves, {:.2} s; all above {OFF_M} m {off_s:.2} s after `up` began.\n\
             From nothing installed to all eight above {OFF_M} m, copying aside: {:.2} s",
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

    /// Until the ring is there.
    pub(super) fn form(&self, sky: &Sky) {
        let from_s = now_s();
        let gap_m = 2.0 * RADIUS_M * math::sin(std::f64::consts::PI / f64::from(HOSTS));
        let is_ring = |look: &Look| {
            let in_band = |radius_m: f64| (radius_m - RADIUS_M).abs() < BAND_M;
            look.all(8, |it| in_band(it.radius_m()) && it.height_m > ALOFT_M) && look.least_m() > EVEN * gap_m
        };
        let ring_s = sky.wait(60, from_s, "there is a ring", is_ring) - from_s;
        say(&format!("a ring of eight, neighbours {gap_m:.0} m apart, {ring_s:.1} s later"));
    }

    /// One agent dies without a word.
    pub(super) fn kill_one(&self, sky: &Sky) {
        let (killed, others) = (4, others(4));
        let life = sky.now().of(killed).unwrap().life;
        let agents = self.lab.host(killed).processes(&["skein", "agent"]);
        assert_eq!(agents.len(), 1, "{agents:?}");
        let killed_s = now_s();
        kill(agents[0]);
        let lost_s = sky.wait_for(10, "its peers lose it", || sky.all_said(&others, killed_s, "lost vehicle 4"));
        let found_s = sky.wait_for(20, "its peers hear it again", || sky.all_said(&others, lost_s, "hears vehicle 4"));
        let back = |look: &Look| {
            look.of(killed).is_some_and(|it| it.is_there && it.life > life && it.is_active && it.height_m > ALOFT_M)
        };
        let back_s = sky.wait(30, killed_s, "it takes part again in a new life", back);
        self.others_fly_on(sky, &others, killed_s);
        say(&format!(
            "kill -9 of an agent: lost by all after {:.2} s, started again by its supervisor, heard by all after {:.2} s, \
             takes part again at its height after {:.2} s",
            lost_s - killed_s,
            found_s - killed_s,
            back_s - killed_s
        ));
    }

    /// One host's cable is pulled, and put back.
    pub(super) fn cut_one(&self, sky: &Sky) {
        let (cut, others) = (5, others(5));
        let before = sky.now();
        let cut_s = now_s();
        self.lab.cut(cut, true);
        let lost_s = sky.wait_for(10, "its peers lose it", || sky.all_said(&others, cut_s, "lost vehicle 5"));
        sleep(Duration::from_secs(1));
        let status = self.cluster("status", 20);
        let silent = |node: &serde_json::Value| node["said"].is_null().then(|| node["id"].as_u64());
        let silent: Vec<_> = rows(&status.json()).iter().filter_map(silent).flatten().collect();
        assert!(status.status == Some(1) && silent == [u64::from(cut)], "it says who is not heard: {status}");
        let healed_s = now_s();
        self.lab.cut(cut, false);
        let found_s =
            sky.wait_for(20, "its peers hear it again", || sky.all_said(&others, healed_s, "hears vehicle 5"));
        let is_back = |look: &Look| look.of(cut).is_some_and(|it| it.is_there && it.height_m > ALOFT_M);
        sky.wait(20, healed_s, "it is seen at its height", is_back);
        self.others_fly_on(sky, &others, cut_s);
        assert_eq!(sky.now().of(cut).unwrap().life, before.of(cut).unwrap().life, "it flew on alone");
        say(&format!(
            "a host cut off: lost by all after {:.2} s; put back {:.1} s later: heard by all after {:.2} s; it flew on",
            lost_s - cut_s,
            healed_s - cut_s,
            found_s - healed_s
        ));
    }

    /// Nobody who is not invited is heard.
    pub(super) fn intrude(&self, sky: &Sky) {
        intruders::equip(&self.lab);
        let before = sky.now();
        let came = intruders::come(&self.lab, &intruders::UNINVITED);
        assert!(came.iter().all(|came| came.links == 0 && came.said > 0), "{came:?}");
        self.nothing_has_changed(sky, &before);
        say(&format!(
            "intruders over {:.0} s: without a certificate, with another authority's and with an expired one: no link, said {:?} \
             times: all eight fly on; in the log of one node:\n{}\n{}\n{}",
            now_s() - before.at_s,
            came.iter().map(|came| came.said).collect::<Vec<_>>(),
            self.logged(["no link with", "peer sent no certificates"]),
            self.logged(["no link with", "BadSignature"]),
            self.logged(["no link with", "xpired"]),
        ));
    }

    /// Nobody who has taken over a node speaks for another, or gives orders.
    pub(super) fn take_over_one(&self, sky: &Sky) {
        let before = sky.now();
        let came = intruders::come(&self.lab, &[intruders::TAKEN_OVER]);
        assert!(came[0].links > 0 && came[0].said > 0, "{came:?}");
        sleep(Duration::from_millis(1500));
        self.nothing_has_changed(sky, &before);

        let status = soon_good(|| self.cluster("status", 20));
        let status_json = status.json();
        let refusals: Vec<_> = rows(&status_json)
            .iter()
            .flat_map(|node| node["said"]["refusals"].as_array().cloned().unwrap_or_default())
            .collect();
        let count = |reason: &str, key: &str| {
            let counted = refusals.iter().filter(|it| it["reason"] == reason && it["key"] == key);
            counted.filter_map(|it| it["count"].as_u64()).sum::<u64>()
        };
        let of = |reason: &str, id: u8| {
            ["mission", "state"].map(|kind| count(reason, &format!("vehicle/{id}/{kind}"))).iter().sum::<u64>()
        };
        let own = intruders::OWN;
        let (orders, in_register) =
            (count("order without a valid seal", "order"), of("order without a valid seal", own));
        let (in_others_name, under_own_key) = (of("forged", intruders::VICTIM), of("forged", own));
        let replayed = of("old or replayed", own) + of("old or replayed", intruders::VICTIM);
        let all = [orders, in_register, in_others_name, under_own_key, replayed];
        assert!(all.iter().all(|count| *count > 0), "{all:?} {status}");
        say(&format!(
            "with node {own}'s key, said {} times over {} links: all eight fly on, nobody takes an order; counted and named in \
             status: {orders} orders and {in_register} in its own register without a valid seal, {in_others_name} words forged in \
             another's name, {under_own_key} of another's under its own, {replayed} replayed",
            came[0].said, came[0].links,
        ));
    }

    /// Since then all eight have flown on, in the same life, under the same order, no faster through the mission than they can.
    fn nothing_has_changed(&self, sky: &Sky, before: &Look) {
        let goes_on =
            |look: &Look| look.vehicles.iter().zip(&before.vehicles).all(|(after, before)| after.step > before.step);
        sky.wait(40, before.at_s, "all go on with the mission", goes_on);
        self.others_fly_on(sky, &ALL, before.at_s);
        let after = sky.now();
        let most = (after.at_s - before.at_s) / DWELL_S + 2.0;
        for (before, after) in before.vehicles.iter().zip(&after.vehicles) {
            assert!(after.life == before.life && after.order == before.order, "{before:?}, {after:?}");
            assert!(after.step > before.step && ((after.step - before.step) as f64) < most, "{before:?}, {after:?}");
        }
        for said in sky.said_since(before.at_s) {
            let is_harmless = !said.what.starts_with("lost") && !said.what.starts_with("takes the order");
            assert!(is_harmless, "{said:?}\n{}", self.lab.skein("cluster logs -n 60 --file lab/cluster.toml", 20));
        }
    }

    /// A line of one node's log that has both.
    fn logged(&self, words: [&str; 2]) -> String {
        let log = self.lab.host(LOGGED).sh("cat /root/.skein/lab/node-1/log/agent.log*").good().out;
        let line = log.lines().find(|line| words.iter().all(|word| line.contains(word)));
        line.unwrap_or_else(|| panic!("nothing in the log of node {LOGGED} with {words:?}:\n{log}")).to_owned()
    }

    /// The operator's PC goes while it is busy with the swarm; another one with the same keys comes.
    pub(super) fn unplug_the_operator(&mut self, sky: &Sky) {
        let lives = |look: &Look| look.vehicles.iter().map(|it| (it.id, it.life)).collect::<Vec<_>>();
        let before = lives(&sky.now());
        let busy = ["cluster up -f lab/cluster.toml", "cluster status -w -f lab/cluster.toml"].map(|words| {
            let mut command = self.lab.operator().command("skein");
            let silent = command.args(words.split(' ')).stdin(Stdio::null()).stdout(Stdio::null());
            silent.stderr(Stdio::null()).spawn().unwrap()
        });
        sleep(Duration::from_secs(1));
        let gone_s = now_s();
        self.lab.take_operator();
        for mut busy in busy {
            busy.wait().unwrap();
        }
        sleep(Duration::from_secs(5));
        assert_eq!(lives(&sky.now()), before, "nobody was started again");
        assert_eq!(
            sky.said_since(gone_s).iter().find(|said| said.what.starts_with("lost")).map(|said| &said.what),
            None
        );
        self.others_fly_on(sky, &ALL, gone_s);
        assert!(sky.now().vehicles.iter().all(|it| it.order.is_empty()), "nobody has ordered anything");

        self.lab.put_operator();
        let order = |verb: &str| self.lab.skein(&format!("order {verb} -f lab/cluster.toml"), 20).good();
        let hold = order("hold");
        sky.wait(20, gone_s, "all hold", |look| look.all(8, |it| it.order == "hold"));
        let step = sky.now().vehicles.iter().map(|it| it.step).max().unwrap() + 1;
        order(&format!("goto {step}"));
        sky.wait(20, gone_s, "all go on", |look| look.all(8, |it| it.step >= step && it.order.starts_with("goto")));
        say(&format!(
            "the operator's PC gone in flight: nothing changed in 5 s; from another one with its keys: {}",
            hold.out.trim()
        ));
    }

    /// Another release and a ninth vehicle, node by node while the others fly. Host 8 then has two agents and no X-Plane.
    pub(super) fn upgrade(&mut self, sky: Sky) -> Sky {
        let program = self.lab.operator().path("/opt/skein");
        fs::rename(other_release(&program), &program).unwrap();
        let ninth = HOSTS + 1;
        fleet::describe(&self.lab, ninth);
        self.fleet.add(&self.lab, ninth);
        self.cluster("keys", 30).good();

        let releases = |look: &Look| look.vehicles.iter().map(|it| it.release.clone()).collect::<Vec<_>>();
        let old = releases(&sky.now());
        let begun_s = now_s();
        let install = self.cluster("install", 240).good();
        let done = install.json();
        let restarted = rows(&done).iter().filter_map(|row| row["restart_s"].as_f64()).collect::<Vec<_>>();
        assert_eq!(restarted.len(), usize::from(HOSTS), "{install}");
        assert!(rows(&done)[..8].iter().all(|row| row["done"] == "upgraded"), "{install}");
        assert_eq!(rows(&done)[8]["done"], "installed", "{install}");
        for look in sky.since(begun_s) {
            let down: Vec<_> = look.vehicles.iter().filter(|it| it.height_m < OFF_M).map(|it| it.id).collect();
            assert!(down.len() <= 1, "one after the other: {down:?} were down");
        }
        let check = self.lab.skein("check -f lab/cluster.toml --json", 60);
        let simulator = format!("aircraft at {}", fleet::place(ninth));
        let checked = check.json();
        let is_heard = |line: &serde_json::Value| {
            line["place"] == format!("node {ninth}")
                && line["what"] == "X-Plane"
                && line["state"] == "good"
                && line["found"].as_str().is_some_and(|found| found.contains(&simulator))
        };
        assert!(checked.as_array().unwrap().iter().any(is_heard), "no {simulator} in {check}");
        self.cluster("up", 60).good();
        drop(sky);
        // Who is in the swarm now stands in other files.
        let sky = Sky::watch(&self.lab);
        let nine = |look: &Look| look.all(9, |it| it.is_active && it.height_m > ALOFT_M);
        sky.wait(60, 0.0, "nine fly", nine);
        assert!(releases(&sky.now()).iter().all(|release| !old.contains(release)), "{:?}", sky.now());
        let shared = self.lab.host(HOSTS);
        let of_host = [&["skein", "agent"][..], &["x-plane"]].map(|words| shared.processes(words).len());
        assert_eq!(of_host, [2, 0], "agents and X-Planes on {}", shared.name);
        for id in [HOSTS, ninth] {
            let of_pc = [&["x-plane"][..], &["skein"]].map(|words| self.lab.pc(id).processes(words).len());
            assert_eq!(of_pc, [1, 0], "X-Planes and agents on {}", self.lab.pc(id).name);
        }
        say(&format!(
            "another release and a ninth vehicle: all in {:.1} s, each lands, starts and is back within {:.1} s (the slowest), \
             one after the other while the rest fly on; then nine fly, two of them from one host over X-Planes on other PCs",
            install.took_s(),
            restarted.iter().copied().fold(0.0, f64::max)
        ));
        sky
    }

    /// From a node itself, with nothing but what it was given.
    pub(super) fn status_from_a_node(&self) {
        let script = "cd .skein/lab && releases/*/skein cluster status -f node-2/current/cluster.toml";
        let status = soon_good(|| self.lab.operator().sh(&format!("ssh heli2 '{script}'")));
        let lines = status.out.lines().filter(|line| line.contains("formation")).count();
        assert_eq!(lines, usize::from(HOSTS), "{status}");
        say(&format!("skein cluster status, on node 2 itself:\n{}", status.out));
    }

    /// Everything lands, and everything goes.
    pub(super) fn end(self, sky: &Sky) {
        let begun_s = now_s();
        let down = self.cluster("down", 90).good();
        let landed = sky.said_since(begun_s).iter().filter(|said| said.what == "landed").count();
        assert!(landed >= usize::from(HOSTS), "they land first: {:?}", sky.said_since(begun_s));
        let uninstall = self.cluster("uninstall", 60).good();
        for (host, before) in self.lab.hosts.iter().zip(&self.before) {
            assert_eq!(&host.files(), before, "{}", host.name);
            assert_eq!(host.processes(&["skein"]), Vec::<u32>::new(), "{}", host.name);
        }
        say(&format!(
            "down, all landed, {:.1} s; uninstalled in {:.1} s: no file and no process is left",
            down.took_s(),
            uninstall.took_s()
        ));
        assert!(self.off_s < OFF_WITHIN_S, "{:.2} s from nothing to all off the ground, copying aside", self.off_s);
    }

    /// Since then, these have been at their height whenever they were seen, and nobody has come near anybody.
    fn others_fly_on(&self, sky: &Sky, ids: &[u8], since_s: f64) {
        for look in sky.since(since_s) {
            assert!(look.least_m() > COLLISION_M, "{look:?}");
            for id in ids {
                let it = look.of(*id).unwrap();
                assert!(it.height_m > ALOFT_M, "vehicle {id} does not fly on: {it:?}");
            }
        }
        assert!(ids.iter().all(|id| sky.now().of(*id).is_some_and(|it| it.is_there && it.is_active)));
    }
}

/// A PC with other things to do may make a simulator falter for a moment, which a status tells too.
fn soon_good(status: impl Fn() -> Ran) -> Ran {
    for _ in 0..10 {
        let ran = status();
        if ran.status == Some(0) {
            return ran;
        }
        sleep(Duration::from_secs(1));
    }
    status().good()
}

/// The rows of a report.
pub(super) fn rows(report: &serde_json::Value) -> &[serde_json::Value] {
    report["nodes"].as_array().map_or(&[], Vec::as_slice)
}

fn others(but: u8) -> Vec<u8> {
    ALL.into_iter().filter(|id| *id != but).collect()
}
