//! Agents as on a cluster: one process each, in its own network namespace, on two bridges that a cable connects. The
//! test can disconnect the cable: then no packet passes, and neither end notices.
//!
//! Needs Linux, root and `ip` (iproute2). Without them these tests print a message and pass, unless
//! `SKEIN_NAMESPACES=required`.

mod cards;
mod network;
mod sites;
mod swarm;
mod two_sites;

use skein_common::math;
use std::io::{Write, stdout};
use std::thread::sleep;
use std::time::Duration;

use network::Side;
use skein_tests::namespaces::missing;
use skein_tests::share::Share;
use swarm::{Line, Swarm};

/// Duration of a network cut.
const CUT: Duration = Duration::from_secs(30);
/// Limit for the time from the end of a cut until the swarm is one again, s.
const REJOIN_LIMIT_S: f64 = 3.0;
/// Limit for the time from the loss of a vehicle until the others continue, s.
const CONTINUE_LIMIT_S: f64 = 1.0;
/// Two vehicles closer than this have collided, m.
const COLLISION_M: f64 = 2.0;

/// Whether these tests can run here.
fn can_run() -> bool {
    let Some(missing) = missing() else { return true };
    refuse(&format!("tests in network namespaces skipped: {missing}"));
    false
}

/// Prints which tests cannot run, and why; fails if they are required.
pub(super) fn refuse(skipped: &str) {
    assert_ne!(std::env::var("SKEIN_NAMESPACES").as_deref(), Ok("required"), "{skipped}");
    print_line(skipped);
}

/// Prints a line to the real stdout, which the test harness does not capture.
pub(super) fn print_line(line: &str) {
    stdout().write_all(format!("{line}\n").as_bytes()).unwrap();
}

/// A ring of 40 m at 10 m height. All steps have the same place, so that each takes only its dwell time.
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

/// Time at which the last of these vehicles reported this event, s; `None` unless all have reported it since `since_s`.
fn all_reported(lines: &[Line], ids: &[u8], since_s: f64, what: &str) -> Option<f64> {
    let first = |id: &u8| {
        let its = lines.iter().filter(|line| line.id == *id && line.at_s >= since_s);
        its.filter(|line| line.what.starts_with(what)).map(|line| line.at_s).reduce(f64::min)
    };
    ids.iter().map(first).try_fold(since_s, |latest_s, at_s| Some(at_s?.max(latest_s)))
}

fn any_reported(lines: &[Line], ids: &[u8], (from_s, to_s): (f64, f64), what: &str) -> bool {
    let within = |line: &&Line| (from_s..to_s).contains(&line.at_s);
    lines.iter().filter(within).any(|line| ids.contains(&line.id) && line.what.starts_with(what))
}

#[test]
fn the_swarm_continues_without_a_killed_agent_which_catches_up_after_its_restart() {
    if !can_run() {
        return;
    }
    let _share = Share::of(50);
    // The fourth vehicle starts far away: the others wait for it.
    let far = [0.0, -95.0];
    let starts = [on_ring(0.0), on_ring(90.0), on_ring(180.0), far];
    let mut swarm = Swarm::start("barrier", &scenario(&starts, "continue"), &[Side::Left; 4]);
    let others = [1, 2, 3];
    let waiting_s = swarm.wait_for("reach step 0", |lines| all_reported(lines, &others, 0.0, "reached step 0"));
    sleep(Duration::from_secs(1));
    assert!(
        !any_reported(&swarm.lines(), &[1, 2, 3, 4], (0.0, f64::INFINITY), "continues"),
        "no vehicle left the barrier"
    );
    assert!(!any_reported(&swarm.lines(), &[4], (0.0, f64::INFINITY), "reached"), "the fourth has not arrived");

    let killed_s = swarm.kill(4);
    let lost_s =
        swarm.wait_for("lose contact", |lines| all_reported(lines, &others, killed_s, "lost contact with vehicle 4"));
    let on_s = swarm.wait_for("continue", |lines| all_reported(lines, &others, killed_s, "continues to step 1"));
    let (detection_s, advance_s) = (lost_s - killed_s, on_s - killed_s);

    sleep(Duration::from_secs(3));
    let restarted_s = swarm.restart(4);
    let found_s = swarm.wait_for("be in contact again", |lines| {
        all_reported(lines, &others, restarted_s, "in contact with vehicle 4")
    });
    let active_s = swarm.wait_for("be active", |lines| all_reported(lines, &[4], restarted_s, "active"));
    let steps = swarm.steps();
    assert!(steps.values().all(|step| step == &steps[&4]), "the vehicle is at the others' step: {steps:?}");
    let next = format!("continues to step {}", steps[&4] + 1);
    let together_s = swarm.wait_for(&next, |lines| all_reported(lines, &[1, 2, 3, 4], active_s, &next));
    let lines = swarm.lines();
    let reached_s = all_reported(&lines, &[4], active_s, "reached").unwrap();
    let before_it = any_reported(&lines, &others, (active_s, reached_s), "continues");
    let separation_m = swarm.least_separation_m();
    print_line(&format!(
        "killed at a barrier ({:.1} s after the others reached it): lost after {detection_s:.3} s, the others continue after \
         {advance_s:.3} s; restarted: in contact with all after {:.2} s, active after {:.2} s, at the others' step, and all \
         continue {:.2} s after it reached that; least separation {separation_m:.1} m",
        killed_s - waiting_s,
        found_s - restarted_s,
        active_s - restarted_s,
        together_s - reached_s,
    ));
    assert!(advance_s <= detection_s + CONTINUE_LIMIT_S && !before_it && separation_m > COLLISION_M);
}

