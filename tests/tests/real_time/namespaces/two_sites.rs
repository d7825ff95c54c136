//! The flight of a fleet at two sites that Zenoh routers join, and what was measured of it.

use std::collections::{BTreeMap, BTreeSet};
use std::thread::sleep;
use std::time::{Duration, Instant};

use super::sites::{Lines, MEMBERS, Site, Sites};
use super::{COLLISION_M, print_line};

/// Timeout of every wait.
const SOON: Duration = Duration::from_secs(120);
/// Duration of each measurement.
const MEASURED: Duration = Duration::from_secs(10);
/// Time from the departure of the two teams until they have passed each other.
const CROSSING: Duration = Duration::from_secs(30);
/// How long the joint is cut, and how long a router is gone.
const GONE: Duration = Duration::from_secs(10);
/// A vehicle below this height is not in the air, m.
const AIRBORNE_M: f64 = 2.0;
/// Place of each team, north and east, m.
const PLACES: [[f64; 2]; 4] = [[0.0, 0.0], [100.0, 0.0], [0.0, 100.0], [100.0, 100.0]];

/// Four teams of four, close together: team 1 of site a and team 3 of site b change places.
const SCENARIO: &str = r#"
name = "sites"
[fleet]
teams = 4
pattern = "list"
places_ne_m = [[0, 0], [100, 0], [0, 100], [100, 100]]
[swarm]
name = "two-sites"
vehicles = 4
[formation]
radius_m = 20
inner_width_m = 10
outer_width_m = 10
altitude_m = 10
[start]
square_m = 60
[[team]]
ids = [1, 2, 3, 4]
mission.steps = [{ centre_ne_m = [0, 0], dwell_s = 3 }]
[[team]]
ids = [1]
mission.steps = [{ centre_ne_m = [0, 0], dwell_s = 3 }, { centre_ne_m = [0, 100] }]
[[team]]
ids = [3]
mission.steps = [{ centre_ne_m = [0, 0], dwell_s = 3 }, { centre_ne_m = [0, -100] }]
"#;

/// The fields of the lines that begin with `kind` and arrived in this time.
fn words(lines: &Lines, kind: &str, from: Instant, to: Instant) -> Vec<(Instant, Vec<String>)> {
    let lines = lines.lock().unwrap();
    let within = lines.iter().filter(|(at, line)| (from..to).contains(at) && line.starts_with(kind));
    within.map(|(at, line)| (*at, line.split(' ').skip(1).map(str::to_owned).collect())).collect()
}

fn is_of(vehicle: &str, site: Site) -> bool {
    site.teams().iter().any(|team| vehicle.starts_with(&format!("{team}/")))
}

/// The states of vehicles of this site that a listener received, with their times of arrival.
fn states_of(lines: &Lines, site: Site, from: Instant, to: Instant) -> Vec<(Instant, Vec<String>)> {
    let mut states = words(lines, "state ", from, to);
    states.retain(|(_, words)| is_of(&words[0], site));
    states
}

fn wait_for<T>(what: &str, found: impl Fn() -> Option<T>) -> T {
    let until = Instant::now() + SOON;
    loop {
        if let Some(found) = found() {
            return found;
        }
        assert!(Instant::now() < until, "timeout: {what}");
        sleep(Duration::from_millis(20));
    }
}

/// Waits for the first state of a vehicle of this site after `since`; returns the time until then, s.
fn until_received(lines: &Lines, site: Site, since: Instant) -> f64 {
    let first = || states_of(lines, site, since, Instant::now()).first().map(|(at, _)| *at);
    wait_for(&format!("states of site {site:?}"), first).duration_since(since).as_secs_f64()
}

/// Median and 99th percentile of the delays of the clock, ms.
fn latency_ms(lines: &Lines, from: Instant, to: Instant) -> [f64; 2] {
    let mut delays: Vec<f64> =
        words(lines, "clock ", from, to).iter().map(|(_, words)| words[0].parse::<f64>().unwrap() / 1000.0).collect();
    delays.sort_by(f64::total_cmp);
    assert!(delays.len() > 100, "{} times of the clock", delays.len());
    [0.5, 0.99].map(|share| delays[((delays.len() - 1) as f64 * share) as usize])
}

