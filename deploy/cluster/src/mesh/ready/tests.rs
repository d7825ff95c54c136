use skein_common::message::{Header, Heartbeat};
use skein_common::time::SenderStamp;

use skein_common::id::{VehicleId, VehicleSet};

use super::*;

fn id() -> VehicleId {
    VehicleId::new(3).unwrap()
}

fn view(membership: Membership, run: u64, life: u64) -> VehicleView {
    let header = Header { sender: id(), incarnation: Incarnation(life), sequence: 1, stamp: SenderStamp::ZERO };
    let mission = Heartbeat {
        header,
        plan: 0,
        membership,
        step: 0,
        vouched: 0,
        reached: None,
        progress_m: 0.0,
        order: None,
        orders: 0,
        echo: None,
        lost: VehicleSet::default(),
    };
    VehicleView { alive: true, mission: Some(mission), run: Some(run), ..VehicleView::default() }
}

#[test]
fn a_vehicle_that_is_not_ready_is_listed_with_the_reason() {
    let why = |view: &VehicleView, after| lacks(Some(view), 7, after).unwrap();
    assert_eq!(lacks(None, 7, None).unwrap(), "not in contact");
    let gone = VehicleView { alive: false, ..view(Membership::Active, 7, 1) };
    assert_eq!(why(&gone, None), "not in contact");
    let silent = VehicleView { alive: true, ..VehicleView::default() };
    assert_eq!(why(&silent, None), "in contact, but sends no heartbeats");
    assert_eq!(
        why(&view(Membership::Active, 8, 1), None),
        "flies in another run of the swarm; run `skein cluster down` first"
    );
    assert!(why(&view(Membership::Joining, 7, 1), None).starts_with("still joining"));
    assert_eq!(why(&view(Membership::Left, 7, 1), None), "has landed and cannot be recalled");
    // Only its health report is missing.
    assert_eq!(why(&view(Membership::Active, 7, 1), None), "sends no health reports");
}

#[test]
fn messages_from_before_a_restart_are_ignored() {
    let before = Some(Incarnation(5));
    assert_eq!(lacks(Some(&view(Membership::Active, 7, 5)), 7, before).unwrap(), "not restarted yet");
    assert_eq!(lacks(Some(&view(Membership::Active, 7, 6)), 7, before).unwrap(), "sends no health reports");
}
