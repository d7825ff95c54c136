//! Agents as on a cluster: a process each, each in a network namespace of its own, on two bridges that a cable joins. The
//! cable can be pulled: then nothing comes through any more, and nobody is told.
//!
//! Needs Linux, root and `ip` (iproute2). Without them these tests say so and pass, unless `SKEIN_NAMESPACES=required`.
#![cfg(target_os = "linux")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]
#![expect(clippy::unwrap_used, reason = "what a test cannot do has failed")]

mod network;
mod swarm;

use skein_common::math;
use std::io::{Write, stdout};
use std::thread::sleep;
use std::time::Duration;

use network::Side;
use skein_tests::namespaces::missing;
use swarm::{Line, Swarm};

/// How long a network is cut.
const CUT: Duration = Duration::from_secs(20);
/// A healed swarm is one again within this time, s.
const ONE_AGAIN_S: f64 = 3.0;
/// Those who stay go on within this time after they have noticed, s.
const GO_ON_S: f64 = 1.0;
/// Nearer than this two have collided, m.
const COLLISION_M: f64 = 2.0;

/// True where these tests can run.
fn can_run() -> bool {
    let Some(missing) = missing() else { return true };
    assert_ne!(std::env::var("SKEIN_NAMESPACES").as_deref(), Ok("required"), "{missing}");
    say(&format!("no test in network namespaces: {missing}"));
    false
}

/// To the real stdout, whatever the harness captures.
fn say(line: &str) {
    stdout().write_all(format!("{line}\n").as_bytes()).unwrap();
}

/// A ring of 40 m at 10 m; each step is the same place, so that it takes no flight but a dwell.
fn scenario(starts_ne_m: &[[f64; 2]], partition: &str) -> String {
    let step = "{ centre_ne_m = [0, 0] }, ".repeat(60);
    let start = |(nth, [north_m, east_m]): (usize, &[f64; 2])| {
        format!("[vehicle.{}]\nstart_ne_m = [{north_m}, {east_m}]\n", nth + 1)
    };
    format!(
        "[swarm]\nvehicles = {}\n[formation]\nradius_m = 40\ninner_width_m = 15\nouter_width_m = 15\naltitude_m = 10\n\
         [mission]\ndwell_s = 2\npartition = \"{partition}\"\nsteps = [{step}]\n{}",
        starts_ne_m.len(),
        starts_ne_m.iter().enumerate().map(start).collect::<String>()
    )
}

/// A place on the ring.
fn on_ring(deg: f64) -> [f64; 2] {
    let (east, north) = math::sin_cos(deg.to_radians());
    [40.0 * north, 40.0 * east]
}

/// The latest of when each of these first said this after `since_s`; `None` while somebody has not.
fn all_said(lines: &[Line], ids: &[u8], since_s: f64, what: &str) -> Option<f64> {
    let first = |id: &u8| {
        let its = lines.iter().filter(|line| line.id == *id && line.at_s >= since_s);
        its.filter(|line| line.what.starts_with(what)).map(|line| line.at_s).reduce(f64::min)
    };
    ids.iter().map(first).try_fold(since_s, |latest_s, at_s| Some(at_s?.max(latest_s)))
}

fn has_said(lines: &[Line], ids: &[u8], (from_s, to_s): (f64, f64), what: &str) -> bool {
    let within = |line: &&Line| (from_s..to_s).contains(&line.at_s);
    lines.iter().filter(within).any(|line| ids.contains(&line.id) && line.what.starts_with(what))
}

#[test]
fn the_rest_go_on_without_one_that_is_killed_at_a_barrier_and_it_catches_up_when_it_is_back() {
    if !can_run() {
        return;
    }
    // The fourth has a long way: the others wait for it.
    let far = [0.0, -95.0];
    let starts = [on_ring(0.0), on_ring(90.0), on_ring(180.0), far];
    let mut swarm = Swarm::start("barrier", &scenario(&starts, "continue"), &[Side::Left; 4]);
    let others = [1, 2, 3];
    let waiting_s = swarm.wait_for("reach step 0", |lines| all_said(lines, &others, 0.0, "reached step 0"));
    sleep(Duration::from_secs(1));
    assert!(!has_said(&swarm.lines(), &[1, 2, 3, 4], (0.0, f64::INFINITY), "goes on"), "nobody left the barrier");
    assert!(!has_said(&swarm.lines(), &[4], (0.0, f64::INFINITY), "reached"), "the fourth is on its way");

    let killed_s = swarm.kill(4);
    let lost_s = swarm.wait_for("lose it", |lines| all_said(lines, &others, killed_s, "lost vehicle 4"));
    let on_s = swarm.wait_for("go on", |lines| all_said(lines, &others, killed_s, "goes on to step 1"));
    let (detection_s, advance_s) = (lost_s - killed_s, on_s - killed_s);

    sleep(Duration::from_secs(3));
    let restarted_s = swarm.restart(4);
    let found_s = swarm.wait_for("hear it", |lines| all_said(lines, &others, restarted_s, "hears vehicle 4"));
    let active_s = swarm.wait_for("take part", |lines| all_said(lines, &[4], restarted_s, "takes part"));
    let steps = swarm.steps();
    assert!(steps.values().all(|step| step == &steps[&4]), "it is at the others' step: {steps:?}");
    let next = format!("goes on to step {}", steps[&4] + 1);
    let together_s = swarm.wait_for(&next, |lines| all_said(lines, &[1, 2, 3, 4], active_s, &next));
    let lines = swarm.lines();
    let reached_s = all_said(&lines, &[4], active_s, "reached").unwrap();
    let before_it = has_said(&lines, &others, (active_s, reached_s), "goes on");
    let separation_m = swarm.least_separation_m();
    say(&format!(
        "killed at a barrier ({:.1} s after the others reached it): lost after {detection_s:.3} s, the others go on after \
         {advance_s:.3} s; restarted: heard by all after {:.2} s, takes part after {:.2} s, at the others' step, and all \
         go on {:.2} s after it reached that; least separation {separation_m:.1} m",
        killed_s - waiting_s,
        found_s - restarted_s,
        active_s - restarted_s,
        together_s - reached_s,
    ));
    assert!(advance_s <= detection_s + GO_ON_S && !before_it && separation_m > COLLISION_M);
}