/// What agents of a site have received from one health report to another: messages a second of one agent, the refused, and
/// the links, as means over the agents.
fn received(lines: &Lines, from: Instant, to: Instant) -> [f64; 3] {
    let mut of_vehicle: BTreeMap<String, Vec<(Instant, Vec<f64>)>> = BTreeMap::new();
    for (at, words) in words(lines, "health ", from, to) {
        let numbers = words[1..].iter().map(|word| word.parse().unwrap()).collect();
        of_vehicle.entry(words[0].clone()).or_default().push((at, numbers));
    }
    let mut sum = [0.0; 3];
    for reports in of_vehicle.values() {
        let ((begin, first), (end, last)) = (&reports[0], reports.last().unwrap());
        let seconds = end.duration_since(*begin).as_secs_f64();
        let values = [(last[1] - first[1]) / seconds, (last[3] - first[3]) / seconds, last[0]];
        sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
    }
    sum.map(|sum| sum / of_vehicle.len() as f64)
}

/// The least distance of two vehicles of different sites in the air, m: places at most 0.15 s apart.
fn least_across_m(one: &Lines, other: &Lines) -> f64 {
    let now = Instant::now();
    let places = |lines: &Lines| -> Vec<(Instant, [f64; 3])> {
        let place = |(at, words): (Instant, Vec<String>)| {
            let team: usize = words[0].split('/').next()?.parse().ok()?;
            let number = |nth: usize| words[nth].parse::<f64>().ok();
            let ([north, east], down) = (PLACES[team - 1], number(3)?);
            (-down > AIRBORNE_M).then_some((at, [number(1)? + north, number(2)? + east, down]))
        };
        words(lines, "place ", now - Duration::from_secs(3600), now).into_iter().filter_map(place).collect()
    };
    let (one, other) = (places(one), places(other));
    let (mut least_m, mut begin) = (f64::INFINITY, 0);
    let window = Duration::from_millis(150);
    for (at, place) in &one {
        while begin < other.len() && other[begin].0 + window < *at {
            begin += 1;
        }
        for (_, stranger) in other[begin..].iter().take_while(|(its, _)| *its < *at + window) {
            let apart_m: f64 = place.iter().zip(stranger).map(|(one, other)| (one - other).powi(2)).sum();
            least_m = least_m.min(apart_m.sqrt());
        }
    }
    least_m
}

/// Lines of a site's logs about lost peers.
fn losses(sites: &Sites, site: Site) -> usize {
    sites.logs(site).iter().filter(|line| line.contains("lost contact")).count()
}

fn all_active(sites: &Sites) -> Option<()> {
    let active = |site: Site| sites.logs(site).iter().filter(|line| line.contains("active")).count();
    Site::BOTH.into_iter().all(|site| active(site) >= 2 * usize::from(MEMBERS)).then_some(())
}