#[test]
fn two_partitions_of_a_cut_swarm_continue_and_rejoin_after_the_cut() {
    if !can_run() {
        return;
    }
    let _share = Share::of(50);
    // The fourth vehicle starts far away: its partition reaches the next step later than the other.
    let starts = [on_ring(0.0), on_ring(90.0), on_ring(180.0), [0.0, -95.0]];
    let sides = [Side::Left, Side::Left, Side::Right, Side::Right];
    let (left, right, all) = ([1, 2], [3, 4], [1, 2, 3, 4]);
    let mut swarm = Swarm::start("halves", &scenario(&starts, "continue"), &sides);
    swarm.wait_for("reach step 0", |lines| all_reported(lines, &[1, 2, 3], 0.0, "reached step 0"));

    let cut_s = swarm.cut(true);
    sleep(CUT);
    let healed_s = swarm.cut(false);
    let steps = swarm.steps();
    let lines = swarm.lines();
    for (partition, other) in [(left, right), (right, left)] {
        assert!(all_reported(&lines, &partition, cut_s, "continues").is_some(), "{partition:?} continue");
        other.iter().for_each(|id| {
            assert!(all_reported(&lines, &partition, cut_s, &format!("lost contact with vehicle {id}")).is_some())
        });
        let within = partition
            .map(|id| any_reported(&lines, &partition, (cut_s, healed_s), &format!("lost contact with vehicle {id}")));
        assert_eq!(within, [false; 2], "no vehicle loses a peer of its own partition");
    }
    assert!(steps[&1].abs_diff(steps[&2]) <= 1 && steps[&3].abs_diff(steps[&4]) <= 1, "{steps:?}");
    assert_ne!(steps[&1], steps[&3], "the partitions are at different steps");
    let detection_s = lines.iter().filter(|line| line.what.starts_with("lost")).map(|line| line.at_s - cut_s);
    let detection_s = detection_s.fold(0.0, f64::max);

    let one_s = swarm.wait_for("rejoin", |lines| Swarm::rejoined_s(lines, healed_s));
    let next = format!("continues to step {}", swarm.steps()[&1] + 1);
    swarm.wait_for("continue together", |lines| all_reported(lines, &all, healed_s, &next));
    let separation_m = swarm.least_separation_m();
    print_line(&format!(
        "cut into two partitions, both continue: the last lost after {detection_s:.2} s; at steps {steps:?} at the end of the cut; rejoined \
         after {:.2} s; least separation {separation_m:.1} m",
        one_s - healed_s
    ));
    let since: Vec<_> = swarm.lines().into_iter().filter(|line| line.at_s >= healed_s).collect();
    assert!(one_s - healed_s <= REJOIN_LIMIT_S, "cut ended at {healed_s:.3} s: {since:#?}");
    assert!(separation_m > COLLISION_M);
}

#[test]
fn under_a_quorum_only_the_larger_partition_of_a_cut_swarm_continues() {
    if !can_run() {
        return;
    }
    let _share = Share::of(50);
    let starts = [0.0, 144.0, 216.0, 72.0, 288.0].map(on_ring);
    let sides = [Side::Left, Side::Left, Side::Left, Side::Right, Side::Right];
    let (larger, smaller, all) = ([1, 2, 3], [4, 5], [1, 2, 3, 4, 5]);
    let mut swarm = Swarm::start("quorum", &scenario(&starts, "quorum"), &sides);
    swarm.wait_for("continue to step 1", |lines| all_reported(lines, &all, 0.0, "continues to step 1"));

    let cut_s = swarm.cut(true);
    let held_s = swarm.wait_for("hold", |lines| all_reported(lines, &smaller, cut_s, "no quorum in contact"));
    sleep(CUT - Duration::from_secs_f64(held_s - cut_s));
    let healed_s = swarm.cut(false);
    let (lines, steps) = (swarm.lines(), swarm.steps());
    assert!(all_reported(&lines, &larger, held_s, "continues").is_some(), "the larger partition continues");
    let within =
        larger.map(|id| any_reported(&lines, &larger, (cut_s, healed_s), &format!("lost contact with vehicle {id}")));
    assert_eq!(within, [false; 3], "no vehicle loses a peer of the larger partition");
    for moves in ["continues", "reached", "skips"] {
        assert!(!any_reported(&lines, &smaller, (held_s, healed_s), moves), "the smaller partition waits");
    }

    let one_s = swarm.wait_for("rejoin", |lines| Swarm::rejoined_s(lines, healed_s));
    let separation_m = swarm.least_separation_m();
    print_line(&format!(
        "cut 3 to 2 under a quorum: the 2 hold after {:.2} s; at steps {steps:?} at the end of the cut; rejoined after {:.2} s; \
         least separation {separation_m:.1} m",
        held_s - cut_s,
        one_s - healed_s
    ));
    let since: Vec<_> = swarm.lines().into_iter().filter(|line| line.at_s >= healed_s).collect();
    assert!(one_s - healed_s <= REJOIN_LIMIT_S, "cut ended at {healed_s:.3} s: {since:#?}");
    assert!(separation_m > COLLISION_M);
}

#[test]
#[ignore = "a process that the other tests start, in its own namespace"]
fn watcher() {
    swarm::watch();
}

#[test]
#[ignore = "takes two minutes: `.ci/long`"]
fn two_sites_joined_by_routers() {
    if can_run() {
        two_sites::fly();
    }
}

#[test]
#[ignore = "a process that the test of two sites starts, in its own namespace"]
fn site_process() {
    sites::process();
}
