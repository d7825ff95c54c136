use skein_common::message::Failure;

use super::super::tests::{set, vehicle};
use super::*;

fn id(number: u8) -> VehicleId {
    VehicleId::new(number).unwrap()
}

fn links(links: &[(u8, u8)]) -> Vec<Link> {
    links.iter().map(|&(sender, receiver)| (id(sender), id(receiver))).collect()
}

/// Vehicle `number`, a member in contact with these vehicles.
fn member(number: u8, in_contact: &[u8]) -> VehicleNow {
    VehicleNow { in_contact: set(in_contact), ..vehicle(number, 0.0, 100.0, 30.0) }
}

fn dead(number: u8) -> VehicleNow {
    VehicleNow { runs: false, ..member(number, &[]) }
}

fn landed(number: u8, in_contact: &[u8]) -> VehicleNow {
    VehicleNow { membership: Membership::Left, ..member(number, in_contact) }
}

fn joining(number: u8, in_contact: &[u8]) -> VehicleNow {
    VehicleNow { membership: Membership::Joining, ..member(number, in_contact) }
}

/// Three members, each in contact with the others.
fn three() -> Detection {
    let mut detection = Detection::new(3, None);
    detection.observe(0.0, &[member(1, &[2, 3]), member(2, &[1, 3]), member(3, &[1, 2])]);
    detection
}

fn figures(detection: &Detection, t_s: f64) -> (Worst, Worst) {
    (detection.detection(t_s), detection.rejoin(t_s))
}

#[track_caller]
fn assert_took(worst: Worst, expected_s: f64) {
    assert!(worst.s().is_some_and(|took_s| (took_s - expected_s).abs() < 1e-9), "{worst:?}, expected {expected_s} s");
}

#[test]
fn a_death_is_detected_when_the_last_peer_has_lost_the_vehicle() {
    let mut detection = three();
    detection.died(10.0, id(2));
    detection.observe(10.0, &[member(1, &[2, 3]), dead(2), member(3, &[1, 2])]);
    detection.observe(10.5, &[member(1, &[3]), dead(2), member(3, &[1, 2])]);
    assert_eq!(detection.detection(10.5).s(), None);
    detection.observe(11.25, &[member(1, &[3]), dead(2), member(3, &[1])]);
    assert_took(detection.detection(11.25), 1.25);
    assert_eq!(detection.members, set(&[1, 3]));
}

#[test]
fn a_death_that_is_not_detected_in_time_counts_as_never() {
    let mut detection = three();
    detection.died(10.0, id(2));
    detection.observe(10.0, &[member(1, &[3]), dead(2), member(3, &[1, 2])]);
    let (early, late) = (detection.detection(40.0), detection.detection(40.1));
    assert_eq!((early.s(), early.is_never, late.s(), late.is_never), (None, false, None, true));
}

#[test]
fn a_restarted_agent_has_rejoined_when_all_members_count_it_as_active() {
    let mut detection = three();
    detection.died(10.0, id(2));
    detection.observe(10.1, &[member(1, &[3]), dead(2), member(3, &[1])]);
    detection.restarted(30.0, id(2));
    detection.observe(30.0, &[member(1, &[3]), joining(2, &[]), member(3, &[1])]);
    detection.observe(31.0, &[member(1, &[2, 3]), joining(2, &[1, 3]), member(3, &[1, 2])]);
    assert_eq!(detection.rejoin(31.0).s(), None, "in contact with all, but not an active member yet");
    detection.observe(32.5, &[member(1, &[2, 3]), member(2, &[1, 3]), member(3, &[1, 2])]);
    let (detection, rejoin) = figures(&detection, 32.5);
    assert_took(detection, 0.1);
    assert_took(rejoin, 2.5);
}

#[test]
fn a_restart_before_the_death_was_detected_leaves_nothing_to_detect() {
    let mut detection = three();
    detection.died(10.0, id(2));
    detection.observe(10.0, &[member(1, &[2, 3]), dead(2), member(3, &[1, 2])]);
    detection.restarted(10.2, id(2));
    detection.observe(12.4, &[member(1, &[2, 3]), member(2, &[1, 3]), member(3, &[1, 2])]);
    let (detection, rejoin) = figures(&detection, 60.0);
    assert_eq!((detection.s(), detection.is_never), (None, false));
    assert_took(rejoin, 2.2);
}

#[test]
fn a_cut_is_detected_by_its_receivers_and_over_when_they_receive_again() {
    let mut detection = three();
    // 3 does not receive 1 and 2; they receive it.
    let cut = links(&[(1, 3), (2, 3)]);
    detection.cut(20.0, &cut);
    assert!(detection.is_split());
    detection.observe(21.0, &[member(1, &[2, 3]), member(2, &[1, 3]), member(3, &[1])]);
    detection.observe(22.0, &[member(1, &[2, 3]), member(2, &[1, 3]), member(3, &[])]);
    assert_took(detection.detection(22.0), 2.0);
    detection.healed(40.0, &cut);
    assert!(!detection.is_split());
    detection.observe(40.0, &[member(1, &[2, 3]), member(2, &[1, 3]), member(3, &[])]);
    detection.observe(40.5, &[member(1, &[2, 3]), member(2, &[1, 3]), member(3, &[1])]);
    detection.observe(41.0, &[member(1, &[2, 3]), member(2, &[1, 3]), member(3, &[1, 2])]);
    assert_took(detection.rejoin(41.0), 1.0);
}