/// Flies the fleet, disturbs the joint, and prints a table of what was measured.
pub(super) fn fly() {
    let mut sites = Sites::new(SCENARIO);
    let mut table = String::new();
    sites.start_relay(Duration::ZERO);
    Site::BOTH.into_iter().for_each(|site| sites.start_router(site));
    sites.start_agents();
    let listens = sites.start_listener(Site::A, false);
    let observes = Site::BOTH.map(|site| sites.start_listener(site, true));
    sites.start_clock(Site::B);
    let logs = || Site::BOTH.map(|site| sites.logs(site));
    let until = Instant::now() + SOON;
    while all_active(&sites).is_none() {
        assert!(Instant::now() < until, "not all vehicles are active: {:#?}", logs());
        sleep(Duration::from_millis(20));
    }
    let row = |table: &mut String, name: &str, value: String| {
        let line = format!("{name:<64}{value:>16}");
        print_line(&line);
        *table += &(line + "\n");
    };

    // Team 1 and team 3 change places; they are at different sites.
    let begin = Instant::now();
    let are_on_the_way = |lines: &Lines, team: &str| {
        let places = words(lines, "place ", begin, Instant::now());
        let moving = places.iter().filter(|(_, words)| words[0].starts_with(team) && words[4] == "1");
        moving.map(|(_, words)| &words[0]).collect::<BTreeSet<_>>().len() == usize::from(MEMBERS)
    };
    wait_for("teams 1 and 3 set out", || {
        (are_on_the_way(&observes[0], "1/") && are_on_the_way(&observes[1], "3/")).then_some(())
    });
    sleep(CROSSING);
    let least_m = least_across_m(&observes[0], &observes[1]);
    row(&mut table, "two teams of the two sites change places, least separation", format!("{least_m:.1} m"));

    // Everything is quiet: rates, traffic, latency.
    let measure = |sites: &Sites| {
        let (from, joint, router_s) = (Instant::now(), sites.at_joint(), sites.processor_s("router a"));
        sleep(MEASURED);
        let (to, seconds) = (Instant::now(), MEASURED.as_secs_f64());
        let bytes =
            sites.at_joint().iter().zip(joint).map(|(after, before)| (after - before) as f64).collect::<Vec<_>>();
        let cores = (sites.processor_s("router a") - router_s) / seconds;
        (from, to, bytes.iter().map(|bytes| bytes / seconds).collect::<Vec<_>>(), cores)
    };
    let (from, to, joint, cores) = measure(&sites);
    let [messages, refused, links] = received(&observes[0], from, to);
    let at_listener = |site: Site| states_of(&listens, site, from, to).len() as f64 / MEASURED.as_secs_f64();
    row(&mut table, "an agent of site a receives, messages/s [refused]", format!("{messages:.1} [{refused:.1}]"));
    row(&mut table, "  its links", format!("{links:.0}"));
    row(&mut table, "states of site b at router a, of eight vehicles, 1/s", format!("{:.1}", at_listener(Site::B)));
    row(
        &mut table,
        "states of site a relayed by router a to its own site, 1/s",
        format!("{:.1}", at_listener(Site::A)),
    );
    row(&mut table, "over the joint, kB/s in and out", format!("{:.1} {:.1}", joint[0] / 1e3, joint[1] / 1e3));
    row(&mut table, "  packets/s in and out", format!("{:.0} {:.0}", joint[2], joint[3]));
    row(&mut table, "router a, cores", format!("{cores:.3}"));
    let [median, p99] = latency_ms(&listens, from, to);
    row(&mut table, "through both routers, median and p99", format!("{median:.2} {p99:.2} ms"));
    let before = Site::BOTH.map(|site| losses(&sites, site));

    // The joint is cut.
    sites.cut(true);
    let cut = Instant::now();
    sleep(GONE);
    let (from, to) = (cut + GONE / 2, Instant::now());
    let [alone, ..] = received(&observes[0], from, to);
    let strangers = states_of(&listens, Site::B, from, to).len();
    sites.cut(false);
    let again_s = until_received(&listens, Site::B, Instant::now());
    row(&mut table, "joint cut: an agent of site a receives, messages/s", format!("{alone:.1}"));
    row(&mut table, "  states of site b in the second half of 10 s", strangers.to_string());
    row(&mut table, "  after the cut, until a state of site b arrives", format!("{again_s:.2} s"));
    sleep(Duration::from_secs(5));

    // A router is killed, and started again.
    sites.kill("router b");
    sleep(GONE);
    sites.start_router(Site::B);
    let again_s = until_received(&listens, Site::B, Instant::now());
    row(&mut table, "router b killed for 10 s: from its start until a state arrives", format!("{again_s:.2} s"));
    sleep(Duration::from_secs(5));

    // A slow joint that loses packets.
    for (delay_ms, percent) in [(20, 0), (20, 2)] {
        sites.kill("relay");
        if percent > 0 {
            sites.lose(percent);
        }
        sites.start_relay(Duration::from_millis(delay_ms));
        until_received(&listens, Site::B, Instant::now());
        sleep(Duration::from_secs(5));
        let (from, to, ..) = measure(&sites);
        let [median, p99] = latency_ms(&listens, from, to);
        let rate = states_of(&listens, Site::B, from, to).len() as f64 / MEASURED.as_secs_f64();
        let name = format!("joint of {delay_ms} ms that loses {percent} %: median and p99");
        row(&mut table, &name, format!("{median:.2} {p99:.2} ms"));
        row(&mut table, "  states of site b at router a, 1/s", format!("{rate:.1}"));
    }
    let after = Site::BOTH.map(|site| losses(&sites, site));
    let lost = after[0] + after[1] - before[0] - before[1];
    row(&mut table, "peers lost within the sites meanwhile", lost.to_string());
    let least_m = least_across_m(&observes[0], &observes[1]);
    assert!(least_m > COLLISION_M, "{table}");
    assert!(messages > 1.5 * alone && strangers == 0 && lost == 0, "{table}");
}
