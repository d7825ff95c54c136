use skein_common::message::{Header, Mission};
use skein_common::time::SenderStamp;

use super::*;

fn id() -> VehicleId {
    VehicleId::new(3).unwrap()
}

fn view(membership: Membership, run: u64, life: u64) -> Seen {
    let header = Header { sender: id(), incarnation: Incarnation(life), sequence: 1, stamp: SenderStamp::ZERO };
    let mission = Mission {
        header,
        plan: 0,
        membership,
        step: 0,
        vouched: 0,
        reached: None,
        progress_m: 0.0,
        order: None,
        echo: None,
    };
    Seen { alive: true, mission: Some(mission), run: Some(run), ..Seen::default() }
}

#[test]
fn who_is_not_ready_is_told_why() {
    let why = |view: &Seen, after| lacks(Some(view), 7, after).unwrap();
    assert_eq!(lacks(None, 7, None).unwrap(), "not heard on the network");
    let gone = Seen { alive: false, ..view(Membership::Active, 7, 1) };
    assert_eq!(why(&gone, None), "not heard on the network");
    let silent = Seen { alive: true, ..Seen::default() };
    assert_eq!(why(&silent, None), "there, but silent");
    assert_eq!(
        why(&view(Membership::Active, 8, 1), None),
        "flies in another run of the swarm; `skein cluster down` first"
    );
    assert!(why(&view(Membership::Joining, 7, 1), None).starts_with("joins still"));
    assert_eq!(why(&view(Membership::Left, 7, 1), None), "has landed for good");
    // All that is wanting is its health.
    assert_eq!(why(&view(Membership::Active, 7, 1), None), "does not tell how it does");
}

#[test]
fn what_it_said_before_its_restart_does_not_count() {
    let before = Some(Incarnation(5));
    assert_eq!(lacks(Some(&view(Membership::Active, 7, 5)), 7, before).unwrap(), "not started again");
    assert_eq!(lacks(Some(&view(Membership::Active, 7, 6)), 7, before).unwrap(), "does not tell how it does");
}