#[test]
fn a_cut_that_is_healed_undetected_is_neither_detected_nor_rejoined() {
    let mut detection = three();
    let cut = links(&[(1, 3)]);
    detection.cut(20.0, &cut);
    detection.observe(20.0, &[member(1, &[2, 3]), member(2, &[1, 3]), member(3, &[1, 2])]);
    detection.healed(20.5, &cut);
    detection.observe(20.5, &[member(1, &[2, 3]), member(2, &[1, 3]), member(3, &[1, 2])]);
    let (detection, rejoin) = figures(&detection, 100.0);
    assert_eq!((detection.s(), detection.is_never, rejoin.s(), rejoin.is_never), (None, false, None, false));
}

#[test]
fn a_receiver_that_is_cut_off_does_not_have_to_detect_a_return() {
    let mut detection = three();
    detection.cut(5.0, &links(&[(2, 3), (3, 2)]));
    detection.died(10.0, id(2));
    detection.restarted(30.0, id(2));
    detection.observe(32.0, &[member(1, &[2, 3]), member(2, &[1]), member(3, &[1])]);
    assert_took(detection.rejoin(32.0), 2.0);
}

#[test]
fn losing_a_living_peer_that_can_be_received_is_a_false_suspicion() {
    let all_members = [member(1, &[2, 3]), member(2, &[1, 3]), member(3, &[1, 2])];
    let lost_by = |detection: &mut Detection, t_s, lost, by| {
        detection.reported(t_s, id(by), &EventKind::PeerLost(id(lost)));
        detection.observe(t_s, &all_members);
        detection.false_suspicions
    };
    let mut detection = three();
    assert_eq!(lost_by(&mut detection, 1.0, 2, 1), 1);
    detection.cut(2.0, &links(&[(2, 1)]));
    assert_eq!(lost_by(&mut detection, 2.5, 2, 1), 1, "vehicle 1 cannot receive it");
    assert_eq!(lost_by(&mut detection, 2.5, 1, 2), 1, "the session is cut in one direction");
    assert_eq!(lost_by(&mut detection, 2.5, 3, 2), 2, "another link");
    detection.healed(3.0, &links(&[(2, 1)]));
    assert_eq!(lost_by(&mut detection, 4.9, 2, 1), 2, "healed just now");
    assert_eq!(lost_by(&mut detection, 5.1, 2, 1), 3);
}

#[test]
fn a_loss_beyond_the_distance_where_messages_get_lost_is_not_a_false_suspicion() {
    for (reach_m, expected) in [(None, 1), (Some(250.0), 1), (Some(150.0), 0)] {
        let mut detection = Detection::new(2, reach_m);
        let all_members = [vehicle(1, 0.0, 100.0, 30.0), vehicle(2, 180.0, 100.0, 30.0)];
        detection.observe(0.0, &all_members);
        detection.reported(9.0, id(1), &EventKind::PeerLost(id(2)));
        detection.observe(9.0, &all_members);
        assert_eq!(detection.false_suspicions, expected, "200 m apart, {reach_m:?}");
    }
}

#[test]
fn the_loss_of_a_dead_restarted_or_landed_vehicle_is_right() {
    let mut detection = three();
    // In a live run the reports of other vehicles may arrive before the death itself.
    detection.reported(1.0, id(1), &EventKind::PeerLost(id(2)));
    detection.died(1.0, id(2));
    detection.observe(1.0, &[member(1, &[3]), dead(2), member(3, &[1])]);
    detection.restarted(3.0, id(2));
    detection.reported(4.0, id(3), &EventKind::PeerLost(id(2)));
    detection.observe(4.0, &[member(1, &[2, 3]), member(2, &[1, 3]), member(3, &[1])]);
    // Vehicle 1 has landed.
    detection.observe(9.0, &[landed(1, &[2, 3]), member(2, &[1, 3]), member(3, &[1, 2])]);
    detection.reported(10.0, id(3), &EventKind::PeerLost(id(1)));
    detection.observe(10.0, &[landed(1, &[2, 3]), member(2, &[1, 3]), member(3, &[2])]);
    assert_eq!(detection.false_suspicions, 0);
}

#[test]
fn the_response_to_a_failure_is_the_report_of_its_own_vehicle() {
    let mut detection = three();
    detection.failed(50.0, id(2));
    detection.reported(50.5, id(1), &EventKind::OwnDataStale);
    assert_eq!(detection.response(50.5).s(), None, "another vehicle's report");
    detection.reported(51.5, id(2), &EventKind::Failed(Failure::Engine));
    detection.reported(70.0, id(2), &EventKind::OwnDataStale);
    assert_took(detection.response(70.0), 1.5);
    detection.failed(80.0, id(3));
    assert!(!detection.response(110.0).is_never && detection.response(110.1).is_never);
}

#[test]
fn a_restarted_agent_that_leaves_before_it_is_a_member_has_not_failed_to_rejoin() {
    let mut detection = three();
    detection.died(10.0, id(2));
    detection.observe(12.0, &[member(1, &[3]), dead(2), member(3, &[1])]);
    detection.restarted(30.0, id(2));
    detection.observe(31.0, &[member(1, &[2, 3]), joining(2, &[1, 3]), member(3, &[1, 2])]);
    detection.observe(55.0, &[member(1, &[2, 3]), landed(2, &[1, 3]), member(3, &[1, 2])]);
    let (_, rejoin) = figures(&detection, 100.0);
    assert_eq!((rejoin.s(), rejoin.is_never), (None, false));
}