#[test]
fn two_halves_of_a_cut_swarm_go_on_and_are_one_again_when_it_is_healed() {
    if !can_run() {
        return;
    }
    // The fourth has a long way: its half comes to the next step later than the other.
    let starts = [on_ring(0.0), on_ring(90.0), on_ring(180.0), [0.0, -95.0]];
    let sides = [Side::Left, Side::Left, Side::Right, Side::Right];
    let (left, right, all) = ([1, 2], [3, 4], [1, 2, 3, 4]);
    let mut swarm = Swarm::start("halves", &scenario(&starts, "continue"), &sides);
    swarm.wait_for("reach step 0", |lines| all_said(lines, &[1, 2, 3], 0.0, "reached step 0"));

    let cut_s = swarm.cut(true);
    sleep(CUT);
    let healed_s = swarm.cut(false);
    let steps = swarm.steps();
    let lines = swarm.lines();
    for (half, other) in [(left, right), (right, left)] {
        assert!(all_said(&lines, &half, cut_s, "goes on").is_some(), "{half:?} go on by themselves");
        other.iter().for_each(|id| assert!(all_said(&lines, &half, cut_s, &format!("lost vehicle {id}")).is_some()));
        let within = half.map(|id| has_said(&lines, &half, (cut_s, healed_s), &format!("lost vehicle {id}")));
        assert_eq!(within, [false; 2], "a half is whole");
    }
    assert!(steps[&1].abs_diff(steps[&2]) <= 1 && steps[&3].abs_diff(steps[&4]) <= 1, "{steps:?}");
    assert_ne!(steps[&1], steps[&3], "the halves are at different steps");
    let detection_s = lines.iter().filter(|line| line.what.starts_with("lost")).map(|line| line.at_s - cut_s);
    let detection_s = detection_s.fold(0.0, f64::max);

    let one_s = swarm.wait_for("be one again", |lines| Swarm::one_again(lines, healed_s));
    let next = format!("goes on to step {}", swarm.steps()[&1] + 1);
    swarm.wait_for("go on together", |lines| all_said(lines, &all, healed_s, &next));
    let separation_m = swarm.least_separation_m();
    say(&format!(
        "cut in halves, both go on: the last lost after {detection_s:.2} s; at steps {steps:?} when healed; one again \
         after {:.2} s; least separation {separation_m:.1} m",
        one_s - healed_s
    ));
    let since: Vec<_> = swarm.lines().into_iter().filter(|line| line.at_s >= healed_s).collect();
    assert!(one_s - healed_s <= ONE_AGAIN_S, "healed at {healed_s:.3} s: {since:#?}");
    assert!(separation_m > COLLISION_M);
}

#[test]
fn under_a_quorum_only_the_larger_part_of_a_cut_swarm_goes_on() {
    if !can_run() {
        return;
    }
    let starts = [0.0, 144.0, 216.0, 72.0, 288.0].map(on_ring);
    let sides = [Side::Left, Side::Left, Side::Left, Side::Right, Side::Right];
    let (larger, smaller, all) = ([1, 2, 3], [4, 5], [1, 2, 3, 4, 5]);
    let mut swarm = Swarm::start("quorum", &scenario(&starts, "quorum"), &sides);
    swarm.wait_for("go on to step 1", |lines| all_said(lines, &all, 0.0, "goes on to step 1"));

    let cut_s = swarm.cut(true);
    let held_s = swarm.wait_for("hold", |lines| all_said(lines, &smaller, cut_s, "hears too few to go on"));
    sleep(CUT - Duration::from_secs_f64(held_s - cut_s));
    let healed_s = swarm.cut(false);
    let (lines, steps) = (swarm.lines(), swarm.steps());
    assert!(all_said(&lines, &larger, held_s, "goes on").is_some(), "the larger part goes on");
    let within = larger.map(|id| has_said(&lines, &larger, (cut_s, healed_s), &format!("lost vehicle {id}")));
    assert_eq!(within, [false; 3], "the larger part is whole");
    for moves in ["goes on", "reached", "carried"] {
        assert!(!has_said(&lines, &smaller, (held_s, healed_s), moves), "the smaller part waits");
    }

    let one_s = swarm.wait_for("be one again", |lines| Swarm::one_again(lines, healed_s));
    let separation_m = swarm.least_separation_m();
    say(&format!(
        "cut 3 to 2 under a quorum: the 2 hold after {:.2} s; at steps {steps:?} when healed; one again after {:.2} s; \
         least separation {separation_m:.1} m",
        held_s - cut_s,
        one_s - healed_s
    ));
    let since: Vec<_> = swarm.lines().into_iter().filter(|line| line.at_s >= healed_s).collect();
    assert!(one_s - healed_s <= ONE_AGAIN_S, "healed at {healed_s:.3} s: {since:#?}");
    assert!(separation_m > COLLISION_M);
}

#[test]
#[ignore = "the process that looks on for the other tests, in a namespace of its own"]
fn watcher() {
    swarm::watch();
}
