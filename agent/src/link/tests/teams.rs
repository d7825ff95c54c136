//! Links of a fleet: what a member of a team receives of its own team and of others.

use skein_common::scenario::load_any;
use skein_core::strangers::StrangerState;

use super::*;

pub(super) fn team_trust(swarm: &SwarmName, team: u16) -> Trust {
    let fleet = load_any(&Source { name: "x", text: "fleet.teams = 3\nswarm.vehicles = 1" }, &[]).unwrap();
    Trust { team: fleet.all()[usize::from(team) - 1].scenario.team, ..trust(swarm) }
}

pub(super) const HOME: Cell = Cell { x: 0, y: 0 };
const NEXT: Cell = Cell { x: 0, y: 1 };
const FAR: Cell = Cell { x: 9, y: 9 };

/// Agent 1/1 with a hub that the two others dial, its team mate 1/2, and the stranger 2/1.
fn three(test: &str) -> [Link; 3] {
    let (swarm, hub, dial) = hub(test);
    let link = |session, own, team| Link::new(session, id(own), LocalClock::start(), team_trust(&swarm, team)).unwrap();
    let dialling = || open_zenoh(&swarm, &[], &dial, &[]).unwrap();
    [link(hub, 1, 1), link(dialling(), 2, 1), link(dialling(), 1, 2)]
}

/// All states of strangers received until one of them is wanted; `again` is repeated.
pub(super) fn strangers(
    link: &Link,
    mut again: impl FnMut(),
    wanted: impl Fn(&StrangerState) -> bool,
) -> Vec<StrangerState> {
    let mut received = Vec::new();
    let deadline = now() + TIMEOUT;
    while !received.iter().any(&wanted) {
        assert!(now() < deadline, "received only {received:?}, dropped {:?}", link.drops());
        again();
        pause();
        link.drain_strangers(&mut received, &mut Vec::new());
    }
    received
}

#[test]
fn a_vehicle_that_crosses_a_border_is_neither_lost_nor_seen_twice() {
    let [own, mate, stranger] = three("border");
    own.subscribe_to(vec![HOME, NEXT]);
    let mut sequence = 0;
    strangers(
        &own,
        || {
            sequence += 1;
            stranger.publish_state(&state(1, sequence), HOME);
        },
        |_| true,
    );
    // Each state on its own, the cells alternating: all of them arrive, each once.
    let mut received = Vec::new();
    for nth in 0..20 {
        sequence += 1;
        stranger.publish_state(&state(1, sequence), if nth % 2 == 0 { NEXT } else { HOME });
        let wanted = |state: &StrangerState| state.order.sequence == sequence;
        received.extend(strangers(&own, || {}, wanted).into_iter().filter(|state| state.order.sequence > sequence - 1));
    }
    let names: Vec<String> = received.iter().map(|state| state.id.to_string()).collect();
    assert_eq!(names, vec!["2/1"; 20]);
    // A state from elsewhere, and states of the own team, are not among the strangers'.
    stranger.publish_state(&state(1, sequence + 1), FAR);
    let members = until(
        &own,
        || {
            sequence += 1;
            mate.publish_state(&state(2, sequence), HOME);
        },
        |received| (!received.is_empty()).then(|| received.to_vec()),
    );
    assert!(members.iter().all(|received| received.message.sender() == Some(id(2))), "{members:?}");
    let after = strangers(
        &own,
        || {
            sequence += 2;
            stranger.publish_state(&state(1, sequence), HOME);
        },
        |_| true,
    );
    assert!(after.iter().all(|state| state.id.to_string() == "2/1"), "{after:?}");
    assert_eq!(own.drops(), Drops::default(), "no message arrived twice");
}

#[test]
fn heartbeats_and_orders_stay_in_their_team() {
    let [own, mate, stranger] = three("team-orders");
    let order = Order { epoch: 1, issuer: 9, verb: Verb::Hold, vehicles: None, signature: None };
    let session = stranger.sessions.first();
    let mut sequence = 0;
    let received = until(
        &own,
        || {
            sequence += 1;
            stranger.publish_mission(&mission(1, sequence));
            send(session, "team/2/order/9", &encode(&order));
            send(session, "order/9", &encode(&order));
            mate.publish_mission(&mission(2, sequence));
        },
        |received| (received.len() > 5).then(|| received.to_vec()),
    );
    let is_of_mate = |received: &Received| received.message.sender() == Some(id(2));
    assert!(received.iter().all(is_of_mate), "{received:?}");
    let given = until(
        &own,
        || send(session, "team/1/order/9", &encode(&order)),
        |received| message(received, |message| *message == PeerMessage::Order(order)),
    );
    assert_eq!(given.message.sender(), None);
}

#[test]
fn a_stranger_of_a_team_that_does_not_exist_or_in_another_name_is_refused() {
    let [own, _, stranger] = three("no-team");
    own.subscribe_to(vec![HOME]);
    let session = stranger.sessions.first();
    let mut sequence = 0;
    let received = strangers(
        &own,
        || {
            sequence += 1;
            let bytes = encode(&state(7, sequence));
            send(session, "team/4/vehicle/7/cell/0/0/state", &bytes);
            send(session, "team/2/vehicle/8/cell/0/0/state", &bytes);
            stranger.publish_state(&state(1, sequence), HOME);
        },
        |_| own.drops().forged >= 4,
    );
    assert!(received.iter().all(|state| state.id.to_string() == "2/1"), "{received:?}");
}
